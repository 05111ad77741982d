//! Files that appear whole or not at all, and are read whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// Reads a file of at most `most` bytes: what is larger, or never ends, costs no more memory than that.
///
/// # Errors
/// When it cannot be read, or is larger.
pub fn read_whole(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let why = format!("more than {most} bytes, which no file of its kind has");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, why));
    }
    Ok(bytes)
}

/// As [`read_whole`], of text.
///
/// # Errors
/// As [`read_whole`], and when it is not UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let not_text = |_| io::Error::new(io::ErrorKind::InvalidData, "not text in UTF-8");
    String::from_utf8(read_whole(path, most)?).map_err(not_text)
}

/// A file being written beside its place; dropped without [`WholeFile::finish`] it leaves nothing behind.
pub struct WholeFile(Target);

enum Target {
    Beside {
        file: BufWriter<NamedTempFile>,
        place: PathBuf,
    },
    /// A device or pipe, which must not be replaced.
    Through(BufWriter<File>),
}

impl WholeFile {
    /// Begins a file at `path`.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn create(path: &Path) -> io::Result<Self> {
        match path.metadata() {
            Ok(there) if there.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(there) if !there.is_file() => {
                return Ok(Self(Target::Through(BufWriter::new(
                    OpenOptions::new().write(true).open(path)?,
                ))));
            }
            // What may not be written may not be replaced either.
            Ok(_) => drop(OpenOptions::new().append(true).open(path)?),
            Err(_) => {}
        }
        // A link to a file stays a link: what it names is replaced.
        let place = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let folder = place
            .parent()
            .filter(|p| !p.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let file = tempfile::Builder::new()
            .permissions(PermissionsExt::from_mode(0o644))
            .tempfile_in(folder)
            .map_err(|error| unnamed(&error))?;
        Ok(Self(Target::Beside {
            file: BufWriter::new(file),
            place,
        }))
    }

    /// Puts the file in its place.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn finish(self) -> io::Result<()> {
        match self.0 {
            Target::Beside { file, place } => {
                let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
                file.persist(place).map(drop).map_err(|error| error.error)
            }
            Target::Through(mut file) => file.flush(),
        }
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.0 {
            Target::Beside { file, .. } => file.write(bytes),
            Target::Through(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.0 {
            Target::Beside { file, .. } => file.flush(),
            Target::Through(file) => file.flush(),
        }
    }
}

/// An error of `tempfile` without the name of the temporary file or folder, which nobody typed.
pub fn unnamed(error: &io::Error) -> io::Error {
    let said = error.to_string();
    let of_system = said
        .split_once(" at path \"")
        .map_or(said.as_str(), |(before, _)| before);
    io::Error::new(error.kind(), of_system)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::fs;

    #[test]
    fn a_file_appears_only_when_it_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"one").unwrap();
        drop(file);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"two").unwrap();
        assert!(!path.exists());
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn devices_are_written_through_and_folders_refused() {
        WholeFile::create(Path::new("/dev/null"))
            .unwrap()
            .finish()
            .unwrap();
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
        assert!(WholeFile::create(tempfile::tempdir().unwrap().path()).is_err());
        let error = WholeFile::create(Path::new("/no/such/folder/file"))
            .err()
            .unwrap();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert_eq!(error.to_string(), "No such file or directory (os error 2)");
    }

    #[test]
    fn a_link_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a"), folder.path().join("b"));
        fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        let mut whole = WholeFile::create(&link).unwrap();
        whole.write_all(b"new").unwrap();
        whole.finish().unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"new");
        assert!(link.is_symlink());
    }
}
