//! Commands of the desk: scenes, inspection, evaluation, comparison.
#![allow(clippy::unwrap_used)]

use std::fs;

use crate::program::{assert_expected, files, gapwatch_in, gapwatch_threads};

fn empty() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

#[test]
fn scenes_are_the_same_bytes_for_any_number_of_threads() {
    let folder = empty();
    for (threads, name) in [(1, "one"), (2, "two"), (5, "five")] {
        let args = [
            "scene",
            "--out",
            name,
            "--count",
            "12",
            "--seed",
            "3",
            "--condition",
            "rain:2.5",
        ];
        let said = gapwatch_threads(folder.path(), threads, &args).ok();
        assert_eq!(said, format!("12 scenes of 320x160 in {name}\n"));
    }
    let bytes = |name: &str| -> Vec<_> {
        let root = folder.path().join(name);
        files(&root)
            .into_iter()
            .map(|(path, bytes)| (path.strip_prefix(&root).unwrap().to_owned(), bytes))
            .collect()
    };
    let one = bytes("one");
    assert_eq!(one.len(), 25);
    assert!(one == bytes("two") && one == bytes("five"));
    assert!(one[0].1 != one[1].1, "two scenes of a set differ");
    let list = fs::read_to_string(folder.path().join("one/scenes.jsonl")).unwrap();
    assert_expected("scenes.jsonl", &list);
}

#[test]
fn scenes_can_be_told_to_look_otherwise_and_do_without_elements() {
    let folder = empty();
    let run = |args: &[&str]| gapwatch_in(folder.path(), args).ok();
    run(&["scene", "--out", "plain", "--count", "3"]);
    run(&["scene", "--out", "game", "--count", "3", "--look", "game"]);
    let elements = run(&["scene", "--list", "elements"]);
    assert!(
        elements.lines().count() > 5 && elements.contains("traffic\n"),
        "{elements}"
    );
    let mut bare = vec!["scene", "--out", "bare", "--count", "3"];
    bare.extend(elements.lines().flat_map(|element| ["--without", element]));
    run(&bare);
    let frame = |set: &str| {
        let file = folder.path().join(set).join("frames/000001.png");
        image::open(file).unwrap().into_rgb8()
    };
    assert!(frame("plain") != frame("game") && frame("plain") != frame("bare"));
    assert_eq!(
        run(&["scene", "--list", "looks"]),
        "sim\nsim-realistic\ngame\n"
    );
}

#[test]
fn inspect_writes_a_sheet_a_frame_and_the_numbers_behind_them() {
    let folder = empty();
    let drive = "scene:sim?seed=7&seconds=3";
    let args = ["inspect", drive, "--out", "sheets", "--count", "3"];
    let said = gapwatch_in(folder.path(), &args).ok();
    assert!(said.starts_with("sheets: 3 sheets of 3 frames\n"), "{said}");
    let numbers = fs::read_to_string(folder.path().join("sheets/inspect.json")).unwrap();
    let numbers: serde_json::Value = serde_json::from_str(&numbers).unwrap();
    let frames = numbers["frames"].as_array().unwrap();
    let places: Vec<u64> = frames
        .iter()
        .map(|f| f["frame"].as_u64().unwrap())
        .collect();
    assert_eq!(places, [0, 10, 20]);
    for frame in frames {
        let sheet = folder
            .path()
            .join("sheets")
            .join(frame["sheet"].as_str().unwrap());
        // Panels of 320x160, enlarged twice: the lane mask and three taps, and below each the regions that differ, and the
        // channels.
        assert_eq!(image::image_dimensions(sheet).unwrap(), (2_560, 960));
        assert!(frame["lane_area"].as_f64().unwrap() > 0.005);
        for tap in ["e2", "e3", "e4"] {
            let tap = &frame["taps"][tap];
            let share = tap["energy_on_lanes"].as_f64().unwrap();
            let lift = tap["lift"].as_f64().unwrap();
            assert!(tap["peak_energy"].as_f64().unwrap() > 0.0);
            assert!((share / frame["lane_area"].as_f64().unwrap() - lift).abs() < 1e-9);
            let profile = &tap["profile"];
            let numbers = |key: &str| profile[key].as_array().unwrap().len();
            assert_eq!(profile["kind"], "energies");
            assert!(numbers("live") > 16 && numbers("live") == numbers("nominal"));
        }
    }
    assert!(numbers["median"]["e4"]["lift"].as_f64().unwrap() > 1.0);
    // What cannot be judged has a reason and no sheet.
    let black = image::RgbImage::new(320, 160);
    black.save(folder.path().join("black.png")).unwrap();
    let args = ["inspect", "black.png", "--out", "dark"];
    let said = gapwatch_in(folder.path(), &args).ok();
    assert!(said.starts_with("dark: 0 sheets of 1 frames"), "{said}");
}

#[test]
fn inspect_marks_the_bins_that_a_histogram_counts() {
    let folder = empty();
    let calibrate = "calibrate --metric paper --out paper.json --sim scene:sim?seed=1..4&seconds=2";
    gapwatch_in(folder.path(), &calibrate.split(' ').collect::<Vec<_>>()).ok();
    let args = "inspect scene:sim?seed=9&seconds=1 --out sheets --count 1 --reference paper.json";
    gapwatch_in(folder.path(), &args.split(' ').collect::<Vec<_>>()).ok();
    let sheets = folder.path().join("sheets");
    let numbers = fs::read_to_string(sheets.join("inspect.json")).unwrap();
    let numbers: serde_json::Value = serde_json::from_str(&numbers).unwrap();
    let profile = &numbers["frames"][0]["taps"]["e3"]["profile"];
    let shares = |key: &str| -> Vec<f64> {
        let shares = profile[key].as_array().unwrap().iter();
        shares.map(|share| share.as_f64().unwrap()).collect()
    };
    // The paper counts bins 101 to 255 of 256, and most pixels are below.
    assert_eq!((shares("left_out").len(), shares("live").len()), (101, 155));
    assert!((shares("live").iter().sum::<f64>() - 1.0).abs() < 1e-9);
    assert!(shares("left_out").iter().sum::<f64>() > 1.0);
    // White below the counted bins of the three taps alone.
    let sheet = image::open(sheets.join("000000.png")).unwrap().to_rgb8();
    assert_eq!(sheet.dimensions(), (2_560, 640));
    let white = |x: u32| sheet.get_pixel(x, 639).0 == [255; 3];
    let first = (640..1_280).find(|&x| white(x)).unwrap() - 640;
    assert!((first..640).all(|x| white(640 + x)));
    assert!((first * 256 / 640).abs_diff(101) <= 1, "{first}");
}

#[test]
fn evaluate_judges_every_look_condition_and_severity_with_counts_and_intervals() {
    let folder = empty();
    let args = [
        "evaluate", "--only", "lane_iou", "--scenes", "2", "--out", "e.json", "--format", "json",
    ];
    let out = gapwatch_in(folder.path(), &args).ok();
    assert_eq!(
        out,
        fs::read_to_string(folder.path().join("e.json")).unwrap()
    );
    let results: serde_json::Value = serde_json::from_str(&out).unwrap();
    let rows = results["lane_iou"].as_array().unwrap();
    assert_eq!(rows.len(), 3 * (1 + 10 * 5));
    for row in rows {
        assert_eq!((&row["scenes"], &row["default"]), (&2.into(), &true.into()));
        let iou = row["iou"].as_f64().unwrap();
        let interval = row["interval"].as_array().unwrap();
        assert!(interval[0].as_f64().unwrap() <= iou && iou <= interval[1].as_f64().unwrap());
    }
    let csv = gapwatch_in(
        folder.path(),
        &[
            "evaluate", "--only", "lane_iou", "--scenes", "2", "--format", "csv",
        ],
    )
    .ok();
    assert_eq!(csv.lines().count(), rows.len() + 1);
    let first = format!("sim,none,0,2,{:.4},", rows[0]["iou"].as_f64().unwrap());
    assert!(csv.lines().nth(1).unwrap().contains(&first), "{csv}");
}

#[test]
fn scenes_do_not_replace_what_is_there() {
    let folder = empty();
    fs::create_dir(folder.path().join("full")).unwrap();
    fs::write(folder.path().join("full/mine.txt"), "mine").unwrap();
    let line = gapwatch_in(folder.path(), &["scene", "--out", "full", "--count", "1"]).refusal();
    assert!(line.contains("not an empty folder"), "{line}");
    fs::create_dir(folder.path().join("void")).unwrap();
    gapwatch_in(folder.path(), &["scene", "--out", "void", "--count", "1"]).ok();
}

#[test]
fn compare_writes_the_same_numbers_as_table_json_and_csv() {
    let folder = empty();
    let sets = [
        "scene:sim?seed=1..4&seconds=2&fps=2",
        "scene:sim?seed=9..12&seconds=2&fps=2",
        "random:frames=8",
    ];
    let compare = |format: &str| {
        gapwatch_in(
            folder.path(),
            &["compare", sets[0], sets[1], sets[2], "--format", format],
        )
        .ok()
    };
    let (table, csv) = (compare("table"), compare("csv"));
    assert_expected("compare.txt", &table);
    assert_expected("compare.csv", &csv);
    let json: serde_json::Value = serde_json::from_str(&compare("json")).unwrap();
    let rows = json.as_array().unwrap();
    assert_eq!(rows.len(), 2 * 13);
    for (row, line) in rows.iter().zip(csv.lines().skip(1)) {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(
            (row["set"].as_str(), row["metric"].as_str()),
            (Some(cells[0]), Some(cells[1]))
        );
        for (tap, cell) in ["e2", "e3", "e4"].iter().zip(&cells[2..]) {
            assert_eq!(row[*tap].as_f64(), cell.parse().ok(), "{line}");
        }
    }
    let value = |set: usize, metric: &str| {
        rows.iter()
            .find(|r| r["set"] == sets[set] && r["metric"] == metric)
            .unwrap()["e4"]
            .as_f64()
            .unwrap()
    };
    for metric in [
        "attention-js",
        "log-energy-js",
        "log-energy-w1",
        "mahalanobis",
    ] {
        assert!(
            value(2, metric) > 4.0 * value(1, metric),
            "{metric}: noise is farther than other drives"
        );
    }
}

#[test]
fn a_set_compared_with_itself_is_alike() {
    let set = "scene:sim?seed=1..2&seconds=2&fps=5";
    let json = gapwatch_in(empty().path(), &["compare", set, set, "--format", "json"]).ok();
    for row in serde_json::from_str::<serde_json::Value>(&json)
        .unwrap()
        .as_array()
        .unwrap()
    {
        let metric = row["metric"].as_str().unwrap();
        if metric == "frechet" {
            let why = row["reasons"]["e4"].as_str().unwrap();
            assert!(why.contains("20, wanted at least 128"), "{why}");
            continue;
        }
        let correlates = metric == "paper" || metric.ends_with("pearson");
        let same = if correlates { 1.0 } else { 0.0 };
        for tap in ["e2", "e3", "e4"] {
            assert!((row[tap].as_f64().unwrap() - same).abs() < 1e-12, "{row}");
        }
    }
}
