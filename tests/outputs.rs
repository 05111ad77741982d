//! Files that commands write: they replace neither what is read nor files of another kind, and a signal leaves them whole.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::program::{Ran, files, gapwatch_in, ran};

/// Runs a command that must refuse and change no file.
fn refused(folder: &Path, args: &[&str]) -> String {
    let before = files(folder);
    let said = gapwatch_in(folder, args).refusal();
    assert!(files(folder) == before, "{args:?} changed a file");
    said
}

/// A folder with a drive as recording, journal and CAN log, pictures, a reference, and notes.
fn inputs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let drive = [
        "replay",
        "scene:sim?seed=5&seconds=2",
        "--mcap",
        "drive.mcap",
        "--journal",
        "j.jsonl",
        "--can",
        "log:can.log",
    ];
    gapwatch_in(folder.path(), &drive).ok();
    gapwatch_in(folder.path(), &["scene", "--out", "road", "--count", "2"]).ok();
    fs::copy(root("calibration/sim.json"), at("r.json")).unwrap();
    fs::copy(
        root("calibration/enet-sad-lite-320x160.onnx"),
        at("lane.onnx"),
    )
    .unwrap();
    fs::copy(
        root("calibration/enet-sad-lite-320x160.toml"),
        at("lane.toml"),
    )
    .unwrap();
    fs::write(at("notes.txt"), "of the drive").unwrap();
    std::os::unix::fs::symlink("drive.mcap", at("link.mcap")).unwrap();
    folder
}

fn root(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

#[test]
fn no_command_writes_over_what_it_reads() {
    let folder = inputs();
    for args in [
        &["replay", "drive.mcap", "--mcap", "drive.mcap"][..],
        &["replay", "drive.mcap", "--mcap", "link.mcap"],
        &["replay", "link.mcap", "--mcap", "./drive.mcap"],
        &["replay", "drive.mcap", "--journal", "drive.mcap"],
        &["replay", "drive.mcap", "--can", "log:drive.mcap"],
        &[
            "replay",
            "drive.mcap?condition=fog:3",
            "--mcap",
            "drive.mcap",
        ],
        &["replay", "--reference", "r.json", "--journal", "r.json"],
        &["replay", "--model", "lane.onnx", "--journal", "lane.onnx"],
        &["calibrate", "--sim", "drive.mcap", "--out", "drive.mcap"],
        &[
            "calibrate",
            "--sim",
            "scene:sim?seed=1",
            "--model",
            "lane.onnx",
            "--out",
            "lane.onnx",
        ],
        &[
            "calibrate",
            "--base",
            "r.json",
            "--accept",
            "drive.mcap",
            "--out",
            "r.json",
        ],
        &["merge", "r.json", "r.json", "--out", "r.json"],
        &["report", "j.jsonl", "--out", "j.jsonl"],
        &[
            "compare",
            "road/frames",
            "road/masks",
            "--histograms",
            "road/frames/000000.png",
        ],
    ] {
        let said = refused(folder.path(), args);
        assert!(
            said.contains("would be lost") || said.contains("outside of it"),
            "{said}"
        );
    }
}

#[test]
fn no_command_writes_over_a_file_of_another_kind() {
    let folder = inputs();
    fs::copy(
        root("calibration/results.json"),
        folder.path().join("results.json"),
    )
    .unwrap();
    for args in [
        &["replay", "--journal", "notes.txt"][..],
        &["replay", "--journal", "can.log"],
        &["replay", "--can", "log:j.jsonl"],
        &["replay", "--mcap", "road/frames/000000.png"],
        &[
            "calibrate",
            "--sim",
            "scene:sim?seed=1",
            "--out",
            "lane.onnx",
        ],
        &[
            "calibrate",
            "--sim",
            "scene:sim?seed=1",
            "--out",
            "results.json",
        ],
        &["merge", "r.json", "--out", "j.jsonl"],
        &["report", "j.jsonl", "--out", "notes.txt"],
        &[
            "compare",
            "road/frames",
            "road/masks",
            "--histograms",
            "notes.txt",
        ],
        &[
            "evaluate", "--only", "lane_iou", "--quick", "--out", "r.json",
        ],
        &[
            "evaluate",
            "--only",
            "speed_error",
            "--quick",
            "--plot",
            "notes.txt",
        ],
    ] {
        let said = refused(folder.path(), args);
        assert!(said.contains("wanted"), "{said}");
    }
}

#[test]
fn what_the_monitor_finds_in_its_place_is_kept() {
    let folder = inputs();
    let board =
        "[camera]\nsource = \"scene:sim?seed=1&seconds=1\"\n[can]\nsink = \"none\"\nlisten_s = 0\n";
    fs::write(folder.path().join("board.toml"), board).unwrap();
    let live = ["monitor", "--board", "board.toml", "--journal"];
    refused(folder.path(), &[&live[..], &["board.toml"]].concat());
    for _ in 0..3 {
        gapwatch_in(folder.path(), &[&live[..], &["notes.txt"]].concat()).ok();
    }
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(read("notes.txt.1"), "of the drive");
    assert!(read("notes.txt").starts_with("{\"gapwatch_journal\""));
    assert!(read("notes.txt.2").starts_with("{\"gapwatch_journal\""));
}

#[test]
fn files_of_the_same_kind_are_replaced() {
    let folder = inputs();
    let before = files(folder.path());
    let drive = "scene:sim?seed=6&seconds=2";
    let outputs = [
        "--mcap",
        "drive.mcap",
        "--journal",
        "j.jsonl",
        "--can",
        "log:can.log",
    ];
    gapwatch_in(folder.path(), &[&["replay", drive][..], &outputs].concat()).ok();
    let report = ["report", "j.jsonl", "--out", "r.html"];
    for _ in 0..2 {
        gapwatch_in(folder.path(), &report).ok();
    }
    let after = files(folder.path());
    for name in ["drive.mcap", "j.jsonl", "can.log"] {
        let of = |all: &[(std::path::PathBuf, Vec<u8>)]| {
            let place = folder.path().join(name);
            all.iter()
                .find(|(path, _)| *path == place)
                .unwrap()
                .1
                .clone()
        };
        assert!(of(&before) != of(&after), "{name}");
    }
}

/// Starts a command, and sends it SIGINT when `begun` says so.
fn interrupted(folder: &Path, args: &[&str], begun: impl Fn() -> bool) -> Ran {
    let child = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(args)
        .current_dir(folder)
        .env("TMPDIR", folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let until = Instant::now() + Duration::from_secs(60);
    while !begun() {
        assert!(Instant::now() < until, "{args:?} did not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    let pid = child.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &pid])
            .status()
            .unwrap()
            .success()
    );
    ran(child.wait_with_output().unwrap())
}

/// Number of entries of a folder whose name begins so, and that hold a file.
fn begun_in(folder: &Path, prefix: &str) -> bool {
    let entries = fs::read_dir(folder).unwrap().flatten();
    entries
        .filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix))
        .any(|entry| !files(&entry.path()).is_empty())
}

#[test]
fn a_signal_leaves_the_scenes_and_sheets_that_are_finished() {
    let folder = tempfile::tempdir().unwrap();
    let begun = || begun_in(folder.path(), ".gapwatch-");
    let scenes = ["scene", "--out", "scenes", "--count", "100000"];
    let said = interrupted(folder.path(), &scenes, begun).refusal();
    assert!(said.contains("stopped by a signal"), "{said}");
    let list = fs::read_to_string(folder.path().join("scenes/scenes.jsonl")).unwrap();
    assert!(!list.is_empty());
    for line in list.lines() {
        let line: serde_json::Value = serde_json::from_str(line).unwrap();
        for file in ["frame", "mask"] {
            image::open(
                folder
                    .path()
                    .join("scenes")
                    .join(line[file].as_str().unwrap()),
            )
            .unwrap();
        }
    }
    let all = files(&folder.path().join("scenes")).len();
    assert_eq!(all, 2 * list.lines().count() + 1);

    let sheets = [
        "inspect",
        "scene:sim?seed=1&seconds=600",
        "--out",
        "sheets",
        "--count",
        "5000",
    ];
    let said = interrupted(folder.path(), &sheets, begun).refusal();
    assert!(said.contains("stopped by a signal"), "{said}");
    let json = fs::read_to_string(folder.path().join("sheets/inspect.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let frames = json["frames"].as_array().unwrap();
    assert_eq!(files(&folder.path().join("sheets")).len(), frames.len() + 1);
    assert!(!begun(), "a temporary folder is left");
}

#[test]
fn a_signal_leaves_no_temporary_files_of_a_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let begun = || begun_in(folder.path(), "gapwatch-surveys-");
    let args = [
        "calibrate",
        "--sim",
        "scene:sim?seed=1..2000&seconds=5&fps=2",
        "--held-out",
        "scene:sim?seed=3001..3100&seconds=5&fps=2",
        "--out",
        "r.json",
    ];
    let ended = interrupted(folder.path(), &args, begun);
    // Ended by the signal, without an exit code.
    assert_eq!((ended.code, ended.err.as_str()), (-1, ""));
    assert_eq!(files(folder.path()), []);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
