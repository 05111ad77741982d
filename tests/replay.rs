//! Drives through the whole chain: states, journal, bus, exit codes.
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::cast_possible_truncation
)]

use crate::program::{assert_expected, gapwatch_in, journal_of, names};
use serde_json::Value;
use std::fs;
use std::io::Read;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// The replay's words, without the time it took.
fn without_duration(out: &str) -> String {
    let cut = |line: &str| match (line.find(" of drive in "), line.find(" s: ")) {
        (Some(from), Some(to)) => format!("{} of drive{}", &line[..from], &line[to + 2..]),
        _ => line.to_owned(),
    };
    out.lines().map(|line| cut(line) + "\n").collect()
}

#[test]
fn the_built_in_drive_is_ok_then_a_gap_within_3_s_of_the_shift_then_ok_again_5_s_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = gapwatch_in(
        folder.path(),
        &["replay", "--journal", "j.jsonl", "--can", "log:can.log"],
    )
    .ok();
    assert_expected("replay.txt", &without_duration(&out));
    let journal = journal_of(&folder.path().join("j.jsonl"));
    assert_eq!(journal.len(), 600);
    let state = |tenth: usize| journal[tenth]["state"].as_str().unwrap();
    for (part, tenths, wanted) in [
        ("nominal", 20..180, "Ok"),
        (
            "fog, from 3 s after it has reached its severity",
            230..380,
            "Gap",
        ),
        ("nominal again, from 5 s after it has gone", 450..600, "Ok"),
    ] {
        for tenth in tenths {
            assert_eq!(
                state(tenth),
                wanted,
                "{part}: at {tenth} tenths of a second"
            );
        }
    }
    let log = fs::read_to_string(folder.path().join("can.log")).unwrap();
    assert!(log.lines().filter(|line| line.contains(" 5D0#")).count() >= 600);
    for id in [" 5D1#", " 5D3#"] {
        assert!(log.lines().filter(|line| line.contains(id)).count() >= 60);
    }
}

#[test]
fn journal_lines_have_every_key_and_one_number_a_tap() {
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(
        folder.path(),
        &[
            "replay",
            "scene:sim?seed=3&seconds=2&fps=5",
            "--journal",
            "j.jsonl",
        ],
    )
    .ok();
    for line in journal_of(&folder.path().join("j.jsonl")) {
        for key in [
            "t_s",
            "seq",
            "state",
            "reason",
            "score",
            "gap",
            "tap_gap",
            "tap_similarity",
            "health",
            "latency_ms",
        ] {
            assert!(!line[key].is_null(), "{key} in {line}");
        }
        for tap in ["e2", "e3", "e4"] {
            let (gap, similarity) = (
                line["tap_gap"][tap].as_f64().unwrap(),
                line["tap_similarity"][tap].as_f64().unwrap(),
            );
            assert!(gap >= 0.0 && (similarity * (1.0 + gap) - 1.0).abs() < 1e-12);
        }
    }
}

#[test]
fn the_same_drive_gives_the_same_verdicts_twice() {
    let folder = tempfile::tempdir().unwrap();
    let verdicts = |name: &str| {
        let drive = "scene:sim?seed=11&seconds=8&condition=dirt:3@3-6";
        gapwatch_in(folder.path(), &["replay", drive, "--journal", name]).ok();
        let mut lines = journal_of(&folder.path().join(name));
        lines
            .iter_mut()
            .for_each(|line| line["latency_ms"] = Value::Null);
        lines
    };
    assert_eq!(verdicts("a"), verdicts("b"));
}

#[test]
fn check_tells_gap_no_gap_and_could_not_judge_apart() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("black")).unwrap();
    for i in 0..20 {
        image::RgbImage::new(64, 32)
            .save(folder.path().join(format!("black/{i}.png")))
            .unwrap();
    }
    let check = |source: &str| gapwatch_in(folder.path(), &["replay", source, "--check"]);
    assert_eq!(check("scene:sim?seed=7&seconds=8").code, 0);
    assert_eq!(
        check("scene:sim?seed=7&seconds=8&condition=noise:5").code,
        1
    );
    // One frame in 2.5 s never fills a window.
    assert_eq!(
        check("scene:sim?seed=7&seconds=30&fps=0.4&condition=noise:5").code,
        3
    );
    // At one frame a second there is no verdict half of the time, but evidence adds up.
    assert_eq!(check("scene:sim?seed=7&seconds=20&fps=1").code, 3);
    assert_eq!(
        check("scene:sim?seed=7&seconds=20&fps=1&condition=noise:5").code,
        1
    );
    let blind = check("black");
    assert_eq!(blind.code, 3, "{}", blind.err);
    assert!(
        blind.out.contains("SensorFault") && !blind.out.contains("Ok"),
        "{}",
        blind.out
    );
}

#[test]
fn with_the_log_on_standard_output_nothing_else_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let ran = gapwatch_in(
        folder.path(),
        &["replay", "scene:sim?seconds=2", "--can", "log:-"],
    );
    assert_eq!(ran.code, 0);
    for line in ran.out.lines() {
        assert!(line.starts_with('(') && line.contains('#'), "{line}");
    }
    assert!(ran.out.lines().count() >= 21, "{}", ran.out);
    assert!(ran.err.contains("Ok"), "{}", ran.err);
}

#[test]
fn silence_between_frames_is_unavailable_on_the_bus_and_in_the_journal() {
    let folder = tempfile::tempdir().unwrap();
    let drive = [
        "replay",
        "scene:sim?seed=7&seconds=12&fps=1",
        "--journal",
        "j.jsonl",
        "--can",
        "log:can.log",
    ];
    gapwatch_in(folder.path(), &drive).ok();
    let journal = journal_of(&folder.path().join("j.jsonl"));
    let silent: Vec<&Value> = journal
        .iter()
        .filter(|line| line["seq"].is_null())
        .collect();
    assert_eq!((journal.len(), silent.len()), (12 + 11, 11));
    for line in silent {
        assert_eq!(
            (line["state"].as_str(), line["reason"].as_str()),
            (Some("Unavailable"), Some("stale"))
        );
        assert_eq!(line["t_s"].as_f64().unwrap().fract(), 0.5);
    }
    // Bits 16 to 18 of GapStatus are the state, the low half of byte 1 the counter, the high half the age.
    let log = fs::read_to_string(folder.path().join("can.log")).unwrap();
    for line in log.lines().filter(|line| line.contains(" 5D0#")) {
        let time: f64 = line[1..18].parse().unwrap();
        let bytes = line.split('#').nth(1).unwrap();
        let byte = |i: usize| u8::from_str_radix(&bytes[2 * i..2 * i + 2], 16).unwrap();
        let since = time.fract();
        if time > 1.0 {
            assert_eq!(byte(2) & 7, if since < 0.45 { 1 } else { 5 }, "{line}");
        }
        let age = f64::from(byte(1) >> 4) * 0.1;
        assert!((age - since).abs() < 0.16, "{line}: age {age} s");
    }
}

#[test]
fn a_signal_ends_a_replay_in_order_and_a_second_one_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let start = |source: &str| {
        let outputs = ["--journal", "j", "--mcap", "m.mcap", "--can", "log:l"];
        Command::new(env!("CARGO_BIN_EXE_gapwatch"))
            .args(["replay", source, "--evidence", "seen"])
            .args(outputs)
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let signal = |child: &Child, name: &str| {
        let kill = format!("kill -{name} {}", child.id());
        assert!(
            Command::new("sh")
                .args(["-c", &kill])
                .status()
                .unwrap()
                .success()
        );
    };
    // It has begun when it has told people of its first frame.
    let begun = |child: &mut Child| {
        let mut first = [0];
        child
            .stdout
            .as_mut()
            .unwrap()
            .read_exact(&mut first)
            .unwrap();
    };
    for name in ["INT", "TERM", "HUP"] {
        let mut child = start("scene:sim?seed=7&seconds=3600&size=160x80");
        begun(&mut child);
        signal(&child, name);
        let done = child.wait_with_output().unwrap();
        let said = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains("stopped by a signal after "), "{said}");
        let read = gapwatch::record::journal::read(&folder.path().join("j")).unwrap();
        assert!(!read.breaks_off);
        let frames = read.entries.len();
        let again = ["replay", "m.mcap", "--journal", "k"];
        gapwatch_in(folder.path(), &again).ok();
        assert_eq!(journal_of(&folder.path().join("k")).len(), frames);
        let log = fs::read_to_string(folder.path().join("l")).unwrap();
        assert!(log.ends_with('\n') && log.contains(" 5D0#"));
        let left = names(folder.path());
        assert_eq!(left, ["j", "k", "l", "m.mcap", "seen"], "after {name}");
        fs::remove_file(folder.path().join("k")).unwrap();
    }

    // Nobody reads what it writes, so it waits for that.
    let mut child = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(["replay", "scene:sim?seed=7&seconds=36000&size=64x32"])
        .args(["--can", "log:-", "--quiet"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let waits = || {
        let stack = format!("/proc/{}/wchan", child.id());
        fs::read_to_string(stack).is_ok_and(|at| at.contains("pipe"))
    };
    let until = Instant::now() + Duration::from_secs(60);
    while !waits() {
        assert!(Instant::now() < until, "it never waits");
        std::thread::sleep(Duration::from_millis(20));
    }
    signal(&child, "INT");
    std::thread::sleep(Duration::from_millis(300));
    assert!(child.try_wait().unwrap().is_none(), "it did not wait");
    signal(&child, "INT");
    assert_eq!(child.wait().unwrap().code(), Some(130));
}
