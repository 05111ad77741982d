//! A line of a journal: what is known after a frame, or when no frame came.

use std::time::Duration;

use serde::Serialize;
use serde::ser::{SerializeMap, Serializer};

use crate::features::image_quality::ImageQuality;
use crate::monitor::detector::BlockScore;
use crate::monitor::judge::Verdict;

/// A line.
#[derive(Serialize)]
pub struct Line<'a> {
    t_s: f64,
    captured_s: Option<f64>,
    seq: Option<u64>,
    state: &'static str,
    reason: &'static str,
    score: Option<f64>,
    gap: Option<f64>,
    change: Option<f64>,
    lanes: Option<f64>,
    cause: Option<&'static str>,
    cause_probability: Option<f64>,
    health: String,
    latency_ms: f64,
    tap_gap: PerTap<'a>,
    tap_similarity: PerTap<'a>,
    tap_score: PerTap<'a>,
    image: Option<Image>,
}

/// How good the picture was, rounded to a thousandth.
#[derive(Serialize)]
struct Image {
    brightness: f64,
    contrast: f64,
    clipped: f64,
    sharpness: f64,
}

impl From<ImageQuality> for Image {
    fn from(of: ImageQuality) -> Self {
        let rounded = |value: f64| (1e3 * value).round() / 1e3;
        Self {
            brightness: rounded(of.brightness),
            contrast: rounded(of.contrast),
            clipped: rounded(of.clipped),
            sharpness: rounded(of.sharpness),
        }
    }
}

impl<'a> Line<'a> {
    pub fn new(
        taps: &'a [String],
        told_at: Duration,
        verdict: &'a Verdict,
        latency: Duration,
    ) -> Self {
        let per_tap = |value| PerTap {
            taps,
            blocks: &verdict.blocks,
            value,
        };
        Self {
            t_s: told_at.as_secs_f64(),
            captured_s: verdict.sequence.map(|_| verdict.at.as_secs_f64()),
            seq: verdict.sequence,
            state: verdict.state.name(),
            reason: verdict.reason.name(),
            score: verdict.score,
            gap: verdict.gap,
            change: verdict.change,
            lanes: verdict.lanes,
            cause: verdict.cause.map(|likely| likely.cause.name()),
            cause_probability: verdict.cause.map(|likely| likely.probability),
            health: verdict
                .undefined
                .as_ref()
                .map_or_else(|| "ok".to_owned(), ToString::to_string),
            latency_ms: latency.as_secs_f64() * 1e3,
            tap_gap: per_tap(|block| block.gap),
            tap_similarity: per_tap(|block| block.similarity),
            tap_score: per_tap(|block| block.score),
            image: verdict.quality.map(Image::from),
        }
    }
}

/// One number for each tap, in the order of the taps; `null` if there is none.
struct PerTap<'a> {
    taps: &'a [String],
    blocks: &'a [BlockScore],
    value: fn(&BlockScore) -> f64,
}

impl Serialize for PerTap<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.taps.len()))?;
        for (index, tap) in self.taps.iter().enumerate() {
            map.serialize_entry(tap, &self.blocks.get(index).map(self.value))?;
        }
        map.end()
    }
}
