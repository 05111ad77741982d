//! Scores of nominal drives → the factor on all thresholds that keeps a wanted rate of false alarms.
//!
//! A false alarm is an entry into `Gap` of the whole chain: window, CUSUM and debounce, with a reset before each drive.
//! Drives are used as a whole, because the frames of a drive depend on each other.

use std::time::Duration;

use crate::capture::undefined::Undefined;
use crate::monitor::alarm::{Alarm, AlarmState, Judgement, Reason};
use crate::monitor::cusum::Cusum;
use crate::monitor::detector::{Evidence, judgement};
use crate::reference::{FalseAlarms, NominalDrives, RateFactor};
use crate::statistics::bootstrap;
use crate::statistics::event_rate::poisson_interval;

/// Factors that are tried: the first one, the ratio of each to the one before, and their number.
const FACTOR_MIN: f64 = 0.1;
const FACTOR_STEP: f64 = 1.02;
const FACTORS: i32 = 350;
/// If at least this many entries are wanted on the drives, entries are counted; with fewer, the tail is modelled.
const COUNTED_MIN: f64 = 10.0;
/// Number of entries from which a tail is modelled, as a share of the number of drives, and its minimum.
const TAIL_SHARE: f64 = 0.25;
const TAIL_MIN: usize = 5;
/// Margin on the factor at which no drive enters `Gap`, if there are not enough drives for a tail.
const FEW_DRIVES_MARGIN: f64 = 1.5;
/// A frame that represents more than this many usual periods is followed by an interruption, in which nothing was
/// judged.
const STANDS_MAX: u32 = 2;

/// One of this many drives judges the rate that the others set. Most drives set the rate, because a low rate cannot be
/// set well on few hours.
const JUDGE_EVERY: usize = 4;

/// Rates, entries an hour, whose factors a reference keeps besides the rate that was asked for.
const RATES_PER_HOUR: [f64; 3] = [10.0, 1.0, 0.1];

/// A drive's scores, frame by frame, with which the rest of the chain can be run at other thresholds.
#[derive(Clone, Debug, Default)]
pub struct DriveScores {
    frames: Vec<(Duration, Scored)>,
}

/// The scores of a frame, or why it has none.
#[derive(Clone, Copy, Debug)]
enum Scored {
    Known {
        gap: f64,
        change: Option<f64>,
        settled: bool,
    },
    Cannot(Reason),
}

impl DriveScores {
    /// Adds a frame: its time, its score, and whether a whole window has been seen.
    pub fn add(&mut self, at: Duration, score: f64, settled: bool) {
        self.add_with_change(at, score, None, settled);
    }

    /// Adds a frame with its two scores: how far the road is from what is nominal, and from its own past.
    pub fn add_with_change(&mut self, at: Duration, gap: f64, change: Option<f64>, settled: bool) {
        self.frames.push((
            at,
            Scored::Known {
                gap,
                change,
                settled,
            },
        ));
    }

    /// Adds what is known after a frame.
    pub fn add_evidence(&mut self, at: Duration, evidence: &Result<Evidence, Undefined>) {
        match evidence {
            Ok(of) => self.add_with_change(at, of.gap, of.change, of.fill >= 1.0),
            Err(why) => self.add_unjudged(at, Reason::from(why)),
        }
    }

    /// Adds a frame that cannot be judged.
    pub fn add_unjudged(&mut self, at: Duration, reason: Reason) {
        self.frames.push((at, Scored::Cannot(reason)));
    }

    /// Every frame's largest score; `None` for a frame that could not be judged.
    pub fn scores(&self) -> impl Iterator<Item = (Duration, Option<f64>)> + '_ {
        self.frames.iter().map(|&(at, seen)| match seen {
            Scored::Known { gap, change, .. } => (at, Some(change.map_or(gap, |of| of.max(gap)))),
            Scored::Cannot(_) => (at, None),
        })
    }

    /// Judged time, hours: the time that the frames with a score represent. A frame represents the time to the next
    /// frame, and the last frame the same time as the one before it, but an interruption does not count. The time is 0
    /// for a drive in which no frame completed a window, because its state stays `Init`.
    pub fn hours(&self) -> f64 {
        let is_settled = |seen| matches!(seen, Scored::Known { settled, .. } if settled);
        let to_next = self
            .frames
            .windows(2)
            .map(|pair| pair[1].0.saturating_sub(pair[0].0));
        let mut stands: Vec<Duration> = to_next.collect();
        let Some(&last) = stands.last() else {
            return 0.0;
        };
        if !self.frames.iter().any(|&(_, seen)| is_settled(seen)) {
            return 0.0;
        }
        stands.push(last);
        let mut sorted = stands.clone();
        sorted.sort_unstable();
        let longest = STANDS_MAX * sorted[sorted.len() / 2];
        let judged = self
            .scores()
            .zip(&stands)
            .filter(|((_, score), _)| score.is_some());
        let stood: Duration = judged.map(|(_, &stands)| stands.min(longest)).sum();
        stood.as_secs_f64() / 3_600.0
    }

    /// The state after each frame if all thresholds are `factor` times as far from their medians.
    pub fn states(&self, factor: f64) -> impl Iterator<Item = (Duration, AlarmState)> + '_ {
        let (mut alarm, mut cusum) = (Alarm::default(), Cusum::default());
        self.frames.iter().map(move |&(at, seen)| {
            let seen = match seen {
                Scored::Known {
                    gap,
                    change,
                    settled,
                } => {
                    let gap = gap / factor;
                    let drift = if settled { cusum.add(at, gap) } else { 0.0 };
                    judgement(gap, change.map(|change| change / factor), drift, settled)
                }
                Scored::Cannot(reason) => Judgement::Cannot(reason),
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

fn tried(index: i32) -> f64 {
    FACTOR_MIN * FACTOR_STEP.powi(index)
}

/// Whether the held-out drive with this number judges the rate that the others set.
pub fn is_judging(drive: usize) -> bool {
    drive % JUDGE_EVERY == JUDGE_EVERY - 1
}

/// The factor for a wanted rate alone, set on the same drives as by [`calibrated`]. Each drive has its number.
pub(super) fn factor(
    drives: &[(usize, DriveScores)],
    wanted_per_hour: f64,
    optimistic: bool,
) -> f64 {
    factor_for(&sorted(drives, optimistic).0, wanted_per_hour).0
}

/// The drives that set the rate, and those that judge it.
fn sorted(
    drives: &[(usize, DriveScores)],
    optimistic: bool,
) -> (Vec<&DriveScores>, Vec<&DriveScores>) {
    let (mut setting, mut judging) = (Vec::new(), Vec::new());
    for (number, scores) in drives {
        if optimistic || !is_judging(*number) {
            setting.push(scores);
        } else {
            judging.push(scores);
        }
    }
    (setting, judging)
}

/// The factor for a rate on drives, and how it was found.
fn factor_for(drives: &[&DriveScores], per_hour: f64) -> (f64, &'static str) {
    let hours: f64 = drives.iter().map(|drive| drive.hours()).sum();
    if hours * per_hour >= COUNTED_MIN {
        (counted(drives, hours * per_hour), "entries counted")
    } else {
        modelled(drives, hours * per_hour)
    }
}

/// The factor for a wanted rate, and the rate that it gives on other drives, each with its number: of every four drives,
/// three set it and one judges it. `optimistic`: the drives have also scaled the gaps, so all of them set the factor and
/// none is left to judge it.
pub(super) fn calibrated(
    drives: &[(usize, DriveScores)],
    wanted_per_hour: f64,
    optimistic: bool,
) -> FalseAlarms {
    let (setting, judging) = sorted(drives, optimistic);
    let (factor, how) = factor_for(&setting, wanted_per_hour);
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
                factor: factor_for(&setting, per_hour).0,
            })
            .to_vec(),
        chosen_on: nominal(&setting, factor),
        judged_on: judged(&judging, factor),
    }
}

/// Counts the entries anew, on drives of all domains whose scores are at the final thresholds.
pub(super) fn count(of: &mut FalseAlarms, drives: &[(usize, DriveScores)], optimistic: bool) {
    let (setting, judging) = sorted(drives, optimistic);
    of.chosen_on = nominal(&setting, 1.0);
    of.judged_on = judged(&judging, 1.0);
}

fn judged(drives: &[&DriveScores], factor: f64) -> Option<NominalDrives> {
    Some(nominal(drives, factor)).filter(|on| on.hours > 0.0)
}

/// The smallest factor from which on at most `wanted` entries are counted.
#[allow(clippy::cast_precision_loss)]
fn counted(drives: &[&DriveScores], wanted: f64) -> f64 {
    let too_loud = (0..FACTORS)
        .rev()
        .find(|&i| entries(drives, tried(i)) as f64 > wanted);
    tried(too_loud.map_or(0, |i| i + 1))
}

fn entries(drives: &[&DriveScores], factor: f64) -> u64 {
    drives.iter().map(|drive| drive.entries(factor)).sum()
}

/// The factors up to which entries last, the largest first, at most `most` of them: at the k-th factor, at least k
/// entries are left.
fn last_factors(drives: &[&DriveScores], most: usize) -> Vec<f64> {
    let mut last = Vec::new();
    for index in (0..FACTORS).rev() {
        let left = usize::try_from(entries(drives, tried(index))).unwrap_or(usize::MAX);
        last.resize(left.min(most).max(last.len()), tried(index));
        if last.len() == most {
            break;
        }
    }
    last
}

/// The factor at which `wanted` entries are left, from an exponential tail of the factors up to which the loudest
/// entries last (peaks over threshold, Pickands 1975). Entries and not drives are used, because a road near the
/// threshold enters `Gap` often.
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
    let judged: Vec<(u64, f64)> = drives
        .iter()
        .map(|drive| (drive.entries(factor), drive.hours()))
        .filter(|&(_, hours)| hours > 0.0)
        .collect();
    let hours = judged.iter().map(|of| of.1).sum();
    let entries = judged.iter().map(|of| of.0).sum();
    NominalDrives {
        drives: judged.len() as u64,
        hours,
        entries,
        per_hour: poisson_interval(entries, hours),
        resampled: bootstrap::one_sided_bounds(bootstrap::rates(&judged)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;
    use crate::statistics::event_rate::{CountedRate, Loudness};

    /// Calibrated on drives of the simulation, not optimistic.
    fn calibrated_on(drives: &[DriveScores], per_hour: f64) -> FalseAlarms {
        let numbered: Vec<_> = drives.iter().cloned().enumerate().collect();
        calibrated(&numbered, per_hour, false)
    }

    /// A drive of a minute at 2 frames a second that is calm, except for 5 s at `peak`.
    fn drive(peak: f64) -> DriveScores {
        let mut drive = DriveScores::default();
        for i in 0..120_u64 {
            let score = if (60..70).contains(&i) { peak } else { 0.1 };
            drive.add(Duration::from_millis(500 * i), score, i >= 2);
        }
        drive
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
        // 600 drives (10 h) whose peaks have an exponential tail.
        let drives: Vec<DriveScores> = (0..600_u32)
            .map(|i| {
                let share =
                    (f64::from(i.wrapping_mul(2_654_435_769) >> 8) + 0.5) / f64::from(1 << 24);
                drive(1.0 - share.ln())
            })
            .collect();
        for wanted in [2.0, 5.0] {
            let found = calibrated_on(&drives, wanted);
            let judged = found.judged_on.unwrap();
            assert_eq!(judged.drives, 150);
            let (low, high) = judged.per_hour;
            assert!(low <= wanted && wanted <= high, "{wanted}: {judged:?}");
            assert!(!matches!(found.loudness(), Loudness::Louder), "{judged:?}");
        }
        let few = calibrated_on(&drives[..8], 1.0);
        assert!(few.said().starts_with("not shown: 0 to "), "{}", few.said());
        let none = calibrated_on(&drives[..3], 1.0);
        assert!(
            none.said()
                .contains("nothing was judged; 3.0 hours without"),
            "{}",
            none.said()
        );
    }

    #[test]
    fn drives_that_are_louder_than_those_that_set_the_rate_are_told() {
        let peaks = |minutes: u64, peak: f64| {
            let mut drive = DriveScores::default();
            for i in 0..120 * minutes {
                let score = if (60..70).contains(&(i % 120)) {
                    peak
                } else {
                    0.01
                };
                drive.add(Duration::from_millis(500 * i), score, i >= 2);
            }
            drive
        };
        // Every fourth drive, which judges, enters ten times in ten minutes; the others are calm.
        let (calm, loud) = (peaks(1, 0.01), peaks(10, 9.0));
        let drives: Vec<DriveScores> = (0..24)
            .map(|i| if is_judging(i) { &loud } else { &calm })
            .cloned()
            .collect();
        let found = calibrated_on(&drives, 1.0);
        let on = found.judged_on.unwrap();
        assert_eq!((on.drives, on.entries), (6, 60));
        assert_eq!(found.loudness(), Loudness::Louder);
        assert!(
            found.said().starts_with("louder than asked: at least 47."),
            "{}",
            found.said()
        );
        // The same entries are all in one drive of six, which may be the only one of its kind.
        let mut kinds = vec![calm; 24];
        kinds[3] = loud;
        let found = calibrated_on(&kinds, 20.0);
        assert_eq!(found.judged_on.unwrap().entries, 10);
        assert_eq!(
            CountedRate::new(10, found.judged_on.unwrap().hours, None).loudness(20.0),
            Loudness::Louder
        );
        assert!(
            matches!(found.loudness(), Loudness::NotShown { .. }),
            "{}",
            found.said()
        );
    }

    #[test]
    fn hours_are_those_of_frames_that_could_be_judged() {
        let minutes = |drive: &DriveScores| 60.0 * drive.hours();
        let drive_of = |seen: &dyn Fn(u64) -> Option<bool>| {
            let mut drive = DriveScores::default();
            for i in 0..120_u64 {
                let at = Duration::from_millis(500 * i);
                match seen(i) {
                    Some(settled) => drive.add(at, 0.1, settled),
                    None => drive.add_unjudged(at, Reason::Black),
                }
            }
            drive
        };
        let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-9, "{found}");
        near(minutes(&drive_of(&|i| Some(i >= 2))), 1.0);
        near(
            minutes(&drive_of(&|i| (i % 3 > 0).then_some(true))),
            40.0 / 60.0,
        );
        near(minutes(&drive_of(&|_| None)), 0.0);
        // The state never left Init, as with frames too far apart for the window.
        near(minutes(&drive_of(&|_| Some(false))), 0.0);
        // An interruption of an hour between two halves counts no more than two frames.
        let mut hole = DriveScores::default();
        for i in 0..120_u64 {
            let at = 500 * i + if i < 60 { 0 } else { 3_600_000 };
            hole.add(Duration::from_millis(at), 0.1, i >= 2);
        }
        near(minutes(&hole), 60.5 / 60.0);
        near(minutes(&DriveScores::default()), 0.0);
        // A drive that could not be judged does not judge.
        let blind = vec![drive_of(&|_| None); 8];
        let found = calibrated_on(&blind, 1.0);
        assert_eq!((found.judged_on, found.chosen_on.drives), (None, 0));
    }
}
