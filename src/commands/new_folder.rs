//! Folders that appear whole or not at all.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use gapwatch::whole_file::unnamed;
use tempfile::TempDir;

/// A folder under another name until it is complete; removed if that never happens.
pub struct NewFolder {
    folder: TempDir,
    target: PathBuf,
}

impl NewFolder {
    /// Begins the folder `target`, which must not exist or be empty.
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
        let parent = target
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let folder = tempfile::Builder::new()
            .prefix(".gapwatch-")
            .permissions(PermissionsExt::from_mode(0o755))
            .tempdir_in(parent)
            .map_err(|error| unnamed(&error))
            .with_context(|| format!("cannot create {}", target.display()))?;
        Ok(Self { folder, target })
    }

    /// Where its files are written.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Puts the folder in its place.
    pub fn keep(self) -> anyhow::Result<()> {
        fs::rename(self.path(), &self.target)
            .with_context(|| format!("cannot put {} in place", self.target.display()))
    }
}
