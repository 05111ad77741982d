//! The arm64 package in an emulated car computer: Debian's kernel and systemd with its test drivers for cameras (vivid) and
//! buses (vcan). It is installed, its doctor is content, its service warns of a drive, and it leaves nothing behind.
//!
//! `tests/vehicle/run` builds the package, runs this and shows what was measured; `tests/vehicle/guest.sh` is what happens
//! inside. The machine's clock counts instructions, so milliseconds are millions of them.
#![cfg(feature = "can")]
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::clips::{clip, pictures};
use crate::program::gapwatch_in;
use gapwatch::can::e2e::{E2eReceiver, Sequence};
use gapwatch::can::message::GapStatus;
use gapwatch::monitor::alarm::{AlarmState, Reason};
use serde_json::Value;

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Fog of 60 m visibility between 4 and 8 s.
const DRIVE: &str = "scene:sim?seed=7&seconds=11&fps=30&condition=fog:4@4-8";
const NOMINAL: &str = "scene:sim?seed=8&seconds=2&fps=30";
/// A drive that is judged on both kinds of machine.
const SHORT_DRIVE: &str = "scene:sim?seed=7&seconds=3&condition=fog:4@1-3";
/// Most memory that the program may hold while it watches.
const MEMORY_KB: u64 = 48 * 1_024;

/// What the machine left in its shared folder.
struct Left(PathBuf);

impl Left {
    fn text(&self, name: &str) -> String {
        let path = self.0.join(name);
        fs::read_to_string(&path).unwrap_or_else(|why| panic!("{}: {why}", path.display()))
    }

    /// The output of a command that did its job.
    fn done(&self, name: &str) -> String {
        let out = self.text(&format!("{name}.out"));
        let code = self.text(&format!("{name}.code"));
        assert_eq!(code.trim(), "0", "{name}: {out}");
        out
    }

    /// A number of kilobytes of /proc/PID/status.
    fn kilobytes(&self, name: &str, key: &str) -> u64 {
        let text = self.text(name);
        let line = text.lines().find(|line| line.starts_with(key)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }
}

/// The package to test: the newest that `packages/build arm64` has made.
fn package() -> PathBuf {
    std::env::var_os("GAPWATCH_ARM64_PACKAGE")
        .expect("GAPWATCH_ARM64_PACKAGE, as tests/vehicle/run sets it")
        .into()
}

fn machine() -> Left {
    let share = Path::new(env!("CARGO_TARGET_TMPDIR")).join("vehicle");
    let _ = fs::remove_dir_all(&share);
    fs::create_dir_all(&share).unwrap();
    fs::copy(package(), share.join("gapwatch.deb")).unwrap();
    clip(&share.join("drive"), &pictures(DRIVE));
    clip(&share.join("nominal"), &pictures(NOMINAL));
    let guest = format!("{ROOT}/tests/vehicle/guest.sh");
    fs::copy(guest, share.join("guest.sh")).unwrap();
    fs::create_dir(share.join("short")).unwrap();
    for (n, picture) in pictures(SHORT_DRIVE).into_iter().enumerate() {
        image::RgbImage::from_raw(picture.width, picture.height, picture.rgb)
            .unwrap()
            .save(share.join(format!("short/{n:04}.png")))
            .unwrap();
    }
    let console = File::create(share.join("console.log")).unwrap();
    let ended = Command::new(format!("{ROOT}/tests/vehicle/boot"))
        .arg(&share)
        .stdout(Stdio::from(console))
        .status()
        .unwrap();
    let console = share.join("console.log");
    assert!(ended.success(), "{ended}; see {}", console.display());
    Left(share)
}

/// What was said on the bus, each frame with a right CRC; and how often a counter began anew.
fn statuses(log: &str) -> (Vec<(f64, GapStatus)>, u32) {
    let mut receiver = E2eReceiver::new(0x5D0);
    let mut beginnings = 0;
    let frames = log.lines().filter_map(|line| {
        let mut words = line.split(' ');
        let at = words.next()?.trim_matches(['(', ')']).parse().ok()?;
        let data = words.nth(1)?.strip_prefix("5D0#")?;
        let data = u64::from_str_radix(data, 16).unwrap().to_be_bytes();
        match receiver.check(&data) {
            Ok(Sequence::Next) => {}
            _ => beginnings += 1,
        }
        Some((at, GapStatus::from_bytes(&data).unwrap()))
    });
    (frames.collect(), beginnings)
}

/// Lines of a journal, without the time that each took.
fn verdicts(journal: &str) -> Vec<Value> {
    // The first one says when the run was.
    let lines = journal.lines().skip(1).map(|line| {
        let mut line: Value = serde_json::from_str(line).unwrap();
        line.as_object_mut().unwrap().remove("latency_ms").unwrap();
        line
    });
    lines.collect()
}

fn paths(text: &str) -> BTreeSet<&str> {
    text.lines().collect()
}

#[test]
#[ignore = "needs a package for arm64 and an emulator: tests/vehicle/run"]
fn arm64_package_is_installed_warns_and_leaves_nothing_behind() {
    let left = machine();

    // Installed.
    assert_eq!(left.text("before.out"), "");
    left.done("install");
    assert!(left.done("version").starts_with("gapwatch "));
    let listed = left.done("listed");
    for file in [
        "/usr/bin/gapwatch",
        "/usr/lib/systemd/system/gapwatch@.service",
        "/usr/share/man/man1/gapwatch-monitor.1.gz",
        "/usr/share/bash-completion/completions/gapwatch",
        "/usr/share/gapwatch/boards/raspberry-pi-5.toml",
    ] {
        assert!(listed.lines().any(|line| line == file), "{file}: {listed}");
    }

    // The doctor is content.
    let doctor = left.done("doctor");
    assert!(!doctor.contains("fail"), "{doctor}");
    for check in ["camera", "bus", "budget", "picture"] {
        let line = doctor
            .lines()
            .find(|line| line.contains(&format!(" {check} ")));
        assert!(line.unwrap().starts_with("pass"), "{doctor}");
    }
    assert!(doctor.contains("YUYV"), "{doctor}");
    // The built-in reference has too few judged hours.
    assert!(
        doctor.contains("false alarms an hour, not shown: "),
        "{doctor}"
    );

    // The service is started and has no rights.
    left.done("enable");
    assert_eq!(left.text("active.out").trim(), "active");
    let process = left.text("process.out");
    for line in ["CapEff:\t0000000000000000", "NoNewPrivs:\t1", "Seccomp:\t2"] {
        assert!(process.contains(line), "{process}");
    }
    let user = process
        .lines()
        .find(|line| line.starts_with("Uid:"))
        .unwrap();
    assert!(!user.split_whitespace().any(|id| id == "0"), "{user}");
    assert!(left.text("status.out").contains("Ok") || left.text("status.out").contains("Gap"));

    // A drive raises the warning, and the road that follows it takes it back.
    let (frames, beginnings) = statuses(&left.text("bus.log"));
    let first = |state| frames.iter().position(|(_, said)| said.state == state);
    let ok = first(AlarmState::Ok).unwrap();
    let gap = first(AlarmState::Gap).unwrap();
    assert!(ok < gap);
    assert!(
        frames[gap..]
            .iter()
            .any(|(_, said)| said.state == AlarmState::Ok)
    );
    assert!(frames[gap].1.gap_stored);
    let lost =
        |said: &GapStatus| said.state == AlarmState::SensorFault || said.reason == Reason::Lagging;
    assert!(!frames[..gap].iter().any(|(_, said)| lost(said)));

    // Upgraded, hung and started anew, stopped: one beginning of the counter each, and a last word.
    let upgraded = left.text("upgraded.out");
    left.done("upgrade");
    let words: Vec<&str> = upgraded.split_whitespace().collect();
    assert!(words[0] == "active" && words[1] != words[2], "{upgraded}");
    let hung = left.text("hung.out");
    let words: Vec<&str> = hung.split_whitespace().collect();
    assert!(words[0] != words[1] && words[3] == "1", "{hung}");
    left.done("stop");
    assert_eq!(left.text("stopped.out").trim(), "success");
    assert_eq!(beginnings, 3, "first start, upgrade, restart");
    let last = frames.last().unwrap().1;
    assert_eq!(
        (last.state, last.reason),
        (AlarmState::Unavailable, Reason::Stopped)
    );
    let log: Vec<Value> = left
        .text("journal.out")
        .lines()
        .map(|l| serde_json::from_str(l).unwrap())
        .collect();
    assert!(
        log.iter()
            .any(|line| line["MESSAGE"].as_str().is_some_and(|m| m.contains("Gap")))
    );

    // The service may write its evidence: both pictures and what was said of them.
    let evidence = left.text("evidence.out");
    for file in ["seen/000001/event.json", "/frame-", "/heat-"] {
        assert!(evidence.contains(file), "{file}: {evidence}");
    }

    // Removed but for what the integrator has made, then purged without a trace.
    left.done("remove");
    let kept = left.text("removed.out");
    assert_eq!(left.text("kept.out").trim(), "car.toml");
    assert!(
        paths(&kept)
            .iter()
            .all(|path| path.starts_with("/etc/gapwatch") || path.starts_with("/var/lib")),
        "{kept}"
    );
    left.done("purge");
    assert_eq!(left.text("purged.out"), "");
    let (before, after) = (left.text("files-before.log"), left.text("files-after.log"));
    let new: Vec<_> = paths(&after).difference(&paths(&before)).copied().collect();
    let ours = |path: &&&str| {
        path.contains("gapwatch") || path.contains("/usr/") || path.contains("/etc/")
    };
    assert_eq!(new.iter().filter(ours).count(), 0, "{new:?}");

    // The same numbers, to the last bit, as on the machine that runs this test.
    let folder = tempfile::tempdir().unwrap();
    let short = left.0.join("short").display().to_string();
    let replay = ["replay", &short, "--journal", "replay.jsonl"];
    gapwatch_in(folder.path(), &replay).ok();
    let here = fs::read_to_string(folder.path().join("replay.jsonl")).unwrap();
    left.done("replay");
    let (here, there) = (verdicts(&here), verdicts(&left.text("replay.jsonl")));
    assert_eq!(here.len(), 30);
    assert!(here == there, "{here:?}\n{there:?}");

    // What it takes.
    let memory = left.kilobytes("process-after.out", "VmHWM");
    assert!(memory < MEMORY_KB, "{memory} kB");
    report(&left, memory, &frames, gap);
}

fn report(left: &Left, memory: u64, frames: &[(f64, GapStatus)], gap: usize) {
    let package = fs::metadata(left.0.join("gapwatch.deb")).unwrap().len();
    println!("package {package} bytes; resident {memory} kB at most");
    println!(
        "first Gap {:.2} s after the first status",
        frames[gap].0 - frames[0].0
    );
    println!("doctor:\n{}", left.text("doctor.out"));
    println!("{}", left.text("security.out"));
}
