//! Files that appear whole or not at all, and are read whole or not at all.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags, linkat};
use tempfile::TempPath;

use crate::files::durable::{folder_of, sync, sync_folder};
use crate::files::unfinished::Unfinished;

/// Beginning of the temporary names of files while they are put in place.
const PREFIX: &str = ".gapwatch-";

/// Reads a file of at most `most` bytes. A file that is larger, or that never ends, takes no more memory than this.
///
/// # Errors
/// When it cannot be read, or when it is larger.
pub fn read_whole(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    read_to_end(File::open(path)?, most)
}

fn read_to_end(file: File, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let why = format!("more than {most} bytes, which is too large for this kind of file");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, why));
    }
    Ok(bytes)
}

/// Like [`read_whole`], for a plain file alone.
///
/// # Errors
/// Like [`read_whole`], and when it is a link, a folder, a device or a pipe.
pub fn read_plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    // A pipe without a writer would wait for one.
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let wrong = |what: &str| io::Error::new(io::ErrorKind::InvalidInput, what);
    let opened = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
        rustix::io::Errno::LOOP => wrong("it is a link"),
        error => error.into(),
    })?;
    let file = File::from(opened);
    if !file.metadata()?.is_file() {
        return Err(wrong("it is not a plain file"));
    }
    read_to_end(file, most)
}

/// Like [`read_whole`], for text. A byte order mark in front of it, as editors of Windows write it, is left out.
///
/// # Errors
/// Like [`read_whole`], and when it is not UTF-8.
pub fn read_text(path: &Path, most: u64) -> io::Result<String> {
    let bytes = read_whole(path, most)?;
    let not_text = |_| io::Error::new(io::ErrorKind::InvalidData, "not text in UTF-8");
    String::from_utf8(without_mark(&bytes).to_vec()).map_err(not_text)
}

/// Text without the byte order mark in front of it.
pub fn without_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(text)
}

/// A file that is written without a name. If it is dropped without [`WholeFile::finish`], or if the program is killed,
/// nothing is left. If the file system does not support files without names, it is written under another name beside
/// its place, and this file is left only by a killed program.
pub struct WholeFile(Target);

enum Target {
    Beside {
        file: BufWriter<File>,
        /// `None` for a file without a name.
        name: Option<(TempPath, Unfinished)>,
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
        Self::begin(path, without_name)
    }

    fn begin(path: &Path, nameless: fn(&Path) -> Option<File>) -> io::Result<Self> {
        match path.metadata() {
            Ok(there) if there.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
            Ok(there) if !there.is_file() => {
                return Ok(Self(Target::Through(BufWriter::new(
                    OpenOptions::new().write(true).open(path)?,
                ))));
            }
            // A file that may not be written to may not be replaced either.
            Ok(_) => drop(OpenOptions::new().append(true).open(path)?),
            Err(_) => {}
        }
        // A link to a file stays a link: its target is replaced.
        let place = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let folder = folder_of(&place);
        let (file, name) = match nameless(folder) {
            Some(file) => (file, None),
            None => {
                let named = tempfile::Builder::new()
                    .prefix(PREFIX)
                    .permissions(PermissionsExt::from_mode(0o644))
                    .tempfile_in(folder)
                    .map_err(|error| unnamed(&error))?;
                let (file, name) = named.into_parts();
                let unfinished = Unfinished::note(&name);
                (file, Some((name, unfinished)))
            }
        };
        Ok(Self(Target::Beside {
            file: BufWriter::new(file),
            name,
            place,
        }))
    }

    /// Puts the file in its place. It is on the disk when this returns.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(self) -> io::Result<()> {
        match self.0 {
            Target::Beside { file, name, place } => {
                let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
                sync(&file)?;
                let folder = folder_of(&place);
                let (name, _unfinished) = name.map_or_else(|| named(&file, folder), Ok)?;
                name.persist(&place).map_err(|error| error.error)?;
                sync_folder(folder)
            }
            Target::Through(mut file) => file.flush(),
        }
    }
}

/// A file without a name; `None` if the file system has no files that can be given a name later, or if nothing can be
/// written.
fn without_name(folder: &Path) -> Option<File> {
    let flags = OFlags::WRONLY | OFlags::TMPFILE | OFlags::CLOEXEC;
    let file = File::from(rustix::fs::open(folder, flags, Mode::from(0o644)).ok()?);
    name_of_open(&file).exists().then_some(file)
}

/// The path under which every program sees its own open files, also those without a name.
fn name_of_open(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()))
}

/// Gives a file without a name a name in `folder`.
fn named(file: &File, folder: &Path) -> io::Result<(TempPath, Unfinished)> {
    let open = name_of_open(file);
    let link = |name: &Path| Ok(linkat(CWD, &open, CWD, name, AtFlags::SYMLINK_FOLLOW)?);
    let mut builder = tempfile::Builder::new();
    let name = builder.prefix(PREFIX).make_in(folder, link)?;
    let name = name.into_temp_path();
    let unfinished = Unfinished::note(&name);
    Ok((name, unfinished))
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

/// An error of `tempfile` without the name of the temporary file or folder, which the user does not know.
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
    fn a_file_being_written_has_no_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(&[1; 100_000]).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), [1; 100_000]);
    }

    #[test]
    fn without_nameless_files_it_is_the_same_file() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other) = (folder.path().join("one"), folder.path().join("other"));
        let mut named = WholeFile::begin(&one, |_| None).unwrap();
        let mut unnamed = WholeFile::create(&other).unwrap();
        for file in [&mut named, &mut unnamed] {
            file.write_all(b"text").unwrap();
        }
        drop(WholeFile::begin(&one, |_| None).unwrap());
        named.finish().unwrap();
        unnamed.finish().unwrap();
        let (one, other) = (fs::metadata(&one).unwrap(), fs::metadata(&other).unwrap());
        assert_eq!(one.permissions(), other.permissions());
        assert_eq!((one.len(), other.len()), (4, 4));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
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
    fn only_plain_files_are_read_as_such() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("file"), "data").unwrap();
        std::os::unix::fs::symlink("file", path("link")).unwrap();
        rustix::fs::mkfifoat(CWD, path("pipe"), Mode::from(0o600)).unwrap();
        assert_eq!(read_plain(&path("file"), 4).unwrap(), b"data");
        let refused = |path: &Path, most| read_plain(path, most).unwrap_err();
        assert_eq!(
            refused(&path("file"), 3).kind(),
            io::ErrorKind::FileTooLarge
        );
        assert_eq!(refused(&path("none"), 4).kind(), io::ErrorKind::NotFound);
        assert!(refused(&path("link"), 4).to_string().contains("a link"));
        for other in [path("pipe"), folder.path().to_owned()] {
            let said = refused(&other, 4).to_string();
            assert!(said.contains("not a plain file"), "{said}");
        }
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
