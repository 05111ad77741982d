//! Journal: one JSON object a line for every frame that was looked at. The first line also says what the run was made
//! with.

mod reading;
mod recording;

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::ser::{SerializeMap, Serializer};
use serde::{Deserialize, Serialize};

use crate::detector::BlockScore;
use crate::event_rate::Hours;
use crate::image_quality::ImageQuality;
use crate::pipeline::Verdict;
use crate::reference::{FalseAlarms, NominalDrives, Reference};
use crate::whole_file::WholeFile;

pub use reading::{Entry, ReadError, Reading, read};
pub use recording::RecordingJournal;

/// A journal that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("journal {}: {error}", path.display())]
pub struct JournalError {
    path: PathBuf,
    error: io::Error,
}

/// Writes a journal; the file appears whole when it is finished.
pub struct Journal {
    path: PathBuf,
    lines: WholeFile,
    taps: Vec<String>,
    /// For the next line.
    about: Option<About>,
}

/// What a run was made with; unknown fields are skipped and missing ones empty, so that versions read each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct About {
    /// Version of the program.
    pub gapwatch: String,
    /// What was looked at, as typed.
    pub source: String,
    /// Name of the model.
    pub model: String,
    /// Hash of its ONNX file.
    pub model_sha256: String,
    /// The reference's file, or `built-in`.
    pub reference: String,
    /// Made of simulation alone.
    pub strict: bool,
    /// How gaps were measured.
    pub metric: String,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Where the reference's medians and thresholds came from, and what they do not promise.
    pub thresholds: String,
    /// What is known of false alarms with them, in words.
    pub false_alarms: String,
    /// The command that makes the reference again.
    pub calibrated_by: String,
}

impl About {
    /// What is to be said of a run over `source` against the reference of that name.
    pub fn new(source: &str, name: &str, reference: &Reference) -> Self {
        Self {
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            source: source.to_owned(),
            model: reference.model.name.clone(),
            model_sha256: reference.model.sha256.clone(),
            reference: name.to_owned(),
            strict: reference.strict,
            metric: reference.metric.to_string(),
            window_s: reference.window_s,
            thresholds: reference.false_alarms.method.clone(),
            false_alarms: known_of(&reference.false_alarms),
            calibrated_by: reference.provenance.command.clone(),
        }
    }
}

/// What was measured of false alarms, in words.
fn known_of(alarms: &FalseAlarms) -> String {
    let drives = |what: &str, on: &NominalDrives| {
        if on.hours <= 0.0 {
            return format!("; {what} on no drive that could be judged");
        }
        format!(
            "; {what} on {} nominal drives of {} together: {} entries into Gap",
            on.drives,
            Hours(on.hours),
            on.entries
        )
    };
    let mut text = format!("at most {} an hour wanted", alarms.wanted_per_hour);
    text += &drives("chosen", &alarms.chosen_on);
    if let Some(judged_on) = &alarms.judged_on {
        text += &drives("judged", judged_on);
    }
    text + "; " + &alarms.said()
}

#[derive(Serialize)]
struct Line<'a> {
    t_s: f64,
    seq: Option<u64>,
    state: &'static str,
    reason: &'static str,
    score: Option<f64>,
    gap: PerTap<'a>,
    similarity: PerTap<'a>,
    health: String,
    latency_ms: f64,
    tap_score: PerTap<'a>,
    image: Option<Image>,
    #[serde(skip_serializing_if = "Option::is_none")]
    about: Option<About>,
}

/// How good the picture was, to a thousandth.
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
    fn new(
        taps: &'a [String],
        verdict: &'a Verdict,
        latency: Duration,
        about: Option<About>,
    ) -> Self {
        let per_tap = |value| PerTap {
            taps,
            blocks: &verdict.blocks,
            value,
        };
        Self {
            t_s: verdict.at.as_secs_f64(),
            seq: verdict.sequence,
            state: verdict.state.name(),
            reason: verdict.reason.name(),
            score: verdict.score,
            gap: per_tap(|block| block.gap),
            similarity: per_tap(|block| block.similarity),
            health: verdict
                .undefined
                .as_ref()
                .map_or_else(|| "ok".to_owned(), ToString::to_string),
            latency_ms: latency.as_secs_f64() * 1e3,
            tap_score: per_tap(|block| block.score),
            image: verdict.quality.map(Image::from),
            about,
        }
    }
}

/// One number a tap, in the order of the taps; `null` where there is none.
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

impl Journal {
    /// Begins a journal of a model with these taps.
    ///
    /// # Errors
    /// When nothing can be written beside `path`.
    pub fn create(path: &Path, taps: &[String]) -> Result<Self, JournalError> {
        let lines = WholeFile::create(path).map_err(|error| JournalError {
            path: path.to_owned(),
            error,
        })?;
        Ok(Self {
            path: path.to_owned(),
            lines,
            taps: taps.to_vec(),
            about: None,
        })
    }

    /// Lets the next line say what the run is made with.
    pub fn describe(&mut self, about: About) {
        self.about = Some(about);
    }

    /// Adds a verdict and the time it took from frame to verdict.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn add(&mut self, verdict: &Verdict, latency: Duration) -> Result<(), JournalError> {
        let about = self.about.take();
        let line = Line::new(&self.taps, verdict, latency, about);
        serde_json::to_writer(&mut self.lines, &line)
            .map_err(io::Error::from)
            .and_then(|()| self.lines.write_all(b"\n"))
            .map_err(|error| JournalError {
                path: self.path.clone(),
                error,
            })
    }

    /// Puts the file in place.
    ///
    /// # Errors
    /// When the disk does not take it.
    pub fn finish(self) -> Result<(), JournalError> {
        self.lines.finish().map_err(|error| JournalError {
            path: self.path,
            error,
        })
    }
}
