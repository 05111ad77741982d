//! Entries into `Gap` on hours of nominal drives that were not used for tuning.

use serde::{Deserialize, Serialize};

use super::scripts::{Script, Shown};
use crate::calibration::DriveScores;
use crate::lab::scene::Look;
use crate::statistics::bootstrap;
use crate::statistics::event_rate::{CountedRate, Loudness, poisson_interval};

/// Length of a drive, seconds.
pub const DRIVE_S: f64 = 300.0;
/// First seed of the drives.
pub const FIRST_SEED: u64 = 100_001;

/// The nominal drive with this number; `stretch_m` is the mean length of the stretches of its road, metres, 0 for a road
/// of one kind.
pub fn script(nominal: Look, stretch_m: u32, number: u64, (seconds, fps): (f64, f64)) -> Script {
    Script {
        parts: vec![(
            0.0,
            Shown::Drive {
                look: nominal,
                seed: FIRST_SEED + number,
                stretch_m,
                conditions: vec![],
            },
        )],
        seconds,
        fps,
    }
}

/// False alarms at thresholds made for a rate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FalseAlarmRate {
    /// The nominal look.
    pub nominal: String,
    /// Mean length of the stretches of the roads, metres; 0 for roads of one kind.
    #[serde(default)]
    pub stretch_m: u32,
    /// Frames a second of the drives; 0 in files of older versions.
    #[serde(default)]
    pub fps: f64,
    /// Entries an hour for which the thresholds are made.
    pub wanted: f64,
    /// Entries an hour that were found; `None` if nothing could be judged.
    pub measured: Option<f64>,
    /// 95 % interval of the rate from resampling drives, because a road near the threshold enters `Gap` more than once.
    /// It is never narrower than the exact interval of independent entries (Poisson). `None` if nothing could be
    /// judged.
    pub bound: Option<(f64, f64)>,
    /// One-sided 95 % bounds of the rate from resampling drives. `None` if nothing could be judged, and in files of
    /// older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resampled: Option<(f64, f64)>,
    /// Number of entries.
    pub entries: u64,
    /// Drives in which something could be judged.
    pub drives: u64,
    /// Total of judged hours.
    pub hours: f64,
}

impl FalseAlarmRate {
    /// What the drives say about the wanted rate.
    pub fn loudness(&self) -> Loudness {
        self.counted().loudness(self.wanted)
    }

    /// What is missing to show that the rate is not louder than wanted; `None` if nothing is missing.
    pub fn missing(&self) -> Option<String> {
        self.counted().missing(self.wanted)
    }

    /// If one-sided bounds are missing, the ends of the two-sided interval are used instead, which are wider.
    fn counted(&self) -> CountedRate {
        CountedRate::new(self.entries, self.hours, self.resampled.or(self.bound))
    }
}

/// Counts the entries of drives at thresholds `factor` times as far from their medians as those of the scores.
pub fn rate(
    (nominal, stretch_m, fps): (Look, u32, f64),
    drives: &[DriveScores],
    wanted: f64,
    factor: f64,
) -> FalseAlarmRate {
    let of = |drive: &DriveScores| (drive.entries(factor), drive.hours());
    let judged: Vec<(u64, f64)> = drives.iter().map(of).filter(|of| of.1 > 0.0).collect();
    let entries: u64 = judged.iter().map(|of| of.0).sum();
    let hours: f64 = judged.iter().map(|of| of.1).sum();
    let independent = poisson_interval(entries, hours);
    let resampled = bootstrap::rates(&judged);
    let bound = bootstrap::percentile_interval(resampled.clone())
        .map(|(low, high)| (low.min(independent.0), high.max(independent.1)));
    // Counts of entries are small.
    #[allow(clippy::cast_precision_loss)]
    let measured = (hours > 0.0).then(|| entries as f64 / hours);
    FalseAlarmRate {
        nominal: nominal.name().to_owned(),
        stretch_m,
        fps,
        wanted,
        measured,
        bound,
        resampled: bootstrap::one_sided_bounds(resampled),
        entries,
        drives: judged.len() as u64,
        hours,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use super::*;
    use crate::monitor::alarm::Reason;

    /// Drives of a minute, each with a number of entries of 3 s that are 10 s apart.
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
        // 60 entries in 60 drives, which are an hour: one in each drive, or five in every fifth drive.
        let single = rate((Look::Sim, 0, 2.0), &drives(&[1; 60]), 60.0, 1.0);
        let together = rate(
            (Look::Sim, 0, 2.0),
            &drives(&[5, 0, 0, 0, 0].repeat(12)),
            60.0,
            1.0,
        );
        assert_eq!((single.entries, together.entries), (60, 60));
        let exact = poisson_interval(60, single.hours);
        assert_eq!(single.bound, Some(exact));
        let bound = together.bound.unwrap();
        assert!(bound.0 < 0.9 * exact.0 && bound.1 > 1.1 * exact.1);
        // Single entries show that the rate is above 48 and below 74 an hour; grouped entries do not.
        let at = |of: &FalseAlarmRate, wanted| {
            FalseAlarmRate {
                wanted,
                ..of.clone()
            }
            .loudness()
        };
        assert_eq!(at(&single, 47.0), Loudness::Louder);
        assert_eq!(at(&single, 75.0), Loudness::NotLouder);
        for wanted in [47.0, 75.0] {
            assert!(
                matches!(at(&together, wanted), Loudness::NotShown { .. }),
                "{together:?}"
            );
        }
        assert_eq!(at(&together, 20.0), Loudness::Louder);
    }

    #[test]
    fn drives_that_cannot_be_judged_count_no_hours() {
        let mut blind = DriveScores::default();
        for i in 0..7_200_u64 {
            blind.add_unjudged(Duration::from_millis(500 * i), Reason::Undefined);
        }
        let found = rate(
            (Look::Sim, 0, 2.0),
            &[blind.clone(), blind.clone()],
            1.0,
            1.0,
        );
        assert_eq!((found.drives, found.measured, found.bound), (0, None, None));
        let missing = found.missing().unwrap();
        assert_eq!(missing, "3.0 hours without an entry");
        let mut some = drives(&[1; 6]);
        some.push(blind);
        let found = rate((Look::Sim, 0, 2.0), &some, 1.0, 1.0);
        assert!((found.hours - 0.1).abs() < 1e-9, "{found:?}");
        assert_eq!(found.drives, 6);
    }

    #[test]
    fn a_rate_within_the_interval_is_not_shown_whatever_an_older_file_called_it() {
        let row = |wanted: f64, entries: u64, bound: (f64, f64)| {
            let row = serde_json::json!({
                "nominal": "game", "wanted": wanted, "measured": 0.1, "bound": bound, "entries": entries,
                "drives": 144, "hours": 12.0, "kept": true, "demonstrated": true,
            });
            serde_json::from_value::<FalseAlarmRate>(row).unwrap()
        };
        let quiet = row(10.0, 64, (1.83, 9.99));
        assert_eq!(
            (quiet.loudness(), quiet.missing()),
            (Loudness::NotLouder, None)
        );
        let near = row(1.0, 32, (0.17, 6.08));
        let missing = near.missing().unwrap();
        assert_eq!(
            (near.loudness().name(), missing.as_str()),
            ("not shown", "about 61.0 hours more without an entry")
        );
        assert_eq!(row(0.1, 32, (0.17, 6.08)).loudness(), Loudness::Louder);
    }
}
