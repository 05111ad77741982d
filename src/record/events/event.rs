//! An event: the moments around the beginning of an alarm.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::monitor::profile::TapProfile;
use crate::reference::cause::Cause;

/// The file of an event that describes its other files.
pub const EVENT_FILE: &str = "event.json";
/// One event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Index of the moment that began it.
    pub edge: usize,
    /// Frames around it, in the order of time.
    pub moments: Vec<Moment>,
}

/// A moment of an event, as it is in `event.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Time of the frame, seconds since the source began.
    pub t_s: f64,
    /// Number of the frame.
    pub seq: u64,
    /// The state that was reported to the car.
    pub state: String,
    /// The reason for the state.
    pub reason: String,
    /// The largest score of the answers that raise the warning.
    pub score: Option<f64>,
    /// How far the road is from the nearest nominal domain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gap: Option<f64>,
    /// How far the road differs from its own past, if this is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<f64>,
    /// Forecast of the share of lanes that the model loses, 0..1, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lanes: Option<f64>,
    /// What most likely causes the evidence, if anything is known of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<Cause>,
    /// How likely the cause is, 0..1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause_probability: Option<f64>,
    /// File of the frame.
    pub frame: String,
    /// Files of the heat maps by tap; most moments have none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub heat: BTreeMap<String, String>,
    /// The window beside what is nominal, one entry for each tap; most moments have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub profiles: Vec<TapProfile>,
}
