//! Recordings as ROS 2, camera drivers and other tools write them, against Python's reader of MCAP (order and times)
//! and OpenCV (colours): `tests/python/foreign_recordings.py` makes them and says what is right.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation)]

use std::fs;
use std::path::Path;

use gapwatch::capture::{Frame, SourceError, open};
use serde_json::Value;

use crate::program::{check, gapwatch_in};

fn frames(path: &str) -> Result<Vec<Frame>, SourceError> {
    let mut source = open(path)?;
    let mut frames = Vec::new();
    while let Some(frame) = source.next_frame()? {
        frames.push(frame);
    }
    Ok(frames)
}

/// Largest difference from a picture, apart from an edge of two pixels, where colours have fewer neighbours.
fn difference(frame: &Frame, wanted: &image::RgbImage) -> u8 {
    let found = frame.picture.as_ref().unwrap().picture();
    assert_eq!((found.width, found.height), wanted.dimensions());
    let (width, height) = (found.width, found.height);
    let inner = (2..height - 2).flat_map(|y| (2..width - 2).map(move |x| (x, y)));
    let pixels = inner.map(|(x, y)| {
        let at = 3 * (y * width + x) as usize;
        let pair = found.rgb[at..at + 3].iter().zip(wanted.get_pixel(x, y).0);
        pair.map(|(a, b)| a.abs_diff(b)).max().unwrap()
    });
    pixels.max().unwrap()
}

#[test]
#[ignore = "needs the Python packages of tests/requirements.txt: run tests/run"]
fn recordings_as_people_have_them_are_read_in_order_or_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    check("foreign_recordings.py", &[folder.to_str().unwrap()]);
    let cases: Value =
        serde_json::from_slice(&fs::read(folder.join("cases.json")).unwrap()).unwrap();
    let cases = cases.as_array().unwrap();
    assert!(cases.len() > 40, "{}", cases.len());
    for case in cases {
        let name = case["name"].as_str().unwrap();
        let source = case["source"].as_str().unwrap();
        if let Some(wanted) = case["refused"].as_str() {
            let line = gapwatch_in(folder, &["replay", source, "--journal", "j"]).refusal();
            assert!(line.contains(wanted), "{name}: {line}");
            assert!(!folder.join("j").exists(), "{name}");
            continue;
        }
        let found = frames(folder.join(source).to_str().unwrap());
        let found = found.unwrap_or_else(|why| panic!("{name}: {why}"));
        let times = case["times_s"].as_array().unwrap();
        assert_eq!(found.len(), times.len(), "{name}");
        for (frame, time) in found.iter().zip(times) {
            let (at, wanted) = (frame.captured_at.as_secs_f64(), time.as_f64().unwrap());
            assert!(
                (at - wanted).abs() < 1e-6,
                "{name}: {at} s, wanted {wanted} s"
            );
        }
        let pictures = case["pictures"].as_array().unwrap();
        let tolerance = u8::try_from(case["tolerance"].as_u64().unwrap()).unwrap();
        for (frame, picture) in found.iter().zip(pictures) {
            let picture = Path::new(picture.as_str().unwrap());
            let wanted = image::open(folder.join(picture)).unwrap().into_rgb8();
            let away = difference(frame, &wanted);
            assert!(
                away <= tolerance,
                "{name}: frame {} by {away}",
                frame.sequence
            );
        }
    }
}
