//! Evidence on disk: what a drive leaves, what a killed program leaves, what is refused.
#![allow(clippy::unwrap_used)]

mod program;

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use program::{files, gapwatch_in, whole_events};

/// Noise that comes and goes: an alarm every 4 s.
fn flicker(seconds: u32) -> String {
    let noise = (1..seconds - 2).step_by(8);
    let noise = noise.map(|s| format!("&condition=noise:5@{s}-{}", s + 2));
    format!(
        "scene:sim?seed=7&seconds={seconds}&size=160x80{}",
        noise.collect::<String>()
    )
}

#[test]
fn a_drive_leaves_events_within_the_quota_and_the_report_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let drive = flicker(32);
    let replay = [
        "replay",
        &drive,
        "--journal",
        "j",
        "--evidence",
        "seen",
        "--evidence-events",
        "2",
    ];
    let said = gapwatch_in(folder.path(), &replay).ok();
    assert!(
        said.contains("evidence: 4 events written, 2 older ones removed"),
        "{said}"
    );
    assert_eq!(
        whole_events(&folder.path().join("seen")),
        ["000003", "000004"]
    );
    let report = ["report", "j", "--evidence", "seen", "--out", "r.html"];
    gapwatch_in(folder.path(), &report).ok();
    let page = fs::read_to_string(folder.path().join("r.html")).unwrap();
    let count = |what: &str| page.matches(what).count();
    assert!(count("alt=\"Frame, ") >= 6, "{}", count("alt=\"Frame, "));
    assert_eq!(count("alt=\"Energies over the frame, ") % 3, 0, "one a tap");
    assert!(count("alt=\"Energies over the frame, ") >= 6);
    // Evidence of another drive is not shown.
    let other = ["replay", "scene:sim?seed=8&seconds=3", "--journal", "k"];
    gapwatch_in(folder.path(), &other).ok();
    gapwatch_in(
        folder.path(),
        &["report", "k", "--evidence", "seen", "--out", "k.html"],
    )
    .ok();
    let page = fs::read_to_string(folder.path().join("k.html")).unwrap();
    assert!(!page.contains("image/jpeg;"));
}

#[test]
fn a_killed_program_leaves_only_whole_events_and_the_next_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    let drive = flicker(200);
    let args = ["replay", &drive, "--evidence", "seen"];
    let mut before = 0;
    for kill in 0..4 {
        let mut child = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
            .args(args)
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let began = Instant::now();
        while whole_events(&seen).len() <= before {
            assert!(began.elapsed() < Duration::from_secs(60), "no event");
            std::thread::sleep(Duration::from_millis(3));
        }
        // At another moment of the next event each time.
        std::thread::sleep(Duration::from_millis(170 * kill));
        child.kill().unwrap();
        child.wait().unwrap();
        before = whole_events(&seen).len();
    }
    assert!(before >= 4);
    // What a kill in the middle of an event leaves goes at the next start.
    fs::create_dir_all(seen.join(".unfinished-000099")).unwrap();
    fs::write(seen.join(".unfinished-000099/frame-000001.jpg"), "half").unwrap();
    let drive = flicker(8);
    gapwatch_in(folder.path(), &["replay", &drive, "--evidence", "seen"]).ok();
    assert!(whole_events(&seen).len() > before);
    assert!(!seen.join(".unfinished-000099").exists());
}

/// A small file system of its own at a folder, until it is dropped.
struct SmallDisk<'a>(&'a Path);

impl<'a> SmallDisk<'a> {
    fn mount(folder: &'a Path, size: &str) -> Self {
        let status = Command::new("mount")
            .args([
                "-t",
                "tmpfs",
                "-o",
                &format!("size={size}"),
                "gapwatch-test",
            ])
            .arg(folder)
            .status();
        assert!(status.unwrap().success(), "cannot mount a tmpfs");
        Self(folder)
    }
}

impl Drop for SmallDisk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).status();
    }
}

#[test]
#[ignore = "needs root, for a disk that fills up: run tests/run"]
fn root_a_full_disk_costs_events_and_no_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    fs::create_dir(&seen).unwrap();
    let drive = flicker(48);
    let journal = |name: &str, more: &[&str]| {
        let args = ["replay", &drive, "--journal", name];
        let said = gapwatch_in(folder.path(), &[&args, more].concat()).ok();
        let text = fs::read_to_string(folder.path().join(name)).unwrap();
        let lines = text
            .lines()
            .map(|line| line.split(",\"latency_ms\"").next().unwrap().to_owned());
        (said, lines.collect::<Vec<_>>())
    };
    let (_, without) = journal("j", &[]);
    let disk = SmallDisk::mount(&seen, "400k");
    let (said, with) = journal("k", &["--evidence", "seen"]);
    assert_eq!(with, without);
    let whole = whole_events(&seen).len();
    assert!((1..6).contains(&whole), "{whole} events");
    assert!(
        said.contains(&format!(
            "evidence: {whole} events written, {} could not be written",
            6 - whole
        )),
        "{said}"
    );
    // Nothing half is left, and with a quota below the disk's size nothing is lost.
    assert_eq!(fs::read_dir(&seen).unwrap().count(), whole);
    drop(disk);
    let _disk = SmallDisk::mount(&seen, "2m");
    let quota = ["--evidence", "seen", "--evidence-mb", "1"];
    let (said, _) = journal("l", &quota);
    assert!(
        said.contains("evidence: 6 events written") && !said.contains("could not"),
        "{said}"
    );
}

#[test]
fn folders_that_cannot_be_written_or_read_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let before = files(folder.path());
    for place in ["file", "file/below"] {
        let args = ["replay", "scene:sim?seconds=1", "--evidence", place];
        let line = gapwatch_in(folder.path(), &args).refusal();
        assert!(
            line.contains(&format!("cannot keep evidence in {place}")),
            "{line}"
        );
    }
    assert_eq!(files(folder.path()), before);
    let line = r#"{"t_s":1,"seq":1,"state":"Gap","reason":"abrupt","score":2.5,"gap":{},"similarity":{},"health":"ok","latency_ms":1}"#;
    fs::write(folder.path().join("j"), line).unwrap();
    let event = folder.path().join("seen/000001");
    fs::create_dir_all(&event).unwrap();
    fs::write(folder.path().join("secret"), [0xff, 0xd8, 0xff, 1]).unwrap();
    let moment = |frame: &str| {
        format!(
            r#"{{"edge":0,"moments":[{{"t_s":1.0,"seq":1,"state":"Gap","reason":"abrupt","score":2.5,"frame":"{frame}"}}]}}"#
        )
    };
    for (json, said) in [
        ("hello".to_owned(), "seen/000001/event.json"),
        (r#"{"edge":3,"moments":[]}"#.to_owned(), "edge 3"),
        (moment("../../secret"), "inside the event's folder"),
        (moment("gone.jpg"), "gone.jpg"),
        (moment("event.json"), "JPEG"),
    ] {
        fs::write(event.join("event.json"), json).unwrap();
        let args = ["report", "j", "--evidence", "seen", "--out", "r.html"];
        let line = gapwatch_in(folder.path(), &args).refusal();
        assert!(line.contains(said), "{line}");
        assert!(!folder.path().join("r.html").exists());
    }
    let args = ["report", "j", "--evidence", "missing", "--out", "r.html"];
    assert!(
        gapwatch_in(folder.path(), &args)
            .refusal()
            .contains("evidence missing")
    );
}
