//! Scores of nominal drives → the factor on all thresholds that keeps a wanted rate of false alarms.
//!
//! A false alarm is an entry into `Gap` of the whole chain: window, CUSUM and debounce, each drive from reset. Drives are
//! taken whole: the frames of one depend on each other.

use std::time::Duration;

use crate::alarm::{Alarm, AlarmState, Judgement, Reason};
use crate::detector::{Cusum, judgement};
use crate::reference::{FalseAlarms, NominalDrives, RateFactor};

/// Factors that are tried: from the first, each this much above the one before.
const FACTOR_MIN: f64 = 0.1;
const FACTOR_STEP: f64 = 1.02;
const FACTORS: i32 = 350;
/// With at least this many wanted entries on the drives at hand they are counted; with fewer the tail is modelled.
const COUNTED_MIN: f64 = 10.0;
/// Entries that a tail is modelled from, as a share of the drives, and fewest.
const TAIL_SHARE: f64 = 0.25;
const TAIL_MIN: usize = 5;
/// Without enough drives for a tail: margin on the factor at which none of them enters `Gap`.
const FEW_DRIVES_MARGIN: f64 = 1.5;
/// Hours times rate that demonstrate a rate when nothing happens in them (rule of three).
pub const DEMONSTRATED: f64 = 3.0;

/// One drive of so many judges the rate that the others set: a rate of one in so many hours is set badly on fewer.
const JUDGE_EVERY: usize = 4;

/// Rates, entries an hour, whose factors a reference keeps beside the one asked for.
const RATES_PER_HOUR: [f64; 3] = [10.0, 1.0, 0.1];

/// A drive's scores, frame by frame, from which the chain behind them can be run at other thresholds.
#[derive(Clone, Debug, Default)]
pub struct DriveScores {
    frames: Vec<(Duration, Judgement)>,
}

impl DriveScores {
    /// Adds a frame: its time, its score, and whether a whole window has been seen.
    pub fn add(&mut self, at: Duration, score: f64, settled: bool) {
        self.frames.push((at, Judgement::Score { score, settled }));
    }

    /// Adds a frame that cannot be judged.
    pub fn add_unjudged(&mut self, at: Duration, reason: Reason) {
        self.frames.push((at, Judgement::Cannot(reason)));
    }

    /// Every frame's score; `None` of one that could not be judged.
    pub fn scores(&self) -> impl Iterator<Item = (Duration, Option<f64>)> + '_ {
        self.frames.iter().map(|&(at, seen)| match seen {
            Judgement::Score { score, .. } => (at, Some(score)),
            _ => (at, None),
        })
    }

    /// Length of the drive, hours: the last frame lasts as long as the one before.
    pub fn hours(&self) -> f64 {
        let [.., (before, _), (last, _)] = self.frames[..] else {
            return 0.0;
        };
        (last + (last - before) - self.frames[0].0).as_secs_f64() / 3_600.0
    }

    /// The state after each frame when all thresholds lie `factor` times as far from their medians.
    pub fn states(&self, factor: f64) -> impl Iterator<Item = (Duration, AlarmState)> + '_ {
        let (mut alarm, mut cusum) = (Alarm::default(), Cusum::default());
        self.frames.iter().map(move |&(at, seen)| {
            let seen = match seen {
                Judgement::Score { score, settled } => {
                    let score = score / factor;
                    let drift = if settled { cusum.add(at, score) } else { 0.0 };
                    judgement(score, drift, settled)
                }
                other => other,
            };
            alarm.step(at, seen);
            (at, alarm.state())
        })
    }

    /// Entries into `Gap` at that factor.
    pub fn entries(&self, factor: f64) -> u64 {
        let mut before = AlarmState::Init;
        self.states(factor)
            .map(|(_, state)| {
                let entered = before != AlarmState::Gap && state == AlarmState::Gap;
                before = state;
                u64::from(entered)
            })
            .sum()
    }
}

fn factor(index: i32) -> f64 {
    FACTOR_MIN * FACTOR_STEP.powi(index)
}

/// Whether the held-out drive of a number judges the rate that others set.
pub fn is_judging(drive: usize) -> bool {
    drive % JUDGE_EVERY == JUDGE_EVERY - 1
}

/// The factor for a wanted rate, and the rate that it keeps on other drives: of every four drives three set it and one
/// judges.
/// `optimistic`: the drives have also scaled the gaps, so all of them set the factor and none is left to judge it.
#[allow(clippy::cast_precision_loss)]
pub(super) fn calibrated(
    drives: &[DriveScores],
    wanted_per_hour: f64,
    optimistic: bool,
) -> FalseAlarms {
    let (mut choose, mut judge) = (Vec::new(), Vec::new());
    for (index, drive) in drives.iter().enumerate() {
        if optimistic || !is_judging(index) {
            choose.push(drive)
        } else {
            judge.push(drive)
        }
    }
    let hours: f64 = choose.iter().map(|drive| drive.hours()).sum();
    let factor_for = |per_hour: f64| {
        if hours * per_hour >= COUNTED_MIN {
            (counted(&choose, hours * per_hour), "entries counted")
        } else {
            modelled(&choose, hours * per_hour)
        }
    };
    let (factor, how) = factor_for(wanted_per_hour);
    let judged_on = (!judge.is_empty()).then(|| nominal(&judge, factor));
    let judged_hours = judged_on.map_or(0.0, |on| on.hours);
    let wanted_hours = DEMONSTRATED / wanted_per_hour;
    let missing = (judged_hours < wanted_hours).then(|| {
        format!(
            "{:.1} hours of held-out drives more to demonstrate {wanted_per_hour} an hour (rule of three)",
            wanted_hours - judged_hours
        )
    });
    let drawn = if optimistic {
        "the drives that scaled the gaps, optimistic"
    } else {
        "held-out drives"
    };
    FalseAlarms {
        wanted_per_hour,
        method: format!("whole chain from reset on {drawn}; {how}"),
        factor,
        factors: RATES_PER_HOUR
            .map(|per_hour| RateFactor {
                per_hour,
                factor: factor_for(per_hour).0,
            })
            .to_vec(),
        chosen_on: nominal(&choose, factor),
        judged_on,
        missing,
    }
}

/// The smallest factor from which on no more than `wanted` entries are counted.
#[allow(clippy::cast_precision_loss)]
fn counted(drives: &[&DriveScores], wanted: f64) -> f64 {
    let too_loud = (0..FACTORS)
        .rev()
        .find(|&i| entries(drives, factor(i)) as f64 > wanted);
    factor(too_loud.map_or(0, |i| i + 1))
}

fn entries(drives: &[&DriveScores], factor: f64) -> u64 {
    drives.iter().map(|drive| drive.entries(factor)).sum()
}

/// The factors up to which entries last, largest first, at most `most` of them: at the k-th one, at least k entries are left.
fn last_factors(drives: &[&DriveScores], most: usize) -> Vec<f64> {
    let mut last = Vec::new();
    for index in (0..FACTORS).rev() {
        let left = usize::try_from(entries(drives, factor(index))).unwrap_or(usize::MAX);
        last.resize(left.min(most).max(last.len()), factor(index));
        if last.len() == most {
            break;
        }
    }
    last
}

/// The factor at which `wanted` entries are left, from an exponential tail of the factors up to which the loudest entries
/// last (peaks over threshold, Pickands 1975). Entries and not drives: a road that is near the threshold enters often.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn modelled(drives: &[&DriveScores], wanted: f64) -> (f64, &'static str) {
    let tail = ((TAIL_SHARE * drives.len() as f64) as usize).max(TAIL_MIN);
    let last = last_factors(drives, tail + 1);
    let Some(&from) = last.get(tail).filter(|_| drives.len() > tail) else {
        let worst = last.first().copied().unwrap_or(1.0);
        return (
            FEW_DRIVES_MARGIN * worst,
            "too few drives or entries for a rate: the loudest and a margin",
        );
    };
    let mean_excess = last[..tail].iter().map(|q| q - from).sum::<f64>() / tail as f64;
    let factor = from + mean_excess * (tail as f64 / wanted).ln().max(0.0);
    (
        factor,
        "exponential tail of the factors up to which entries last",
    )
}

fn nominal(drives: &[&DriveScores], factor: f64) -> NominalDrives {
    let hours = drives.iter().map(|drive| drive.hours()).sum();
    let entries = drives.iter().map(|drive| drive.entries(factor)).sum();
    NominalDrives {
        drives: drives.len() as u64,
        hours,
        entries,
        per_hour: poisson_interval(entries, hours),
    }
}

/// Exact 95 % interval of a rate from `events` in `hours` (Garwood 1936); from 0 without events, to the bound at which none
/// has a chance of 2.5 %.
#[allow(clippy::cast_precision_loss)]
pub fn poisson_interval(events: u64, hours: f64) -> (f64, f64) {
    if hours <= 0.0 {
        return (0.0, f64::MAX);
    }
    // Chance of at most `events` events at an expectation of `mean`, summed from its largest term down.
    let at_most = |events: u64, mean: f64| -> f64 {
        let log_factorial = |n: u64| (1..=n).map(|i| (i as f64).ln()).sum::<f64>();
        let log_last = events as f64 * mean.ln() - mean - log_factorial(events);
        let mut term = log_last.exp();
        let mut sum = term;
        for n in (1..=events).rev() {
            term *= n as f64 / mean;
            sum += term;
        }
        sum
    };
    let solved = |target: &dyn Fn(f64) -> bool| {
        let (mut low, mut high) = (1e-9, 10.0 + 3.0 * (events as f64 + 1.0));
        for _ in 0..100 {
            let middle = 0.5 * (low + high);
            if target(middle) {
                low = middle
            } else {
                high = middle
            }
        }
        0.5 * (low + high)
    };
    let upper = solved(&|mean| at_most(events, mean) > 0.025);
    let lower = if events == 0 {
        0.0
    } else {
        solved(&|mean| 1.0 - at_most(events - 1, mean) < 0.025)
    };
    (lower / hours, upper / hours)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;

    /// A drive of a minute at 2 frames a second that is calm but for 5 s at `peak`.
    fn drive(peak: f64) -> DriveScores {
        let mut drive = DriveScores::default();
        for i in 0..120_u64 {
            let score = if (60..70).contains(&i) { peak } else { 0.1 };
            drive.add(Duration::from_millis(500 * i), score, i >= 2);
        }
        drive
    }

    #[test]
    fn intervals_of_a_rate_are_garwoods() {
        // Ulm's table: 0: 0 to 3.689; 5: 1.623 to 11.668; 10: 4.795 to 18.390.
        for (events, low, high) in [
            (0, 0.0, 3.6889),
            (5, 1.6235, 11.6683),
            (10, 4.7954, 18.3904),
        ] {
            let (found_low, found_high) = poisson_interval(events, 2.0);
            assert!(
                (found_low - low / 2.0).abs() < 1e-3,
                "{events}: {found_low}"
            );
            assert!(
                (found_high - high / 2.0).abs() < 1e-3,
                "{events}: {found_high}"
            );
        }
    }

    #[test]
    fn entries_are_counted_and_the_last_frame_has_a_length() {
        let drive = drive(2.0);
        assert_eq!((drive.entries(1.0), drive.entries(3.0)), (1, 0));
        assert!((drive.hours() - 60.0 / 3_600.0).abs() < 1e-12);
        // Its one entry lasts up to the factor at which 2.0 is no longer an alarm.
        let last = last_factors(&[&drive], 9);
        assert!(
            last.len() == 1 && (1.9..=2.0).contains(&last[0]),
            "{last:?}"
        );
    }

    #[test]
    fn a_wanted_rate_is_kept_on_the_drives_that_judge() {
        // 600 drives (10 h) with peaks of an exponential tail.
        let drives: Vec<DriveScores> = (0..600_u32)
            .map(|i| {
                let share =
                    (f64::from(i.wrapping_mul(2_654_435_769) >> 8) + 0.5) / f64::from(1 << 24);
                drive(1.0 - share.ln())
            })
            .collect();
        for wanted in [2.0, 5.0] {
            let found = calibrated(&drives, wanted, false);
            let judged = found.judged_on.unwrap();
            assert_eq!(judged.drives, 150);
            let (low, high) = judged.per_hour;
            assert!(low <= wanted && wanted <= high, "{wanted}: {judged:?}");
            assert_eq!(found.missing, None);
        }
        let few = calibrated(&drives[..8], 1.0, false);
        assert!(few.missing.unwrap().contains("3.0 hours"));
    }
}
