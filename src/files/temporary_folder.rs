//! Folders that are removed when the program ends. If a program was killed, the next run removes its folder.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, SystemTime};

use tempfile::TempDir;

use crate::files::unfinished::Unfinished;

/// Number of random characters at the end of a name.
const RANDOM: usize = 6;
/// A folder younger than this may belong to a program that has not locked it yet.
const YOUNG: Duration = Duration::from_secs(60);

/// A folder with a random name, which is removed when this is dropped.
pub struct TemporaryFolder {
    folder: TempDir,
    /// The folder, which is locked as long as this program runs.
    _lock: File,
    _unfinished: Unfinished,
}

impl TemporaryFolder {
    /// Creates a folder in `parent` whose name begins with `prefix`. Folders with this prefix that killed programs have
    /// left are removed.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn create(parent: &Path, prefix: &str, mode: u32) -> io::Result<Self> {
        remove_left(parent, prefix);
        let folder = tempfile::Builder::new()
            .prefix(prefix)
            .rand_bytes(RANDOM)
            .permissions(PermissionsExt::from_mode(mode))
            .tempdir_in(parent)?;
        let unfinished = Unfinished::note(folder.path());
        let lock = File::open(folder.path())?;
        // If locks do not work there, no folder is found unlocked, and old folders stay.
        if let Err(TryLockError::Error(error)) = lock.try_lock_shared() {
            log::debug!("{}: {error}", folder.path().display());
        }
        Ok(Self {
            folder,
            _lock: lock,
            _unfinished: unfinished,
        })
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Best effort: the next run tries again to remove what stays.
fn remove_left(parent: &Path, prefix: &str) {
    let is_left = |entry: &fs::DirEntry| -> io::Result<bool> {
        let name = entry.file_name();
        let random = name.to_str().and_then(|name| name.strip_prefix(prefix));
        let ours = random.is_some_and(|random| {
            random.len() == RANDOM && random.bytes().all(|byte| byte.is_ascii_alphanumeric())
        });
        if !ours || !entry.file_type()?.is_dir() {
            return Ok(false);
        }
        let age = SystemTime::now().duration_since(entry.metadata()?.modified()?);
        Ok(age.is_ok_and(|age| age >= YOUNG) && File::open(entry.path())?.try_lock().is_ok())
    };
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        if is_left(&entry).unwrap_or(false)
            && let Err(error) = fs::remove_dir_all(entry.path())
        {
            log::debug!("{}: {error}", entry.path().display());
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_a_killed_program_left_goes_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        let age = |path: &Path| {
            let old = SystemTime::now() - 2 * YOUNG;
            File::open(path).unwrap().set_modified(old).unwrap();
        };
        let used = TemporaryFolder::create(root.path(), "work-", 0o700).unwrap();
        fs::write(used.path().join("file"), "").unwrap();
        age(used.path());
        for (name, old) in [
            ("work-aB3dE6", true),
            ("work-young1", false),
            ("work-mine", true),
            ("other-aB3dE6", true),
        ] {
            fs::create_dir(at(name)).unwrap();
            fs::write(at(name).join("file"), "").unwrap();
            if old {
                age(&at(name));
            }
        }
        fs::write(at("work-file12"), "").unwrap();
        age(&at("work-file12"));
        let next = TemporaryFolder::create(root.path(), "work-", 0o700).unwrap();
        assert!(!at("work-aB3dE6").exists());
        for name in ["work-young1", "work-mine", "other-aB3dE6", "work-file12"] {
            assert!(at(name).exists(), "{name}");
        }
        assert!(used.path().join("file").exists());
        let places = [used.path().to_owned(), next.path().to_owned()];
        drop((used, next));
        assert!(places.iter().all(|place| !place.exists()));
    }
}
