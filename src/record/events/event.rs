//! An event: the moments around the beginning of an alarm.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::monitor::profile::TapProfile;

/// The file of an event that says what the others are.
pub const EVENT_FILE: &str = "event.json";
/// One event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Which of the moments began it.
    pub edge: usize,
    /// Frames around it in order of time.
    pub moments: Vec<Moment>,
}

/// A moment of an event, as its `event.json` has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Time of the frame, seconds since the source began.
    pub t_s: f64,
    /// Its number.
    pub seq: u64,
    /// What the car was told.
    pub state: String,
    /// Why.
    pub reason: String,
    /// The largest score of the blocks.
    pub score: Option<f64>,
    /// File of the frame.
    pub frame: String,
    /// Files of the heat maps by tap; most moments have none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub heat: BTreeMap<String, String>,
    /// The window beside what is nominal, one entry a tap; most moments have none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub profiles: Vec<TapProfile>,
}
