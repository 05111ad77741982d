//! `gapwatch monitor` under a service manager: what it says on its socket, and what its log lines look like there.
#![allow(clippy::unwrap_used)]

use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_millis(900);

/// Runs the monitor on a source for a while; what it said to the manager, and when.
fn said(folder: &Path, source: &str, seconds: u32) -> Vec<(Duration, String)> {
    let board = format!(
        "[camera]\nsource = \"{source}\"\n[can]\nsink = \"log:can.log\"\nlisten_s = 0.0\n[monitor]\nstrict = true\n"
    );
    fs::write(folder.join("board.toml"), board).unwrap();
    let manager = UnixDatagram::bind(folder.join("notify")).unwrap();
    manager
        .set_read_timeout(Some(Duration::from_millis(100)))
        .unwrap();
    let mut child = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(["monitor", "--board", "board.toml"])
        .args(["--seconds", &seconds.to_string()])
        .current_dir(folder)
        .env("NOTIFY_SOCKET", folder.join("notify"))
        .env("WATCHDOG_USEC", LIMIT.as_micros().to_string())
        .env_remove("WATCHDOG_PID")
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let (mut words, mut bytes) = (Vec::new(), [0; 4_096]);
    loop {
        match manager.recv(&mut bytes) {
            Ok(length) => {
                let text = String::from_utf8_lossy(&bytes[..length]);
                let told = text.lines().map(|line| (began.elapsed(), line.to_owned()));
                words.extend(told);
            }
            Err(_) if child.try_wait().unwrap().is_some() => break,
            Err(_) => {}
        }
    }
    assert!(child.wait().unwrap().success());
    words
}

/// Whether the service manager was told a status with these words in it.
fn has_status(words: &[(Duration, String)], part: &str) -> bool {
    let mut told = words.iter().map(|(_, said)| said);
    told.any(|said| said.starts_with("STATUS=") && said.contains(part))
}

#[test]
fn it_is_ready_with_the_first_verdict_lives_by_them_and_says_when_it_stops() {
    let folder = tempfile::tempdir().unwrap();
    let words = said(folder.path(), "scene:sim?seed=7&seconds=60", 4);
    let times = |word: &str| -> Vec<Duration> {
        let of = words.iter().filter(|(_, said)| said == word);
        of.map(|(at, _)| *at).collect()
    };
    assert_eq!(times("READY=1").len(), 1);
    assert_eq!(times("STOPPING=1").len(), 1);
    let alive = times("WATCHDOG=1");
    assert!(alive.len() >= 6, "{words:?}");
    let pauses = alive.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(pauses.max().unwrap() < LIMIT, "{words:?}");
    assert!(has_status(&words, "Init"), "{words:?}");
}

#[test]
fn a_fault_that_is_reported_is_life_too() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("slow")).unwrap();
    for n in 0..2 {
        image::RgbImage::from_pixel(64, 32, image::Rgb([n, 90, 7]))
            .save(folder.path().join(format!("slow/{n}.png")))
            .unwrap();
    }
    // One picture of one colour, then nothing for 10 s.
    let words = said(folder.path(), "slow?fps=0.1", 4);
    let alive = words.iter().filter(|(_, said)| said == "WATCHDOG=1");
    assert!(alive.count() >= 5, "{words:?}");
    assert!(has_status(&words, "Unavailable"), "{words:?}");
}

#[test]
fn the_journal_of_systemd_gets_levels() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("stderr");
    let stderr = File::create(&path).unwrap();
    let about = stderr.metadata().unwrap();
    let code = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(["monitor", "--board", "none.toml"])
        .env("JOURNAL_STREAM", format!("{}:{}", about.dev(), about.ino()))
        .current_dir(folder.path())
        .stderr(stderr)
        .status()
        .unwrap();
    assert_eq!(code.code(), Some(2));
    let said = fs::read_to_string(&path).unwrap();
    assert!(said.starts_with("<3>gapwatch: none.toml"), "{said}");
}
