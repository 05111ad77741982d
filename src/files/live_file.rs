//! Files that grow while they are read: every line is in the file as soon as it is written, and on the disk a second
//! later.
//!
//! A thread writes the lines, so that the caller never waits for a disk. If the disk is full, whole lines are lost,
//! counted and logged, and nothing else is affected. An earlier file of the same name is kept as `NAME.1`, and replaces the one
//! before it; a file of another kind is never replaced.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel,
};
use std::time::{Duration, Instant};

use crate::files::durable;

/// Largest number of lines that wait for a disk that hangs: several minutes of a monitor.
const QUEUE_MAX: usize = 4_096;
/// Longest time until a line is on the disk.
const SYNC_EVERY: Duration = Duration::from_secs(1);
/// How long the end waits for a disk that hangs.
const FINISH_WITHIN: Duration = Duration::from_secs(3);
/// Shortest time between two log lines about the same error.
const COMPLAINT: Duration = Duration::from_secs(1);
/// Bytes at the beginning of a file by which its kind is known.
const HEAD: u64 = 64;
/// Largest number in the name of an earlier file.
const EARLIER_MAX: u32 = 100;

/// A file that is being written.
pub struct LiveFile {
    name: String,
    lines: SyncSender<Vec<u8>>,
    ended: Receiver<io::Result<()>>,
    left_out: LeftOut,
}

impl LiveFile {
    /// Begins a file at `path`; an earlier regular file is kept beside it. `is_own` tells by the first bytes of a file
    /// whether it is of the kind that is written.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn create(path: &Path, is_own: fn(&[u8]) -> bool) -> io::Result<Self> {
        let (file, place) = open(path, is_own)?;
        let name = path.display().to_string();
        let (lines, to_write) = sync_channel(QUEUE_MAX);
        let (says_how, ended) = channel();
        let mut writer = Writer {
            file,
            place,
            whole: 0,
            unsynced_since: None,
            left_out: LeftOut::new(&name),
        };
        std::thread::Builder::new()
            .name("live-file".to_owned())
            .spawn(move || {
                // There is no receiver if the program's end did not wait.
                let _ = says_how.send(writer.run(&to_write));
            })?;
        Ok(Self {
            left_out: LeftOut::new(&name),
            name,
            lines,
            ended,
        })
    }

    /// Waits until all lines are on the disk, but at most a few seconds.
    ///
    /// # Errors
    /// When they are not on the disk, or when some lines were left out.
    pub fn finish(self) -> io::Result<()> {
        let Self {
            lines,
            ended,
            left_out,
            ..
        } = self;
        drop(lines);
        match ended.recv_timeout(FINISH_WITHIN) {
            Ok(how) => how?,
            Err(_) => {
                return Err(io::Error::new(
                    io::ErrorKind::TimedOut,
                    "the last lines are not on the disk",
                ));
            }
        }
        left_out.outcome()
    }
}

/// Each call writes one whole line.
impl Write for LiveFile {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match self.lines.try_send(line.to_vec()) {
            Ok(()) => self.left_out.over(),
            Err(TrySendError::Full(_)) => self
                .left_out
                .add("the disk does not accept data", Instant::now()),
            Err(TrySendError::Disconnected(_)) => {
                return Err(io::Error::other(format!(
                    "the writer of {} ended",
                    self.name
                )));
            }
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Counts of lines that were not written.
struct LeftOut {
    name: String,
    all: u64,
    /// Number since the last line that was written.
    now: u64,
    complained_at: Option<Instant>,
}

impl LeftOut {
    fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            all: 0,
            now: 0,
            complained_at: None,
        }
    }

    fn add(&mut self, why: &str, now: Instant) {
        self.all += 1;
        self.now += 1;
        if self.complained_at.is_none_or(|at| now - at >= COMPLAINT) {
            self.complained_at = Some(now);
            let (name, count) = (&self.name, self.now);
            log::error!(
                "{name}: {why}; lines are left out until they can be written again, {count} so far"
            );
        }
    }

    /// A line could be written.
    fn over(&mut self) {
        if self.now > 0 {
            log::warn!(
                "{}: lines are written again; {} were left out",
                self.name,
                self.now
            );
            self.now = 0;
            self.complained_at = None;
        }
    }

    fn outcome(&self) -> io::Result<()> {
        match self.all {
            0 => Ok(()),
            count => Err(io::Error::other(format!("{count} lines are left out"))),
        }
    }
}

/// The thread that receives from the queue.
struct Writer {
    file: File,
    /// Path of the file; `None` for a device or pipe, which is neither truncated nor synced.
    place: Option<PathBuf>,
    /// Number of bytes in whole lines.
    whole: u64,
    unsynced_since: Option<Instant>,
    left_out: LeftOut,
}

impl Writer {
    fn run(&mut self, lines: &Receiver<Vec<u8>>) -> io::Result<()> {
        loop {
            let wait = self
                .unsynced_since
                .map(|since| SYNC_EVERY.saturating_sub(since.elapsed()));
            let line = match wait {
                None => lines.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(wait) => lines.recv_timeout(wait),
            };
            match line {
                Ok(line) => self.take(&line),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if self
                .unsynced_since
                .is_some_and(|since| since.elapsed() >= SYNC_EVERY)
            {
                self.unsynced_since = None;
                if let Err(error) = self.sync() {
                    log::error!("{}: {error}", self.left_out.name);
                }
            }
        }
        self.sync()?;
        self.left_out.outcome()
    }

    fn take(&mut self, line: &[u8]) {
        match self.file.write_all(line) {
            Ok(()) => {
                self.whole += line.len() as u64;
                self.unsynced_since.get_or_insert_with(Instant::now);
                self.left_out.over();
            }
            Err(error) => {
                self.left_out.add(&error.to_string(), Instant::now());
                if self.place.is_some() {
                    // Half a line would damage the next line. If even this fails, the reader reports the line.
                    let _ = self.file.set_len(self.whole);
                    let _ = self.file.seek(SeekFrom::Start(self.whole));
                }
            }
        }
    }

    fn sync(&self) -> io::Result<()> {
        if self.place.is_some() {
            durable::sync(&self.file)
        } else {
            Ok(())
        }
    }
}

fn open(path: &Path, is_own: fn(&[u8]) -> bool) -> io::Result<(File, Option<PathBuf>)> {
    // A link to a file stays a link.
    let place = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    match place.metadata() {
        Ok(there) if there.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(there) if !there.is_file() => {
            return Ok((OpenOptions::new().write(true).open(place)?, None));
        }
        Ok(there) => {
            // A file that may not be written to may not be moved either.
            drop(OpenOptions::new().append(true).open(&place)?);
            if there.len() > 0 {
                fs::rename(&place, name_of_earlier(&place, is_own)?)?;
            }
        }
        Err(_) => {}
    }
    let file = File::create(&place)?;
    durable::sync_folder(durable::folder_of(&place))?;
    Ok((file, Some(place)))
}

/// The first of `NAME.1`, `NAME.2` and so on that is free, or that holds nothing or a file of the kind that is written.
fn name_of_earlier(place: &Path, is_own: fn(&[u8]) -> bool) -> io::Result<PathBuf> {
    for number in 1..=EARLIER_MAX {
        let mut name = place.as_os_str().to_owned();
        name.push(format!(".{number}"));
        let name = PathBuf::from(name);
        let free = match File::open(&name) {
            Ok(file) => {
                let mut head = Vec::new();
                file.take(HEAD).read_to_end(&mut head)?;
                head.iter().all(|&byte| byte == 0) || is_own(&head)
            }
            Err(error) => error.kind() == io::ErrorKind::NotFound,
        };
        if free {
            return Ok(name);
        }
    }
    Err(io::Error::new(
        io::ErrorKind::AlreadyExists,
        format!(
            "its earlier file has no place: NAME.1 to NAME.{EARLIER_MAX} are files of another kind"
        ),
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn is_own(head: &[u8]) -> bool {
        !head.starts_with(b"notes")
    }

    #[test]
    fn a_file_of_another_kind_is_kept_whatever_follows() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        fs::write(&path, "notes").unwrap();
        for text in ["one\n", "two\n", "three\n"] {
            let mut file = LiveFile::create(&path, is_own).unwrap();
            file.write_all(text.as_bytes()).unwrap();
            file.finish().unwrap();
        }
        let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
        assert_eq!(
            [read("j"), read("j.1"), read("j.2")],
            ["three\n", "notes", "two\n"]
        );
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
    }

    #[test]
    fn a_line_is_there_while_the_file_is_open() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j.jsonl");
        let mut file = LiveFile::create(&path, is_own).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"");
        for n in 0..3 {
            file.write_all(format!("line {n}\n").as_bytes()).unwrap();
            let wanted: String = (0..=n).map(|n| format!("line {n}\n")).collect();
            let until = Instant::now() + Duration::from_secs(10);
            while fs::read_to_string(&path).unwrap() != wanted {
                assert!(Instant::now() < until, "line {n} is not there");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        file.finish().unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap().lines().count(), 3);
    }

    #[test]
    fn an_earlier_file_is_kept_once_and_an_empty_one_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("can.log");
        for text in ["one\n", "two\n", "", "three\n"] {
            let mut file = LiveFile::create(&path, is_own).unwrap();
            file.write_all(text.as_bytes()).unwrap();
            file.finish().unwrap();
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), "three\n");
        let earlier = folder.path().join("can.log.1");
        assert_eq!(fs::read_to_string(earlier).unwrap(), "two\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn devices_are_written_through_and_what_cannot_be_written_is_refused() {
        let mut null = LiveFile::create(Path::new("/dev/null"), is_own).unwrap();
        null.write_all(b"line\n").unwrap();
        null.finish().unwrap();
        assert!(!Path::new("/dev/null").metadata().unwrap().is_file());
        assert!(LiveFile::create(tempfile::tempdir().unwrap().path(), is_own).is_err());
        assert!(LiveFile::create(Path::new("/no/such/folder/file"), is_own).is_err());
    }

    #[test]
    fn a_full_disk_costs_lines_and_is_told_at_the_end() {
        let mut full = LiveFile::create(Path::new("/dev/full"), is_own).unwrap();
        for _ in 0..5 {
            full.write_all(b"line\n").unwrap();
        }
        let said = full.finish().unwrap_err().to_string();
        assert_eq!(said, "5 lines are left out");
    }
}
