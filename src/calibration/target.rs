//! The calibration target.

use crate::reference::gap::Metric;
use crate::reference::{EvidenceKind, JudgedRate};

/// Share of held-out windows below the threshold, before the rate of false alarms moves all thresholds together. It
/// sets the relative weight of the taps and window lengths.
pub const THRESHOLD_QUANTILE: f64 = 0.99;

/// Metric, window and rate of false alarms for which a reference is made.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Metric that measures the gap.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Entries into `Gap` an hour of nominal driving.
    pub false_alarms_per_hour: f64,
    /// What the road is judged by.
    pub evidence: EvidenceKind,
    /// How often it is judged.
    pub rate: JudgedRate,
}

impl Target {
    /// The rate of `false_alarms_per_hour` for a metric, with everything else as it is by default.
    pub fn new(metric: Metric, window_s: f64, false_alarms_per_hour: f64) -> Self {
        Self {
            metric,
            window_s,
            false_alarms_per_hour,
            evidence: EvidenceKind::Windows,
            rate: JudgedRate::default(),
        }
    }

    /// Whether windows and changes have nominal spreads of their own.
    pub fn is_timed(&self) -> bool {
        self.metric == Metric::Mahalanobis && self.evidence == EvidenceKind::Windows
    }
}
