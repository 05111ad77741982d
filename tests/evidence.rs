//! Evidence on disk: what a drive leaves, what a killed program leaves, what is refused.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::program::{SmallDisk, files, gapwatch_in, verdict_lines, whole_events};

/// Noise that comes and goes: an alarm every 8 s, once the longest window is full.
fn flicker(seconds: u32) -> String {
    let noise = (6..seconds - 2).step_by(8);
    let noise = noise.map(|s| format!("&condition=noise:5@{s}-{}", s + 2));
    format!(
        "scene:sim?seed=7&seconds={seconds}&size=160x80{}",
        noise.collect::<String>()
    )
}

#[test]
fn a_drive_leaves_events_within_the_quota_and_the_report_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let drive = flicker(40);
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
    let drive = flicker(12);
    gapwatch_in(folder.path(), &["replay", &drive, "--evidence", "seen"]).ok();
    assert!(whole_events(&seen).len() > before);
    assert!(!seen.join(".unfinished-000099").exists());
}

/// Nothing is left of the files of a killed run: none has a name before it is finished.
#[test]
fn a_killed_program_leaves_no_half_files() {
    let folder = tempfile::tempdir().unwrap();
    let drive = flicker(200);
    let mut child = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args([
            "replay",
            &drive,
            "--journal",
            "j",
            "--mcap",
            "m.mcap",
            "--can",
            "log:c.log",
        ])
        .current_dir(folder.path())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    // Until it writes into files of its own.
    let open = format!("/proc/{}/fd", child.id());
    let here = folder.path().canonicalize().unwrap();
    let ours = || {
        let files = fs::read_dir(&open).unwrap().flatten();
        let names = files.filter_map(|file| fs::read_link(file.path()).ok());
        names.filter(|name| name.starts_with(&here)).count()
    };
    let began = Instant::now();
    while ours() < 3 {
        assert!(
            began.elapsed() < Duration::from_secs(60),
            "no file is written"
        );
        std::thread::sleep(Duration::from_millis(3));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn what_is_no_event_is_left_alone_and_read_past() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    fs::create_dir_all(seen.join("000002")).unwrap();
    fs::write(seen.join("000001"), "mine").unwrap();
    fs::write(seen.join(".unfinished-x"), "mine").unwrap();
    let before = files(&seen);
    let drive = flicker(12);
    let said = gapwatch_in(
        folder.path(),
        &[
            "replay",
            &drive,
            "--journal",
            "j",
            "--evidence",
            "seen",
            "--evidence-events",
            "1",
        ],
    )
    .ok();
    assert!(said.contains("evidence: 1 event written"), "{said}");
    let report = ["report", "j", "--evidence", "seen", "--out", "r.html"];
    gapwatch_in(folder.path(), &report).ok();
    let page = fs::read_to_string(folder.path().join("r.html")).unwrap();
    assert!(page.contains("alt=\"Frame, "));
    fs::remove_dir_all(seen.join("000003")).unwrap();
    assert_eq!(files(&seen), before);
    assert!(seen.join("000002").is_dir());
}

/// What a disk of which `live` is the image would hold if the power were cut now.
fn after_a_power_cut(live: &Path, copy: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    fs::copy(live, copy).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let disk = SmallDisk::mount_image(folder.path(), copy);
    let found = files_of(folder.path());
    drop(disk);
    found
}

/// Files by their name in the folder.
fn files_of(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let named =
        |(path, bytes): (PathBuf, Vec<u8>)| (path.strip_prefix(folder).unwrap().to_owned(), bytes);
    files(folder).into_iter().map(named).collect()
}

#[test]
#[ignore = "needs root, for a disk of its own: run tests/run"]
fn root_what_is_told_as_written_is_there_after_a_power_cut() {
    let root = tempfile::tempdir().unwrap();
    let (image, copy) = (root.path().join("image"), root.path().join("copy"));
    fs::File::create(&image)
        .unwrap()
        .set_len(128 << 20)
        .unwrap();
    let made = Command::new("mkfs.ext4").arg("-q").arg(&image).status();
    assert!(made.unwrap().success(), "cannot make an ext4 file system");
    let folder = root.path().join("disk");
    fs::create_dir(&folder).unwrap();
    let _disk = SmallDisk::mount_image(&folder, &image);
    let drive = flicker(12);
    for args in [
        vec![
            "replay",
            &drive,
            "--journal",
            "j",
            "--mcap",
            "m.mcap",
            "--can",
            "log:c.log",
        ],
        vec!["replay", &drive, "--evidence", "a/new/folder"],
        // For the second event the first goes.
        vec![
            "replay",
            &drive,
            "--evidence",
            "a/new/folder",
            "--evidence-events",
            "1",
        ],
        vec!["report", "j", "--out", "r.html"],
        vec!["scene", "--count", "3", "--out", "scenes"],
        vec![
            "calibrate",
            "--sim",
            "scene:sim?seed=1..6&seconds=6&fps=5",
            "--metric",
            "attention-js",
            "--surveys",
            "kept/surveys",
            "--out",
            "r.json",
        ],
    ] {
        gapwatch_in(&folder, &args).ok();
        let there = files_of(&folder);
        assert!(there.iter().all(|(_, bytes)| !bytes.is_empty()));
        // Byte for byte, nothing more and nothing less.
        assert!(after_a_power_cut(&image, &copy) == there, "{args:?}");
    }
}

#[test]
#[ignore = "needs root, for a disk that fills up: run tests/run"]
fn root_a_full_disk_costs_events_and_no_verdict() {
    let folder = tempfile::tempdir().unwrap();
    let seen = folder.path().join("seen");
    fs::create_dir(&seen).unwrap();
    let drive = flicker(54);
    let journal = |name: &str, more: &[&str]| {
        let args = ["replay", &drive, "--journal", name];
        let said = gapwatch_in(folder.path(), &[&args, more].concat()).ok();
        (said, verdict_lines(&folder.path().join(name)))
    };
    let (_, without) = journal("j", &[]);
    let disk = SmallDisk::mount(&seen, "600k");
    let (said, with) = journal("k", &["--evidence", "seen"]);
    assert_eq!(with, without);
    let whole = whole_events(&seen).len();
    assert!((1..6).contains(&whole), "{whole} events");
    assert!(
        said.contains(&format!(
            "evidence: {whole} event{} written, {} could not be written",
            if whole == 1 { "" } else { "s" },
            6 - whole
        )),
        "{said}"
    );
    // Nothing half is left, and with a quota below the disk's size nothing is lost.
    assert_eq!(fs::read_dir(&seen).unwrap().count(), whole);
    drop(disk);
    let disk = SmallDisk::mount(&seen, "2m");
    let quota = ["--evidence", "seen", "--evidence-mb", "1"];
    let (said, _) = journal("l", &quota);
    assert!(
        said.contains("evidence: 6 events written") && !said.contains("could not"),
        "{said}"
    );
    // Where two events do not fit beside each other, the one that the quota has no more room for goes first.
    drop(disk);
    let _disk = SmallDisk::mount(&seen, "700k");
    let (said, _) = journal("m", &["--evidence", "seen", "--evidence-events", "1"]);
    assert!(
        said.contains("evidence: 6 events written, 5 older ones removed")
            && !said.contains("could not"),
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
    let line = r#"{"t_s":1,"captured_s":1,"seq":1,"state":"Gap","reason":"abrupt","score":2.5,"gap":2.5,"health":"ok","latency_ms":1}"#;
    let journal = format!("{{\"gapwatch_journal\":4}}\n{line}\n");
    fs::write(folder.path().join("j"), journal).unwrap();
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
