//! The folder of events on disk: each event appears whole, the quota is kept, and files that are not events are left
//! alone.
//!
//! An event is a folder that is named by its number and holds an `event.json`. A new event is written under another
//! name, synced, and put in place when there is room for it within the quota, so that no older event is removed for an
//! event that cannot be written. Only on a full disk, room is made first. The files of all events in place never exceed
//! the quota. While an event is written, its own files, at most the quota again, exist in addition. What cannot be
//! removed continues to count in the quota, and its removal is tried again.

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::event::{EVENT_FILE, Event};
use super::quota::Quota;
use crate::capture::clock;
use crate::files::durable::{create_folders, put_in_place, rename_to_free_name, sync, sync_folder};

/// Names under which events are written and removed; they never count as events.
const UNFINISHED: &str = ".unfinished-";
/// Text after the number of an event that is being removed.
const GONE: &str = "-gone";
/// The largest number of an event.
const NUMBER_MAX: u64 = 999_999_999_999_999;
/// An event in the folder.
pub struct OnDisk {
    pub number: u64,
    pub bytes: u64,
    written: Written,
}

impl OnDisk {
    /// The name of its folder.
    pub fn name(&self) -> String {
        name_of(self.number)
    }
}

/// When an event was written. The clock of a computer without a battery jumps when it receives the time; this does not
/// change the age of what was written in this run.
enum Written {
    Before(SystemTime),
    InThisRun(Instant),
}

impl Written {
    /// `None` if the clock was not set then or is not set now, or if the event would be from the future.
    fn age(&self, now: SystemTime) -> Option<Duration> {
        match self {
            Self::Before(at) if clock::is_set(*at) && clock::is_set(now) => {
                now.duration_since(*at).ok()
            }
            Self::Before(_) => None,
            Self::InThisRun(at) => Some(at.elapsed()),
        }
    }
}

/// What an earlier write or removal left and what cannot be removed yet: its bytes count.
struct Leftover {
    path: PathBuf,
    bytes: u64,
}

/// The content of a folder.
#[derive(Default)]
pub struct Content {
    /// Events, the oldest first.
    pub events: Vec<OnDisk>,
    /// Folders of events that were being written or removed when a program ended.
    pub unfinished: Vec<PathBuf>,
    /// Names of everything else.
    pub others: Vec<String>,
}

impl Content {
    pub fn of(folder: &Path) -> io::Result<Self> {
        let mut content = Self::default();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let (path, name) = (entry.path(), entry.file_name());
            let name = name.to_string_lossy();
            let event = number(&name).map_or(Ok(None), |number| on_disk(&path, number));
            match event {
                Ok(Some(event)) => content.events.push(event),
                // A link to a folder is not a folder here.
                Ok(None) if is_unfinished(&name) && entry.file_type()?.is_dir() => {
                    content.unfinished.push(path);
                }
                Ok(None) => content.others.push(name.into_owned()),
                Err(error) => {
                    log::warn!("evidence {}: is left alone: {error}", path.display());
                    content.others.push(name.into_owned());
                }
            }
        }
        content.events.sort_unstable_by_key(|event| event.number);
        content.others.sort_unstable();
        Ok(content)
    }
}

/// The event in a folder that is named by its number, if it is one.
fn on_disk(folder: &Path, number: u64) -> io::Result<Option<OnDisk>> {
    if !is_event(folder)? {
        return Ok(None);
    }
    Ok(Some(OnDisk {
        number,
        bytes: bytes_in(folder)?,
        written: Written::Before(folder.symlink_metadata()?.modified()?),
    }))
}

/// The content of a folder of evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Found {
    /// Number of events.
    pub events: usize,
    /// Bytes of all their files.
    pub bytes: u64,
    /// Number of folders that a program left unfinished when it ended; the next run removes them.
    pub unfinished: usize,
    /// Names of files that are not events and are left alone.
    pub others: Vec<String>,
}

/// Opens a folder like [`EventRecorder::start`](super::EventRecorder::start), but changes nothing in it.
///
/// # Errors
/// When nothing can be written there, or when another program writes there.
pub fn examine(folder: &Path) -> io::Result<Found> {
    let lock = File::open(folder)?;
    // The lock is held only for a moment, so that a program that begins to write finds the folder free.
    lock.try_lock_shared().map_err(taken)?;
    lock.unlock()?;
    let content = Content::of(folder)?;
    tempfile::tempfile_in(folder)?;
    Ok(Found {
        events: content.events.len(),
        bytes: content.events.iter().map(|event| event.bytes).sum(),
        unfinished: content.unfinished.len(),
        others: content.others,
    })
}

fn taken(error: TryLockError) -> io::Error {
    match error {
        TryLockError::WouldBlock => io::Error::other(
            "another gapwatch keeps its evidence there; wanted a separate folder for each",
        ),
        TryLockError::Error(error) => error,
    }
}

pub struct EventFolder {
    path: PathBuf,
    /// The folder, which stays locked as long as this exists, so that no two programs write to it.
    _lock: File,
    quota: Quota,
    /// Events, the oldest first.
    events: Vec<OnDisk>,
    leftovers: Vec<Leftover>,
    next: u64,
    removed: u64,
    disk: Disk,
}

/// Operations on the disk that may fail; tests replace them.
#[derive(Clone, Copy)]
struct Disk {
    /// Writes a file, which is on the disk when this returns.
    write: fn(&Path, &[u8]) -> io::Result<()>,
    /// Removes a folder with everything in it.
    delete: fn(&Path) -> io::Result<()>,
}

impl Disk {
    const REAL: Self = Self {
        write: |path, bytes| {
            let mut file = File::create_new(path)?;
            file.write_all(bytes)?;
            sync(&file)
        },
        delete: |folder| fs::remove_dir_all(folder),
    };
}

impl EventFolder {
    /// Opens or creates a folder; what an earlier run left unfinished is removed.
    pub fn open(path: &Path, quota: Quota) -> io::Result<Self> {
        Self::open_on(Disk::REAL, path, quota)
    }

    fn open_on(disk: Disk, path: &Path, quota: Quota) -> io::Result<Self> {
        create_folders(path)?;
        let lock = File::open(path)?;
        lock.try_lock().map_err(taken)?;
        let Content {
            events, unfinished, ..
        } = Content::of(path)?;
        let mut folder = Self {
            path: path.to_owned(),
            _lock: lock,
            quota,
            next: events.last().map_or(1, |event| event.number + 1),
            events,
            leftovers: Vec::new(),
            removed: 0,
            disk,
        };
        for path in unfinished {
            folder.discard(path);
        }
        // An error at the start is better than a lost event at the first alarm.
        tempfile::tempfile_in(path)?;
        Ok(folder)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of events that were removed since the folder was opened, to make room or because they were old.
    pub fn removed(&self) -> u64 {
        self.removed
    }

    /// Adds an event, which is on the disk when this returns. The oldest events are removed to make room.
    pub fn add(&mut self, event: &Event, files: &[(String, Vec<u8>)]) -> io::Result<()> {
        let json = serde_json::to_vec_pretty(event)?;
        let bytes = json.len() + files.iter().map(|(_, bytes)| bytes.len()).sum::<usize>();
        let bytes = bytes as u64;
        if bytes > self.quota.bytes || self.quota.events == 0 {
            return Err(io::Error::other(format!(
                "event of {bytes} bytes is larger than the quota"
            )));
        }
        self.clean();
        let unfinished = match self.write(&json, files) {
            Err(error) if is_full(&error) => {
                let before = self.removed;
                self.make_room(bytes)?;
                if self.removed == before {
                    return Err(error);
                }
                self.write(&json, files)
            }
            written => written,
        }?;
        let placed = self
            .make_room(bytes)
            .and_then(|()| self.place(&unfinished, bytes));
        if placed.is_err() {
            self.discard(unfinished);
        }
        placed
    }

    /// Writes an event under another name; returns its path.
    fn write(&mut self, json: &[u8], files: &[(String, Vec<u8>)]) -> io::Result<PathBuf> {
        let unfinished = self.free_name("", |name| fs::create_dir(name))?;
        let files = files
            .iter()
            .map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
        let write = |(name, bytes): (&str, &[u8])| (self.disk.write)(&unfinished.join(name), bytes);
        let written = files
            .chain([(EVENT_FILE, json)])
            .try_for_each(write)
            .and_then(|()| sync_folder(&unfinished));
        match written {
            Ok(()) => Ok(unfinished),
            Err(error) => {
                self.discard(unfinished);
                Err(error)
            }
        }
    }

    /// Gives a written event its number.
    fn place(&mut self, unfinished: &Path, bytes: u64) -> io::Result<()> {
        loop {
            if self.next > NUMBER_MAX {
                return Err(io::Error::other("no number is left for an event"));
            }
            let place = self.at(self.next);
            match rename_to_free_name(unfinished, &place) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => self.next += 1,
                renamed => break renamed?,
            }
        }
        self.events.push(OnDisk {
            number: self.next,
            bytes,
            written: Written::InThisRun(Instant::now()),
        });
        self.next += 1;
        // If this fails, the event is there, complete, and counts. Whether it stays is not known, so it is not reported
        // as written.
        sync_folder(&self.path)
    }

    /// Removes events that are older than allowed at the time `now`. An event whose age is not known is removed only by
    /// the quota.
    pub fn expire(&mut self, now: SystemTime) -> io::Result<()> {
        let Some(keep) = self.quota.keep else {
            return Ok(());
        };
        self.clean();
        let old = |event: &OnDisk| event.written.age(now).is_some_and(|age| age > keep);
        let mut stay = None;
        let mut index = 0;
        // All events are checked: if the clock jumped, the oldest may be the newest.
        while index < self.events.len() {
            if !old(&self.events[index]) {
                index += 1;
            } else if let Err(error) = self.remove(index) {
                stay = Some(error);
                index += 1;
            }
        }
        stay.map_or(Ok(()), Err)
    }

    /// Removes the oldest events until there is room for another one of `bytes`.
    fn make_room(&mut self, bytes: u64) -> io::Result<()> {
        let mut stay = None;
        // Events before this index stay.
        let mut index = 0;
        while self.events.len() >= self.quota.events
            || self.bytes().saturating_add(bytes) > self.quota.bytes
        {
            if index == self.events.len() {
                let why = stay.map_or_else(String::new, |error| format!(": {error}"));
                return Err(io::Error::other(format!(
                    "the quota is full of files that cannot be removed{why}"
                )));
            }
            if let Err(error) = self.remove(index) {
                stay = Some(error);
                index += 1;
            }
        }
        if let Some(error) = stay {
            log::warn!(
                "evidence {}: cannot be removed, a newer event was removed instead: {error}",
                self.path.display()
            );
        }
        Ok(())
    }

    /// Bytes that count in the quota.
    fn bytes(&self) -> u64 {
        let events = self.events.iter().map(|event| event.bytes);
        events
            .chain(self.leftovers.iter().map(|left| left.bytes))
            .sum()
    }

    /// Removes an event. It is dropped from the list only when it is gone, also if another program has removed or
    /// changed it.
    fn remove(&mut self, index: usize) -> io::Result<()> {
        let place = self.at(self.events[index].number);
        if !is_event(&place)? {
            self.events.remove(index);
            return Ok(());
        }
        let named = |error: io::Error| io::Error::other(format!("{}: {error}", place.display()));
        let gone = self
            .free_name(GONE, |name| rename_to_free_name(&place, name))
            .map_err(named)?;
        // It is renamed before its files are removed, so that half an event does not have its name after the power was
        // cut.
        let before = bytes_in(&gone).ok();
        let deleted = sync_folder(&self.path).and_then(|()| (self.disk.delete)(&gone));
        if let Err(error) = deleted {
            // If nothing of it is lost yet, it becomes an event again.
            let whole = before.is_some() && bytes_in(&gone).ok() == before;
            if whole && is_event(&gone).unwrap_or(false) && put_in_place(&gone, &place).is_ok() {
                return Err(named(error));
            }
            log::warn!("evidence {}: cannot be removed: {error}", gone.display());
            self.leave(gone);
        }
        self.events.remove(index);
        self.removed += 1;
        Ok(())
    }

    /// Removes what is not an event. If this fails, it is tried again later.
    fn discard(&mut self, path: PathBuf) {
        if let Err(error) = self.deleted(&path) {
            log::warn!("evidence {}: cannot be removed: {error}", path.display());
            self.leave(path);
        }
    }

    fn leave(&mut self, path: PathBuf) {
        let bytes = bytes_in(&path).unwrap_or_default();
        self.leftovers.push(Leftover { path, bytes });
    }

    fn clean(&mut self) {
        for Leftover { path, bytes } in std::mem::take(&mut self.leftovers) {
            if self.deleted(&path).is_err() {
                let bytes = bytes_in(&path).unwrap_or(bytes);
                self.leftovers.push(Leftover { path, bytes });
            }
        }
    }

    fn deleted(&self, path: &Path) -> io::Result<()> {
        match (self.disk.delete)(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            deleted => deleted,
        }
    }

    fn at(&self, number: u64) -> PathBuf {
        self.path.join(name_of(number))
    }

    /// Calls `take` with the first free name of an unfinished event; returns the name.
    fn free_name(&self, end: &str, take: impl Fn(&Path) -> io::Result<()>) -> io::Result<PathBuf> {
        let mut number = self.next;
        loop {
            let name = self.path.join(format!("{UNFINISHED}{number:06}{end}"));
            match take(&name) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                taken => return taken.map(|()| name),
            }
        }
    }
}

/// Whether the disk is full, or the quota of its owner is used up.
fn is_full(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    )
}

/// Whether a folder is the folder of an event; a link to such a folder is not.
fn is_event(folder: &Path) -> io::Result<bool> {
    let kind = |path: &Path| match path.symlink_metadata() {
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory
            ) =>
        {
            Ok(None)
        }
        metadata => metadata.map(|it| Some(it.file_type())),
    };
    Ok(kind(folder)?.is_some_and(|it| it.is_dir())
        && kind(&folder.join(EVENT_FILE))?.is_some_and(|it| it.is_file()))
}

fn name_of(number: u64) -> String {
    format!("{number:06}")
}

/// The number of an event from the name of its folder, which can be written in only one way.
fn number(name: &str) -> Option<u64> {
    let number = name.parse().ok().filter(|&number| number <= NUMBER_MAX)?;
    (name == name_of(number)).then_some(number)
}

/// Whether a name is one that is used while an event is written or removed.
fn is_unfinished(name: &str) -> bool {
    let rest = name.strip_prefix(UNFINISHED);
    // Earlier versions tested with "probe" whether the folder can be written to.
    rest.is_some_and(|rest| {
        rest == "probe" || number(rest.strip_suffix(GONE).unwrap_or(rest)).is_some()
    })
}

/// Bytes of all files below a folder.
fn bytes_in(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        bytes += if metadata.is_dir() {
            bytes_in(&entry.path())?
        } else {
            metadata.len()
        };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests;
