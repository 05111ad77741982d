//! The first line of a journal: what a run was made with, and when.

use serde::{Deserialize, Serialize};

use crate::capture::clock::ClockTime;
use crate::files::whole_file::without_mark;
use crate::monitor::warn::WarnOn;
use crate::reference::{FalseAlarms, NominalDrives, Reference};
use crate::statistics::event_rate::Hours;

/// Version of the format.
pub const VERSION: u64 = 4;

/// The first line.
#[derive(Serialize)]
pub struct FirstLine<'a> {
    pub gapwatch_journal: u64,
    pub began: &'a ClockTime,
    pub about: &'a About,
}

/// What a run was made with; unknown fields are skipped and missing ones empty, so that versions read each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct About {
    /// Version of the program.
    pub gapwatch: String,
    /// The source, as typed.
    pub source: String,
    /// Name of the model.
    pub model: String,
    /// Hash of its ONNX file.
    pub model_sha256: String,
    /// The reference's file, or `built-in`.
    pub reference: String,
    /// Whether the reference was made of simulation alone.
    pub strict: bool,
    /// The answers that raise the warning: gap, change, lanes.
    pub warn: String,
    /// Whether the road was seen while it was judged, so that the time of day is that of the road.
    pub live: bool,
    /// How gaps were measured.
    pub metric: String,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Where the reference's medians and thresholds come from, and what they do not guarantee.
    pub thresholds: String,
    /// What is known of false alarms with these thresholds, as text.
    pub false_alarms: String,
    /// The command that makes the reference again.
    pub calibrated_by: String,
}

impl About {
    /// Describes a run over `source` with the reference of that name.
    pub fn new(source: &str, name: &str, reference: &Reference, warn: WarnOn) -> Self {
        Self {
            gapwatch: env!("CARGO_PKG_VERSION").to_owned(),
            source: source.to_owned(),
            model: reference.model.name.clone(),
            model_sha256: reference.model.sha256.clone(),
            reference: name.to_owned(),
            strict: reference.strict,
            warn: warn.to_string(),
            live: false,
            metric: reference.metric.to_string(),
            window_s: reference.window_s,
            thresholds: reference.false_alarms.method.clone(),
            false_alarms: known_of(&reference.false_alarms),
            calibrated_by: reference.provenance.command.clone(),
        }
    }
}

/// What was measured of false alarms, as text.
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

/// Whether a file that begins like this is a journal, of any version.
pub fn begins_like_one(head: &[u8]) -> bool {
    without_mark(head).starts_with(b"{\"gapwatch_journal\"")
}
