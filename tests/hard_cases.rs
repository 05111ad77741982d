//! Pictures and files that nothing can be said about are answered with a reason, never with a NaN.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use crate::program::{gapwatch_in, journal_of};
use image::{Rgb, RgbImage};
use serde_json::Value;

const SCENES: &str = "scene:sim?seed=1..3&seconds=2&fps=2";

fn compare(folder: &Path, set: &str) -> (Value, String) {
    let text = gapwatch_in(folder, &["compare", SCENES, set, "--format", "json"]).ok();
    assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    (serde_json::from_str(&text).unwrap(), text)
}

#[test]
fn pictures_without_content_are_undefined_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let constant = |value: [u8; 3]| RgbImage::from_pixel(320, 160, Rgb(value));
    for (name, picture, reason) in [
        ("constant.png", constant([90, 120, 30]), "uniform"),
        ("black.png", constant([0, 0, 0]), "black"),
        ("white.png", constant([255, 255, 255]), "uniform"),
        (
            "dot.png",
            RgbImage::from_pixel(1, 1, Rgb([7, 8, 9])),
            "1x1 pixels is too small",
        ),
    ] {
        picture.save(folder.path().join(name)).unwrap();
        let (rows, _) = compare(folder.path(), name);
        assert_eq!(rows.as_array().unwrap().len(), 13);
        for row in rows.as_array().unwrap() {
            assert_eq!(
                (row["images"].as_u64(), row["judged"].as_u64()),
                (Some(1), Some(0))
            );
            for tap in ["e2", "e3", "e4"] {
                assert!(row[tap].is_null(), "{name}: {row}");
                assert!(
                    row["reasons"][tap].as_str().unwrap().contains(reason),
                    "{name}: {row}"
                );
            }
        }
    }
    let table = gapwatch_in(folder.path(), &["compare", SCENES, "black.png"]).ok();
    assert!(
        table.contains("undefined") && table.contains("picture is black"),
        "{table}"
    );
}

#[test]
fn a_reference_that_cannot_be_judged_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    RgbImage::new(320, 160)
        .save(folder.path().join("black.png"))
        .unwrap();
    let line = gapwatch_in(folder.path(), &["compare", "black.png", SCENES]).refusal();
    assert!(
        line.contains("black.png") && line.contains("picture is black"),
        "{line}"
    );
}

#[test]
fn cut_image_files_are_named() {
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(folder.path(), &["scene", "--out", "scenes", "--count", "1"]).ok();
    let drawn = folder.path().join("scenes/frames/000000.png");
    let mut source = gapwatch::capture::open(drawn.to_str().unwrap()).unwrap();
    let picture = source.next_frame().unwrap().unwrap().picture.unwrap();
    let jpeg = gapwatch::capture::jpeg(&picture.picture()).unwrap();
    for (name, whole) in [
        ("cut.png", fs::read(drawn).unwrap()),
        ("cut.jpg", jpeg.clone()),
        ("cut.jpeg", jpeg),
    ] {
        let path = folder.path().join(name);
        // Of a JPEG image nothing is missing without its end marker, the last two bytes.
        for length in [0, 2, 20, whole.len() / 2, whole.len() - 6] {
            fs::write(&path, &whole[..length]).unwrap();
            let line = gapwatch_in(folder.path(), &["compare", SCENES, name]).refusal();
            assert!(
                line.contains(name) && line.contains("wanted a whole PNG or JPEG"),
                "{length} bytes: {line}"
            );
        }
    }
}

#[test]
fn a_drive_with_a_cut_picture_goes_on_without_it() {
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(folder.path(), &["scene", "--out", "s", "--count", "20"]).ok();
    for index in 8..16 {
        let path = folder.path().join(format!("s/frames/{index:06}.png"));
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() / 3]).unwrap();
    }
    let ran = gapwatch_in(
        folder.path(),
        &["replay", "s/frames", "--journal", "j.jsonl", "--check"],
    );
    assert_eq!(ran.code, 3, "{}", ran.err);
    let lines = journal_of(&folder.path().join("j.jsonl"));
    assert_eq!(lines.len(), 20);
    assert!(
        lines[8]["health"].as_str().unwrap().contains("000008.png"),
        "{}",
        lines[8]
    );
    assert!(lines[8]["score"].is_null() && lines[8]["tap_gap"]["e2"].is_null());
    assert_eq!(
        (lines[15]["state"].as_str(), lines[15]["reason"].as_str()),
        (Some("SensorFault"), Some("corrupt"))
    );
    assert_ne!(lines[17]["state"], "SensorFault");
}

#[test]
fn empty_folders_and_files_that_are_no_pictures_are_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("void")).unwrap();
    fs::write(folder.path().join("void/readme.txt"), "no picture").unwrap();
    fs::write(folder.path().join("text.mp4"), "no video").unwrap();
    for (source, said) in [("void", "no PNG or JPEG image"), ("text.mp4", "text.mp4")] {
        let line = gapwatch_in(folder.path(), &["replay", source]).refusal();
        assert!(line.contains(source) && line.contains(said), "{line}");
    }
}

#[test]
fn a_crop_may_end_at_the_edge_of_the_picture() {
    let folder = tempfile::tempdir().unwrap();
    gapwatch_in(
        folder.path(),
        &["scene", "--out", "s", "--count", "2", "--size", "640x480"],
    )
    .ok();
    for crop in ["0,0.46,1,0.54", "0.1,0.7,0.9,0.3", "0.3,0.3,0.7,0.7"] {
        let args = [
            "compare", "s/frames", "s/frames", "--crop", crop, "--format", "csv",
        ];
        let csv = gapwatch_in(folder.path(), &args).ok();
        assert!(
            csv.lines().skip(1).all(|line| line.contains(",2,2,")),
            "{crop}: {csv}"
        );
    }
}
