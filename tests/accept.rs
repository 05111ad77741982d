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
use serde_json::Value;

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
            .contains("accepted: this road lasts 20 s, and 60 s or more are wanted"),
        "{}",
        ran.err
    );
    assert!(ran.err.contains("40 s are missing"), "{}", ran.err);
    let before = fs::read(folder.join("short.json")).unwrap();
    let over = ["calibrate", "--base", "short.json", "--out", "./short.json"];
    let more = ["--accept-as", "more=scene:game?seed=5&seconds=20&fps=4"];
    let refused = gapwatch_in(folder, &[&over[..], &more].concat()).refusal();
    assert!(refused.contains("--out is what --base reads"), "{refused}");
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

const SMALL: &str = "scene:sim?seed=1..24&seconds=4";

/// A road of pictures, in the order of their names.
fn pictures(folder: &Path, name: &str, count: u32, pixel: impl Fn(u32, u32, u32) -> u8) {
    fs::create_dir(folder.join(name)).unwrap();
    for number in 0..count {
        let picture =
            image::RgbImage::from_fn(320, 160, |x, y| image::Rgb([pixel(number, x, y); 3]));
        picture
            .save(folder.join(format!("{name}/{number}.png")))
            .unwrap();
    }
}

/// Changes a file of JSON.
fn change(file: &Path, change: impl FnOnce(&mut Value)) {
    let mut value: Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
    change(&mut value);
    fs::write(file, value.to_string()).unwrap();
}

#[test]
fn a_held_out_drive_of_another_look_is_refused_by_name_and_allowed_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sim = "scene:sim?seed=1..24&seconds=10&fps=2";
    let args = ["calibrate", "--sim", sim, "--out", "r.json", "--held-out"];
    let like = "scene:sim?seed=101..104&seconds=20&fps=2";
    let far = "scene:game?seed=1&seconds=20&fps=2";
    let ran = gapwatch_in(folder, &[&args[..], &[like]].concat());
    assert!(!ran.err.contains("far"), "{}", ran.err);
    ran.ok();
    fs::remove_file(folder.join("r.json")).unwrap();
    let refused = gapwatch_in(folder, &[&args[..], &[like, far]].concat()).refusal();
    for words in [
        &format!("held-out drive {far} is "),
        "times as far from domain simulation, the nearest one, as its limit; far is 3 or more",
        "--accept-as NAME=DRIVE",
        "--allow-far",
    ] {
        assert!(refused.contains(words), "{words}: {refused}");
    }
    assert!(!refused.contains("seed=101"), "{refused}");
    assert!(!folder.join("r.json").exists());
    let allowed = gapwatch_in(folder, &[&args[..], &[like, far, "--allow-far"]].concat());
    assert!(
        allowed.err.contains("it is used all the same"),
        "{}",
        allowed.err
    );
    allowed.ok();
}

#[test]
fn an_accepted_drive_of_another_look_is_refused_among_many_and_beside_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let args = ["calibrate", "--base", "built-in", "--out", "r.json"];
    let odd = "scene:game?seed=11&seconds=40&fps=4";
    let accept = |seeds: &str| format!("scene:sim?seed={seeds}&seconds=40&fps=2");
    for (roads, words) in [("1..5", "is 3."), ("5", "of domain accepted are 3.")] {
        let roads = accept(roads);
        let roads = ["--accept", &roads, odd];
        let refused = gapwatch_in(folder, &[&args[..], &roads].concat()).refusal();
        assert!(
            refused.contains(odd) && refused.contains(words),
            "{refused}"
        );
        assert!(refused.contains("--accept-as NAME=DRIVE"), "{refused}");
        let allowed = gapwatch_in(folder, &[&args[..], &roads, &["--allow-far"]].concat());
        assert!(
            allowed.err.contains("it is used all the same"),
            "{}",
            allowed.err
        );
        allowed.ok();
    }
}

#[test]
fn held_out_drives_of_accepted_roads_alone_set_no_threshold_of_the_simulation() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let game = "scene:game?seed=1..3&seconds=20&fps=4";
    let args = ["calibrate", "--sim", SMALL, "--accept", game, "--allow-far"];
    let args = [&args[..], &["--out", "r.json", "--held-out"]].concat();
    let own = "scene:game?seed=4..5&seconds=20&fps=4";
    let refused = gapwatch_in(folder, &[&args[..], &[own]].concat()).refusal();
    assert!(
        refused.contains("all 2 held-out drives are nearest to accepted roads"),
        "{refused}"
    );
    let one = "scene:sim?seed=101&seconds=20&fps=2";
    let few = gapwatch_in(folder, &[&args[..], &[own, one]].concat());
    assert!(
        few.err
            .contains("only 1 of the held-out drives are nearest to the simulation"),
        "{}",
        few.err
    );
    few.ok();
}

#[test]
fn pictures_in_random_order_are_told_from_a_drive() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A light that passes slowly, or jumps about.
    let road = |number: u32, x: u32, y: u32| -> u8 {
        let near = 255_u32.saturating_sub(x.abs_diff(8 * number)) / 2;
        (near + (x * 7 + y * 13 + number * 29) % 31) as u8
    };
    pictures(folder, "drive", 40, road);
    pictures(folder, "stills", 40, |number, x, y| {
        road(number * 17 % 40, x, y)
    });
    for (name, warned) in [("drive", false), ("stills", true)] {
        let args = ["calibrate", "--base", "built-in", "--accept", name];
        let ran = gapwatch_in(folder, &[&args[..], &["--out", "r.json"]].concat());
        let said = ran.err.contains(&format!(
            "accepted {name}: the pictures do not follow each other in time"
        ));
        assert_eq!(said, warned, "{name}: {}", ran.err);
        assert!(
            ran.err.contains("40 frames show how 80 energies vary"),
            "{}",
            ran.err
        );
        ran.ok();
    }
}

#[test]
fn a_road_on_which_the_lens_is_covered_is_named_with_its_counts() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // The left three quarters of half of the pictures are black.
    pictures(folder, "covered", 40, |number, x, y| {
        match number < 20 && x < 240 {
            true => 0,
            false => ((x + y + 5 * number) % 200) as u8,
        }
    });
    let args = ["calibrate", "--base", "built-in", "--accept", "covered"];
    let ran = gapwatch_in(folder, &[&args[..], &["--out", "r.json"]].concat());
    assert!(
        ran.err
            .contains("accepted road covered: 20 of 40 frames are faults of the camera to the monitor (20 covered)"),
        "{}",
        ran.err
    );
    ran.ok();
}

#[test]
fn the_commands_of_a_base_and_of_its_roads_are_both_kept_with_the_options_of_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let taps = ["--taps", "e3,e4"];
    let sim = ["calibrate", "--sim", SMALL, "--out", "base.json"];
    gapwatch_in(folder, &[&sim[..], &taps].concat()).ok();
    let road = "scene:game?seed=1&seconds=20&fps=4";
    let args = ["calibrate", "--base", "base.json", "--accept", road];
    let args = [&args[..], &["--out", "road.json"], &taps].concat();
    let said = gapwatch_in(folder, &args).ok();
    assert!(
        said.contains(
            "480 frames fitted, 480 held out, 80 of accepted roads fitted and scaled crosswise"
        ),
        "{said}"
    );
    let of = |name: &str| Reference::read(Some(&folder.join(name))).unwrap();
    let (base, road) = (of("base.json"), of("road.json"));
    assert_eq!(road.built_on, [base.provenance.command]);
    let command = road.provenance.command;
    assert!(command.contains("--taps e3,e4 --size "), "{command}");
    assert!(command.ends_with("--out reference.json"), "{command}");
}

#[test]
fn what_cannot_be_added_to_a_base_is_refused_before_any_road_is_looked_at() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    gapwatch_in(folder, &["calibrate", "--sim", SMALL, "--out", "base.json"]).ok();
    let args = [
        "calibrate",
        "--base",
        "base.json",
        "--surveys",
        "looked",
        "--out",
        "no.json",
    ];
    let refused = |more: &[&str]| gapwatch_in(folder, &[&args[..], more].concat()).refusal();
    let again = refused(&["--accept", "scene:sim?seed=3&seconds=4"]);
    assert!(
        again.contains("source scene:sim?seed=3&seconds=4 is in the reference base.json already"),
        "{again}"
    );
    let many: Vec<String> = (0..64)
        .map(|n| format!("road{n}=scene:sim?seed={}&seconds=4", 100 + n))
        .collect();
    let mut many: Vec<&str> = many.iter().map(String::as_str).collect();
    many.insert(0, "--accept-as");
    assert!(refused(&many).contains("wanted at most"));
    let looked = fs::read_dir(folder.join("looked")).map_or(0, Iterator::count);
    assert_eq!(looked, 0);
    // A base for a model with fewer energies.
    change(&folder.join("base.json"), |base| {
        for tap in base["components"][0]["taps"].as_array_mut().unwrap() {
            let norm = &mut tap["nominal"]["energies"];
            norm["mean"].as_array_mut().unwrap().truncate(79);
            norm["whitening"]
                .as_array_mut()
                .unwrap()
                .truncate(79 * 80 / 2);
        }
    });
    let other = refused(&["--accept", "scene:game?seed=1&seconds=5&fps=10"]);
    assert!(
        other.contains("the model gives [80, 80, 80] energies in its blocks, but the reference has [79, 79, 79]"),
        "{other}"
    );
    assert!(!folder.join("no.json").exists());
}

#[test]
fn an_input_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    pictures(folder, "road", 2, |number, x, y| (x + y + number) as u8);
    let picture = fs::read(folder.join("road/0.png")).unwrap();
    for (option, source, out) in [
        ("--accept", "road/0.png", "road/0.png"),
        ("--sim", "road?fps=4", "road/0.png"),
        ("--held-out", "road", "./road/0.png"),
        ("--causes", "road/0.png?condition=fog:3@1-2", "road/0.png"),
        ("--accept-as", "mine=road", "road/0.png"),
        ("--surveys", "road", "road/0.png"),
    ] {
        let args = ["calibrate", "--sim", SMALL, "--out", out, option, source];
        let refused = gapwatch_in(folder, &args).refusal();
        assert!(
            refused.contains("--out is ") && refused.contains(option),
            "{refused}"
        );
    }
    assert_eq!(fs::read(folder.join("road/0.png")).unwrap(), picture);
}

#[test]
fn a_domain_without_a_name_of_its_own_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let long = format!("{}=road", "a".repeat(65));
    for source in [
        "scene:game?seed=1&seconds=5",
        "road?fps=4",
        "roads/mine=road",
        " =road",
        &long,
    ] {
        let args = ["calibrate", "--base", "built-in", "--out", "r.json"];
        let ran = gapwatch_in(
            folder.path(),
            &[&args[..], &["--accept-as", source]].concat(),
        );
        assert_eq!(ran.code, 2, "{source}");
        assert!(
            ran.err
                .contains("with a name of 1 to 64 characters without ?, : and /"),
            "{source}: {}",
            ran.err
        );
    }
}

#[test]
fn accepted_drives_that_do_not_say_their_domains_are_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let two = [
        "--accept-as",
        "city=scene:game?seed=1&seconds=6&fps=4",
        "hills=scene:sim-realistic?seed=1&seconds=6&fps=4",
    ];
    let args = [
        "calibrate",
        "--sim",
        SMALL,
        "--surveys",
        "s.surveys",
        "--out",
    ];
    gapwatch_in(folder, &[&args[..], &["r.json"], &two].concat()).ok();
    gapwatch_in(folder, &[&args[..], &["s.json", "--shard"], &two].concat()).ok();
    let forget = |sources: &mut Value| {
        for source in sources.as_array_mut().unwrap() {
            source.as_object_mut().unwrap().remove("domain");
        }
    };
    change(&folder.join("r.json"), |r| {
        forget(&mut r["provenance"]["sources"])
    });
    change(&folder.join("s.json"), |s| forget(&mut s["sources"]));
    for (file, words) in [
        (
            "r.json",
            "a reference with 2 accepted domains that does not say to which scene:game",
        ),
        (
            "s.json",
            "2 accepted drives without the names of their domains",
        ),
    ] {
        let refused = gapwatch_in(folder, &["merge", file, "--out", "m.json"]).refusal();
        assert!(refused.contains(words), "{refused}");
    }
    // Of one accepted domain, all nameless drives are its own.
    gapwatch_in(folder, &[&args[..], &["one.json"], &two[..2]].concat()).ok();
    change(&folder.join("one.json"), |r| {
        forget(&mut r["provenance"]["sources"])
    });
    gapwatch_in(folder, &["merge", "one.json", "--out", "m.json"]).ok();
    let merged = Reference::read(Some(&folder.join("m.json"))).unwrap();
    assert_eq!(merged.components[1].name, "city");
}
