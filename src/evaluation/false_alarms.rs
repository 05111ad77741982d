//! Entries into `Gap` on hours of nominal drives that nothing was tuned on.

use serde::{Deserialize, Serialize};

use super::resampling::{ROUNDS, SplitMix64, percentile_interval};
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
    /// 95 % interval of the rate: from resampling drives, since a road that is near the threshold enters more than once, and
    /// never narrower than the exact one of independent entries (Poisson).
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

fn interval(drives: &[DriveScores], factor: f64, hours: f64) -> (f64, f64) {
    let counts: Vec<u64> = drives.iter().map(|drive| drive.entries(factor)).collect();
    let independent = poisson_interval(counts.iter().sum(), hours);
    let mut dice = SplitMix64::new(0);
    // Counts of entries are small, and drives are of equal length.
    #[allow(clippy::cast_precision_loss)]
    let resampled = (0..ROUNDS).map(|_| {
        let drawn = (0..counts.len()).map(|_| counts[dice.below(counts.len())]);
        drawn.sum::<u64>() as f64 / hours.max(f64::MIN_POSITIVE)
    });
    match percentile_interval(resampled.collect()) {
        Some((low, high)) => (low.min(independent.0), high.max(independent.1)),
        None => independent,
    }
}

/// Counts the entries of drives at thresholds `factor` times as far from their medians as those of the scores.
pub fn rate(nominal: Look, drives: &[DriveScores], wanted: f64, factor: f64) -> FalseAlarmRate {
    let hours: f64 = drives.iter().map(DriveScores::hours).sum();
    let entries: u64 = drives.iter().map(|drive| drive.entries(factor)).sum();
    let bound = interval(drives, factor, hours);
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Drives of a minute, each with so many entries of 3 s, 10 s apart.
    fn drives(entries: &[u64]) -> Vec<DriveScores> {
        let of = |&entries: &u64| {
            let mut drive = DriveScores::default();
            for i in 0..120_u64 {
                let (round, within) = (i / 20, i % 20);
                let loud = round < entries && (10..16).contains(&within);
                let score = if loud { 2.0 } else { 0.1 };
                drive.add(Duration::from_millis(500 * i), score, i >= 2);
            }
            drive
        };
        entries.iter().map(of).collect()
    }

    #[test]
    fn entries_that_come_together_leave_more_doubt_than_single_ones() {
        // 60 entries in 60 drives, an hour: one each, or five in every fifth.
        let single = rate(Look::Sim, &drives(&[1; 60]), 60.0, 1.0);
        let together = rate(Look::Sim, &drives(&[5, 0, 0, 0, 0].repeat(12)), 60.0, 1.0);
        assert_eq!((single.entries, together.entries), (60, 60));
        let exact = poisson_interval(60, single.hours);
        assert_eq!(single.bound, exact);
        assert!(together.bound.0 < 0.9 * exact.0 && together.bound.1 > 1.1 * exact.1);
        assert!(single.kept && together.kept);
    }
}
