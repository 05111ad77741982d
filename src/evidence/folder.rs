//! The folder of events on disk: each appears whole, and the quota holds.

use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::Quota;
use super::reading::{EVENT_FILE, Event};

/// Names under which events are written and removed; never taken for an event.
const UNFINISHED: &str = ".unfinished-";

/// An event in the folder.
struct OnDisk {
    number: u64,
    bytes: u64,
    written: Written,
}

/// When an event was written. The clock of a computer without a battery jumps once it hears the time; what was written in this run
/// is not older for it.
enum Written {
    Before(SystemTime),
    InThisRun(Instant),
}

impl Written {
    fn age(&self, now: SystemTime) -> Duration {
        match self {
            Self::Before(at) => now.duration_since(*at).unwrap_or_default(),
            Self::InThisRun(at) => at.elapsed(),
        }
    }
}

pub struct EventFolder {
    path: PathBuf,
    /// The folder, locked as long as this is, so that no two write here.
    _lock: File,
    quota: Quota,
    /// Oldest first.
    events: Vec<OnDisk>,
    next: u64,
}

impl EventFolder {
    /// Opens or makes a folder; what an earlier run left unfinished goes.
    pub fn open(path: &Path, quota: Quota) -> io::Result<Self> {
        fs::create_dir_all(path)?;
        let lock = File::open(path)?;
        lock.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => io::Error::other(
                "another gapwatch keeps its evidence there; wanted a folder for each",
            ),
            TryLockError::Error(error) => error,
        })?;
        let mut events = Vec::new();
        for entry in fs::read_dir(path)? {
            let entry = entry?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(UNFINISHED) {
                fs::remove_dir_all(entry.path())?;
            } else if let Some(number) = number(&name) {
                events.push(OnDisk {
                    number,
                    bytes: bytes_in(&entry.path())?,
                    written: Written::Before(entry.metadata()?.modified()?),
                });
            }
        }
        events.sort_unstable_by_key(|event| event.number);
        let next = events.last().map_or(1, |event| event.number + 1);
        // Better refused at the start than counted at the first alarm.
        let probe = path.join(format!("{UNFINISHED}probe"));
        fs::create_dir(&probe)?;
        fs::remove_dir(&probe)?;
        Ok(Self {
            path: path.to_owned(),
            _lock: lock,
            quota,
            events,
            next,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Adds an event; gives how many older ones went for it.
    pub fn add(&mut self, event: &Event, files: &[(String, Vec<u8>)]) -> io::Result<u64> {
        let json = serde_json::to_vec_pretty(event)?;
        let bytes = json.len() + files.iter().map(|(_, bytes)| bytes.len()).sum::<usize>();
        let bytes = bytes as u64;
        if bytes > self.quota.bytes || self.quota.events == 0 {
            return Err(io::Error::other(format!(
                "event of {bytes} bytes is larger than the quota"
            )));
        }
        let mut removed = 0;
        while self.events.len() >= self.quota.events || self.bytes() + bytes > self.quota.bytes {
            self.remove(0)?;
            removed += 1;
        }
        let unfinished = self.path.join(format!("{UNFINISHED}{:06}", self.next));
        let written = self.write(&unfinished, &json, files);
        if let Err(error) = written {
            // Best effort: at the next start it goes in any case.
            let _ = fs::remove_dir_all(&unfinished);
            return Err(error);
        }
        self.events.push(OnDisk {
            number: self.next,
            bytes,
            written: Written::InThisRun(Instant::now()),
        });
        self.next += 1;
        Ok(removed)
    }

    fn write(&self, unfinished: &Path, json: &[u8], files: &[(String, Vec<u8>)]) -> io::Result<()> {
        fs::create_dir(unfinished)?;
        let event = (EVENT_FILE, json);
        let files = files
            .iter()
            .map(|(name, bytes)| (name.as_str(), bytes.as_slice()));
        for (name, bytes) in files.chain([event]) {
            let mut file = File::create_new(unfinished.join(name))?;
            file.write_all(bytes)?;
            // On the disk before the folder has its name, so that a loss of power leaves no hollow event.
            file.sync_all()?;
        }
        fs::rename(unfinished, self.path.join(format!("{:06}", self.next)))
    }

    /// Removes events that are kept for longer than they may be, at the time `now`; gives how many.
    pub fn expire(&mut self, now: SystemTime) -> io::Result<u64> {
        let Some(keep) = self.quota.keep else {
            return Ok(0);
        };
        let mut removed = 0;
        let old = |event: &OnDisk| event.written.age(now) > keep;
        // Any of them: by a clock that jumped, the oldest may be the newest.
        while let Some(index) = self.events.iter().position(old) {
            self.remove(index)?;
            removed += 1;
        }
        Ok(removed)
    }

    fn bytes(&self) -> u64 {
        self.events.iter().map(|event| event.bytes).sum()
    }

    fn remove(&mut self, index: usize) -> io::Result<()> {
        let number = self.events.remove(index).number;
        let gone = self.path.join(format!("{UNFINISHED}{number:06}-gone"));
        match fs::rename(self.path.join(format!("{number:06}")), &gone) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            renamed => renamed.and_then(|()| fs::remove_dir_all(gone)),
        }
    }
}

/// The number of an event by the name of its folder.
pub fn number(name: &str) -> Option<u64> {
    let digits = name.len() >= 6 && name.bytes().all(|b| b.is_ascii_digit());
    digits.then(|| name.parse().ok()).flatten()
}

fn bytes_in(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for file in fs::read_dir(folder)? {
        bytes += file?.metadata()?.len();
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_clock_that_jumps_takes_nothing_of_this_run() {
        let place = tempfile::tempdir().unwrap();
        let day = Duration::from_secs(86_400);
        let quota = Quota {
            keep: Some(2 * day),
            ..Quota::default()
        };
        let event = Event {
            edge: 0,
            moments: Vec::new(),
        };
        let years_on = SystemTime::now() + 3_000 * day;
        let mut folder = EventFolder::open(place.path(), quota).unwrap();
        folder.add(&event, &[]).unwrap();
        assert_eq!(folder.expire(years_on).unwrap(), 0);
        drop(folder);
        // Of an earlier run it is as old as the clock says.
        let mut folder = EventFolder::open(place.path(), quota).unwrap();
        assert_eq!(folder.expire(SystemTime::now()).unwrap(), 0);
        assert_eq!(folder.expire(years_on).unwrap(), 1);
    }
}
