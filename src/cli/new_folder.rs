//! Folders that appear whole or not at all.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use gapwatch::files::durable::{folder_of, put_in_place, sync_contents};
use gapwatch::files::temporary_folder::TemporaryFolder;
use gapwatch::files::whole_file::unnamed;

/// A folder under another name until it is complete; removed if that never happens.
pub struct NewFolder {
    folder: TemporaryFolder,
    target: PathBuf,
}

impl NewFolder {
    /// Begins the folder `target`, which must be new or empty.
    pub fn beside(target: &Path) -> anyhow::Result<Self> {
        let empty =
            |target: &Path| fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_none());
        if target.exists() && !empty(target) {
            bail!(
                "{} exists and is not an empty folder; name another with --out",
                target.display()
            );
        }
        // A link to an empty folder stays a link.
        let target = target.canonicalize().unwrap_or_else(|_| target.to_owned());
        let folder = TemporaryFolder::create(folder_of(&target), ".gapwatch-", 0o755)
            .map_err(|error| unnamed(&error))
            .with_context(|| format!("cannot create {}", target.display()))?;
        Ok(Self { folder, target })
    }

    /// The folder into which its files are written.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Puts the folder in its place. When this returns, the folder is on the disk with everything in it.
    pub fn keep(self) -> anyhow::Result<()> {
        sync_contents(self.path())
            .and_then(|()| put_in_place(self.path(), &self.target))
            .with_context(|| format!("cannot put {} in place", self.target.display()))
    }
}
