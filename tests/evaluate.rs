//! `gapwatch evaluate`: its results file, what is made from it, and the keys on image sets of other roads.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use crate::program::gapwatch_in;
use serde_json::Value;

fn read(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_results_file_grows_key_by_key_and_becomes_markdown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("r.json");
    let kept = r#"{"gapwatch": "0", "weather": [{"wet": 0.1}]}"#;
    fs::write(&path, kept).unwrap();
    let table = [
        "evaluate",
        "--only",
        "paper_table",
        "--quick",
        "--out",
        "r.json",
    ];
    let said = gapwatch_in(folder.path(), &table).ok();
    assert!(said.contains("plain simulation 2") && said.contains("adapted simulation"));
    let alarms = [
        "evaluate",
        "--only",
        "false_alarms",
        "--quick",
        "--out",
        "r.json",
    ];
    gapwatch_in(folder.path(), &alarms).ok();
    let results = read(&path);
    // Ten minutes show nothing of a rate of one in ten hours, and the file says so beside the numbers.
    let rare = &results["false_alarms"][2];
    assert_eq!(
        (&rare["verdict"], rare["wanted"].as_f64()),
        (&"not shown".into(), Some(0.1))
    );
    assert!(rare["missing_hours"].as_f64().unwrap() > 29.0, "{rare}");
    assert_eq!(results["weather"][0]["wet"], 0.1);
    // Without real images the simulation is the only reference: two metrics on three taps.
    let rows = results["paper_table"].as_array().unwrap();
    assert_eq!(rows.len(), 2 * 3);
    for row in rows {
        let sets: Vec<&str> = row["sets"]
            .as_array()
            .unwrap()
            .iter()
            .map(|set| set["set"].as_str().unwrap())
            .collect();
        assert_eq!(sets, ["plain simulation 2", "adapted simulation", "random"]);
        assert_eq!(row["reference"], "plain simulation");
        assert!(row["order_holds"].is_boolean(), "{row}");
    }
    let command = results["made"]["paper_table"]["command"].as_str().unwrap();
    assert_eq!(
        command,
        "gapwatch evaluate --only paper_table --quick --out r.json"
    );
    let from = ["evaluate", "--from", "r.json", "--format", "markdown"];
    let page = gapwatch_in(folder.path(), &from).ok();
    for part in [
        "## paper_table",
        "## false_alarms",
        "Seeds: drives 100001 and on",
        command,
        "| adapted simulation | ",
        "### False alarms an hour",
        "| not shown, ",
        " hours more without an entry",
    ] {
        assert!(page.contains(part), "{part:?} is missing from\n{page}");
    }
    // A key shows the same from the file as when it was made.
    let shown = [
        "evaluate",
        "--from",
        "r.json",
        "--only",
        "paper_table",
        "--format",
        "table",
    ];
    assert_eq!(gapwatch_in(folder.path(), &shown).ok(), said);
}

#[test]
fn wrong_files_and_folders_of_an_evaluation_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("mine.txt"), "precious").unwrap();
    fs::write(folder.path().join("r.json"), r#"{"gapwatch": "0"}"#).unwrap();
    fs::create_dir(folder.path().join("field")).unwrap();
    for (args, said) in [
        (
            vec!["evaluate", "--only", "false_alarms", "--out", "mine.txt"],
            vec!["mine.txt", "not JSON", "wanted results"],
        ),
        (
            vec!["evaluate", "--from", "mine.txt"],
            vec!["mine.txt", "not JSON"],
        ),
        (vec!["evaluate", "--from", "none.json"], vec!["none.json"]),
        (
            vec!["evaluate", "--from", "r.json", "--only", "false_alarms"],
            vec!["r.json", "no key false_alarms"],
        ),
        (
            vec!["evaluate", "--from", "r.json", "--out", "s.json"],
            vec!["--from"],
        ),
        (
            vec!["evaluate", "--only", "field_sets"],
            vec!["field_sets", "--field DIR"],
        ),
        (
            vec!["evaluate", "--only", "field_sets", "--field", "field"],
            vec!["field/sim/carla_town01-03", "calibration/README.md"],
        ),
        (
            vec!["evaluate", "--only", "paper_table", "--field", "nowhere"],
            vec!["nowhere", "no such file or folder"],
        ),
    ] {
        let line = gapwatch_in(folder.path(), &args).refusal();
        for part in said {
            assert!(line.contains(part), "{args:?}: {line}");
        }
    }
    let kept = fs::read_to_string(folder.path().join("mine.txt")).unwrap();
    assert_eq!(kept, "precious");
}

#[test]
fn the_shipped_page_is_made_from_the_shipped_results() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let from = [
        "evaluate",
        "--from",
        "calibration/results.json",
        "--format",
        "markdown",
    ];
    let made = gapwatch_in(root, &from).ok();
    let shipped = fs::read_to_string(root.join("calibration/RESULTS.md")).unwrap();
    assert!(
        made == shipped,
        "calibration/RESULTS.md is older than the results; calibration/README.md has the command"
    );
}

fn field() -> String {
    std::env::var("GAPWATCH_FIELD").expect("GAPWATCH_FIELD names the folder of image sets")
}

#[test]
#[ignore = "needs ffmpeg and GAPWATCH_FIELD: run tests/run"]
fn field_sets_of_other_roads_are_told_from_simulations_with_counts_and_intervals() {
    let folder = tempfile::tempdir().unwrap();
    let field = field();
    let args = [
        "evaluate",
        "--only",
        "field_sets",
        "--quick",
        "--field",
        &field,
        "--format",
        "json",
    ];
    let results: Value = serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    let command = results["made"]["field_sets"]["command"].as_str().unwrap();
    assert_eq!(
        command,
        "gapwatch evaluate --only field_sets --quick --field \"$GAPWATCH_FIELD\""
    );
    let rows = results["field_sets"].as_array().unwrap();
    // Thirteen metrics, three numbers of images, four and six sets.
    assert_eq!(rows.len(), 13 * 3 * (4 + 6));
    for row in rows {
        let taps = row["taps"].as_array().unwrap();
        assert_eq!(taps.len(), 4);
        if row["metric"] == "frechet" {
            let reason = taps[0]["reason"].as_str().unwrap();
            assert!(taps[0]["auroc"].is_null() && reason.contains("too few images"));
            continue;
        }
        let windows = |key: &str| row[key].as_u64().unwrap();
        assert!(windows("blocks") >= 1 && windows("windows") >= windows("blocks"));
        assert!(windows("nominal_windows") >= windows("nominal_blocks"));
        for tap in taps {
            let auroc = tap["auroc"].as_f64().unwrap();
            let interval = tap["auroc_interval"].as_array().unwrap();
            let (low, high) = (interval[0].as_f64().unwrap(), interval[1].as_f64().unwrap());
            // No resampling of a few windows proves anything beyond doubt.
            assert!(low <= auroc && auroc <= high && high - low > 0.01, "{row}");
        }
    }
    for set in ["california_highway", "beamng", "random"] {
        let row = rows.iter().find(|row| {
            row["reference"] == "carla_town01-03"
                && row["set"] == set
                && row["metric"] == "log-energy-js"
                && row["images"] == 5
        });
        let fused = &row.unwrap()["taps"][3];
        assert!(fused["auroc"].as_f64().unwrap() > 0.95, "{set}: {fused}");
        assert!(fused["recall"].as_f64().unwrap() > 0.9, "{set}: {fused}");
    }
}

#[test]
#[ignore = "needs ffmpeg and GAPWATCH_FIELD: run tests/run"]
fn field_images_are_the_references_of_the_papers_table() {
    let folder = tempfile::tempdir().unwrap();
    let field = field();
    let args = [
        "evaluate",
        "--only",
        "paper_table",
        "--quick",
        "--field",
        &field,
        "--format",
        "json",
    ];
    let results: Value = serde_json::from_str(&gapwatch_in(folder.path(), &args).ok()).unwrap();
    let rows = results["paper_table"].as_array().unwrap();
    assert_eq!(rows.len(), 2 * 2 * 3);
    for row in rows {
        let real = row["reference"] == "real: highway clip";
        let sets = row["sets"].as_array().unwrap();
        assert_eq!(sets.len(), 4);
        assert_eq!(sets[0]["set"] == "real 2: other highway images", real);
        for set in sets {
            let value = set["value"].as_f64().unwrap();
            let interval = set["interval"].as_array().unwrap();
            assert!(
                interval[0].as_f64().unwrap() <= value && value <= interval[1].as_f64().unwrap()
            );
        }
        // Noise is farther from either reference than anything else, for the metric that looks at all energies.
        if row["metric"] == "mahalanobis" {
            let values: Vec<f64> = sets.iter().map(|s| s["value"].as_f64().unwrap()).collect();
            assert!(
                values[..3].iter().all(|value| 5.0 * value < values[3]),
                "{row}"
            );
        }
    }
}
