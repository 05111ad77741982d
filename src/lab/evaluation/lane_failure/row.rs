//! The results of a method at a rate of false alarms.

use serde::{Deserialize, Serialize};

/// How one method predicts failures, with thresholds for one rate of false alarms.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LaneFailure {
    /// A metric, or a baseline.
    pub method: String,
    /// Whether it needs none of the encoder's inner values, or only their mean.
    pub baseline: bool,
    /// Entries into `Gap` an hour of nominal driving for which the thresholds are made.
    pub wanted_per_hour: f64,
    /// Number of seconds under a condition that were judged.
    pub seconds: u64,
    /// Number of seconds without a score.
    pub unjudged_seconds: u64,
    /// Number of judged seconds with a failure.
    pub failed_seconds: u64,
    /// Area under the ROC curve of the score for failed seconds among those under a condition; the 95 % interval comes
    /// from resampling roads.
    pub auroc: Option<f64>,
    /// See `auroc`.
    pub auroc_interval: Option<(f64, f64)>,
    /// Rank correlation of the score with the loss, over the same seconds.
    pub spearman: Option<f64>,
    /// See `spearman`.
    pub spearman_interval: Option<(f64, f64)>,
    /// Number of drives with a failure.
    pub failures: u64,
    /// Number of these in which `Gap` was entered between 5 s before and 1 s after its onset.
    pub found: u64,
    /// Number of these in which it was entered between 5 s before and 3 s after the onset.
    #[serde(default)]
    pub found_late: u64,
    /// Share of the failures that were found in time.
    pub recall: Option<f64>,
    /// 95 % interval (Wilson; the roads are fewer than the drives).
    pub recall_interval: (f64, f64),
    /// Median time from entering `Gap` to the onset of the failure, for the failures found, seconds.
    pub lead_median_s: Option<f64>,
    /// Number of drives with a condition that entered `Gap`.
    pub alarmed: u64,
    /// `found` as a share of these. If a warning comes before the condition has begun to grow, for example because a
    /// tunnel can be seen, the drive counts only in `found`.
    pub precision: Option<f64>,
    /// Number of drives that kept 0.9 of their lane IoU.
    pub benign: u64,
    /// Number of these that entered `Gap`.
    pub benign_alarmed: u64,
    /// Share of these.
    pub benign_share: Option<f64>,
    /// 95 % interval (Wilson).
    pub benign_interval: (f64, f64),
    /// Number of drives under a condition of severity 3 or more.
    pub severe: u64,
    /// Number of these in which `Gap` was entered between the beginning of the condition and 2 s after it had reached
    /// its severity, with or without a failure.
    pub severe_found: u64,
    /// 95 % interval of their share (Wilson).
    pub severe_interval: (f64, f64),
    /// Entries into `Gap` on the nominal drives that judge. If there is a forecast for each kind, the forecast with the
    /// most entries counts.
    pub false_alarms: u64,
    /// Hours of these drives.
    pub nominal_hours: f64,
    /// Entries an hour.
    pub false_alarms_per_hour: f64,
    /// 95 % interval (Poisson, exact).
    pub false_alarms_interval: (f64, f64),
}
