//! What is known of a method at a rate of false alarms.

use serde::{Deserialize, Serialize};

/// How one method predicts failures, with thresholds for one rate of false alarms.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaneFailure {
    /// A metric, or a baseline.
    pub method: String,
    /// What the encoder's inner values are not needed for, or only their mean.
    pub baseline: bool,
    /// Entries into `Gap` an hour of nominal driving that the thresholds are made for.
    pub wanted_per_hour: f64,
    /// Seconds under a condition that were judged.
    pub seconds: u64,
    /// Seconds that had no score.
    pub unjudged_seconds: u64,
    /// Of them that failed.
    pub failed_seconds: u64,
    /// Area under the ROC curve of the score for failed seconds among those under a condition; 95 % interval by
    /// resampling roads.
    pub auroc: Option<f64>,
    /// See `auroc`.
    pub auroc_interval: Option<(f64, f64)>,
    /// Rank correlation of the score with the loss, over the same seconds.
    pub spearman: Option<f64>,
    /// See `spearman`.
    pub spearman_interval: Option<(f64, f64)>,
    /// Drives with a failure.
    pub failures: u64,
    /// Those in which `Gap` was entered from 5 s before to 1 s after its onset.
    pub found: u64,
    /// Those in which it was entered in that time or until 3 s after the onset.
    #[serde(default)]
    pub found_late: u64,
    /// Share of those found in time.
    pub recall: Option<f64>,
    /// 95 % interval (Wilson; the roads are fewer than the drives).
    pub recall_interval: (f64, f64),
    /// Median time from entering `Gap` to the onset of the failure, of those found, seconds.
    pub lead_median_s: Option<f64>,
    /// Drives with a condition that entered `Gap`.
    pub alarmed: u64,
    /// `found` as a share of them. Where a warning comes before the condition has begun to grow, as of a tunnel in sight, the
    /// drive counts as found alone.
    pub precision: Option<f64>,
    /// Drives that kept 0.9 of their lane IoU.
    pub benign: u64,
    /// Those of them that entered `Gap`.
    pub benign_alarmed: u64,
    /// Share of them.
    pub benign_share: Option<f64>,
    /// 95 % interval (Wilson).
    pub benign_interval: (f64, f64),
    /// Drives under a condition of severity 3 or more.
    pub severe: u64,
    /// Those in which `Gap` was entered from the condition's beginning to 2 s after it had its severity, failure or not.
    pub severe_found: u64,
    /// 95 % interval of their share (Wilson).
    pub severe_interval: (f64, f64),
    /// Entries into `Gap` on the nominal drives that judge; of a forecast a kind, those of the loudest.
    pub false_alarms: u64,
    /// Their hours.
    pub nominal_hours: f64,
    /// Entries an hour.
    pub false_alarms_per_hour: f64,
    /// 95 % interval (Poisson, exact).
    pub false_alarms_interval: (f64, f64),
}
