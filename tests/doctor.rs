//! `gapwatch doctor`: what it passes, what it fails with what to do, and its exit code.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use crate::program::{Ran, gapwatch_in};
use gapwatch::reference::Reference;
use gapwatch::statistics::event_rate::Loudness;
use serde_json::{Value, json};

const DESK: &str = "[camera]\nsource = \"scene:sim?seed=7&seconds=3\"\n[can]\nsink = \"log:can.log\"\n[monitor]\nstrict = true\n\
    [budget]\nframe_ms = 10000\nmemory_mib = 4000\n";

fn doctor(folder: &Path, board: &str, more: &[&str]) -> Ran {
    fs::write(folder.join("board.toml"), board).unwrap();
    let args = ["doctor", "--board", "board.toml"];
    gapwatch_in(folder, &[&args, more].concat())
}

/// Result and words by check.
fn checks(ran: &Ran) -> Vec<(String, String, String)> {
    let found: Vec<Value> = serde_json::from_str(&ran.out).unwrap();
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let one = |check: &Value| {
        let words = format!("{} | {}", text(&check["found"]), text(&check["do"]));
        (text(&check["check"]), text(&check["result"]), words)
    };
    found.iter().map(one).collect()
}

fn of<'a>(all: &'a [(String, String, String)], check: &str) -> (&'a str, &'a str) {
    let (_, result, words) = all.iter().find(|(name, ..)| name == check).unwrap();
    (result, words)
}

#[test]
fn a_desk_passes_and_nothing_is_left_behind() {
    let folder = tempfile::tempdir().unwrap();
    let asked = ["--journal", "drive.jsonl", "--format", "json"];
    let ran = doctor(folder.path(), DESK, &asked);
    let all = checks(&ran);
    for check in [
        "board", "model", "camera", "bus", "picture", "budget", "memory", "clock", "journal",
    ] {
        assert_eq!(of(&all, check).0, "pass", "{check}: {}", of(&all, check).1);
    }
    assert_eq!(of(&all, "evidence").0, "left out");
    // The built-in reference has too few judged hours; that is no failure.
    let (result, words) = of(&all, "reference");
    let built_in = Reference::read(None).unwrap();
    assert!(matches!(
        built_in.false_alarms.loudness(),
        Loudness::NotShown { .. }
    ));
    assert_eq!(result, "warn", "{words}");
    assert!(
        words.contains(&built_in.false_alarms.said()) && words.contains("--held-out"),
        "{words}"
    );
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn what_fails_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to, check, said) in [
        (
            "strict = true",
            "warn = [\"lanes\", \"speed\"]",
            "board",
            "\"gap\", \"change\" and \"lanes\"",
        ),
        (
            "strict = true",
            "strict = true\nmodel = \"no.onnx\"",
            "model",
            "no.onnx",
        ),
        (
            "strict = true",
            "strict = true\nreference = \"board.toml\"",
            "reference",
            "board.toml",
        ),
        (
            "scene:sim?seed=7&seconds=3",
            "v4l2:/dev/video-of-nobody",
            "camera",
            "/dev/video",
        ),
        ("scene:sim?seed=7&seconds=3", "nowhere", "camera", "nowhere"),
        ("log:can.log", "log:no/such/can.log", "bus", "no/such"),
        ("frame_ms = 10000", "frame_ms = 1", "budget", "rate_hz"),
        ("memory_mib = 4000", "memory_mib = 1", "memory", "MiB"),
        ("[budget]", "[bugdet]", "board", "board.toml:7"),
    ] {
        let ran = doctor(
            folder.path(),
            &DESK.replace(from, to),
            &["--format", "json"],
        );
        let all = checks(&ran);
        let (result, words) = of(&all, check);
        assert_eq!(result, "fail", "{from} -> {to}: {words}");
        assert!(words.contains(said), "{words}");
        assert!(!words.ends_with("| "), "{words}");
        assert_eq!(ran.code, 2);
        assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
        assert!(ran.err.contains(check), "{}", ran.err);
    }
}

#[cfg(feature = "can")]
#[test]
fn a_bus_that_is_not_there_or_no_bus_is_told() {
    let folder = tempfile::tempdir().unwrap();
    for (interface, said) in [
        ("vcan77", "ip link add vcan77"),
        ("nocan7", "plug"),
        ("lo", "CAN"),
    ] {
        let board = DESK.replace("log:can.log", &format!("socketcan:{interface}"));
        let ran = doctor(folder.path(), &board, &["--format", "json"]);
        let all = checks(&ran);
        let (result, words) = of(&all, "bus");
        assert_eq!(result, "fail");
        assert!(words.contains(said), "{words}");
    }
}

#[test]
fn a_black_camera_cannot_be_judged() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("dark")).unwrap();
    for n in 0..3 {
        let black = image::RgbImage::new(64, 32);
        black
            .save(folder.path().join(format!("dark/{n}.png")))
            .unwrap();
    }
    let board = DESK.replace("scene:sim?seed=7&seconds=3", "dark");
    let ran = doctor(folder.path(), &board, &[]);
    assert_eq!(ran.code, 2);
    let line = ran
        .out
        .lines()
        .find(|line| line.contains(" picture "))
        .unwrap();
    assert!(line.starts_with("fail") && line.contains("black"), "{line}");
    assert!(
        ran.out.contains("do: check that nothing covers the lens"),
        "{}",
        ran.out
    );
}

#[test]
fn a_rate_of_false_alarms_passes_warns_or_fails_by_what_its_drives_show() {
    let folder = tempfile::tempdir().unwrap();
    let built_in = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim.json");
    let built_in = fs::read_to_string(built_in).unwrap();
    let board = DESK.replace("strict = true", "strict = true\nreference = \"r.json\"");
    let judged = |entries: u64, hours: f64, resampled: Option<[f64; 2]>| {
        let mut on =
            json!({ "drives": 36, "hours": hours, "entries": entries, "per_hour": [0.1, 9.0] });
        if let Some(bounds) = resampled {
            on["resampled"] = json!(bounds);
        }
        on
    };
    for (on, result, said) in [
        (
            judged(0, 3.0, None),
            "pass",
            "not louder than asked: at most 0.999 an hour",
        ),
        (
            judged(20, 3.0, None),
            "fail",
            "louder than asked: at least 4.42 an hour",
        ),
        // All of them in few drives.
        (
            judged(20, 3.0, Some([0.0, 17.0])),
            "warn",
            "about 48.0 hours more without an entry",
        ),
        (
            judged(0, 2.0, None),
            "warn",
            "59.8 minutes more without an entry",
        ),
        (
            Value::Null,
            "warn",
            "nothing was judged; 3.0 hours without an entry",
        ),
    ] {
        let mut reference: Value = serde_json::from_str(&built_in).unwrap();
        reference["false_alarms"]["judged_on"] = on;
        fs::write(folder.path().join("r.json"), reference.to_string()).unwrap();
        let ran = doctor(folder.path(), &board, &["--format", "json"]);
        let all = checks(&ran);
        let (found, words) = of(&all, "reference");
        assert_eq!(found, result, "{words}");
        assert!(
            words.contains(&format!(
                "made for 1 false alarms an hour, {}",
                if result == "warn" {
                    "not shown: "
                } else {
                    said
                }
            )),
            "{words}"
        );
        assert!(words.contains(said), "{words}");
        assert_eq!(words.ends_with("| "), result == "pass", "{words}");
        assert_eq!(
            ran.code,
            if result == "fail" { 2 } else { 0 },
            "{}",
            ran.err
        );
    }
}

#[test]
fn calibrate_merge_and_doctor_tell_of_drives_that_are_louder_than_asked() {
    let folder = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| gapwatch_in(folder.path(), args);
    let warned = |ran: Ran| {
        assert!(
            ran.out
                .contains("\n  louder than asked: at least 3.08 an hour (95 %)\n"),
            "{}",
            ran.out
        );
        assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
        assert!(
            ran.err
                .contains("r.json: false alarms are louder than asked: at least 3.08"),
            "{}",
            ran.err
        );
        assert_eq!(ran.code, 0);
    };
    // The fourth drive judges: one minute of fog that is one entry.
    let loud = "scene:sim?seed=104&seconds=60&fps=2&condition=fog:5";
    warned(run(&[
        "calibrate",
        "--sim",
        "scene:sim?seed=1..8&seconds=2",
        "--held-out",
        "scene:sim?seed=101..103&seconds=60&fps=2",
        loud,
        "--surveys",
        "r.surveys",
        "--out",
        "r.json",
    ]));
    warned(run(&["merge", "r.json", "--out", "merged-r.json"]));
    let board = DESK.replace("strict = true", "strict = true\nreference = \"r.json\"");
    let ran = doctor(folder.path(), &board, &["--format", "json"]);
    let all = checks(&ran);
    let (result, words) = of(&all, "reference");
    assert_eq!((result, ran.code), ("fail", 2), "{words}");
    assert!(
        words.contains("louder than asked: at least 3.08 an hour"),
        "{words}"
    );
    run(&[
        "replay",
        "scene:sim?seed=7&seconds=2",
        "--reference",
        "r.json",
        "--journal",
        "j.jsonl",
    ])
    .ok();
    let journal = fs::read_to_string(folder.path().join("j.jsonl")).unwrap();
    let first: Value = serde_json::from_str(journal.lines().next().unwrap()).unwrap();
    let known = first["about"]["false_alarms"].as_str().unwrap();
    assert!(
        known.ends_with("1 entries into Gap; louder than asked: at least 3.08 an hour (95 %)"),
        "{known}"
    );
}
