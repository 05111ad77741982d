//! `gapwatch bench`: its keys and what must hold among them on any machine.
#![allow(clippy::unwrap_used)]

use crate::program::gapwatch_in;

#[test]
fn bench_runs_the_encoder_in_tract_when_told() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["bench", "--format", "json", "--frame", "320x160"];
    let args = [&args[..], &["--executor", "tract"]].concat();
    let bench: serde_json::Value =
        serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    assert_eq!(bench["executor"], "tract");
    assert!(bench["encoder_gflops"].is_null());
}

#[test]
fn bench_has_its_keys_and_its_numbers_fit_together() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["bench", "--format", "json", "--frame", "320x160"];
    let bench: serde_json::Value =
        serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    let number = |of: &serde_json::Value, key: &str| {
        of[key]
            .as_f64()
            .unwrap_or_else(|| panic!("no number {key} in {of}"))
    };
    for key in ["machine", "model"] {
        assert!(!bench[key].as_str().unwrap().is_empty());
    }
    assert_eq!(bench["threads"], 1);
    let stages = bench["stages"].as_array().unwrap();
    let names: Vec<&str> = stages.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        [
            "capture",
            "health",
            "preprocess",
            "quality",
            "encoder",
            "energy",
            "histogram",
            "detector",
            "can"
        ]
    );
    for stage in stages {
        assert!(number(stage, "median_ms") <= number(stage, "p99_ms"));
    }
    for stage in &stages[1..] {
        assert_eq!(stage["allocations"], 0, "after the encoder: {stage}");
    }
    assert!(number(&bench, "encoder_ms") > 0.0);
    assert!(number(&bench, "encoder_ms") <= number(&bench, "frame_ms"));
    assert!(number(&bench, "start_ms") >= number(&bench, "encoder_ms"));
    // The built-in model runs in our executor, without a request for memory.
    assert!(bench["executor"].as_str().unwrap().starts_with("own"));
    assert!(number(&bench, "encoder_gflops") > 0.0 && number(&bench, "peak_gflops") > 0.0);
    assert!(number(&bench, "rss_mib") > 1.0 && number(&bench, "binary_mib") > 1.0);
}

#[test]
#[ignore = "takes a minute: run tests/run"]
fn bench_sets_the_frame_loop_with_evidence_beside_that_without() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["bench", "--format", "json", "--frame", "320x160"];
    let args = [&args[..], &["--evidence"]].concat();
    let bench: serde_json::Value =
        serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    let cost = &bench["evidence"];
    assert_eq!(cost["frames"], 700);
    // An alarm in each of the two blocks with the recorder.
    assert_eq!(cost["events"], 2, "{cost}");
    for key in ["off_median_ms", "off_p99_ms", "on_median_ms", "on_p99_ms"] {
        assert!(cost[key].as_f64().unwrap() > 0.0, "{cost}");
    }
}
