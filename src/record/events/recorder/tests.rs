#![allow(clippy::unwrap_used)]
use super::super::reading::read;
use super::*;
use crate::capture::Picture;
use crate::features::attention::EnergyMap;
use crate::monitor::alarm::Reason;
use crate::monitor::profile::ProfileKind;
use crate::monitor::profile::TapProfile;
use crate::reference::cause::{Cause, LikelyCause};
use std::fs;

fn picture() -> Picture {
    Picture {
        width: 32,
        height: 16,
        rgb: [40, 90, 200].repeat(32 * 16),
    }
}

fn offer(recorder: &mut EventRecorder, tenth: u64, state: AlarmState) {
    let at = Duration::from_millis(100 * tenth);
    let frame = Frame {
        sequence: tenth,
        captured_at: at,
        picture: Ok(picture().into()),
    };
    let verdict = Verdict {
        at,
        sequence: Some(tenth),
        state,
        reason: Reason::None,
        score: Some(1.5),
        gap: Some(1.5),
        change: Some(0.5),
        lanes: Some(0.25),
        cause: Some(LikelyCause {
            cause: Cause::Fog,
            probability: 0.75,
        }),
        window_fill: Some(1.0),
        ..Verdict::nothing_yet()
    };
    recorder.offer(frame, &verdict, || Look {
        seen: picture(),
        energies: vec![EnergyMap {
            width: 2,
            height: 1,
            energy: vec![1.0, 2.0],
        }],
        profiles: vec![TapProfile {
            tap: "../e2".to_owned(),
            kind: ProfileKind::Histogram,
            live: vec![0.25, 0.75],
            nominal: vec![0.5, 0.5],
            spread: vec![],
        }],
    });
}

/// `count` alarms, one every 10 s, each with a second of suspicion before the gap.
fn record(folder: &Path, quota: Quota, count: u64) -> EventCounts {
    let recorder = EventRecorder::start(folder, quota, &["../e2".to_owned()]).unwrap();
    let mut recorder = recorder.patient();
    for tenth in 0..100 * count {
        let state = match tenth % 100 {
            50..60 => AlarmState::Suspect,
            60..70 => AlarmState::Gap,
            _ => AlarmState::Ok,
        };
        offer(&mut recorder, tenth, state);
        if tenth % 100 == 99 {
            // A slow disk needs the time between two alarms to write the first event.
            std::thread::sleep(Duration::from_millis(500));
        }
    }
    recorder.finish()
}

#[test]
fn an_event_holds_the_frames_around_its_beginning_and_where_the_encoder_looked() {
    let folder = tempfile::tempdir().unwrap();
    let kept = record(folder.path(), Quota::default(), 1);
    assert_eq!((kept.events, kept.failed), (1, 0));
    let events = read(folder.path()).unwrap();
    let (_, event) = &events[0];
    let moment = &event.moments[event.edge];
    assert_eq!((moment.t_s, moment.state.as_str()), (5.0, "Suspect"));
    assert_eq!((moment.heat.len(), moment.profiles.len()), (1, 1));
    assert_eq!(moment.profiles[0].live, [0.25, 0.75]);
    assert_eq!((moment.change, moment.lanes), (Some(0.5), Some(0.25)));
    let cause = (moment.cause, moment.cause_probability);
    assert_eq!(cause, (Some(Cause::Fog), Some(0.75)));
    let (first, last) = (&event.moments[0], event.moments.last().unwrap());
    // Two seconds before the suspicion, two after the gap began.
    assert!((2.8..=3.2).contains(&first.t_s), "{}", first.t_s);
    assert!((7.8..=8.0).contains(&last.t_s), "{}", last.t_s);
    assert!(
        event
            .moments
            .windows(2)
            .all(|pair| pair[0].t_s < pair[1].t_s)
    );
    assert_eq!(
        event.moments.iter().filter(|m| !m.heat.is_empty()).count(),
        2
    );
}

#[test]
fn a_fault_of_the_camera_is_an_event_of_the_pictures_that_were_no_road() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = EventRecorder::start(folder.path(), Quota::default(), &[]).unwrap();
    let mut recorder = recorder.patient();
    for tenth in 0..100 {
        let fault = (50..60).contains(&tenth);
        let frame = Frame {
            sequence: tenth,
            captured_at: Duration::from_millis(100 * tenth),
            picture: Ok(picture().into()),
        };
        let verdict = Verdict {
            state: if fault {
                AlarmState::SensorFault
            } else {
                AlarmState::Ok
            },
            reason: if fault { Reason::Covered } else { Reason::None },
            gap: (!fault).then_some(0.1),
            ..Verdict::nothing_yet()
        };
        recorder.offer(frame, &verdict, || panic!("nothing was looked at"));
    }
    assert_eq!(recorder.finish().events, 1);
    let events = read(folder.path()).unwrap();
    let moment = &events[0].1.moments[events[0].1.edge];
    assert_eq!(
        (moment.seq, moment.state.as_str(), moment.reason.as_str()),
        (50, "SensorFault", "covered")
    );
    assert!(moment.gap.is_none() && moment.heat.is_empty());
}

#[test]
fn what_was_long_before_an_alarm_is_not_of_its_event() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = EventRecorder::start(folder.path(), Quota::default(), &[])
        .unwrap()
        .patient();
    // One frame, ten minutes without frames, and an alarm with the next frame, like after a camera was unplugged; then
    // a frame every second, like in a parked car, and another alarm; then an alarm that begins before the last frame.
    let (ok, gap) = (AlarmState::Ok, AlarmState::Gap);
    for (tenth, state) in [
        (0, ok),
        (6_000, gap),
        (7_000, ok),
        (7_010, ok),
        (7_020, ok),
        (7_030, ok),
        (7_040, gap),
        (7_500, ok),
        (7_510, ok),
        (100, gap),
    ] {
        offer(&mut recorder, tenth, state);
    }
    assert_eq!(recorder.finish().events, 3);
    let events = read(folder.path()).unwrap();
    let times = |event: &Event| event.moments.iter().map(|m| m.seq).collect::<Vec<_>>();
    let times: Vec<Vec<u64>> = events.iter().map(|(_, event)| times(event)).collect();
    assert_eq!(times, [vec![6_000], vec![7_020, 7_030, 7_040], vec![100]]);
}

#[test]
fn the_last_moments_are_written_when_the_program_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = EventRecorder::start(folder.path(), Quota::default(), &[]).unwrap();
    // Fewer frames than the queue can hold, and an alarm with the last frame.
    for tenth in [0, 2, 4, 6] {
        offer(&mut recorder, tenth, AlarmState::Ok);
    }
    offer(&mut recorder, 7, AlarmState::Gap);
    let kept = recorder.finish();
    assert_eq!((kept.events, kept.dropped_frames), (1, 0));
    let events = read(folder.path()).unwrap();
    assert_eq!((events[0].1.edge, events[0].1.moments.len()), (4, 5));
}

#[test]
#[cfg(target_os = "linux")]
fn the_writer_comes_after_the_verdicts() {
    let folder = tempfile::tempdir().unwrap();
    let recorder = EventRecorder::start(folder.path(), Quota::default(), &[]).unwrap();
    let niceness = || {
        let threads = std::fs::read_dir("/proc/self/task").unwrap();
        let stats = threads
            .filter_map(|entry| std::fs::read_to_string(entry.unwrap().path().join("stat")).ok());
        let of_writers = stats.filter_map(|stat| {
            let (_, rest) = stat.split_once("(evidence) ")?;
            rest.split(' ').nth(16)?.parse::<i32>().ok()
        });
        of_writers.max()
    };
    let until = Instant::now() + Duration::from_secs(10);
    while niceness() != Some(10) && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(niceness(), Some(10));
    recorder.finish();
}

#[test]
fn the_quota_is_kept_and_the_oldest_go_first() {
    let folder = tempfile::tempdir().unwrap();
    let quota = Quota {
        bytes: u64::MAX,
        events: 3,
        keep: None,
    };
    let kept = record(folder.path(), quota, 5);
    assert_eq!((kept.events, kept.removed), (5, 2));
    let begun = |events: &[(std::path::PathBuf, Event)]| -> Vec<f64> {
        events.iter().map(|(_, e)| e.moments[e.edge].t_s).collect()
    };
    assert_eq!(begun(&read(folder.path()).unwrap()), [25.0, 35.0, 45.0]);
    // A later run continues in the same folder, now with room for the bytes of one and a half events.
    let size: u64 = fs::read_dir(folder.path().join("000005"))
        .unwrap()
        .map(|file| file.unwrap().metadata().unwrap().len())
        .sum();
    let quota = Quota {
        bytes: size + size / 2,
        events: 100,
        keep: None,
    };
    let kept = record(folder.path(), quota, 1);
    assert_eq!((kept.events, kept.removed), (1, 3));
    assert_eq!(begun(&read(folder.path()).unwrap()), [5.0]);
    // An event that is larger than the whole quota is not written, and nothing is removed for it.
    let quota = Quota {
        bytes: size / 2,
        events: 100,
        keep: None,
    };
    let kept = record(folder.path(), quota, 1);
    assert_eq!((kept.events, kept.failed), (0, 1));
}

#[test]
fn what_was_kept_long_enough_goes_without_a_new_event() {
    let folder = tempfile::tempdir().unwrap();
    record(folder.path(), Quota::default(), 2);
    let day = Duration::from_secs(86_400);
    let old = fs::File::open(folder.path().join("000001")).unwrap();
    old.set_modified(SystemTime::now() - 3 * day).unwrap();
    let quota = Quota {
        keep: Some(2 * day),
        ..Quota::default()
    };
    let mut recorder = EventRecorder::start(folder.path(), quota, &[])
        .unwrap()
        .patient();
    offer(&mut recorder, 0, AlarmState::Ok);
    assert_eq!(
        (
            recorder.finish().removed,
            read(folder.path()).unwrap().len()
        ),
        (1, 1)
    );
}

#[test]
fn a_folder_that_takes_nothing_is_counted_and_not_fatal() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("evidence");
    let mut recorder = EventRecorder::start(&folder, Quota::default(), &[])
        .unwrap()
        .patient();
    fs::remove_dir_all(&folder).unwrap();
    fs::write(&folder, "a file").unwrap();
    for tenth in 0..30 {
        let state = if tenth < 10 {
            AlarmState::Ok
        } else {
            AlarmState::Gap
        };
        offer(&mut recorder, tenth, state);
    }
    let kept = recorder.finish();
    assert_eq!((kept.events, kept.failed), (0, 1));
    assert!(EventRecorder::start(&folder, Quota::default(), &[]).is_err());
}
