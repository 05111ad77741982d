//! `gapwatch monitor` in real time: the cycle of the bus, its first and last word, and what it refuses.
#![allow(
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss
)]

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::program::whole_events;
use gapwatch::can::e2e::{E2eReceiver, Sequence};
use gapwatch::can::message::GapStatus;
use gapwatch::live::board::Board;
use gapwatch::monitor::alarm::{AlarmState, Reason};

/// Longest time between two status frames: the cycle of 100 ms, and what a busy computer may take.
const LATE: f64 = 0.35;

fn monitor(folder: &Path, board: &str, args: &[&str]) -> Child {
    fs::write(folder.join("board.toml"), board).unwrap();
    Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(["monitor", "--board", "board.toml"])
        .args(args)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn board(source: &str) -> String {
    format!(
        "[camera]\nsource = \"{source}\"\n[can]\nsink = \"log:can.log\"\nlisten_s = 0.0\n[monitor]\nstrict = true\n"
    )
}

/// Times and contents of the status frames of a log, each with a right CRC and the next counter.
fn status_frames(folder: &Path) -> Vec<(f64, GapStatus)> {
    let log = fs::read_to_string(folder.join("can.log")).unwrap();
    let mut receiver = E2eReceiver::new(0x5D0);
    log.lines()
        .filter_map(|line| {
            let mut words = line.split(' ');
            let at = words.next().unwrap().trim_matches(['(', ')']);
            let data = words.nth(1).unwrap().strip_prefix("5D0#")?;
            let data = u64::from_str_radix(data, 16).unwrap().to_be_bytes();
            let sequence = receiver.check(&data).unwrap();
            assert!(matches!(sequence, Sequence::First | Sequence::Next));
            Some((at.parse().unwrap(), GapStatus::from_bytes(&data).unwrap()))
        })
        .collect()
}

fn longest_pause(frames: &[(f64, GapStatus)]) -> f64 {
    let pauses = frames.windows(2).map(|pair| pair[1].0 - pair[0].0);
    pauses.fold(0.0, f64::max)
}

#[test]
fn a_drive_is_shown_at_its_own_pace_with_a_first_and_a_last_word() {
    let folder = tempfile::tempdir().unwrap();
    let source = "scene:sim?seed=7&seconds=3&fps=10";
    let args = ["--journal", "drive.jsonl"];
    let done = monitor(folder.path(), &board(source), &args)
        .wait_with_output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let frames = status_frames(folder.path());
    let first = frames.first().unwrap().1;
    let last = frames.last().unwrap().1;
    assert_eq!(
        (first.state, first.reason),
        (AlarmState::Init, Reason::Starting)
    );
    assert_eq!(
        (last.state, last.reason),
        (AlarmState::Unavailable, Reason::Stopped)
    );
    assert!(frames.iter().any(|(_, status)| status.gap.is_some()));
    assert!(frames.last().unwrap().0 >= 2.5);
    assert!(longest_pause(&frames) < LATE);
    let journal = fs::read_to_string(folder.path().join("drive.jsonl")).unwrap();
    assert!(journal.lines().last().unwrap().contains("stopped"));
}

#[test]
fn the_cycle_goes_on_when_no_frame_comes_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("slow")).unwrap();
    for n in 0..2 {
        image::RgbImage::from_fn(64, 32, |x, y| image::Rgb([(x + y + n) as u8, 90, x as u8]))
            .save(folder.path().join(format!("slow/{n}.png")))
            .unwrap();
    }
    // The second frame comes after 10 s.
    let done = monitor(folder.path(), &board("slow?fps=0.1"), &["--seconds", "3"])
        .wait_with_output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let frames = status_frames(folder.path());
    assert!(frames.last().unwrap().0 >= 2.9);
    assert!(longest_pause(&frames) < LATE);
    let stale = |status: &GapStatus| {
        (status.state, status.reason) == (AlarmState::Unavailable, Reason::Stale)
    };
    let told = frames.iter().find(|(_, status)| stale(status)).unwrap().0;
    assert!((0.5..2.0).contains(&told), "told after {told} s");
    assert!(
        frames
            .iter()
            .all(|(_, status)| status.state != AlarmState::Ok)
    );
}

#[test]
fn a_clear_road_is_looked_at_slowly_and_anything_else_at_full_rate() {
    let folder = tempfile::tempdir().unwrap();
    // The fog begins to grow at 9 s.
    let source = "scene:sim?seed=7&seconds=13&fps=30&condition=fog:4@11-13";
    let board = board(source) + "rate_hz = 10\nidle_rate_hz = 2.0\n";
    let args = ["--journal", "drive.jsonl"];
    let done = monitor(folder.path(), &board, &args)
        .wait_with_output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let read = gapwatch::record::journal::read(&folder.path().join("drive.jsonl")).unwrap();
    let seen: Vec<(f64, f64)> = (read.entries.iter())
        .filter_map(|entry| Some((entry.t_s, entry.sequence.and(entry.score)?)))
        .collect();
    let rate = |from: f64, to: f64| {
        let within = seen.iter().filter(|(at, _)| (from..to).contains(at));
        within.count() as f64 / (to - from)
    };
    assert!(rate(1.0, 5.0) > 5.0, "at first {} a second", rate(1.0, 5.0));
    assert!(rate(7.0, 9.0) < 3.1, "clear {} a second", rate(7.0, 9.0));
    let (first, _) = seen
        .iter()
        .find(|(at, score)| *at > 9.0 && *score > 0.5)
        .unwrap();
    let next = seen.iter().find(|(at, _)| at > first).unwrap().0;
    assert!(
        next - first < 0.35,
        "the next frame {} s later",
        next - first
    );
    assert!(
        rate(*first, 12.5) > 5.0,
        "then {} a second",
        rate(*first, 12.5)
    );
    // A slow road is no silence.
    assert!(read.entries.iter().all(|entry| entry.reason != "stale"));
}

#[test]
fn a_signal_ends_it_with_a_last_word_and_a_whole_log() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = monitor(folder.path(), &board("scene:sim?seed=7&seconds=60"), &[]);
    std::thread::sleep(Duration::from_millis(2_500));
    signal(&child, "TERM");
    let since = Instant::now();
    assert!(child.wait().unwrap().success());
    assert!(since.elapsed() < Duration::from_secs(5));
    let frames = status_frames(folder.path());
    let last = frames.last().unwrap().1;
    assert_eq!(
        (last.state, last.reason),
        (AlarmState::Unavailable, Reason::Stopped)
    );
}

/// Sends a signal by its name.
fn signal(child: &Child, name: &str) {
    let kill = format!("kill -{name} {}", child.id());
    let killed = Command::new("sh").args(["-c", &kill]).status().unwrap();
    assert!(killed.success(), "{kill}");
}

/// Waits until a file has so many whole lines.
fn wait_for_lines(file: &Path, lines: usize) {
    let until = Instant::now() + Duration::from_secs(60);
    let whole = || {
        let text = fs::read(file).unwrap_or_default();
        text.iter().filter(|&&byte| byte == b'\n').count()
    };
    while whole() < lines {
        assert!(Instant::now() < until, "{} lines", whole());
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_hang_up_ends_it_in_order_and_a_killed_one_leaves_every_line_that_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.jsonl");
    let args = ["--journal", "drive.jsonl"];
    let board = board("scene:sim?seed=7&seconds=60&size=160x80");
    let run = |name: &str, files: usize| {
        let mut child = monitor(folder.path(), &board, &args);
        // It begins files of its own.
        let until = Instant::now() + Duration::from_secs(60);
        while crate::program::names(folder.path()).len() < files {
            assert!(Instant::now() < until, "no files");
            std::thread::sleep(Duration::from_millis(10));
        }
        wait_for_lines(&path, 12);
        wait_for_lines(&folder.path().join("can.log"), 12);
        signal(&child, name);
        let ended = child.wait().unwrap();
        let read = gapwatch::record::journal::read(&path).unwrap();
        assert!(read.entries.len() >= 11);
        (ended, read)
    };
    let (ended, read) = run("HUP", 3);
    assert!(ended.success());
    assert_eq!(read.entries.last().unwrap().reason, "stopped");
    assert!(!read.began.utc.is_empty() && read.about.source.starts_with("scene:sim"));
    let (ended, read) = run("KILL", 5);
    assert!(!ended.success());
    assert_ne!(read.entries.last().unwrap().reason, "stopped");
    assert!(status_frames(folder.path()).len() >= 10);
    // The run before is kept beside it, and nothing else is left.
    let before = gapwatch::record::journal::read(&folder.path().join("drive.jsonl.1")).unwrap();
    assert_eq!(before.entries.last().unwrap().reason, "stopped");
    let left = crate::program::names(folder.path());
    let wanted = [
        "board.toml",
        "can.log",
        "can.log.1",
        "drive.jsonl",
        "drive.jsonl.1",
    ];
    assert_eq!(left, wanted);
}

#[test]
fn the_time_of_the_journal_never_runs_backwards_however_often_the_program_is_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.jsonl");
    let drive = "scene:sim?seed=7&seconds=60&size=160x80";
    let mut child = monitor(folder.path(), &board(drive), &["--journal", "drive.jsonl"]);
    for lines in [8, 20, 32, 44] {
        wait_for_lines(&path, lines);
        signal(&child, "STOP");
        std::thread::sleep(Duration::from_millis(800));
        signal(&child, "CONT");
    }
    wait_for_lines(&path, 56);
    signal(&child, "TERM");
    assert!(child.wait().unwrap().success());
    let read = gapwatch::record::journal::read(&path).unwrap();
    let unjudged = read.entries.iter().filter(|entry| entry.score.is_none());
    assert!(unjudged.count() >= 4, "no stop was noticed");
    let report = ["report", "drive.jsonl", "--out", "r.html"];
    crate::program::gapwatch_in(folder.path(), &report).ok();
}

#[test]
#[ignore = "needs root for a small disk: run tests/run"]
fn root_a_full_disk_under_the_log_costs_the_journal_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let small = folder.path().join("small");
    fs::create_dir(&small).unwrap();
    let disk = crate::program::SmallDisk::mount(&small, "4k");
    let board =
        board("scene:sim?seed=7&seconds=60&size=160x80").replace("can.log", "small/can.log");
    let mut child = monitor(folder.path(), &board, &["--journal", "drive.jsonl"]);
    // The log is full after 80 lines, 7 s or less.
    wait_for_lines(&folder.path().join("drive.jsonl"), 120);
    signal(&child, "TERM");
    let ended = child.wait().unwrap();
    // The log stands for the bus, and it is not whole.
    assert_eq!(ended.code(), Some(2));
    let log = fs::read_to_string(small.join("can.log")).unwrap();
    assert!(
        log.ends_with('\n') && log.len() <= 4_096,
        "{} bytes",
        log.len()
    );
    assert!(log.lines().all(|line| line.len() >= 40));
    drop(disk);
    let read = gapwatch::record::journal::read(&folder.path().join("drive.jsonl")).unwrap();
    assert!(read.entries.len() >= 119 && !read.breaks_off);
    assert_eq!(read.entries.last().unwrap().reason, "stopped");
}

#[test]
fn on_a_road_of_pictures_simulation_alone_warns_of_lanes_and_of_gaps_only_if_the_board_is_strict() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("road")).unwrap();
    for number in 0..30_u32 {
        // A striped picture that moves: far from any simulation, and without lanes to lose or to find.
        let picture = image::RgbImage::from_fn(320, 160, |x, y| {
            image::Rgb([(8 * (x + number)) as u8, (3 * y) as u8, (x ^ y) as u8])
        });
        let name = format!("road/{number:02}.png");
        picture.save(folder.path().join(name)).unwrap();
    }
    let run = |said: &str| {
        let board = board("road").replace("strict = true", said);
        let args = ["--journal", "drive.jsonl"];
        monitor(folder.path(), &board, &args)
            .wait_with_output()
            .unwrap()
    };
    let refused = run("warn = [\"gap\", \"lanes\"]");
    assert_eq!(refused.status.code(), Some(2));
    let said = String::from_utf8(refused.stderr).unwrap();
    for part in ["board.toml", "strict = true", "--accept ROAD"] {
        assert!(said.contains(part), "{said}");
    }
    assert!(!folder.path().join("can.log").exists());
    for (said, warned, reasons) in [
        ("rate_hz = 10", "lanes", ["lanes", "none"]),
        ("strict = true", "gap, change", ["abrupt", "drift"]),
    ] {
        let done = run(said);
        assert!(done.status.success(), "{done:?}");
        let read = gapwatch::record::journal::read(&folder.path().join("drive.jsonl")).unwrap();
        assert_eq!(read.about.warn, warned);
        let settled = read.entries.iter().filter(|entry| entry.t_s > 2.0);
        let judged: Vec<_> = settled.filter(|entry| entry.gap.is_some()).collect();
        assert!(judged.len() > 5);
        for entry in judged {
            assert!(entry.gap > Some(1.0) && entry.lanes.is_some());
            assert!(reasons.contains(&entry.reason.as_str()), "{entry:?}");
        }
    }
}

#[test]
fn a_board_keeps_evidence_beside_it_also_when_it_is_killed() {
    let folder = tempfile::tempdir().unwrap();
    let drive =
        "scene:sim?seed=7&seconds=60&size=160x80&condition=noise:5@2-4&condition=noise:5@10-50";
    let board = board(drive) + "[evidence]\nfolder = \"seen\"\nevents = 3\n";
    let seen = folder.path().join("seen");
    let mut child = monitor(folder.path(), &board, &[]);
    let began = Instant::now();
    while whole_events(&seen).is_empty() {
        assert!(began.elapsed() < Duration::from_secs(30), "no event");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(whole_events(&seen), ["000001"]);
    // The next run goes on in the same folder, another folder is the command line's, and none is kept without either.
    let run = |board: &str, args: &[&str]| {
        let done = monitor(folder.path(), board, args)
            .wait_with_output()
            .unwrap();
        assert!(done.status.success(), "{done:?}");
        String::from_utf8(done.stdout).unwrap()
    };
    let short = board.replace("seconds=60", "seconds=7");
    let said = run(&short, &["--journal", "j"]);
    assert!(said.contains("evidence: 1 event written"), "{said}");
    assert_eq!(whole_events(&seen), ["000001", "000002"]);
    let said = run(&short, &["--evidence", "other"]);
    assert!(said.contains("evidence: 1 event written"), "{said}");
    assert_eq!(whole_events(&folder.path().join("other")), ["000001"]);
    let none = short.split("[evidence]").next().unwrap();
    assert!(!run(none, &[]).contains("evidence"));
    assert_eq!(whole_events(&seen).len(), 2);
    let report = ["report", "j", "--evidence", "seen", "--out", "r.html"];
    crate::program::gapwatch_in(folder.path(), &report).ok();
    let page = fs::read_to_string(folder.path().join("r.html")).unwrap();
    assert!(page.contains("image/jpeg;") && page.contains("class=\"regions\""));
}

#[test]
fn a_folder_that_takes_no_evidence_costs_no_verdict() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), "").unwrap();
    let board = board("scene:sim?seed=7&seconds=3&size=160x80");
    let done = monitor(folder.path(), &board, &["--evidence", "file"]);
    let done = done.wait_with_output().unwrap();
    assert!(done.status.success(), "{done:?}");
    let said = String::from_utf8(done.stderr).unwrap();
    assert!(said.contains("cannot keep evidence in file"), "{said}");
    let states: Vec<_> = status_frames(folder.path())
        .iter()
        .map(|(_, s)| s.state)
        .collect();
    assert!(states.contains(&AlarmState::Ok), "{states:?}");
}

#[test]
fn what_is_not_there_is_refused_before_anything_is_sent() {
    let folder = tempfile::tempdir().unwrap();
    let good = board("scene:sim?seed=7&seconds=2");
    for (from, to, said) in [
        ("strict = true", "strct = true", "board.toml:7:"),
        (
            "scene:sim?seed=7&seconds=2",
            "no-such-drive",
            "no such file or folder",
        ),
        (
            "scene:sim?seed=7&seconds=2",
            "v4l2:/dev/video-of-nobody",
            "v4l2:/dev/video-of-nobody",
        ),
        ("log:can.log", "socketcan:nocan7", "socketcan:nocan7"),
    ] {
        let done = monitor(folder.path(), &good.replace(from, to), &[]);
        let done = done.wait_with_output().unwrap();
        assert_eq!(done.status.code(), Some(2));
        let stderr = String::from_utf8(done.stderr).unwrap();
        assert!(
            stderr.contains(said.trim_start_matches("v4l2:")),
            "{stderr}"
        );
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
    }
}

#[test]
fn every_board_that_is_shipped_is_understood() {
    let boards = fs::read_dir("boards").unwrap();
    let boards = boards.map(|entry| entry.unwrap().path());
    let boards: Vec<_> = boards
        .filter(|path| path.extension().is_some_and(|e| e == "toml"))
        .collect();
    assert!(boards.len() >= 4);
    for board in boards {
        Board::read(&board).unwrap();
    }
}
