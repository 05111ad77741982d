#![allow(clippy::unwrap_used, clippy::cast_possible_truncation)]
mod scripts;

use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::symlink;

use super::super::{Moment, read};
use super::*;
use crate::reference::cause::Cause;

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

/// An event that differs from others in its time, with one picture.
fn event(t_s: u32) -> Event {
    let moment = Moment {
        t_s: t_s.into(),
        seq: t_s.into(),
        state: "Gap".to_owned(),
        reason: "abrupt".to_owned(),
        score: Some(2.5),
        gap: None,
        change: Some(0.5),
        lanes: None,
        cause: Some(Cause::Fog),
        cause_probability: Some(0.75),
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

/// Does not remove a folder with a file `stuck`, and removes only half of a folder with a file `half`.
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
    // An event of an earlier run is as old as the clock says.
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
    // An event of unknown age is still removed by the quota.
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

/// Puts files that are not events into a folder; returns their names.
fn strangers(folder: &Path) -> BTreeSet<String> {
    let place = |name: &str| folder.join(name);
    fs::write(place("000123"), "a file").unwrap();
    fs::write(place(".unfinished-x"), "a file").unwrap();
    fs::write(place(".unfinished-000001"), "a file").unwrap();
    fs::write(place(".unfinished-000001-gone"), "a file").unwrap();
    fs::write(place(".unfinished-probe"), "a file").unwrap();
    fs::create_dir(place(".unfinished-y")).unwrap();
    // Folders without an `event.json` and empty folders are not events, whatever their number.
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
    // Numbers that are in use are skipped: 1, 5, 7, 8, 9 and 10.
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
    // The next oldest event is removed instead.
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
    // It is not forgotten either when it is old.
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
    // So that a search that tries every number reaches the end.
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
    // With one more byte, the oldest event is removed.
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
    // An event is lost, but was not removed for the next one.
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
    // Its description still exists, and counts.
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
