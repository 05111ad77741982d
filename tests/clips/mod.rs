//! What virtual machines are given: drives as raw frames of a camera to play, and a lane model with its reference.
#![allow(
    dead_code,
    clippy::unwrap_used,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]

use std::fs;
use std::path::Path;

use gapwatch::capture::{Picture, open};

use crate::program::gapwatch_in;

const MODEL: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/calibration/enet-sad-small-160x80"
);

/// Puts the smallest lane model into a folder, as `lane.onnx`, and a reference made for it, as `reference.json`.
pub fn lane_model(folder: &Path) {
    for kind in ["onnx", "toml"] {
        fs::copy(
            format!("{MODEL}.{kind}"),
            folder.join(format!("lane.{kind}")),
        )
        .unwrap();
    }
    let drives = "scene:sim?seed=1001..1040&seconds=3";
    let calibrate = ["calibrate", "--model", "lane.onnx", "--sim", drives];
    gapwatch_in(
        folder,
        &[&calibrate[..], &["--out", "reference.json"]].concat(),
    )
    .ok();
}

/// All pictures of a drive.
pub fn pictures(name: &str) -> Vec<Picture> {
    gapwatch::lab::register();
    let mut source = open(name).unwrap();
    let next = || {
        source
            .next_frame()
            .unwrap()
            .map(|frame| frame.picture.unwrap().picture())
    };
    std::iter::from_fn(next).collect()
}

/// Writes pictures as YUYV, one after the other.
pub fn clip(path: &Path, pictures: &[Picture]) {
    fs::write(path, pictures.iter().flat_map(yuyv).collect::<Vec<u8>>()).unwrap();
}

/// BT.601 of limited range; the colour of two neighbours is their mean.
pub fn yuyv(picture: &Picture) -> Vec<u8> {
    let byte = |value: f64| value.round().clamp(0.0, 255.0) as u8;
    let pairs = picture.rgb.chunks_exact(6).flat_map(|pair| {
        let [left, right] = [&pair[..3], &pair[3..]].map(|rgb| {
            let [r, g, b] = [rgb[0], rgb[1], rgb[2]].map(f64::from);
            let luma = 0.299 * r + 0.587 * g + 0.114 * b;
            [luma, b - luma, r - luma]
        });
        let y = |pixel: [f64; 3]| byte(16.0 + pixel[0] * 219.0 / 255.0);
        let colour = |n: usize, widest: f64| {
            byte(128.0 + (left[n] + right[n]) / 2.0 * 112.0 / 255.0 / widest)
        };
        [y(left), colour(1, 0.886), y(right), colour(2, 0.701)]
    });
    pairs.collect()
}
