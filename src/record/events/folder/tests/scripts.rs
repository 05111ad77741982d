//! Random scripts.

use super::*;
use crate::statistics::random::SplitMix64;

/// Random numbers.
struct Dice(SplitMix64);

impl Dice {
    fn below(&mut self, sides: u64) -> u64 {
        self.0.bits() % sides
    }

    fn of<T: Copy>(&mut self, sides: &[T]) -> T {
        sides[self.below(sides.len() as u64) as usize]
    }
}

/// What must be in the folder.
struct Expected {
    /// By name: the event, and when it was written according to the folder; `None` in this run.
    events: BTreeMap<String, (Event, Option<Duration>)>,
    strange: BTreeSet<String>,
    quota: Quota,
}

struct Script<'a> {
    dice: Dice,
    place: &'a Path,
    folder: Option<EventFolder>,
    expected: Expected,
    /// Number of events removed since the folder was opened.
    removed: u64,
    told: u32,
    /// Bytes of each event.
    sizes: BTreeMap<String, u64>,
}

impl Script<'_> {
    fn folder(&mut self) -> &mut EventFolder {
        self.folder.as_mut().unwrap()
    }

    fn marked(&self, name: &str) -> bool {
        self.place.join(name).join("stuck").exists()
    }

    /// Events that are there and complete.
    fn there(&self) -> BTreeMap<String, Event> {
        let events = read(self.place).unwrap().into_iter();
        events
            .map(|(folder, event)| {
                assert!(folder.join(&event.moments[0].frame).is_file());
                let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
                (name, event)
            })
            .collect()
    }

    fn add(&mut self) {
        self.told += 1;
        let event = event(self.told);
        let size = self.dice.below(self.expected.quota.bytes / 2) as usize;
        let before: Vec<String> = self.expected.events.keys().cloned().collect();
        let writable = self.dice.below(8) > 0;
        let mut files = files(size);
        if !writable {
            files.push(("no/such/folder".to_owned(), vec![1]));
        }
        let added = self.folder().add(&event, &files);
        let there = self.there();
        let (stay, gone): (Vec<_>, Vec<_>) =
            before.iter().partition(|name| there.contains_key(*name));
        self.removed += gone.len() as u64;
        let last_gone = gone.last().map(|name| self.sizes[*name]);
        for name in &gone {
            // No event that could be removed is older than one that was removed.
            let older = stay.iter().filter(|stays| stays < &name);
            assert!(older.clone().all(|stays| self.marked(stays)));
            self.expected.events.remove(*name);
        }
        if let Err(error) = added {
            // For refused events, others are removed only if there was not enough room because something could not be
            // removed.
            let full = error.to_string().contains("quota is full");
            assert_eq!(full, writable, "{error}");
            assert!(full || gone.is_empty());
            assert!(!full || stay.iter().all(|name| self.marked(name)));
            return;
        }
        assert!(writable);
        let new: Vec<_> = there.keys().filter(|name| !before.contains(name)).collect();
        assert_eq!(new.len(), 1);
        assert!(before.iter().all(|name| name < new[0]));
        assert!(there.len() <= self.expected.quota.events);
        let own = names(self.place);
        let own = own.difference(&self.expected.strange);
        let bytes = own.map(|name| bytes_in(&self.place.join(name)).unwrap());
        let (bytes, most) = (bytes.sum::<u64>(), self.expected.quota.bytes);
        assert!(bytes <= most);
        // No event was removed needlessly.
        let by_count = there.len() == self.expected.quota.events;
        assert!(last_gone.is_none_or(|gone| by_count || bytes + gone > most));
        let size = size as u64 + serde_json::to_vec_pretty(&event).unwrap().len() as u64;
        self.sizes.insert(new[0].clone(), size);
        self.expected.events.insert(new[0].clone(), (event, None));
    }

    fn expire(&mut self) {
        let today = [
            Duration::from_secs(50),
            TODAY,
            TODAY + 25 * DAY,
            TODAY + 4_000 * DAY,
        ];
        let now = self.dice.of(&today);
        let is_old = |written: Option<Duration>| {
            written.is_some_and(|written| {
                clock::is_set(at(written))
                    && clock::is_set(at(now))
                    && now.saturating_sub(written) > 30 * DAY
            })
        };
        let (old, kept): (BTreeMap<_, _>, BTreeMap<_, _>) =
            std::mem::take(&mut self.expected.events)
                .into_iter()
                .partition(|(_, (_, written))| is_old(*written));
        let (stuck, gone): (BTreeMap<_, _>, BTreeMap<_, _>) =
            old.into_iter().partition(|(name, _)| self.marked(name));
        let expired = self.folder().expire(at(now));
        assert_eq!(expired.is_err(), !stuck.is_empty());
        self.removed += gone.len() as u64;
        self.expected.events.extend(kept.into_iter().chain(stuck));
    }

    /// Marks an event so that it cannot be removed, or not completely, or removes these marks.
    fn mark(&mut self) {
        let ours = names(self.place);
        let ours: Vec<&String> = ours.difference(&self.expected.strange).collect();
        if ours.is_empty() {
            return;
        }
        let place = self.place.join(self.dice.of(&ours));
        let written = place.metadata().unwrap().modified().unwrap();
        match self.dice.below(4) {
            0 => fs::write(place.join("stuck"), "").unwrap(),
            1 => fs::write(place.join("half"), "").unwrap(),
            _ => {
                let _ = fs::remove_file(place.join("stuck"));
                let _ = fs::remove_file(place.join("half"));
            }
        }
        age(&place, written);
    }

    /// Puts something into the folder that is not part of it.
    fn disturb(&mut self) {
        let near = u64::from(self.told);
        let number = self.dice.below(near + 3);
        let name = match self.dice.below(4) {
            0 => format!("{number:06}"),
            1 => format!("{UNFINISHED}{number:06}"),
            2 => format!("{UNFINISHED}{number:06}{GONE}"),
            _ => format!("{UNFINISHED}x{number}"),
        };
        let place = self.place.join(&name);
        if place.symlink_metadata().is_ok() {
            return;
        }
        match self.dice.below(3) {
            0 => fs::write(place, &name).unwrap(),
            1 => symlink("/no/such", place).unwrap(),
            _ if is_unfinished(&name) => return,
            _ => fs::create_dir(place).unwrap(),
        }
        self.expected.strange.insert(name);
    }

    fn reopen(&mut self) {
        self.folder = None;
        for (name, (_, written)) in &mut self.expected.events {
            let ages = [
                Duration::from_secs(100),
                TODAY - 40 * DAY,
                TODAY - 10 * DAY,
                TODAY + DAY,
            ];
            let at_last = self.dice.of(&ages);
            age(&self.place.join(name), at(at_last));
            *written = Some(at_last);
        }
        // What a killed program would have left.
        let number = self.dice.below(1_000);
        let left = self.place.join(format!("{UNFINISHED}{number:06}"));
        if left.symlink_metadata().is_err() {
            fs::create_dir(&left).unwrap();
            fs::write(left.join("frame.jpg"), "half").unwrap();
        }
        let quota = self.expected.quota;
        self.folder = Some(EventFolder::open_on(STICKY, self.place, quota).unwrap());
        self.removed = 0;
        for name in names(self.place).difference(&self.expected.strange) {
            let marked = |mark| self.place.join(name).join(mark).exists();
            assert!(
                !is_unfinished(name) || marked("stuck") || marked("half"),
                "{name}"
            );
        }
    }

    fn check(&mut self) {
        let (place, removed) = (self.place, self.removed);
        assert_eq!(self.folder().removed(), removed);
        let events = (self.expected.events.iter())
            .map(|(name, (event, _))| (name.clone(), event.clone()))
            .collect::<BTreeMap<_, _>>();
        assert_eq!(self.there(), events);
        for name in names(place) {
            if self.expected.strange.contains(&name) {
                let place = place.join(&name);
                let kind = place.symlink_metadata().unwrap().file_type();
                assert!(!kind.is_file() || fs::read_to_string(&place).unwrap() == name);
                assert!(!kind.is_dir() || names(&place).is_empty());
            } else if !events.contains_key(&name) {
                assert!(is_unfinished(&name), "{name}");
            }
        }
        let strange = &self.expected.strange;
        assert!(
            strange
                .iter()
                .all(|name| place.join(name).symlink_metadata().is_ok())
        );
    }
}

#[test]
fn whatever_happens_to_a_folder_the_quota_holds_and_nothing_else_is_touched() {
    let (mut kept, mut removed, mut refused) = (0, 0, 0);
    for seed in 0..60 {
        // In memory if this folder exists, because thousands of files are synced.
        let memory = Path::new("/dev/shm");
        let place = match memory.is_dir() {
            true => tempfile::tempdir_in(memory).unwrap(),
            false => tempfile::tempdir().unwrap(),
        };
        let mut dice = Dice(SplitMix64::new(seed));
        let quota = quota(dice.of(&[1, 2, 5]), dice.of(&[1_500, 5_000]));
        let mut script = Script {
            dice,
            place: place.path(),
            folder: Some(EventFolder::open_on(STICKY, place.path(), quota).unwrap()),
            expected: Expected {
                events: BTreeMap::new(),
                strange: BTreeSet::new(),
                quota,
            },
            removed: 0,
            told: 0,
            sizes: BTreeMap::new(),
        };
        for _ in 0..60 {
            let before = script.expected.events.len();
            match script.dice.below(10) {
                0..5 => {
                    script.add();
                    refused += u32::from(script.expected.events.len() == before);
                }
                5 => script.expire(),
                6 | 7 => script.mark(),
                8 => script.disturb(),
                _ => script.reopen(),
            }
            script.check();
            removed += script.removed;
        }
        kept += script.expected.events.len();
    }
    // The scripts covered all cases.
    assert!(kept > 60 && removed > 60 && refused > 60);
}
