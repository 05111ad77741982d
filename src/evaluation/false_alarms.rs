//! Entries into `Gap` on hours of nominal drives that nothing was tuned on.

use serde::{Deserialize, Serialize};

use super::watched::{Script, Shown};
use crate::calibration::{DEMONSTRATED, DriveScores, poisson_interval};
use crate::scene::Look;

/// Frames a second of the drives.
const FPS: f64 = 2.0;
/// Length of a drive, seconds.
pub const DRIVE_S: f64 = 300.0;
/// First seed of the drives.
pub const FIRST_SEED: u64 = 100_001;

/// The nominal drive of a number.
pub fn script(nominal: Look, number: u64, seconds: f64) -> Script {
    Script {
        parts: vec![(
            0.0,
            Shown::Drive {
                look: nominal,
                seed: FIRST_SEED + number,
                conditions: vec![],
            },
        )],
        seconds,
        fps: FPS,
    }
}

/// False alarms at thresholds made for a rate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FalseAlarmRate {
    /// The nominal look.
    pub nominal: String,
    /// Entries an hour that the thresholds are made for.
    pub wanted: f64,
    /// Entries an hour found.
    pub measured: f64,
    /// 95 % interval of the rate (Poisson, exact).
    pub bound: (f64, f64),
    /// Entries.
    pub entries: u64,
    /// Drives.
    pub drives: u64,
    /// Hours in all.
    pub hours: f64,
    /// The interval holds the wanted rate.
    pub kept: bool,
    /// There are hours enough to say so: `wanted x hours >= 3`.
    pub demonstrated: bool,
}

/// Counts the entries of drives at thresholds `factor` times as far from their medians as those of the scores.
pub fn rate(nominal: Look, drives: &[DriveScores], wanted: f64, factor: f64) -> FalseAlarmRate {
    let hours: f64 = drives.iter().map(DriveScores::hours).sum();
    let entries: u64 = drives.iter().map(|drive| drive.entries(factor)).sum();
    let bound = poisson_interval(entries, hours);
    // Counts of entries are small.
    #[allow(clippy::cast_precision_loss)]
    let measured = entries as f64 / hours.max(f64::MIN_POSITIVE);
    FalseAlarmRate {
        nominal: nominal.name().to_owned(),
        wanted,
        measured,
        bound,
        entries,
        drives: drives.len() as u64,
        hours,
        kept: bound.0 <= wanted && wanted <= bound.1,
        demonstrated: wanted * hours >= DEMONSTRATED,
    }
}
