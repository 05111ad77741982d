//! Files and folders under temporary names that are removed if a signal ends the program before they are complete.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
/// Other threads may still write into a folder that is being removed.
const TRIES: usize = 100;

/// A temporary name. When this is dropped, the name belongs to someone else, or is gone.
#[derive(Debug)]
pub struct Unfinished(PathBuf);

impl Unfinished {
    /// Notes a temporary name.
    pub fn note(path: &Path) -> Self {
        // The folder in which the program works may change.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        names().insert(path.clone());
        Self(path)
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        names().remove(&self.0);
    }
}

/// Removes everything that has a temporary name now.
pub fn remove_all() {
    for path in names().iter() {
        let mut tries = 0;
        while path.symlink_metadata().is_ok() && tries < TRIES {
            let _ = match path.is_dir() {
                true => fs::remove_dir_all(path),
                false => fs::remove_file(path),
            };
            tries += 1;
        }
    }
}

fn names() -> std::sync::MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}
