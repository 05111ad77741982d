//! What is shipped in `calibration/` belongs together and can be made again.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::fs;
use std::path::{Path, PathBuf};

use crate::program::{assert_expected, gapwatch_in};
use gapwatch::lab::evaluation::{Setting, lane_iou};
use gapwatch::lab::scene::World;
use gapwatch::model::encoder::Encoder;
use gapwatch::model::{ModelOptions, ModelSpec};
use serde_json::Value;
use sha2::{Digest, Sha256};

fn calibration(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("calibration")
        .join(name)
}

pub fn hash_of(bytes: &[u8]) -> String {
    let hash = Sha256::digest(bytes);
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn every_model_has_its_card_and_settings_and_shows_lanes() {
    let mut models = 0;
    let mut bytes = 0;
    for entry in fs::read_dir(calibration("")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "onnx") {
            continue;
        }
        let onnx = fs::read(&path).unwrap();
        let card = fs::read_to_string(path.with_extension("md")).unwrap();
        assert!(
            card.contains(&hash_of(&onnx)),
            "{} is another's card",
            path.display()
        );
        let spec = ModelSpec::new(Some(&path), ModelOptions::default()).unwrap();
        assert_eq!(spec.lane.as_deref(), Some("lane"), "{}", path.display());
        let encoder = Encoder::load_with_lane(&spec).unwrap();
        let nominal = Setting {
            world: World::default(),
            condition: None,
        };
        let judged = lane_iou(&spec, &encoder, &[nominal], 4, &|| {}).unwrap();
        assert!(
            judged[0].iou.unwrap() > 0.6,
            "{}: {judged:?}",
            path.display()
        );
        for tap in &judged[0].attention {
            // The deliberate scale: a median peak energy of 50 on the trainer's validation scenes.
            let peak = tap.peak_energy.unwrap();
            assert!(
                (25.0..100.0).contains(&peak),
                "{} {}: {peak}",
                path.display(),
                tap.tap
            );
        }
        models += 1;
        bytes += onnx.len();
    }
    assert!(
        models >= 4 && bytes < 8_000_000,
        "{models} models of {bytes} bytes"
    );
}

#[test]
fn the_reference_carries_the_hash_of_the_model() {
    let model = fs::read(calibration("enet-sad-lite-320x160.onnx")).unwrap();
    let reference = fs::read_to_string(calibration("sim.json")).unwrap();
    assert!(
        reference.contains(&hash_of(&model)),
        "sim.json is of another model"
    );
}

/// Everything equal but for floats, which may differ by a share: encoders round differently on processors without fused products.
fn assert_alike(place: &str, found: &Value, wanted: &Value) {
    match (found, wanted) {
        (Value::Array(found), Value::Array(wanted)) => {
            assert_eq!(found.len(), wanted.len(), "{place}");
            for (index, (found, wanted)) in found.iter().zip(wanted).enumerate() {
                assert_alike(&format!("{place}[{index}]"), found, wanted);
            }
        }
        (Value::Object(found), Value::Object(wanted)) => {
            assert!(found.keys().eq(wanted.keys()), "{place}");
            for (key, wanted) in wanted {
                assert_alike(&format!("{place}.{key}"), &found[key], wanted);
            }
        }
        (Value::Number(found), Value::Number(wanted))
            if wanted.is_f64() || place.contains("counts[") =>
        {
            let (found, wanted) = (found.as_f64().unwrap(), wanted.as_f64().unwrap());
            // An edge may move by a cell or two of its grid, and its bins then share their pixels otherwise.
            let allowed = match place {
                place if place.contains("edges[") => 2e-3,
                place if place.contains("counts[") => 0.03 * wanted,
                _ => 0.01 * wanted.abs(),
            };
            assert!(
                (found - wanted).abs() <= allowed,
                "{place}: {found}, shipped {wanted}"
            );
        }
        _ => assert_eq!(found, wanted, "{place}"),
    }
}

/// Whether this processor fuses products with their sums: those that do agree to the bit.
fn fuses_products() -> bool {
    #[cfg(target_arch = "x86_64")]
    return is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    #[cfg(not(target_arch = "x86_64"))]
    return cfg!(target_arch = "aarch64");
}

#[test]
fn a_sample_of_the_drives_behind_the_reference_is_seen_as_it_was_to_the_bit() {
    if !fuses_products() {
        println!("left out: this processor does not fuse products with their sums");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let fitted = [1001, 1120].map(|n| format!("scene:sim?seed={n}&seconds=300&fps=2"));
    let held_out = [2048].map(|n| format!("scene:sim?seed={n}&seconds=300&fps=10"));
    let mut args = vec![
        "calibrate",
        "--shard",
        "--surveys",
        "seen",
        "--out",
        "a.json",
        "--sim",
    ];
    args.extend(fitted.iter().map(String::as_str));
    args.push("--held-out");
    args.extend(held_out.iter().map(String::as_str));
    gapwatch_in(folder.path(), &args).ok();
    let mut lines: Vec<String> = fs::read_dir(folder.path().join("seen"))
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_str().unwrap();
            format!("{}  {name}\n", hash_of(&fs::read(&path).unwrap()))
        })
        .collect();
    lines.sort();
    assert_eq!(lines.len(), fitted.len() + held_out.len());
    assert_expected("surveys.txt", &lines.concat());
}

#[test]
#[ignore = "renders 254,400 frames, 15 CPU minutes: run tests/run --all"]
fn whole_the_command_in_the_reference_makes_it_again() {
    let shipped = fs::read_to_string(calibration("sim.json")).unwrap();
    let shipped: Value = serde_json::from_str(&shipped).unwrap();
    let command = shipped["provenance"]["command"]
        .as_str()
        .unwrap()
        .replace('\'', "");
    let (command, _) = command.split_once(" --out ").unwrap();
    let args = command.split(' ').skip(1);
    let args: Vec<&str> = args.chain(["--out", "again.json"]).collect();
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(folder.path(), &args).ok();
    let again = fs::read_to_string(folder.path().join("again.json")).unwrap();
    let again: Value = serde_json::from_str(&again).unwrap();
    assert_alike("reference", &again, &shipped);
}

#[test]
fn no_text_has_a_place_left_to_fill() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in [
        "README.md",
        "CHANGELOG.md",
        "calibration/README.md",
        "calibration/train/README.md",
    ] {
        let text = fs::read_to_string(root.join(name)).unwrap();
        let open = text
            .split('@')
            .skip(1)
            .step_by(2)
            .find(|part| part.chars().all(|c| c.is_ascii_uppercase()));
        assert_eq!(open, None, "{name}");
    }
}
