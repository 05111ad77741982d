#![allow(clippy::unwrap_used, clippy::cast_possible_truncation)]
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::symlink;

use super::super::{Moment, read};
use super::*;

const DAY: Duration = Duration::from_secs(86_400);
/// A day of 2026.
const TODAY: Duration = Duration::from_secs(1_790_000_000);

fn at(since_1970: Duration) -> SystemTime {
    SystemTime::UNIX_EPOCH + since_1970
}

fn quota(events: usize, bytes: u64) -> Quota {
    Quota {
        bytes,
        events,
        keep: Some(30 * DAY),
    }
}

/// An event that is told from others by its time, with one picture.
fn event(t_s: u32) -> Event {
    let moment = Moment {
        t_s: t_s.into(),
        seq: t_s.into(),
        state: "Gap".to_owned(),
        reason: "abrupt".to_owned(),
        score: Some(2.5),
        frame: "frame.jpg".to_owned(),
        heat: BTreeMap::new(),
        profiles: Vec::new(),
    };
    Event {
        edge: 0,
        moments: vec![moment],
    }
}

fn files(bytes: usize) -> Vec<(String, Vec<u8>)> {
    vec![("frame.jpg".to_owned(), vec![7; bytes])]
}

fn age(place: &Path, written: SystemTime) {
    File::open(place).unwrap().set_modified(written).unwrap();
}

/// Names and content of everything in a folder.
fn names(folder: &Path) -> BTreeSet<String> {
    let entries = fs::read_dir(folder).unwrap();
    entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect()
}

/// Does not remove a folder with a file `stuck`, and half of one with a file `half`.
const STICKY: Disk = Disk {
    delete: |folder| {
        if folder.join("stuck").exists() {
            return Err(io::Error::other("stuck"));
        }
        if folder.join("half").exists() {
            let _ = fs::remove_file(folder.join(EVENT_FILE));
            return Err(io::Error::other("half"));
        }
        fs::remove_dir_all(folder)
    },
    ..Disk::REAL
};

/// Holds 2,500 bytes of files.
const SMALL: Disk = Disk {
    write: |path, bytes| {
        let events = path.ancestors().nth(2).unwrap();
        if bytes_in(events)? + bytes.len() as u64 > 2_500 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        (Disk::REAL.write)(path, bytes)
    },
    ..Disk::REAL
};

#[test]
fn a_clock_that_jumps_takes_nothing_of_this_run() {
    let place = tempfile::tempdir().unwrap();
    let quota = quota(10, u64::MAX);
    let years_on = SystemTime::now() + 3_000 * DAY;
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    folder.add(&event(1), &[]).unwrap();
    folder.expire(years_on).unwrap();
    assert_eq!(folder.removed(), 0);
    drop(folder);
    // Of an earlier run it is as old as the clock says.
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    folder.expire(SystemTime::now()).unwrap();
    assert_eq!(folder.removed(), 0);
    folder.expire(years_on).unwrap();
    assert_eq!(folder.removed(), 1);
}

#[test]
fn an_event_of_unknown_age_is_not_old() {
    let place = tempfile::tempdir().unwrap();
    let quota = quota(2, u64::MAX);
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &[]).unwrap();
    }
    drop(folder);
    let reopened = |written: Duration| {
        age(&place.path().join("000001"), at(written));
        EventFolder::open(place.path(), quota).unwrap()
    };
    age(&place.path().join("000002"), at(TODAY));
    // Written before the clock was set, after now, and looked at with a clock that is not set.
    for (written, now) in [
        (Duration::from_secs(100), TODAY),
        (TODAY + DAY, TODAY),
        (TODAY - 60 * DAY, Duration::from_secs(100)),
    ] {
        let mut folder = reopened(written);
        folder.expire(at(now)).unwrap();
        assert_eq!(folder.removed(), 0, "{written:?} {now:?}");
    }
    let mut folder = reopened(TODAY - 60 * DAY);
    folder.expire(at(TODAY)).unwrap();
    assert_eq!(folder.removed(), 1);
    drop(folder);
    // Of unknown age it still goes by the quota.
    age(&place.path().join("000002"), at(Duration::ZERO));
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    for t_s in 3..=4 {
        folder.add(&event(t_s), &[]).unwrap();
    }
    assert_eq!(
        names(place.path()),
        BTreeSet::from(["000003", "000004"].map(str::to_owned))
    );
}

/// Puts what is no event into a folder; gives the names.
fn strangers(folder: &Path) -> BTreeSet<String> {
    let place = |name: &str| folder.join(name);
    fs::write(place("000123"), "a file").unwrap();
    fs::write(place(".unfinished-x"), "a file").unwrap();
    fs::write(place(".unfinished-000001"), "a file").unwrap();
    fs::write(place(".unfinished-000001-gone"), "a file").unwrap();
    fs::write(place(".unfinished-probe"), "a file").unwrap();
    fs::create_dir(place(".unfinished-y")).unwrap();
    // Neither hollow nor empty folders are events, whatever their number.
    fs::create_dir(place("000002")).unwrap();
    fs::create_dir(place("000003")).unwrap();
    fs::write(place("000003/notes.txt"), "mine").unwrap();
    fs::create_dir_all(place("000004/event.json")).unwrap();
    // Another way to write a number.
    fs::create_dir(place("0000005")).unwrap();
    fs::write(place("0000005/event.json"), "{}").unwrap();
    fs::create_dir(place("99999999999999999999")).unwrap();
    fs::write(place("99999999999999999999/event.json"), "{}").unwrap();
    // A link to an event.
    symlink("0000005", place("000006")).unwrap();
    symlink("000003", place(".unfinished-000007")).unwrap();
    names(folder)
}

#[test]
fn what_is_no_event_is_left_alone() {
    let place = tempfile::tempdir().unwrap();
    let strange = strangers(place.path());
    let found = examine(place.path()).unwrap();
    assert_eq!((found.events, found.unfinished), (0, 0));
    assert_eq!(found.others.len(), strange.len());
    let mut folder = EventFolder::open(place.path(), quota(3, u64::MAX)).unwrap();
    for t_s in 1..=6 {
        folder.add(&event(t_s), &files(10)).unwrap();
    }
    assert_eq!(folder.removed(), 3);
    drop(folder);
    let ours = ["000008", "000009", "000010"].map(str::to_owned);
    let there = names(place.path());
    assert!(there.is_superset(&strange));
    let new: Vec<&String> = there.difference(&strange).collect();
    // Numbers that are taken are passed over: 1, 5, 7, 8, 9 and 10.
    assert_eq!(new, ours.iter().collect::<Vec<_>>());
    let read: Vec<Event> = (read(place.path()).unwrap().into_iter())
        .map(|(_, event)| event)
        .collect();
    assert_eq!(read, [event(4), event(5), event(6)]);
    assert_eq!(
        fs::read_to_string(place.path().join("000003/notes.txt")).unwrap(),
        "mine"
    );
}

#[test]
fn what_a_program_left_goes_and_what_stays_is_not_fatal() {
    let place = tempfile::tempdir().unwrap();
    for name in [
        ".unfinished-000007",
        ".unfinished-000003-gone",
        ".unfinished-000004-gone",
        ".unfinished-probe",
    ] {
        fs::create_dir(place.path().join(name)).unwrap();
        fs::write(place.path().join(name).join("frame.jpg"), [7; 600]).unwrap();
    }
    let stuck = place.path().join(".unfinished-000004-gone/stuck");
    fs::write(&stuck, "").unwrap();
    assert_eq!(examine(place.path()).unwrap().unfinished, 4);
    let mut folder = EventFolder::open_on(STICKY, place.path(), quota(9, 1_000)).unwrap();
    assert_eq!(names(place.path()).len(), 1);
    // Its bytes count until it is gone.
    assert!(folder.add(&event(1), &files(300)).is_err());
    fs::remove_file(stuck).unwrap();
    folder.add(&event(1), &files(300)).unwrap();
    assert_eq!(names(place.path()), BTreeSet::from(["000001".to_owned()]));
}

#[test]
fn an_event_that_cannot_be_removed_keeps_its_place_in_the_quota() {
    let place = tempfile::tempdir().unwrap();
    let stuck = |number: u32| place.path().join(format!("{number:06}/stuck"));
    let mut folder = EventFolder::open_on(STICKY, place.path(), quota(2, u64::MAX)).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &[]).unwrap();
    }
    fs::write(stuck(1), "").unwrap();
    // The next oldest goes instead.
    folder.add(&event(3), &[]).unwrap();
    fs::write(stuck(3), "").unwrap();
    let before = names(place.path());
    assert_eq!(
        before,
        BTreeSet::from(["000001", "000003"].map(str::to_owned))
    );
    let error = folder.add(&event(4), &[]).unwrap_err().to_string();
    assert!(
        error.contains("000001") || error.contains("000003"),
        "{error}"
    );
    assert_eq!(names(place.path()), before);
    assert_eq!(read(place.path()).unwrap().len(), 2);
    // Nor is it forgotten when it is old.
    drop(folder);
    for number in [1, 3] {
        age(stuck(number).parent().unwrap(), at(TODAY - 60 * DAY));
    }
    let mut folder = EventFolder::open_on(STICKY, place.path(), quota(2, u64::MAX)).unwrap();
    assert!(folder.expire(at(TODAY)).is_err());
    fs::remove_file(stuck(3)).unwrap();
    folder.add(&event(4), &[]).unwrap();
    assert_eq!(
        names(place.path()),
        BTreeSet::from(["000001", "000004"].map(str::to_owned))
    );
    fs::remove_file(stuck(1)).unwrap();
    folder.expire(at(TODAY)).unwrap();
    assert_eq!(names(place.path()), BTreeSet::from(["000004".to_owned()]));
    assert_eq!(folder.removed(), 2);
}

#[test]
fn an_event_that_cannot_be_written_costs_no_other_and_leaves_nothing() {
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open(place.path(), quota(2, 10_000)).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &files(10)).unwrap();
    }
    let before = names(place.path());
    let unwritable = [files(10), vec![("no/such/folder".to_owned(), vec![1])]].concat();
    assert!(folder.add(&event(3), &unwritable).is_err());
    assert!(folder.add(&event(3), &files(10_001)).is_err());
    assert_eq!((folder.removed(), names(place.path())), (0, before));
}

#[test]
fn on_a_full_disk_the_oldest_goes_first_where_the_quota_wants_it() {
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open_on(SMALL, place.path(), quota(2, 10_000)).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &files(800)).unwrap();
    }
    // There is no room for a third one beside them.
    folder.add(&event(3), &files(800)).unwrap();
    let two = BTreeSet::from(["000002", "000003"].map(str::to_owned));
    assert_eq!((folder.removed(), names(place.path())), (1, two));
}

#[test]
fn on_a_full_disk_nothing_goes_that_the_quota_allows() {
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open_on(SMALL, place.path(), quota(3, 10_000)).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &files(800)).unwrap();
    }
    let before = names(place.path());
    let error = folder.add(&event(3), &files(800)).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::StorageFull);
    assert_eq!((folder.removed(), names(place.path())), (0, before));
}

#[test]
fn numbers_end() {
    let place = tempfile::tempdir().unwrap();
    let last = place.path().join(NUMBER_MAX.to_string());
    fs::create_dir(&last).unwrap();
    fs::write(last.join(EVENT_FILE), "{}").unwrap();
    let mut folder = EventFolder::open(place.path(), quota(2, 10_000)).unwrap();
    let error = folder.add(&event(1), &[]).unwrap_err().to_string();
    assert!(error.contains("no number is left"), "{error}");
    assert_eq!(names(place.path()).len(), 1);
}

#[test]
fn the_last_number_is_given_and_none_after_it() {
    let place = tempfile::tempdir().unwrap();
    let last_but_one = place.path().join(name_of(NUMBER_MAX - 1));
    fs::create_dir(&last_but_one).unwrap();
    fs::write(last_but_one.join(EVENT_FILE), "{}").unwrap();
    let mut folder = EventFolder::open(place.path(), quota(9, 10_000)).unwrap();
    folder.add(&event(1), &[]).unwrap();
    assert!(place.path().join(name_of(NUMBER_MAX)).is_dir());
    assert!(folder.add(&event(2), &[]).is_err());
    assert_eq!(number(&name_of(NUMBER_MAX)), Some(NUMBER_MAX));
    assert_eq!(number(&name_of(NUMBER_MAX + 1)), None);
}

#[test]
fn an_event_that_cannot_have_its_name_uses_no_number_up() {
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open(place.path(), quota(9, 10_000)).unwrap();
    // So that one that tries every number comes to their end.
    folder.next = NUMBER_MAX;
    let error = folder.place(&place.path().join("missing"), 1).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::NotFound);
    assert_eq!((folder.next, folder.events.len()), (NUMBER_MAX, 0));
}

#[test]
fn a_quota_may_be_filled_to_the_last_byte() {
    let json = serde_json::to_vec_pretty(&event(1)).unwrap().len();
    let all = quota(9, 2 * (json as u64 + 100));
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open(place.path(), all).unwrap();
    assert_eq!(folder.path(), place.path());
    for t_s in 1..=2 {
        folder.add(&event(t_s), &files(100)).unwrap();
    }
    assert_eq!((folder.removed(), folder.bytes()), (0, all.bytes));
    // One byte more costs the oldest.
    folder.add(&event(3), &files(101)).unwrap();
    assert_eq!(names(place.path()), BTreeSet::from(["000003".to_owned()]));
    let whole = 2 * (json + 100) - json;
    folder.add(&event(4), &files(whole)).unwrap();
    assert_eq!(folder.bytes(), all.bytes);
    assert!(folder.add(&event(5), &files(whole + 1)).is_err());
    assert_eq!(names(place.path()), BTreeSet::from(["000004".to_owned()]));
}

#[test]
fn a_quota_of_no_events_keeps_none() {
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open(place.path(), quota(0, 10_000)).unwrap();
    let error = folder.add(&event(1), &[]).unwrap_err().to_string();
    assert!(error.contains("larger than the quota"), "{error}");
    assert_eq!(names(place.path()), BTreeSet::new());
}

#[test]
fn an_event_is_old_when_its_time_is_over_and_not_before() {
    let place = tempfile::tempdir().unwrap();
    let quota = quota(9, 10_000);
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    folder.add(&event(1), &[]).unwrap();
    drop(folder);
    age(&place.path().join("000001"), at(TODAY));
    let mut folder = EventFolder::open(place.path(), quota).unwrap();
    folder.expire(at(TODAY + 30 * DAY)).unwrap();
    assert_eq!(folder.removed(), 0);
    let just_after = TODAY + 30 * DAY + Duration::from_nanos(1);
    folder.expire(at(just_after)).unwrap();
    assert_eq!((folder.removed(), names(place.path()).len()), (1, 0));
}

#[test]
fn what_somebody_else_has_removed_counts_no_more() {
    let place = tempfile::tempdir().unwrap();
    let left = place.path().join(".unfinished-000001");
    fs::create_dir(&left).unwrap();
    fs::write(left.join("frame.jpg"), [7; 600]).unwrap();
    fs::write(left.join("stuck"), "").unwrap();
    let mut folder = EventFolder::open_on(STICKY, place.path(), quota(1, 1_000)).unwrap();
    assert!(folder.add(&event(1), &files(300)).is_err());
    fs::remove_dir_all(&left).unwrap();
    folder.add(&event(1), &files(300)).unwrap();
    // An event is forgotten, and was not removed for the next one.
    let first = names(place.path()).pop_first().unwrap();
    fs::remove_dir_all(place.path().join(&first)).unwrap();
    folder.add(&event(2), &files(300)).unwrap();
    assert_eq!((folder.removed(), names(place.path()).len()), (0, 1));
    assert_ne!(names(place.path()).pop_first(), Some(first));
}

#[test]
fn an_event_that_lost_a_file_is_none_again() {
    let losing = Disk {
        delete: |folder| {
            fs::remove_file(folder.join("frame.jpg"))?;
            Err(io::Error::other("the rest stays"))
        },
        ..Disk::REAL
    };
    let place = tempfile::tempdir().unwrap();
    let mut folder = EventFolder::open_on(losing, place.path(), quota(1, 10_000)).unwrap();
    for t_s in 1..=2 {
        folder.add(&event(t_s), &files(100)).unwrap();
    }
    let read = read(place.path()).unwrap();
    let left: Vec<Event> = read.into_iter().map(|(_, event)| event).collect();
    assert_eq!((left, folder.removed()), (vec![event(2)], 1));
    // Its description is there, and counts.
    assert_eq!((folder.leftovers.len(), names(place.path()).len()), (1, 2));
    assert!(folder.leftovers[0].bytes > 0);
}

#[test]
fn what_is_not_there_is_no_event_and_what_cannot_be_seen_may_be_one() {
    let place = tempfile::tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::create_dir(at("000001")).unwrap();
    assert!(!is_event(&at("000001")).unwrap());
    fs::write(at("000001").join(EVENT_FILE), "{}").unwrap();
    assert!(is_event(&at("000001")).unwrap());
    assert!(!is_event(&at("000002")).unwrap());
    assert!(!is_event(&at("000001").join(EVENT_FILE).join("below")).unwrap());
    assert!(is_event(&at(&"9".repeat(300))).is_err());
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Dice(u64);

impl Dice {
    fn below(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (z ^ (z >> 31)) % sides
    }

    fn of<T: Copy>(&mut self, sides: &[T]) -> T {
        sides[self.below(sides.len() as u64) as usize]
    }
}

/// What must be in the folder.
struct Expected {
    /// By name: the event, and when the folder says it was written, `None` in this run.
    events: BTreeMap<String, (Event, Option<Duration>)>,
    strange: BTreeSet<String>,
    quota: Quota,
}

struct Script<'a> {
    dice: Dice,
    place: &'a Path,
    folder: Option<EventFolder>,
    expected: Expected,
    /// Removed of this opening.
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

    /// Events that are there, whole.
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
            // No event that could go is older than one that went.
            let older = stay.iter().filter(|stays| stays < &name);
            assert!(older.clone().all(|stays| self.marked(stays)));
            self.expected.events.remove(*name);
        }
        if let Err(error) = added {
            // Refused events cost others only where something in the way kept the room from being enough.
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
        // None went in vain.
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

    /// Marks an event so that it cannot be removed, or not wholly, or takes such marks away.
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

    /// Puts something into the folder that is none of ours.
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
        // In memory where there is such a folder: thousands of files are synced.
        let memory = Path::new("/dev/shm");
        let place = match memory.is_dir() {
            true => tempfile::tempdir_in(memory).unwrap(),
            false => tempfile::tempdir().unwrap(),
        };
        let mut dice = Dice(seed);
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
    // The scripts came to all of it.
    assert!(kept > 60 && removed > 60 && refused > 60);
}
