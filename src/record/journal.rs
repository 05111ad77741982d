//! Journal, version 2: one JSON object a line. The first line says what the run was made with and when; every other one
//! what was known after a frame, or when none came.
//!
//! ```text
//! {"gapwatch_journal":2,"began":{"utc":…,"is_set":true,"monotonic_s":…},"about":{…}}
//! {"t_s":0.105,"captured_s":0.1,"seq":1,"state":"Ok",…}
//! ```
//!
//! `t_s` is when it was told, and never runs backwards; `captured_s` is when the frame was taken. In a replay, where time
//! stands still while a frame is judged, they are the same. What a line does not know may be `null` or left out.

mod reading;
mod recording;

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::ser::{SerializeMap, Serializer};
use serde::{Deserialize, Serialize};

use crate::capture::clock::ClockTime;
use crate::features::image_quality::ImageQuality;
use crate::files::live_file::LiveFile;
use crate::files::output::{Output, Stream};
use crate::files::whole_file::WholeFile;
use crate::monitor::detector::BlockScore;
use crate::monitor::judge::Verdict;
use crate::reference::{FalseAlarms, NominalDrives, Reference};
use crate::statistics::event_rate::Hours;

pub use reading::{Entry, ReadError, Reading, read};
pub use recording::RecordingJournal;

/// Version of the format.
const VERSION: u64 = 2;

/// A journal that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("journal {}: {error}", path.display())]
pub struct JournalError {
    path: PathBuf,
    error: io::Error,
}

/// Writes a journal.
pub struct Journal {
    path: PathBuf,
    lines: Box<dyn Output>,
    taps: Vec<String>,
    /// When the last line was told.
    told_at: Duration,
}

#[derive(Serialize)]
struct FirstLine<'a> {
    gapwatch_journal: u64,
    began: &'a ClockTime,
    about: &'a About,
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
    captured_s: Option<f64>,
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
    fn new(taps: &'a [String], told_at: Duration, verdict: &'a Verdict, latency: Duration) -> Self {
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
            gap: per_tap(|block| block.gap),
            similarity: per_tap(|block| block.similarity),
            health: verdict
                .undefined
                .as_ref()
                .map_or_else(|| "ok".to_owned(), ToString::to_string),
            latency_ms: latency.as_secs_f64() * 1e3,
            tap_score: per_tap(|block| block.score),
            image: verdict.quality.map(Image::from),
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
    /// Begins a journal of a model with these taps, whose file appears whole when it is finished.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn create(
        path: &Path,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let lines = WholeFile::create(path).map_err(|error| failed(path, error))?;
        Self::begin(path, Box::new(lines), taps, began, about)
    }

    /// As [`create`](Self::create), in a file whose lines are there as they are written.
    ///
    /// # Errors
    /// When nothing can be written there.
    pub fn live(
        path: &Path,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let lines = LiveFile::create(path).map_err(|error| failed(path, error))?;
        Self::begin(path, Box::new(lines), taps, began, about)
    }

    /// As [`create`](Self::create), into a stream; `path` names it in errors.
    ///
    /// # Errors
    /// When it takes nothing.
    pub fn stream(
        path: &Path,
        out: impl io::Write + Send + 'static,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        Self::begin(path, Box::new(Stream(out)), taps, began, about)
    }

    fn begin(
        path: &Path,
        lines: Box<dyn Output>,
        taps: &[String],
        began: &ClockTime,
        about: &About,
    ) -> Result<Self, JournalError> {
        let mut journal = Self {
            path: path.to_owned(),
            lines,
            taps: taps.to_vec(),
            told_at: Duration::ZERO,
        };
        let first = FirstLine {
            gapwatch_journal: VERSION,
            began,
            about,
        };
        write_line(&mut journal.lines, &first).map_err(|error| failed(path, error))?;
        Ok(journal)
    }

    /// Adds a verdict that is told at `now`, `latency` after its frame was taken. A time before that of the last line is taken
    /// for the same time.
    ///
    /// # Errors
    /// When the output does not take it.
    pub fn add(
        &mut self,
        now: Duration,
        verdict: &Verdict,
        latency: Duration,
    ) -> Result<(), JournalError> {
        self.told_at = self.told_at.max(now);
        let line = Line::new(&self.taps, self.told_at, verdict, latency);
        write_line(&mut self.lines, &line).map_err(|error| failed(&self.path, error))
    }

    /// Ends the journal: its file is in place, and on the disk.
    ///
    /// # Errors
    /// When the output does not take it.
    pub fn finish(self) -> Result<(), JournalError> {
        let finished = self.lines.finish();
        finished.map_err(|error| failed(&self.path, error))
    }
}

/// With one call, as an [`Output`] wants it.
fn write_line(out: &mut Box<dyn Output>, line: &impl Serialize) -> io::Result<()> {
    let mut bytes = serde_json::to_vec(line)?;
    bytes.push(b'\n');
    out.write_all(&bytes)
}

fn failed(path: &Path, error: io::Error) -> JournalError {
    JournalError {
        path: path.to_owned(),
        error,
    }
}
