//! The calibration target.

use crate::reference::gap::Metric;

/// Metric, window and rate of false alarms for which a reference is made.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Metric that measures the gap.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Entries into `Gap` an hour of nominal driving.
    pub false_alarms_per_hour: f64,
}
