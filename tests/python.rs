//! What independent programs say of our output: Python's `cantools` and `autosar-e2e` of the bus, onnxruntime, NumPy and
//! OpenCV of the numbers, `ffmpeg` of the videos. `tests/run` installs them.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::program::{check, gapwatch_in, verdict_lines};

const PROGRAM: &str = env!("CARGO_BIN_EXE_gapwatch");
const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn scenes(folder: &Path, name: &str, more: &[&str]) -> PathBuf {
    gapwatch_in(folder, &[&["scene", "--out", name], more].concat()).ok();
    folder.join(name).join("frames")
}

/// Makes a video of the frames of a scene set `s`.
fn video(folder: &Path, codec: &[&str], name: &str) {
    let frames = ["-v", "error", "-framerate", "10", "-i", "s/frames/%06d.png"];
    let status = Command::new("ffmpeg")
        .args(frames)
        .args(codec)
        .arg(name)
        .current_dir(folder)
        .status()
        .unwrap();
    assert!(status.success());
}

/// The folder of real image sets.
fn field(set: &str) -> String {
    let root =
        std::env::var("GAPWATCH_FIELD").expect("GAPWATCH_FIELD names the folder of image sets");
    format!("{root}/{set}")
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn every_frame_on_the_bus_is_decoded_and_its_crc_and_counter_accepted_by_others() {
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(folder.path(), &["replay", "--can", "log:can.log", "--fd"]).ok();
    let log = folder.path().join("can.log");
    let said = check(
        "check_can_log.py",
        &[
            log.to_str().unwrap(),
            &format!("{ROOT}/src/can/gapwatch.dbc"),
            "--reference",
            &format!("{ROOT}/calibration/sim.json"),
        ],
    );
    let report: serde_json::Value = serde_json::from_str(said.lines().last().unwrap()).unwrap();
    // 60 s: ten status frames a second, one health, one version and one detail.
    assert!(report["frames"].as_u64().unwrap() >= 780, "{report}");
    assert!(report["version_frames"].as_u64().unwrap() >= 60, "{report}");
    let states: Vec<&str> = report["states"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s[1].as_str().unwrap())
        .collect();
    assert_eq!(states, ["Init", "Ok", "Suspect", "Gap", "Ok"]);
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn compare_equals_an_independent_computation() {
    let folder = tempfile::tempdir().unwrap();
    let nominal = scenes(
        folder.path(),
        "nominal",
        &["--count", "24", "--seed", "5", "--size", "640x380"],
    );
    let fog = scenes(
        folder.path(),
        "fog",
        &["--count", "10", "--seed", "6", "--condition", "fog:3"],
    );
    let other = scenes(
        folder.path(),
        "other",
        &["--count", "10", "--seed", "8", "--size", "500x300"],
    );
    // At 0.2 of the peak our scenes have fewer than 50 counted pixels an image.
    check_compare(
        "0.5peak",
        &[&nominal, &fog, &other].map(|set| set.to_str().unwrap().to_owned()),
    );
}

fn check_compare(temperature: &str, sets: &[String]) {
    let model = format!("{ROOT}/calibration/enet-sad-lite-320x160");
    let (onnx, toml) = (format!("{model}.onnx"), format!("{model}.toml"));
    let mut args = vec![
        "--gapwatch",
        PROGRAM,
        "--model",
        &onnx,
        "--options",
        &toml,
        "--temperature",
        temperature,
    ];
    args.extend(sets.iter().map(String::as_str));
    let said = check("check_compare.py", &args);
    assert!(said.contains("compare agrees with the oracle"), "{said}");
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn networks_of_other_peoples_shape_are_tapped_calibrated_and_compared() {
    let folder = tempfile::tempdir().unwrap();
    let nominal = scenes(folder.path(), "nominal", &["--count", "70", "--seed", "5"]);
    let rain = scenes(
        folder.path(),
        "rain",
        &["--count", "20", "--seed", "6", "--condition", "rain:4"],
    );
    let sets = [nominal.to_str().unwrap(), rain.to_str().unwrap()];
    check(
        "check_foreign_model.py",
        &["--gapwatch", PROGRAM, sets[0], sets[1]],
    );
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn recordings_that_others_write_are_seen_like_the_pictures_in_them() {
    let folder = tempfile::tempdir().unwrap();
    let pictures = scenes(folder.path(), "s", &["--count", "25", "--seed", "2"]);
    let of = |path: &Path| path.to_str().unwrap().to_owned();
    check(
        "check_mcap.py",
        &["write", &of(&pictures), &of(folder.path())],
    );
    let journal = |source: &str| {
        gapwatch_in(folder.path(), &["replay", source, "--journal", "j"]).ok();
        verdict_lines(&folder.path().join("j"))
    };
    let (colours, grey) = (journal("s/frames"), journal("grey"));
    assert_eq!(colours.len(), 25);
    assert_ne!(colours, grey);
    for name in ["ros-rgb8", "ros-bgr8", "ros-rgba8", "ros-bgra8", "ros-png"] {
        assert_eq!(journal(&format!("{name}.mcap")), colours, "{name}");
    }
    for name in ["foxglove-raw", "foxglove-png", "foxglove-json"] {
        assert_eq!(journal(&format!("{name}.mcap")), colours, "{name}");
    }
    assert_eq!(journal("grey-mono8.mcap"), grey);
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn recordings_of_verdicts_are_read_by_others() {
    let folder = tempfile::tempdir().unwrap();
    let drive = "scene:sim?seed=7&seconds=6&condition=night:5@2-4";
    let args = ["replay", drive, "--journal", "j", "--mcap", "r.mcap"];
    gapwatch_in(folder.path(), &args).ok();
    let of = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let said = check("check_mcap.py", &["read", &of("r.mcap"), &of("j")]);
    let read: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(read["images"], 60, "{read}");
    assert!(read["verdicts"].as_u64().unwrap() >= 60, "{read}");
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn a_video_is_seen_like_the_pictures_it_was_made_of() {
    let folder = tempfile::tempdir().unwrap();
    scenes(folder.path(), "s", &["--count", "30", "--seed", "2"]);
    video(
        folder.path(),
        &["-c:v", "ffv1", "-pix_fmt", "bgr0"],
        "v.mkv",
    );
    let journal = |source: &str, name: &str| {
        gapwatch_in(folder.path(), &["replay", source, "--journal", name]).ok();
        verdict_lines(&folder.path().join(name))
    };
    let (video, pictures) = (journal("v.mkv", "v.jsonl"), journal("s/frames", "p.jsonl"));
    assert_eq!(video.len(), 30);
    assert_eq!(video, pictures);
}

#[test]
#[ignore = "needs the ffmpeg program: run tests/run"]
fn a_damaged_video_gives_the_frames_that_are_there_and_a_cut_one_its_name() {
    let folder = tempfile::tempdir().unwrap();
    scenes(folder.path(), "s", &["--count", "30", "--seed", "2"]);
    video(folder.path(), &["-c:v", "mjpeg"], "v.avi");
    let path = folder.path().join("v.avi");
    let whole = std::fs::read(&path).unwrap();
    let frames = |args: &[&str]| {
        let ran = gapwatch_in(folder.path(), args);
        assert_eq!(ran.code, 0, "{}", ran.err);
        verdict_lines(&folder.path().join("j")).len()
    };
    let replay = ["replay", "v.avi", "--journal", "j"];
    assert_eq!(frames(&replay), 30);
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let kept = frames(&replay);
    assert!(
        (5..20).contains(&kept),
        "{kept} frames of the first half of the file"
    );
    std::fs::write(&path, &whole[..whole.len() / 50]).unwrap();
    let line = gapwatch_in(folder.path(), &replay).refusal();
    assert!(line.contains("v.avi"), "{line}");
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt and GAPWATCH_FIELD: run tests/run"]
fn field_compare_on_real_images_equals_an_independent_computation() {
    let sets = [
        "sim/carla_town01-03",
        "sim/carla_town05",
        "real/california_highway",
        "sim/beamng",
    ]
    .map(field);
    check_compare("0.4peak", &sets);
    // The road as the reference has lower peaks: at 0.3 of them there are more than 50 counted pixels an image.
    let sets = [
        "real/california_highway/project_video_frames",
        "sim/carla_town05",
        "sim/beamng",
    ]
    .map(field);
    check_compare("0.3peak", &sets);
}

#[test]
#[ignore = "needs ffmpeg and GAPWATCH_FIELD: run tests/run"]
fn field_compare_takes_folders_videos_and_noise() {
    let sets = [
        field("sim/carla_town01-03"),
        field("sim/carla_town05"),
        field("real/california_highway"),
        field("real/california_highway/solidWhiteRight.mp4"),
        field("sim/beamng"),
        "random:".to_owned(),
    ];
    let folder = tempfile::tempdir().unwrap();
    let args: Vec<&str> = ["compare"]
        .into_iter()
        .chain(sets.iter().map(String::as_str))
        .chain(["--format", "json"])
        .collect();
    let rows: serde_json::Value =
        serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    assert_eq!(rows.as_array().unwrap().len(), 5 * 13);
    let gap = |set: &str| {
        let row = rows
            .as_array()
            .unwrap()
            .iter()
            .find(|r| r["set"] == set && r["metric"] == "log-energy-js")
            .unwrap();
        row["e4"].as_f64().unwrap()
    };
    let town = gap(&sets[1]);
    for set in &sets[2..] {
        assert!(
            gap(set) > 2.0 * town,
            "{set}: {} against {town} of another town of the same simulator",
            gap(set)
        );
    }
}
