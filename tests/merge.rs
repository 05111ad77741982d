//! Surveys on disk: a reference merged of shards is that of one run, bit for bit, and what was seen is not looked at again.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

use crate::program::{Ran, gapwatch_in, gapwatch_threads};
use serde_json::Value;

fn empty() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// Runs `calibrate` with the drives as typed and their surveys in `NAME.surveys`; writes `NAME.json`.
fn calibrate(folder: &Path, name: &str, more: &[&str]) {
    let (surveys, out) = (format!("{name}.surveys"), format!("{name}.json"));
    let args = ["calibrate", "--surveys", &surveys, "--out", &out];
    gapwatch_in(folder, &[&args, more].concat()).ok();
}

fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    fs::read(folder.join(name)).unwrap()
}

/// The surveys of a folder with the time of their last change.
fn surveys(folder: &Path) -> Vec<(String, SystemTime)> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut found: Vec<_> = entries
        .map(|entry| entry.unwrap())
        .map(|entry| (entry.file_name().into_string().unwrap(), entry.path()))
        .filter(|(name, _)| name.ends_with(".survey"))
        .map(|(name, path)| (name, path.metadata().unwrap().modified().unwrap()))
        .collect();
    found.sort();
    found
}

/// The line that says that drives had to be looked at again.
fn looked_again(ran: &Ran) -> Option<&str> {
    ran.err
        .lines()
        .find(|line| line.contains("without a survey"))
}

#[test]
fn merged_shards_are_the_reference_of_one_run_bit_for_bit_in_any_order_and_grouping() {
    let folder = empty();
    let folder = folder.path();
    let sim = |seeds: &str| format!("scene:sim?seed={seeds}&seconds=3&fps=5");
    let game = |seeds: &str| format!("scene:game?seed={seeds}&seconds=5&fps=5");
    let long = |seeds: &str| format!("scene:sim?seed={seeds}&seconds=10&fps=2");
    // In an order that is not theirs, with one thread; neither matters.
    let args = [
        "calibrate",
        "--held-out",
        &long("21..24"),
        "--accept",
        &game("3..4"),
        &game("1..2"),
        "--sim",
        &sim("9..12"),
        &sim("1..8"),
        "--out",
        "one.json",
    ];
    let said = gapwatch_threads(folder, 1, &args).ok();
    let one = bytes(folder, "one.json");
    // Two references of their own.
    let of_two = [
        ("a", ["1..7", "1..2", "21..22"]),
        ("b", ["8..12", "3..4", "23..24"]),
    ];
    for (name, [sims, games, longs]) in of_two {
        let drives = [
            &sim(sims),
            "--accept",
            &game(games),
            "--held-out",
            &long(longs),
        ];
        calibrate(folder, name, &[&["--sim"], &drives[..]].concat());
    }
    // Three shards that are too small for a reference.
    calibrate(folder, "c", &["--shard", "--sim", &sim("12"), &sim("1..9")]);
    calibrate(folder, "d", &["--shard", "--held-out", &long("21..24")]);
    let rest = [
        "--shard",
        "--accept",
        &game("1..4"),
        "--sim",
        &sim("10..11"),
    ];
    calibrate(folder, "e", &rest);
    gapwatch_in(folder, &["merge", "e.json", "d.json", "--out", "ed.json"]).refusal();
    for files in [
        &["a.json", "b.json"][..],
        &["b.json", "a.json"],
        &["c.json", "d.json", "e.json"],
        &["e.json", "c.json", "d.json"],
    ] {
        let merged = gapwatch_in(folder, &[&["merge"], files, &["--out", "m.json"]].concat());
        assert_eq!(looked_again(&merged), None, "{files:?}");
        assert_eq!(merged.ok(), said.replace("one.json", "m.json"), "{files:?}");
        assert!(bytes(folder, "m.json") == one, "{files:?}");
    }
    // A merge of merges.
    gapwatch_in(folder, &["merge", "c.json", "e.json", "--out", "ce.json"]).ok();
    gapwatch_in(folder, &["merge", "d.json", "ce.json", "--out", "m.json"]).ok();
    assert!(bytes(folder, "m.json") == one);
    let reference: Value = serde_json::from_slice(&one).unwrap();
    let command = reference["provenance"]["command"].as_str().unwrap();
    let names = format!(
        "gapwatch calibrate --sim '{}' --accept '{}' --held-out '{}' --false-alarms-per-hour 1 ",
        sim("1..12"),
        game("1..4"),
        long("21..24")
    );
    assert!(command.starts_with(&names), "{command}");
    let name = reference["components"][1]["name"].as_str().unwrap();
    assert_eq!(name, "accepted");
    // Without surveys the drives are looked at again.
    fs::create_dir(folder.join("far")).unwrap();
    for name in ["a.json", "b.json"] {
        fs::copy(folder.join(name), folder.join("far").join(name)).unwrap();
    }
    let files = ["merge", "far/a.json", "far/b.json", "--out", "m.json"];
    let again = gapwatch_in(folder, &files);
    assert!(
        again.err.contains("20 drives without a survey"),
        "{}",
        again.err
    );
    assert!(bytes(folder, "m.json") == one);
    let named = [&files[..], &["--surveys", "a.surveys", "b.surveys"]].concat();
    assert_eq!(looked_again(&gapwatch_in(folder, &named)), None);
    assert!(bytes(folder, "m.json") == one);
}

#[test]
fn merged_shards_with_histograms_or_lane_labels_are_the_reference_of_one_run_too() {
    let folder = empty();
    let folder = folder.path();
    for (metric, labels) in [
        ("log-energy-js", &[][..]),
        ("attention-w1", &[]),
        (
            "lane-risk",
            &[
                "scene:sim?seed=31&seconds=1&fps=2",
                "scene:sim?seed=33&seconds=1&fps=2",
            ],
        ),
    ] {
        let metric = ["--metric", metric];
        let (one, two) = (
            "scene:sim?seed=1..3&seconds=4&fps=5",
            "scene:sim?seed=4&seconds=4&fps=5",
        );
        let labelled = |which: &[&'static str]| match which {
            [] => vec![],
            which => [&["--labelled"], which].concat(),
        };
        calibrate(
            folder,
            "all",
            &[&metric[..], &["--sim", two, one], &labelled(labels)].concat(),
        );
        let (first, second) = labels.split_at(labels.len() / 2);
        for (name, drive, labels) in [("a", one, second), ("b", two, first)] {
            let drives = ["--shard", "--sim", drive];
            calibrate(
                folder,
                name,
                &[&metric[..], &drives, &labelled(labels)].concat(),
            );
        }
        let merged = gapwatch_in(folder, &["merge", "b.json", "a.json", "--out", "m.json"]);
        assert_eq!(merged.err, "");
        assert!(
            bytes(folder, "m.json") == bytes(folder, "all.json"),
            "{metric:?}"
        );
    }
}

#[test]
fn a_calibration_that_was_killed_goes_on_without_losing_finished_drives() {
    let folder = empty();
    let kept = folder.path().join("s.surveys");
    let args = [
        "calibrate",
        "--sim",
        "scene:sim?seed=1..12&seconds=5&fps=5",
        "--surveys",
        "s.surveys",
        "--out",
        "s.json",
    ];
    let mut killed = Command::new(env!("CARGO_BIN_EXE_gapwatch"))
        .args(args)
        .current_dir(folder.path())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while surveys(&kept).len() < 2 && began.elapsed() < Duration::from_secs(120) {
        std::thread::sleep(Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    let finished = surveys(&kept);
    assert!(finished.len() >= 2 && !folder.path().join("s.json").exists());
    gapwatch_in(folder.path(), &args).ok();
    let all = surveys(&kept);
    assert_eq!(all.len(), 12);
    assert!(finished.iter().all(|survey| all.contains(survey)));
    let once = bytes(folder.path(), "s.json");
    // Another rate and window need no second look.
    let other = [&args[..5], &["--window", "2", "--out", "other.json"]].concat();
    gapwatch_in(folder.path(), &other).ok();
    assert_eq!(surveys(&kept), all);
    // What is damaged or gone is looked at again, and nothing else.
    let [damaged, cut, old, gone] = [0, 1, 2, 3].map(|i| kept.join(&all[i].0));
    let mut content = fs::read(&damaged).unwrap();
    content[1_000] ^= 1;
    fs::write(&damaged, &content).unwrap();
    fs::write(&cut, &content[..20]).unwrap();
    let mut content = fs::read(&old).unwrap();
    content[16] = 99;
    fs::write(&old, content).unwrap();
    fs::remove_file(&gone).unwrap();
    let again = gapwatch_in(folder.path(), &args);
    for (path, said) in [
        (&damaged, "checksum"),
        (&cut, "20 bytes"),
        (&old, "version 99"),
    ] {
        let name = path.file_name().unwrap().to_str().unwrap();
        let line = again.err.lines().find(|line| line.contains(name)).unwrap();
        assert!(line.contains(said), "{line}");
    }
    assert_eq!(again.err.lines().count(), 3, "{}", again.err);
    let now = surveys(&kept);
    assert!(now[4..] == all[4..] && now.len() == 12);
    assert!(bytes(folder.path(), "s.json") == once);
}

#[test]
fn pictures_that_have_changed_are_looked_at_again() {
    let folder = empty();
    let run = |args: &[&str]| gapwatch_in(folder.path(), args).ok();
    run(&["scene", "--out", "a", "--count", "60"]);
    let args = [
        "calibrate",
        "--sim",
        "a/frames?fps=2",
        "--surveys",
        "s",
        "--out",
        "r.json",
    ];
    run(&args);
    let (first, kept) = (
        bytes(folder.path(), "r.json"),
        surveys(&folder.path().join("s")),
    );
    run(&args);
    assert_eq!(surveys(&folder.path().join("s")), kept);
    run(&["scene", "--out", "b", "--count", "1", "--look", "game"]);
    let from = folder.path().join("b/frames/000000.png");
    fs::copy(from, folder.path().join("a/frames/000007.png")).unwrap();
    run(&args);
    assert!(bytes(folder.path(), "r.json") != first);
    assert_eq!(surveys(&folder.path().join("s")).len(), 1);
}

#[test]
fn parts_that_do_not_belong_together_are_refused_by_name() {
    let folder = empty();
    let folder = folder.path();
    let shard = |name: &str, seed: &str, more: &[&str]| {
        let drive = format!("scene:sim?seed={seed}&seconds=2&fps=2");
        calibrate(
            folder,
            name,
            &[&["--shard", "--sim", &drive], more].concat(),
        );
    };
    shard("a", "1", &[]);
    shard("same", "1", &[]);
    shard("model", "2", &["--mean", "0,0,0"]);
    shard("metric", "2", &["--metric", "attention-js"]);
    shard("window", "2", &["--window", "2"]);
    shard("rate", "2", &["--false-alarms-per-hour", "2"]);
    let shard: Value = serde_json::from_slice(&bytes(folder, "a.json")).unwrap();
    let changed = |name: &str, change: fn(&mut Value)| {
        let mut shard = shard.clone();
        change(&mut shard);
        fs::write(folder.join(name), shard.to_string()).unwrap();
    };
    changed("version.json", |shard| shard["version"] = 9.into());
    changed("program.json", |shard| shard["gapwatch"] = "0.0.1".into());
    changed("frames.json", |shard| {
        shard["sources"][0]["frames"] = 9.into()
    });
    changed("role.json", |shard| {
        shard["sources"][0]["role"] = "spectator".into()
    });
    changed("hash.json", |shard| {
        shard["model"]["sha256"] = "00".into();
    });
    fs::write(folder.join("text.json"), "text").unwrap();
    for (files, said) in [
        (&["a.json", "model.json"][..], "preprocessing"),
        (
            &["a.json", "metric.json"],
            "wanted mahalanobis as in a.json",
        ),
        (&["a.json", "window.json"], "window"),
        (&["a.json", "rate.json"], "rate"),
        (&["a.json", "same.json"], "is in a.json too"),
        (&["version.json"], "version 9"),
        (&["a.json", "program.json"], "version of gapwatch 0.0.1"),
        (&["program.json"], "made by gapwatch 0.0.1"),
        (
            &["frames.json"],
            "9 frames of scene:sim?seed=1&seconds=2&fps=2, but its survey has 4",
        ),
        (&["role.json"], "spectator"),
        (&["text.json"], "not JSON"),
        (&["none.json"], "none.json: No such file"),
        (&["a.json"], "too few images: 1, wanted at least 20"),
        (
            &["a.json", "--surveys", "nowhere"],
            "nowhere: no such folder",
        ),
    ] {
        let args = [&["merge"], files, &["--out", "m.json"]].concat();
        let line = gapwatch_in(folder, &args).refusal();
        let place = files.last().filter(|_| files.len() == 1).unwrap_or(&"");
        assert!(line.contains(said), "{files:?}: {line}");
        assert!(said.contains("too few") || line.contains(place), "{line}");
    }
    // Drives that must be looked at again, with a model that is not in use.
    let lost = gapwatch_in(folder, &["merge", "hash.json", "--out", "m.json"]);
    assert!(
        lost.code == 2
            && lost
                .err
                .contains("hash.json: drives without a survey, of another model"),
        "{}",
        lost.err
    );
    assert!(!folder.join("m.json").exists());
}
