//! What a reference is to be like.

use crate::reference::gap::Metric;

/// What a reference is to be like.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// How gaps are measured.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Entries into `Gap` an hour of nominal driving.
    pub false_alarms_per_hour: f64,
}
