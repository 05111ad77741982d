//! `gapwatch doctor`: what it passes, what it fails with what to do, and its exit code.
#![allow(clippy::unwrap_used)]

mod program;

use std::fs;
use std::path::Path;

use program::{Ran, gapwatch_in};
use serde_json::Value;

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
        "board",
        "model",
        "reference",
        "camera",
        "bus",
        "picture",
        "budget",
        "memory",
        "clock",
        "journal",
    ] {
        assert_eq!(of(&all, check).0, "pass", "{check}: {}", of(&all, check).1);
    }
    assert_eq!(of(&all, "evidence").0, "left out");
    assert_eq!((ran.code, ran.err.as_str()), (0, ""));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn what_fails_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    for (from, to, check, said) in [
        ("strict = true", "", "reference", "strict = true"),
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
    assert!(ran.out.contains("do: see that the lens"), "{}", ran.out);
}
