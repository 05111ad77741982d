//! Each command in an empty folder: output, files, exit code, and how wrong use is met.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use crate::program::{assert_expected, files, gapwatch_in, gapwatch_threads};

fn empty() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

/// Words of the program's own types and libraries, which say nothing to a person.
const NOT_PLAIN: [&str; 12] = [
    "invalid type",
    "invalid digit",
    "invalid length",
    "unknown variant",
    "unknown field",
    "missing field",
    "expected one of",
    "expected a ",
    "u16",
    "f64",
    "..=",
    ".tmp",
];

/// A part of an error that it says a second time.
fn said_twice(line: &str) -> Option<&str> {
    const SHORTEST: usize = 12;
    let parts: Vec<&str> = line.trim().split([':', ';']).map(str::trim).collect();
    let long = parts.iter().filter(|part| part.len() >= SHORTEST);
    let mut long = long.copied();
    long.find(|part| parts.iter().filter(|other| *other == part).count() > 1)
}

#[test]
fn a_part_that_is_said_twice_is_found() {
    let twice = "gapwatch: scene \"a\": no such look; wanted b: \"a\": no such look; wanted b";
    assert_eq!(said_twice(twice), Some("no such look"));
    assert_eq!(
        said_twice("gapwatch: no such look; wanted such a look"),
        None
    );
}

#[test]
fn a_drive_of_one_image_is_summed_up_without_shares() {
    let said = gapwatch_in(empty().path(), &["replay", "scene:sim?seconds=0.1"]).ok();
    let last = said.lines().last().unwrap();
    assert!(
        last.starts_with("1 frame, 0.0 s of drive in ") && last.ends_with(" s: Init"),
        "{said}"
    );
}

#[test]
fn files_that_are_wrong_are_met_in_plain_words_with_their_line() {
    let folder = empty();
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).unwrap();
    write("m.onnx", "hello");
    let reference = gapwatch_reference();
    let short = ["replay", "scene:sim?seconds=0.1", "--journal", "j.jsonl"];
    gapwatch_in(folder.path(), &short).ok();
    let journal = fs::read_to_string(folder.path().join("j.jsonl")).unwrap();
    for (name, text, args, said) in [
        (
            "b.toml",
            "[camera]\nsource = 3\n".to_owned(),
            vec!["monitor", "--board", "b.toml"],
            "b.toml:2: source = 3; wanted v4l2:/dev/videoN",
        ),
        (
            "m.toml",
            "taps = 3\n".to_owned(),
            vec!["replay", "--model", "m.onnx"],
            "m.toml:1: taps = 3; wanted a list",
        ),
        (
            "r.json",
            reference.replacen("\"window_s\": 1.0", "\"window_s\": \"1\"", 1),
            vec!["replay", "--reference", "r.json"],
            "reference r.json: another kind of value than belongs there at line ",
        ),
        (
            "r.json",
            reference.replacen("\"window_s\"", "\"windows\"", 1),
            vec!["replay", "--reference", "r.json"],
            "reference r.json: \"windows\", which is not known, at line ",
        ),
        (
            "r.json",
            reference[..reference.len() / 2].to_owned(),
            vec!["replay", "--reference", "r.json"],
            "reference r.json: not JSON: it ends at line ",
        ),
        (
            "s.json",
            "{\"format\": \"gapwatch-shard\", \"version\": 2}".to_owned(),
            vec!["merge", "s.json", "--out", "o.json"],
            "s.json: no \"",
        ),
        (
            "j.jsonl",
            journal.replacen("\"about\":{", "\"about\":3,\"of\":{", 1),
            vec!["report", "j.jsonl", "--out", "o.html"],
            "line 1: found about: 3; wanted an object",
        ),
    ] {
        write(name, &text);
        let line = gapwatch_in(folder.path(), &args).refusal();
        assert!(line.contains(said), "{args:?}: {line}");
        assert_eq!(said_twice(&line), None, "{line}");
        for word in NOT_PLAIN {
            assert!(!line.contains(word), "{args:?}: {word} in {line}");
        }
    }
}

/// The text of the reference inside the program.
fn gapwatch_reference() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim.json");
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains("\"window_s\": 1.0"));
    text
}

#[test]
fn wrong_use_is_met_with_one_line_and_exit_code_2_and_leaves_nothing_behind() {
    let folder = empty();
    fs::write(folder.path().join("not-a-model.onnx"), "hello").unwrap();
    let before = files(folder.path());
    let model = [
        "--taps", "a", "--size", "32x16", "--mean", "0,0,0", "--std", "1,1,1",
    ];
    let with_model = |rest: &[&'static str]| [rest, &model].concat();
    for (args, said) in [
        (vec!["replay", "--speeed", "max"], "--speeed"),
        (vec!["replay", "--speed", "warp"], "warp"),
        (vec!["rewind"], "rewind"),
        (
            vec!["replay", "no-such-drive"],
            "no-such-drive: no such file or folder",
        ),
        (
            vec!["replay", "scene:moon"],
            "no such look; wanted sim, sim-realistic, game",
        ),
        (
            vec!["replay", "scene:sim?without=wheels"],
            "no such element; wanted curves",
        ),
        (
            vec!["replay", "scene:sim?condition=mist:3"],
            "kinds are askew, tunnel",
        ),
        (
            vec!["replay", "--can", "log:no/such/folder/can.log"],
            "no/such/folder/can.log",
        ),
        (
            vec!["replay", "--can", "can0"],
            "an interface is named socketcan:can0",
        ),
        (vec!["monitor"], "--board"),
        (
            vec!["monitor", "--board", "missing.toml"],
            "missing.toml: No such file",
        ),
        (
            vec!["replay", "--can", "socketcan:nocan7"],
            "socketcan:nocan7",
        ),
        (
            vec!["replay", "--journal", "no/such/folder/j.jsonl"],
            "no/such/folder/j.jsonl",
        ),
        (
            vec!["replay", "--reference", "missing.json"],
            "missing.json",
        ),
        (
            with_model(&["replay", "--model", "missing.onnx"]),
            "missing.onnx",
        ),
        (
            with_model(&["replay", "--model", "not-a-model.onnx"]),
            "not-a-model.onnx",
        ),
        (
            vec!["replay", "/dev/video0"],
            "source = \"v4l2:/dev/video0\" in [camera]",
        ),
        (
            vec!["calibrate", "--sim", "/dev/video0", "--out", "r.json"],
            "source = \"v4l2:/dev/video0\" in [camera]",
        ),
        (vec!["replay", ""], "wanted scene:"),
        (
            vec!["compare", "random:", "random:", "--metric", "lane-risk"],
            "calibrate --metric lane-risk --labelled",
        ),
        (
            vec!["compare", "random:", "random:", "--levels", "x"],
            "a whole number from 2 to 65536",
        ),
        (
            vec!["scene", "--out", "s", "--seed", "-"],
            "a whole number from 0 to 4294967294",
        ),
        (vec!["replay", "--mean", "0,0"], "3 numbers"),
        (vec!["replay", "--taps", "e2,e9,e4"], "e9"),
        (vec!["replay", "--size", "640x320"], "enet-sad-lite"),
        (
            vec![
                "replay",
                "scene:sim",
                "--can",
                "log:same",
                "--journal",
                "./same",
            ],
            "a file of its own",
        ),
        (
            vec!["replay", "--crop", "0.5,0,0.6,1"],
            "inside the picture",
        ),
        (vec!["compare", "random:"], "2"),
        (vec!["compare", "random:", "random:frames=x"], "frames=x"),
        (
            vec!["compare", "random:", "random:", "--metric", "kl"],
            "attention-js",
        ),
        (
            vec!["compare", "random:", "random:", "--temperature", "0"],
            "above 0",
        ),
        (
            vec!["compare", "random:", "random:", "--first-level", "256"],
            "--first-level 256",
        ),
        (
            vec![
                "compare",
                "random:",
                "random:",
                "--histograms",
                "no/such/h.json",
            ],
            "no/such/h.json",
        ),
        (
            vec!["calibrate", "--sim", "random:", "--out", "no/such/r.json"],
            "no/such/r.json",
        ),
        (
            vec!["calibrate", "--sim", "random:frames=9", "--out", "r.json"],
            "too few images: 3, wanted at least 20",
        ),
        (
            vec![
                "calibrate",
                "--sim",
                "scene:sim?seed=5..3",
                "--out",
                "r.json",
            ],
            "seed=A..B",
        ),
        (
            vec![
                "calibrate",
                "--sim",
                "scene:sim",
                "--window",
                "9",
                "--out",
                "r.json",
            ],
            "0.05 to 3",
        ),
        (
            vec![
                "calibrate",
                "--sim",
                "scene:sim?seconds=86400&fps=240",
                "--out",
                "r.json",
            ],
            "at most 600000",
        ),
        (
            vec![
                "calibrate",
                "--sim",
                "scene:sim",
                "scene:sim",
                "--out",
                "r.json",
            ],
            "given twice",
        ),
        (
            vec!["replay", "--mean", "90,90,90", "--std", "1,1,1"],
            "divide by 255",
        ),
        (vec!["calibrate", "--out", "r.json"], "--sim"),
        (vec!["scene", "--out", "no/such/folder"], "no/such"),
        (vec!["scene", "--out", "s", "--size", "32"], "WIDTHxHEIGHT"),
        (vec!["scene", "--out", "s", "--count", "0"], "0"),
        (
            vec!["scene", "--out", "s", "--condition", "fog:3@1-2"],
            "@FROM-TO",
        ),
        (vec!["scene", "--count", "3"], "--out"),
        (vec!["scene", "--out", "s", "--look", "moon"], "moon"),
        (
            vec!["inspect", "random:", "--out", "no/such/folder"],
            "no/such",
        ),
        (
            vec!["inspect", "random:", "--out", "s", "--lane", "lanes"],
            "no tap named \"lanes\"",
        ),
        (
            vec!["inspect", "random:", "--out", "s", "--lane", "e4"],
            "one of the taps",
        ),
        (
            vec!["evaluate", "--model", "not-a-model.onnx"],
            "not-a-model.onnx",
        ),
        (vec!["evaluate", "--quick", "--scenes", "3"], "--quick"),
        (vec!["evaluate", "--format", "csv"], "--only lane_iou"),
        (
            vec!["evaluate", "--only", "lane_iou", "--plot", "p.svg"],
            "--plot is for speed_error",
        ),
        (
            vec!["evaluate", "--only", "lane_iou", "--budget", "2"],
            "--budget is for speed_error",
        ),
        (
            vec![
                "evaluate",
                "--scenes",
                "1",
                "--out",
                "no/such/folder/e.json",
            ],
            "no/such/folder/e.json",
        ),
    ] {
        let line = gapwatch_in(folder.path(), &args).refusal();
        assert!(
            line.starts_with("gapwatch: ") && line.contains(said),
            "{args:?}: {line}"
        );
        assert_eq!(said_twice(&line), None, "{args:?}: {line}");
        for word in NOT_PLAIN {
            assert!(!line.contains(word), "{args:?}: {word} in {line}");
        }
        assert_eq!(files(folder.path()), before, "{args:?} left files behind");
    }
}

#[test]
fn an_existing_file_is_kept_when_the_command_that_would_replace_it_fails() {
    let folder = empty();
    gapwatch_in(folder.path(), &["scene", "--out", "s", "--count", "40"]).ok();
    // A reference of frames of which one cannot be judged fails after all have been looked at.
    let black = image::RgbImage::new(320, 160);
    black
        .save(folder.path().join("s/frames/000039.png"))
        .unwrap();
    let kept = ["r.json", "h.json", "can.log", "j.jsonl"];
    for name in kept {
        fs::write(folder.path().join(name), "precious").unwrap();
    }
    for args in [
        vec!["calibrate", "--sim", "s/frames", "--out", "r.json"],
        vec!["compare", "s/frames", "random:", "--histograms", "h.json"],
        vec![
            "replay",
            "missing",
            "--journal",
            "j.jsonl",
            "--can",
            "log:can.log",
        ],
    ] {
        gapwatch_in(folder.path(), &args).refusal();
    }
    for name in kept {
        assert_eq!(
            fs::read(folder.path().join(name)).unwrap(),
            b"precious",
            "{name}"
        );
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), kept.len() + 1);
}

#[test]
fn output_that_nobody_reads_is_not_a_job_done() {
    let program = env!("CARGO_BIN_EXE_gapwatch");
    let line = format!(
        "'{program}' replay 'scene:sim?seconds=3&condition=noise:5' --check | true; exit ${{PIPESTATUS[0]}}"
    );
    let status = std::process::Command::new("bash")
        .args(["-c", &line])
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(2));
}

#[test]
fn every_command_has_help_with_an_example() {
    for command in [
        "replay",
        "monitor",
        "calibrate",
        "merge",
        "compare",
        "scene",
        "inspect",
        "evaluate",
    ] {
        let help = gapwatch_in(empty().path(), &[command, "--help"]).ok();
        assert!(
            help.contains("Example:") && help.contains(&format!("gapwatch {command}")),
            "{help}"
        );
    }
    assert_expected("help.txt", &gapwatch_in(empty().path(), &["--help"]).ok());
}

#[test]
fn calibrate_writes_a_reference_that_replay_takes_and_its_own_command_reproduces() {
    let folder = empty();
    let calibrate = |threads, out: &str| {
        let args = [
            "calibrate",
            "--sim",
            "scene:sim?seed=1..6&seconds=6&fps=5",
            "--metric",
            "attention-js",
            "--out",
            out,
        ];
        gapwatch_threads(folder.path(), threads, &args).ok()
    };
    assert_expected("calibrate.txt", &calibrate(1, "a.json"));
    calibrate(2, "b.json");
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert_eq!(read("a.json"), read("b.json"));
    let reference: serde_json::Value = serde_json::from_str(&read("a.json")).unwrap();
    assert_eq!(
        reference["provenance"]["sources"].as_array().unwrap().len(),
        6
    );
    let drive = [
        "replay",
        "scene:sim?seed=4&seconds=3",
        "--reference",
        "a.json",
    ];
    gapwatch_in(folder.path(), &drive).ok();
    let other = [&drive[..], &["--mean", "0,0,0", "--std", "1,1,1"]].concat();
    let line = gapwatch_in(folder.path(), &other).refusal();
    assert!(
        line.contains("a.json does not fit") && line.contains("preprocessing"),
        "{line}"
    );
}

#[test]
fn references_that_are_broken_are_refused_by_name() {
    let folder = empty();
    let built_in =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/sim.json"))
            .unwrap();
    let changed = |change: fn(&mut serde_json::Value)| {
        let mut reference: serde_json::Value = serde_json::from_str(&built_in).unwrap();
        change(&mut reference);
        reference.to_string()
    };
    for (name, text, said) in [
        ("empty.json", String::new(), "not JSON"),
        (
            "cut.json",
            built_in[..built_in.len() / 2].to_owned(),
            "not JSON",
        ),
        ("list.json", "[1, 2]".to_owned(), "format null"),
        (
            "old.json",
            built_in.replacen("\"version\": 5", "\"version\": 99", 1),
            "version 99",
        ),
        (
            "older.json",
            built_in.replacen("\"version\": 5", "\"version\": 4", 1),
            "version 4, of an older gapwatch; make it again with the command under provenance",
        ),
        (
            "whitening.json",
            changed(|r| {
                let norm = &mut r["components"][0]["taps"][0]["nominal"]["energies"];
                norm["whitening"] = serde_json::json!([1, 2]);
            }),
            "2 whitening weights",
        ),
        (
            "other.json",
            changed(|r| r["model"]["sha256"] = "00".repeat(32).into()),
            "hash",
        ),
    ] {
        fs::write(folder.path().join(name), text).unwrap();
        let line = gapwatch_in(folder.path(), &["replay", "--reference", name]).refusal();
        assert!(line.contains(name) && line.contains(said), "{line}");
    }
}
