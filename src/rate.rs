//! Verdicts → how often the road is looked at: slowly while it is clearly nominal or the car is parked, at full rate at the
//! first sign of anything else.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::alarm::AlarmState;
use crate::continuity::Continuity;

/// A score up to this is clearly nominal: half of the way from the nominal median to the threshold.
const CLEAR_SCORE: f64 = 0.5;
/// The road must be clearly nominal for this long before it is looked at more slowly: what has just been suspicious may be
/// so again.
const CALM: Duration = Duration::from_secs(5);

/// Times from one frame to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Periods {
    /// At full rate.
    pub full: Duration,
    /// While the road is clearly nominal; the same as `full` for one rate always.
    pub idle: Duration,
}

/// Decides between two rates.
#[derive(Debug)]
pub struct RatePolicy {
    periods: Periods,
    calm_since: Option<Duration>,
    seen: Continuity,
}

impl RatePolicy {
    /// Begins at full rate.
    pub fn new(periods: Periods) -> Self {
        Self {
            periods,
            calm_since: None,
            seen: Continuity::with_frames_every(periods.idle),
        }
    }

    /// Time from the frame of this verdict to the next one. A road that nobody saw for a while was not calm meanwhile.
    pub fn after(&mut self, at: Duration, state: AlarmState, score: Option<f64>) -> Duration {
        if self.seen.step(at).is_none() {
            self.calm_since = None;
        }
        let calm = state == AlarmState::Ok && score.is_some_and(|score| score <= CLEAR_SCORE);
        if !calm {
            self.calm_since = None;
            return self.periods.full;
        }
        let since = *self.calm_since.get_or_insert(at);
        if at.saturating_sub(since) < CALM {
            self.periods.full
        } else {
            self.periods.idle
        }
    }
}

/// The time from one frame to the next that is wanted now, told from the judge to the camera.
#[derive(Debug)]
pub struct WantedPeriod(AtomicU64);

impl WantedPeriod {
    /// To begin with.
    pub fn new(period: Duration) -> Self {
        let wanted = Self(AtomicU64::new(0));
        wanted.set(period);
        wanted
    }

    /// From now on.
    pub fn set(&self, period: Duration) {
        let nanos = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        self.0.store(nanos, Ordering::Relaxed);
    }

    /// Now.
    pub fn get(&self) -> Duration {
        Duration::from_nanos(self.0.load(Ordering::Relaxed))
    }
}

/// Chooses frames at a wanted rate out of those that come at their own.
#[derive(Debug, Default)]
pub struct Pace {
    /// Where on its grid the last chosen frame lay.
    last: Option<Duration>,
}

impl Pace {
    /// Whether a frame at `now` is wanted, when the last one is to be `period` ago.
    pub fn is_due(&mut self, now: Duration, period: Duration) -> bool {
        // Frames do not come on our grid: a quarter too early is on time.
        let slack = period / 4;
        let next = self.last.map_or(now, |last| last + period);
        let due = now + slack >= next;
        if due {
            self.last = Some(next.max(now.saturating_sub(slack)));
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn slow_after_five_clear_seconds_and_fast_with_the_first_other_frame() {
        use AlarmState::{Gap, Init, Ok, SensorFault, Suspect};
        let periods = Periods {
            full: 100 * MS,
            idle: 500 * MS,
        };
        let mut policy = RatePolicy::new(periods);
        let mut now = 0;
        // Ten frames a second up to a time in ms; what comes of the last one.
        let mut after = |until_ms: u32, state, score| {
            let mut period = Duration::ZERO;
            while now <= until_ms {
                period = policy.after(now * MS, state, score);
                now += 100;
            }
            period.as_millis()
        };
        assert_eq!(after(900, Init, Some(0.0)), 100);
        assert_eq!(after(5_900, Ok, Some(0.5)), 100);
        assert_eq!(after(6_000, Ok, Some(0.2)), 500);
        assert_eq!(after(6_100, Ok, Some(0.51)), 100);
        assert_eq!(after(11_100, Ok, Some(0.2)), 100);
        assert_eq!(after(11_200, Ok, Some(0.2)), 500);
        let mut from = 11_200;
        for (state, score) in [
            (Suspect, Some(1.2)),
            (Gap, Some(0.2)),
            (SensorFault, None),
            (Ok, None),
        ] {
            assert_eq!(after(from + 100, state, score), 100);
            assert_eq!(after(from + 5_100, Ok, Some(0.0)), 100);
            assert_eq!(after(from + 5_200, Ok, Some(0.0)), 500);
            from += 5_200;
        }
    }

    #[test]
    fn a_road_that_nobody_saw_was_not_calm() {
        let periods = Periods {
            full: 100 * MS,
            idle: 500 * MS,
        };
        let mut policy = RatePolicy::new(periods);
        let mut after = |ms| policy.after(ms * MS, AlarmState::Ok, Some(0.0)).as_millis();
        assert_eq!([0, 500, 1_000, 1_500].map(&mut after), [100; 4]);
        assert_eq!([600_000, 600_750, 601_500].map(&mut after), [100; 3]);
        assert_eq!([604_250, 605_000].map(&mut after), [100; 2]);
        let frames = (0..7).map(|n| 605_500 + 750 * n);
        let periods: Vec<u128> = frames.map(after).collect();
        assert_eq!(periods, [100, 100, 100, 100, 100, 500, 500]);
    }

    #[test]
    fn a_pace_keeps_its_rate_and_changes_it_within_a_frame() {
        let mut pace = Pace::default();
        let mut chosen = |from: u32, to: u32, period: u32| {
            let frames = (from..to).map(|n| n * 33 * MS);
            let due = frames.filter(|&at| pace.is_due(at, period * MS));
            due.map(|at| at.as_millis()).collect::<Vec<u128>>()
        };
        assert_eq!(chosen(0, 31, 100).len(), 11);
        assert_eq!(chosen(31, 91, 500).len(), 4);
        // The last place on the grid was at 3.0 s.
        let fast = chosen(91, 121, 100);
        assert!(fast[0] <= 3_110 && fast.len() >= 9, "{fast:?}");
    }

    #[test]
    fn frames_are_chosen_at_the_wanted_rate_whatever_theirs_is() {
        for (fps, rate, frames) in [
            (30.0, 10.0, 101),
            (24.0, 10.0, 100),
            (30.0, 30.0, 301),
            (9.0, 10.0, 91),
        ] {
            let (mut pace, period) = (Pace::default(), Duration::from_secs_f64(1.0 / rate));
            let times = (0..).map(|n| Duration::from_secs_f64(f64::from(n) / fps));
            let ten_seconds = times.take_while(|time| *time <= Duration::from_millis(10_001));
            let due = ten_seconds.filter(|time| pace.is_due(*time, period));
            let due: Vec<Duration> = due.collect();
            let found = due.len().abs_diff(frames);
            assert!(found <= 1, "{} of {fps} frames a second", due.len());
            let longest = due.windows(2).map(|pair| pair[1] - pair[0]).max();
            assert!(longest.is_some_and(|pause| pause.as_secs_f64() < 1.3 / rate.min(fps)));
        }
    }
}
