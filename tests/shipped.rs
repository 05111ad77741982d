//! What is shipped in `calibration/` belongs together and can be made again.
#![allow(clippy::unwrap_used)]

mod program;

use std::fs;
use std::path::{Path, PathBuf};

use program::gapwatch_in;
use serde_json::Value;
use sha2::{Digest, Sha256};

/// The processor that `calibration/sim.json` was made on, as the system names it.
const MADE_ON: &str = "Intel(R) Xeon(R) Processor, avx512f";

fn calibration(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("calibration")
        .join(name)
}

/// Model name and widest vector unit of this machine's processor.
fn processor() -> String {
    let info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = info.lines().find(|line| line.starts_with(name));
        line.and_then(|line| line.split_once(':'))
            .map(|(_, value)| value.trim())
            .unwrap_or_default()
    };
    let has = |unit: &&str| field("flags").split(' ').any(|flag| flag == *unit);
    let unit = ["avx512f", "avx2"].into_iter().find(has).unwrap_or("none");
    format!("{}, {unit}", field("model name"))
}

#[test]
fn model_card_and_reference_carry_the_hash_of_the_model() {
    let model = fs::read(calibration("enet-sad-lite-320x160.onnx")).unwrap();
    let hash: String = Sha256::digest(&model)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    for name in ["enet-sad-lite-320x160.md", "sim.json"] {
        assert!(
            fs::read_to_string(calibration(name))
                .unwrap()
                .contains(&hash),
            "{name} is of another model"
        );
    }
}

#[test]
fn the_command_in_the_reference_makes_it_again() {
    let shipped = fs::read_to_string(calibration("sim.json")).unwrap();
    let value: Value = serde_json::from_str(&shipped).unwrap();
    let command = value["provenance"]["command"]
        .as_str()
        .unwrap()
        .replace('\'', "");
    let args: Vec<&str> = command.split(' ').skip(1).collect();
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("calibration")).unwrap();
    gapwatch_in(folder.path(), &args).ok();
    let again = fs::read_to_string(folder.path().join("calibration/sim.json")).unwrap();
    if processor() == MADE_ON {
        assert!(
            again == shipped,
            "not the same bytes on the kind of processor it was made on ({MADE_ON})"
        );
        return;
    }
    let again: Value = serde_json::from_str(&again).unwrap();
    for (tap, other) in value["taps"]
        .as_array()
        .unwrap()
        .iter()
        .zip(again["taps"].as_array().unwrap())
    {
        for (point, other) in tap["scale"]
            .as_array()
            .unwrap()
            .iter()
            .zip(other["scale"].as_array().unwrap())
        {
            let (wanted, found) = (
                point["threshold"].as_f64().unwrap(),
                other["threshold"].as_f64().unwrap(),
            );
            assert!(
                (found / wanted - 1.0).abs() < 0.01,
                "{}: threshold {found}, shipped {wanted}",
                tap["tap"]
            );
        }
    }
}
