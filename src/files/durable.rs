//! Files and folders that are on the disk, with their names, before they are reported, so that they stay even if the
//! power is cut just after.
//!
//! The order is always the same: the content is synced, the name is given, and the folder that holds the name is
//! synced. If a file system cannot sync a file or folder, this is accepted. An error of the disk is an error.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use rustix::fs::{CWD, RenameFlags, renameat_with, syncfs};
use rustix::io::Errno;

/// The folder that holds the name `path`.
pub fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Returns when the content of a file, or the names in a folder, are on the disk.
///
/// # Errors
/// When the disk reports an error.
pub fn sync(file: &File) -> io::Result<()> {
    synced(file.sync_all())
}

/// Returns when the names in a folder are on the disk. A folder that may be written to but not read cannot be synced;
/// this is accepted.
///
/// # Errors
/// When it does not exist, or when the disk reports an error.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    match File::open(folder) {
        Err(error) if error.kind() == io::ErrorKind::PermissionDenied => Ok(()),
        opened => sync(&opened?),
    }
}

/// Returns when everything below a folder is on the disk, together with all other unwritten data of its file system.
/// One call is enough for any number of files.
///
/// # Errors
/// When the folder cannot be read, or when the disk reports an error.
pub fn sync_contents(folder: &Path) -> io::Result<()> {
    synced(syncfs(File::open(folder)?).map_err(io::Error::from))
}

/// The answer of a file system that cannot sync is not an error of the disk.
fn synced(result: io::Result<()>) -> io::Result<()> {
    let cannot = [Errno::INVAL, Errno::OPNOTSUPP, Errno::NOSYS].map(Errno::raw_os_error);
    match result {
        Err(error) if error.raw_os_error().is_some_and(|it| cannot.contains(&it)) => Ok(()),
        result => result,
    }
}

/// Renames `from`, whose content is on the disk, to `to` in the same folder, and replaces what may have that name.
/// Returns when the name is on the disk.
///
/// # Errors
/// When it cannot be renamed, or when the disk reports an error.
pub fn put_in_place(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)?;
    sync_folder(folder_of(to))
}

/// Renames `from` to `to`, if this name is free; the folder is not synced yet.
///
/// # Errors
/// `AlreadyExists` if the name is not free, or another error if it cannot be renamed.
pub fn rename_to_free_name(from: &Path, to: &Path) -> io::Result<()> {
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // The file system does not support this flag.
        Err(Errno::INVAL | Errno::NOSYS | Errno::OPNOTSUPP) => match to.symlink_metadata() {
            Ok(_) => Err(io::ErrorKind::AlreadyExists.into()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => fs::rename(from, to),
            Err(error) => Err(error),
        },
        renamed => Ok(renamed?),
    }
}

/// Creates a folder and the missing folders above it; returns when their names are on the disk.
///
/// # Errors
/// When a folder cannot be created, or when the disk reports an error.
pub fn create_folders(path: &Path) -> io::Result<()> {
    let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.is_dir();
    let missing: Vec<&Path> = path.ancestors().take_while(missing).collect();
    for folder in missing.into_iter().rev() {
        match fs::create_dir(folder) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && folder.is_dir() => {}
            made => made?,
        }
        sync_folder(folder_of(folder))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn what_cannot_be_synced_is_taken_as_it_is_and_an_error_of_the_disk_is_one() {
        let said = |errno: Errno| synced(Err(errno.into()));
        assert!(said(Errno::INVAL).is_ok() && said(Errno::OPNOTSUPP).is_ok());
        assert!(said(Errno::IO).is_err() && said(Errno::NOSPC).is_err());
        // A real case: the kernel's own files cannot be synced.
        sync_folder(Path::new("/proc/self")).unwrap();
        assert!(sync_folder(Path::new("/no/such/folder")).is_err());
    }

    #[test]
    fn a_name_that_is_taken_is_left_alone() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        fs::create_dir(at("new")).unwrap();
        // An empty folder would be replaced by a plain rename.
        fs::create_dir(at("folder")).unwrap();
        fs::write(at("file"), "kept").unwrap();
        std::os::unix::fs::symlink("nowhere", at("link")).unwrap();
        for taken in ["folder", "file", "link"] {
            let error = rename_to_free_name(&at("new"), &at(taken)).unwrap_err();
            assert_eq!(error.kind(), io::ErrorKind::AlreadyExists, "{taken}");
        }
        assert!(at("new").is_dir() && at("folder").is_dir() && at("link").is_symlink());
        rename_to_free_name(&at("new"), &at("free")).unwrap();
        assert!(at("free").is_dir() && !at("new").exists());
    }

    #[test]
    fn folders_are_made_where_they_are_missing() {
        let root = tempfile::tempdir().unwrap();
        let deep = root.path().join("a/b/c");
        create_folders(&deep).unwrap();
        create_folders(&deep).unwrap();
        assert!(deep.is_dir());
        fs::write(root.path().join("file"), "").unwrap();
        assert!(create_folders(&root.path().join("file")).is_err());
        assert!(create_folders(&root.path().join("file/below")).is_err());
    }
}
