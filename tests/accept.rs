//! Roads are added to a reference without the drives that it was made of.
#![allow(
    clippy::unwrap_used,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation
)]

use std::fs;
use std::path::Path;

use crate::program::{gapwatch_in, journal_of};
use gapwatch::reference::Reference;

const ROADS: &str = "scene:game?seed=11..16&seconds=40&fps=4";

fn accept(folder: &Path, base: &str, roads: &[&str], out: &str) -> String {
    let args = ["calibrate", "--base", base, "--out", out];
    gapwatch_in(folder, &[&args, roads].concat()).ok()
}

fn share_of_gap(folder: &Path, source: &str, reference: &[&str]) -> f64 {
    let args = ["replay", source, "--journal", "drive.jsonl"];
    gapwatch_in(folder, &[&args, reference].concat());
    let lines = journal_of(&folder.join("drive.jsonl"));
    let states: Vec<&str> = lines
        .iter()
        .filter_map(|line| line["state"].as_str())
        .collect();
    let gaps = states.iter().filter(|&&state| state == "Gap").count();
    assert!(states.len() > 100, "{} verdicts", states.len());
    gaps as f64 / states.len() as f64
}

#[test]
fn a_road_is_accepted_by_the_reference_inside_the_program_without_rendering_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let said = accept(folder, "built-in", &["--accept", ROADS], "mine.json");
    for words in [
        "2 nominal domains",
        "accepted: 6 drives of 4.0 minutes together",
        "windows of 5 s that do not overlap: 48\n",
        "changes of 22 s that do not overlap: 6; with 5.1 minutes more",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let built_in = Reference::read(None).unwrap();
    let mine = Reference::read(Some(&folder.join("mine.json"))).unwrap();
    assert!(!mine.strict);
    assert_eq!(mine.components[0], built_in.components[0]);
    assert_eq!(mine.false_alarms, built_in.false_alarms);
    assert_eq!(mine.causes, built_in.causes);
    let command = &mine.provenance.command;
    assert_eq!(
        *command,
        format!("gapwatch calibrate --base built-in --accept '{ROADS}' --out reference.json")
    );
    // Another road of this kind is known, and the same road in fog is not.
    let other = "scene:game?seed=6&seconds=40&fps=4";
    assert!(share_of_gap(folder, other, &[]) > 0.9);
    let mine = ["--reference", "mine.json"];
    assert!(share_of_gap(folder, other, &mine) < 0.05);
    let fog = format!("{other}&condition=fog:4@10-60");
    assert!(share_of_gap(folder, &fog, &mine) > 0.6);
}

#[test]
fn a_fast_road_has_the_margins_of_the_simulation_in_windows_of_any_length() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let road = ["--accept", "scene:game?seed=11&seconds=60&fps=10"];
    accept(folder, "built-in", &road, "fast.json");
    let fast = Reference::read(Some(&folder.join("fast.json"))).unwrap();
    let [simulation, road] = &fast.components[..] else {
        panic!("{} domains", fast.components.len());
    };
    for (own, of) in road.taps.iter().zip(&simulation.taps) {
        assert!(own.scale.iter().any(|point| point.frames == 10));
        for point in &own.scale {
            let (_, threshold) = of.scale_for(point.frames);
            assert!(point.threshold >= threshold, "{point:?} beside {threshold}");
        }
    }
}

#[test]
fn several_roads_are_domains_by_name_and_a_name_is_given_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let as_named = [
        "--accept-as",
        "city=scene:game?seed=1&seconds=20&fps=4",
        "city=scene:game?seed=2&seconds=20&fps=4",
        "hills=scene:sim-realistic?seed=1&seconds=70&fps=2",
    ];
    accept(folder, "built-in", &as_named, "two.json");
    let two = Reference::read(Some(&folder.join("two.json"))).unwrap();
    let names: Vec<&str> = two.components.iter().map(|of| of.name.as_str()).collect();
    assert_eq!(names, ["simulation", "city", "hills"]);
    // The result is a base again.
    accept(
        folder,
        "two.json",
        &["--accept", "scene:game?seed=3&seconds=70&fps=2"],
        "three.json",
    );
    let three = Reference::read(Some(&folder.join("three.json"))).unwrap();
    assert_eq!(three.components.len(), 4);
    assert_eq!(three.components[..3], two.components);
    let city = ["--accept-as", "city=scene:game?seed=4&seconds=20&fps=4"];
    let args = ["calibrate", "--base", "two.json", "--out", "no.json"];
    let refused = gapwatch_in(folder, &[&args[..], &city].concat()).refusal();
    assert!(
        refused.contains("domain city is in the reference two.json already"),
        "{refused}"
    );
    assert!(!folder.join("no.json").exists());
}

#[test]
fn a_base_is_read_and_never_written_and_a_short_road_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let road = ["--accept", "scene:game?seed=4&seconds=20&fps=4"];
    let ran = gapwatch_in(
        folder,
        &[
            &["calibrate", "--base", "built-in", "--out", "short.json"][..],
            &road,
        ]
        .concat(),
    );
    assert!(
        ran.err
            .contains("20 s of road are little; wanted 60 s or more"),
        "{}",
        ran.err
    );
    let before = fs::read(folder.join("short.json")).unwrap();
    let over = ["calibrate", "--base", "short.json", "--out", "./short.json"];
    let more = ["--accept-as", "more=scene:game?seed=5&seconds=20&fps=4"];
    let refused = gapwatch_in(folder, &[&over[..], &more].concat()).refusal();
    assert!(refused.contains("--out is the file of --base"), "{refused}");
    assert_eq!(fs::read(folder.join("short.json")).unwrap(), before);
    let nothing = ["calibrate", "--base", "built-in", "--out", "no.json"];
    let refused = gapwatch_in(folder, &nothing).refusal();
    assert!(
        refused.contains("wanted --accept or --accept-as with --base"),
        "{refused}"
    );
}

#[test]
fn a_drive_of_pictures_before_a_strict_reference_is_told_what_accepts_it() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::create_dir(folder.join("road")).unwrap();
    for number in 0..3 {
        let picture = image::RgbImage::from_fn(320, 160, |x, y| {
            image::Rgb([(x + number) as u8, (2 * y) as u8, (x * y) as u8])
        });
        let name = format!("road/{number}.png");
        picture.save(folder.join(name)).unwrap();
    }
    let wanted = "calibrate --base built-in --accept road --out my-roads.json";
    let ran = gapwatch_in(folder, &["replay", "road"]);
    assert!(ran.err.contains(wanted), "{}", ran.err);
    let rendered = gapwatch_in(folder, &["replay", "scene:sim?seed=1&seconds=1"]);
    assert!(!rendered.err.contains(wanted), "{}", rendered.err);
}
