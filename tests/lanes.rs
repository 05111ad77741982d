//! The forecast of lost lanes, beside gap and change.
#![allow(clippy::unwrap_used)]

use std::path::Path;

use crate::program::{gapwatch_in, journal_of};
use gapwatch::reference::Reference;

/// Median forecast of a drive.
fn lanes_lost(folder: &Path, source: &str) -> f64 {
    gapwatch_in(folder, &["replay", source, "--journal", "drive.jsonl"]);
    let lines = journal_of(&folder.join("drive.jsonl"));
    let mut all: Vec<f64> = lines
        .iter()
        .filter_map(|line| line["lanes"].as_f64())
        .collect();
    assert!(all.len() > 30, "{} forecasts", all.len());
    assert!(all.iter().all(|share| (0.0..=1.0).contains(share)));
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

#[test]
fn a_clear_road_loses_no_lanes_and_heavy_snow_nearly_all() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let drive = "scene:sim?seed=7001&seconds=10&fps=5";
    let under =
        |condition: &str| lanes_lost(folder, &format!("{drive}&condition={condition}@0-60"));
    let (clear, snow) = (lanes_lost(folder, drive), under("snow:5"));
    assert!(clear < 0.1, "{clear}");
    assert!(snow > 0.8, "{snow}");
    // Thin fog costs few lanes.
    let haze = under("fog:1");
    assert!(haze < 0.5 * snow, "{haze} beside {snow}");
}

#[test]
fn the_shipped_forecast_says_how_well_it_was_judged() {
    let lanes = Reference::read(None).unwrap().lanes.unwrap();
    assert!(lanes.judged.frames >= 1_000);
    assert!(lanes.judged.mean_absolute_error < 0.4 * lanes.judged.of_the_mean);
}

#[test]
fn a_forecast_needs_two_labelled_drives_and_a_metric_of_energies() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sim = "scene:sim?seed=1..4&seconds=4&fps=5";
    let args = ["calibrate", "--sim", sim, "--out", "r.json", "--labelled"];
    let one = gapwatch_in(
        folder,
        &[&args[..], &["scene:sim?seed=9&seconds=1&fps=2"]].concat(),
    );
    let said = one.refusal();
    assert!(
        said.contains("--labelled: 1 labelled drives; wanted two or more"),
        "{said}"
    );
    let two = [
        "scene:sim?seed=9..10&seconds=1&fps=2",
        "--metric",
        "log-energy-js",
    ];
    let said = gapwatch_in(folder, &[&args[..], &two].concat()).refusal();
    assert!(
        said.contains("wanted --metric mahalanobis or lane-risk"),
        "{said}"
    );
    assert!(!folder.join("r.json").exists());
}

#[test]
fn a_forecast_that_does_not_fit_the_energies_of_its_tap_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("r.json");
    let fault = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut value = serde_json::to_value(Reference::read(None).unwrap()).unwrap();
        change(&mut value["lanes"]);
        std::fs::write(&file, value.to_string()).unwrap();
        Reference::read(Some(&file))
            .map(|_| ())
            .map_err(|why| why.to_string())
    };
    assert_eq!(fault(&|_| {}), Ok(()));
    let epsilon = fault(&|lanes| lanes["risk"]["epsilon"] = 0.5.into()).unwrap_err();
    assert!(
        epsilon.contains("lanes: a forecast with an epsilon of 0.5 beside "),
        "{epsilon}"
    );
    let fewer = fault(&|lanes| {
        for of in ["mean", "spread", "weights"] {
            lanes["risk"][of].as_array_mut().unwrap().pop();
        }
    });
    let fewer = fewer.unwrap_err();
    assert!(
        fewer.contains("a forecast from 79 energies beside 80"),
        "{fewer}"
    );
}
