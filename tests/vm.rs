//! `gapwatch monitor` in a virtual machine: Debian's kernel with its test drivers for cameras (vivid) and buses (vcan).
//!
//! The machine is booted once for all tests, by whichever comes first; `tests/vm/guest.sh` is what happens inside. Its
//! clock counts instructions, so what is late there is late on any computer. `tests/vm/run` runs these tests alone and
//! shows what they measured.
#![cfg(all(feature = "camera", feature = "can"))]
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]

mod faults;
mod share;

use std::fs;
use std::process::Command;

use crate::clips::pictures;
use crate::machine::report;
use gapwatch::can::BusState;
use gapwatch::can::message::{GapHealth, GapStatus};
use gapwatch::capture::Picture;
use gapwatch::capture::pixels::Pixels;
use gapwatch::monitor::alarm::{AlarmState, Reason};
use gapwatch::record::journal::Entry;

use share::*;

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_verdicts_through_camera_and_kernel_equal_those_of_a_replay() {
    let share = machine();
    let seen = journal_of(&share, "drive.jsonl");
    assert!(seen.len() > 100, "{} frames judged", seen.len());
    let files = pictures(DRIVE);
    let camera: Vec<Pixels> = files.iter().map(through_yuyv).collect();
    // Panics unless a frame of the clip explains every score and state to the last bits.
    let shown = shown(&share, &seen, &camera);

    // The pixel format alone, at the same times: colours of two pixels are one, and all are rounded once more.
    let files: Vec<&Picture> = shown.iter().map(|&at| &files[at]).collect();
    let (mut nominal, mut beyond) = (0.0_f64, 0.0_f64);
    for (entry, verdict) in seen.iter().zip(judged(&share, &seen, &files)) {
        let (ours, theirs) = (entry.score.unwrap(), verdict.score.unwrap());
        let difference = (ours - theirs).abs();
        if ours < 1.0 {
            nominal = nominal.max(difference);
        } else {
            beyond = beyond.max(difference / ours);
        }
    }
    assert!(
        nominal < 0.02,
        "below the threshold scores differ by {nominal}"
    );
    assert!(beyond < 0.05, "above it by a share of {beyond}");

    // The program on the same files, ten a second: a window of 1 s may hold one frame more or less.
    let replay = replayed(&share, files.into_iter());
    let (ours, theirs) = (changes(&seen), changes(&replay));
    let states = |changes: &[(f64, AlarmState)]| -> Vec<AlarmState> {
        changes.iter().map(|c| c.1).collect()
    };
    use AlarmState::{Gap, Init, Ok, Suspect};
    assert_eq!(states(&ours), [Init, Ok, Suspect, Gap, Ok]);
    assert_eq!(states(&theirs), states(&ours));
    for (ours, theirs) in ours.iter().zip(&theirs) {
        assert!((ours.0 - theirs.0).abs() < 0.25, "{ours:?} {theirs:?}");
    }
    report(
        &share,
        "equal",
        &format!(
            "Camera and replay of the same files: {} frames, states {:?}; scores equal to {SAME} on the pixels of the camera; \
         against the files they differ by {nominal:.4} at most below the threshold and by {:.1} % above it (YUYV).\n",
            seen.len(),
            states(&ours),
            100.0 * beyond
        ),
    );
}

/// Changes of state with their times.
fn changes(entries: &[Entry]) -> Vec<(f64, AlarmState)> {
    let mut changes: Vec<(f64, AlarmState)> = vec![];
    for entry in entries {
        if changes.last().is_none_or(|last| last.1 != entry.state) {
            changes.push((entry.captured_s.unwrap(), entry.state));
        }
    }
    changes
}

#[test]
#[ignore = "needs qemu and the Python packages of tests/requirements.txt: run tests/run"]
fn vm_candump_and_cantools_read_the_warning_from_the_bus() {
    let share = machine();
    let log = logged(&share);
    let drive = between(&log, "drive", "after").iter();
    let lines: String = drive
        .filter(|l| l.bus == "vcan0")
        .map(|l| l.line.as_str())
        .collect();
    let file = share.join("drive.log");
    fs::write(&file, lines).unwrap();
    let python = std::env::var("GAPWATCH_PYTHON").expect("GAPWATCH_PYTHON; tests/run sets it");
    let out = Command::new(python)
        .arg(format!("{ROOT}/tests/python/check_can_log.py"))
        .arg(&file)
        .arg(format!("{ROOT}/src/can/gapwatch.dbc"))
        // The bus is looked after every 10 ms.
        .args(["--tolerance-ms", "21"])
        .output()
        .unwrap();
    let said = String::from_utf8(out.stdout).unwrap();
    assert!(
        out.status.success(),
        "{said}{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let read: serde_json::Value = serde_json::from_str(said.trim()).unwrap();
    assert!(read["status_frames"].as_u64().unwrap() >= 115, "{read}");
    let states = read["states"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s[1].as_str().unwrap());
    let states: Vec<&str> = states.collect();
    assert_eq!(
        states,
        ["Init", "Ok", "Suspect", "Gap", "Ok", "Unavailable"]
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_a_verdict_is_on_the_bus_soon_after_its_frame() {
    let share = machine();
    let log = logged(&share);
    let bus = statuses(between(&log, "drive", "after"));
    let seen = journal_of(&share, "drive.jsonl");
    // The first status is sent when the monitor's clock starts.
    let began = bus[0].0;
    let mut told = vec![];
    for (at, state) in changes(&seen).into_iter().skip(1) {
        let on_bus = bus
            .iter()
            .find(|(on_bus, status)| *on_bus - began >= at && status.state == state);
        let (on_bus, _) = on_bus.unwrap_or_else(|| panic!("{state:?} of {at} s is not on the bus"));
        told.push((on_bus - began - at) * 1e3);
    }
    let latencies = percentiles(seen.iter().skip(1).map(|entry| entry.latency_ms).collect());
    let reaction = percentiles(told);
    assert!(reaction[2] < 50.0, "frame to bus, ms: {reaction:?}");
    assert!(latencies[2] < 50.0, "frame to verdict, ms: {latencies:?}");
    let pauses = percentiles(pauses_ms(&bus, |_| true));
    assert!(pauses[2] < 121.0, "between status frames, ms: {pauses:?}");
    report(
        &share,
        "reaction",
        &format!(
            "Reaction: frame to verdict handed to the bus p50 {:.1} ms, p99 {:.1} ms over {} frames; changes of state on the bus \
         {:.1} ms after their frame at most; pauses between status frames p50 {:.1} ms, p99 {:.1} ms, longest {:.1} ms.\n",
            latencies[0],
            latencies[1],
            seen.len(),
            reaction[2],
            pauses[0],
            pauses[1],
            pauses[2]
        ),
    );
}

/// Milliseconds from each status frame to the next, of those whose times both count.
fn pauses_ms(statuses: &[(f64, GapStatus)], counts: impl Fn(f64) -> bool) -> Vec<f64> {
    let pairs = statuses.windows(2);
    pairs
        .filter(|pair| counts(pair[0].0) && counts(pair[1].0))
        .map(|pair| (pair[1].0 - pair[0].0) * 1e3)
        .collect()
}

/// Median, 99th percentile and largest.
fn percentiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [0.5, 0.99, 1.0].map(|share| values[(share * (values.len() - 1) as f64).round() as usize])
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_a_night_is_a_gap_and_its_stored_bit_is_cleared_by_a_valid_request_only() {
    let share = machine();
    let log = logged(&share);
    let night = statuses(between(&log, "night", "clear"));
    assert!(
        night
            .iter()
            .any(|(_, status)| status.state == AlarmState::Gap)
    );
    for (at, status) in &night {
        let fault = [AlarmState::SensorFault, AlarmState::Unavailable].contains(&status.state);
        assert!(!fault, "{at}: {status:?}");
    }
    assert_eq!(night.last().unwrap().1.state, AlarmState::Ok);
    let clear = between(&log, "clear", "unacked");
    let requests: Vec<f64> = clear
        .iter()
        .filter(|l| l.id == "5D8")
        .map(|l| l.at)
        .collect();
    let stored_after = |from: f64, to: f64| {
        let statuses = statuses(clear);
        let last = statuses.iter().rfind(|(at, _)| (from..to).contains(at));
        last.unwrap().1.gap_stored
    };
    assert!(
        stored_after(requests[0], requests[1]),
        "cleared by a wrong checksum"
    );
    assert!(
        !stored_after(requests[1], requests[2]),
        "not cleared by a right one"
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_a_bus_that_nobody_acknowledges_holds_one_old_frame_at_most() {
    let share = machine();
    let log = logged(&share);
    let stuck = statuses(between(&log, "unacked", "acked"));
    assert!(stuck.len() <= 1, "{stuck:?}");
    let after = statuses(between(&log, "acked", "free"));
    assert!(after.len() >= 9, "{after:?}");
    let black = |(_, status): &&(f64, GapStatus)| {
        (status.state, status.reason) == (AlarmState::SensorFault, Reason::Black)
    };
    let old = after.iter().filter(|status| !black(status)).count();
    assert!(old <= 1, "{after:?}");
    assert!(after[old..].iter().all(|status| black(&status)));
    let queue = fs::read_to_string(share.join("queue")).unwrap();
    report(
        &share,
        "unacknowledged",
        &format!(
            "Nobody acknowledges for 4 s, queue of {queue} frames: then {old} frame of before is sent, and the newest behind it.\n"
        ),
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_silence_follows_a_kill_and_a_foreign_sender_is_refused_at_the_start() {
    let share = machine();
    let log = logged(&share);
    assert!(statuses(between(&log, "killed", "again")).is_empty());
    let again = statuses(between(&log, "again", "other"));
    assert_eq!(again[0].1.state, AlarmState::Init);
    assert!(
        again
            .iter()
            .any(|(_, status)| status.state == AlarmState::Ok)
    );
    let said = fs::read_to_string(share.join("other.err")).unwrap();
    assert!(
        said.contains("0x5D0 is already sent by another node"),
        "{said}"
    );
    assert_eq!(fs::read_to_string(share.join("other.code")).unwrap(), "2\n");
    // The disk was full meanwhile.
    let said = fs::read_to_string(share.join("again.err")).unwrap();
    assert!(
        said.contains("full/again.jsonl: No space left on device")
            && said.contains("lines are left out"),
        "{said}"
    );
    let codes = [
        "drive.code",
        "again.code",
        "adapter.code",
        "clock.code",
        "soak.code",
    ];
    for code in codes {
        assert_eq!(
            fs::read_to_string(share.join(code)).unwrap(),
            "0\n",
            "{code}"
        );
    }
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_the_cycle_goes_on_when_the_clock_jumps_by_years() {
    let share = machine();
    let log = logged(&share);
    let before = between(&log, "done", "clock");
    let after = between(&log, "clock", "end2");
    assert!(after.last().unwrap().at - before.last().unwrap().at > 1e8);
    let all: Vec<Logged> = before.iter().chain(after).cloned().collect();
    // Counters follow each other; 3 s at ten a second, and one for each change.
    let all = statuses(&all);
    assert!(
        (29..40).contains(&all.len()),
        "{} status frames in 3 s",
        all.len()
    );
    let after = statuses(after);
    let stopped = after.iter().position(|(_, s)| s.reason == Reason::Stopped);
    let (judged, end) = after.split_at(stopped.unwrap());
    assert!(judged.len() >= 5 && end.len() <= 3, "{after:?}");
    assert!(
        judged.iter().all(|(_, s)| s.state == AlarmState::Ok),
        "{judged:?}"
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_memory_does_not_grow_through_faults() {
    let share = machine();
    let log = fs::read_to_string(share.join("memory.log")).unwrap();
    let kib = |line: &str| {
        line.split_whitespace()
            .nth(1)
            .unwrap()
            .parse::<u64>()
            .unwrap()
    };
    let [before, after] = [0, 1].map(|n| kib(log.lines().nth(n).unwrap()));
    assert!(after < before + 1024, "{before} KiB, then {after} KiB");
    report(
        &share,
        "memory",
        &format!("Memory: {before} KiB after 4 s, {after} KiB after all faults.\n"),
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_a_controller_in_trouble_is_told_and_nothing_is_lost_in_bus_off() {
    let share = machine();
    let log = logged(&share);
    let on_adapter = |from: &str, to: &str| -> Vec<Logged> {
        let all = between(&log, from, to).iter().filter(|l| l.bus == "can0");
        all.cloned()
            .map(|l| Logged {
                bus: "vcan0".to_owned(),
                ..l
            })
            .collect()
    };
    // Every counter follows the one before, through bus-off too.
    let all = statuses(&on_adapter("adapter", "done"));
    assert!(all.iter().any(|(_, status)| status.state == AlarmState::Ok));
    let told = |from: &str, to: &str| {
        let frames = on_adapter(from, to);
        let health = frames.iter().rfind(|l| l.id == "5D1").unwrap();
        let data: [u8; 8] = health.data.as_slice().try_into().unwrap();
        GapHealth::from_bytes(&data).unwrap().bus_state
    };
    assert_eq!(told("adapter", "warning"), BusState::Active);
    assert_eq!(told("warning", "passive"), BusState::Warning);
    assert_eq!(told("passive", "off"), BusState::Passive);
    let off = statuses(&on_adapter("off", "back"));
    assert!(off.len() <= 1, "{off:?} in bus-off");
    let back = statuses(&on_adapter("back", "done"));
    let marked = between(&log, "off", "done")
        .iter()
        .find(|l| l.id == "7F0")
        .unwrap()
        .at;
    assert!(
        back[0].0 - marked < 0.3,
        "{} s after the bus was back",
        back[0].0 - marked
    );
    let said = fs::read_to_string(share.join("adapter.err")).unwrap();
    assert!(
        said.contains("Passive -> Off") && said.contains("bus-off"),
        "{said}"
    );
}

#[test]
#[ignore = "needs qemu and Debian's kernel: run tests/run"]
fn vm_faults_at_random_lose_no_warning_and_no_memory() {
    let share = machine();
    let log = logged(&share);
    let soak = between(&log, "soak", "soaked");
    let (all, after_a_loss) = statuses_and_losses(soak);
    let marks = soak
        .iter()
        .filter(|logged| logged.id == "7F0")
        .map(|logged| (logged.at, std::str::from_utf8(&logged.data).unwrap()));
    // Each ends with a nominal road, the last one with the end.
    let end = soak.last().map(|last| (last.at, "soaked"));
    let marks: Vec<(f64, &str)> = marks.chain(end).collect();
    let events: Vec<[(f64, &str); 3]> = marks
        .windows(3)
        .filter(|three| three[0].1 != "nominal" && three[1].1 == "nominal")
        .map(|three| [three[0], three[1], three[2]])
        .collect();
    assert!(events.len() >= 5, "{} faults", events.len());
    let mut nights = 0;
    let mut wrong = vec![];
    for [(begin, name), (end, _), (next, _)] in &events {
        let within = |from: f64, to: f64| all.iter().filter(move |(at, _)| (from..to).contains(at));
        let gaps = within(*begin, *next).filter(|(_, status)| status.state == AlarmState::Gap);
        let gaps = gaps.count();
        nights += usize::from(*name == "night");
        if (gaps > 0) != (*name == "night") {
            wrong.push(format!("{name} at {begin}: {gaps} times Gap"));
        }
        let last = within(*end, *next)
            .next_back()
            .map(|(_, status)| status.state);
        if last != Some(AlarmState::Ok) {
            wrong.push(format!("{name} at {begin}: {last:?} at its end"));
        }
    }
    assert!(nights > 0, "no night among {} faults", events.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let said = fs::read_to_string(share.join("soak.err")).unwrap();
    assert!(
        !said.contains("panic") && !said.contains("internal error"),
        "{said}"
    );

    let memory = fs::read_to_string(share.join("soak-memory.log")).unwrap();
    let kib = |line: &str| -> u64 { line.split_whitespace().nth(1).unwrap().parse().unwrap() };
    let kib: Vec<u64> = memory.lines().map(kib).collect();
    // Everything has happened once after a third of the time, or nearly.
    let warm = &kib[kib.len() / 3..];
    let (least, most) = (warm.iter().min().unwrap(), warm.iter().max().unwrap());
    assert!(most - least <= 1024, "{kib:?}");
    // Linux says that a frame was taken over, and drops it, when the interface goes down at that moment (`noop_enqueue` of its
    // net/sched/sch_generic.c answers NET_XMIT_CN, which is no error). The receiver's counter tells, once a time.
    let mut lost_otherwise = after_a_loss.clone();
    for [begin, end, _] in &events {
        if ["busdown", "busgone"].contains(&begin.1) {
            let lost = |at: &f64| (begin.0..end.0 + 0.5).contains(at);
            if let Some(first) = lost_otherwise.iter().position(lost) {
                lost_otherwise.remove(first);
            }
        }
    }
    assert!(lost_otherwise.is_empty(), "{lost_otherwise:?}");
    let disturbs_the_bus = ["busdown", "busgone", "paused"];
    let quiet = |at: f64| {
        let disturbed = |event: &[(f64, &str); 3]| {
            disturbs_the_bus.contains(&event[0].1) && (event[0].0..event[1].0 + 0.5).contains(&at)
        };
        !events.iter().any(disturbed)
    };
    let pauses = percentiles(pauses_ms(&all, quiet));
    assert!(pauses[2] < 150.0, "between status frames, ms: {pauses:?}");
    report(
        &share,
        "soak",
        &format!(
            "Faults at random, seed {SOAK_SEED}: {} in {:.0} s, {nights} of them nights, each a Gap and nothing else; memory {least} to \
             {most} KiB; pauses between status frames p50 {:.1} ms, p99 {:.1} ms, longest {:.1} ms; {} of {} frames after a hole, where the bus went down.\n",
            events.len(),
            soak.last().unwrap().at - soak[0].at,
            pauses[0],
            pauses[1],
            pauses[2],
            after_a_loss.len(),
            all.len()
        ),
    );
}
