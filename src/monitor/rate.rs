//! Verdicts → how often the road is looked at: slowly while it is clearly nominal or the car is parked, and at full
//! rate at the first sign of anything else.

use std::time::Duration;

use crate::monitor::alarm::{Alarm, AlarmState, Judgement};
use crate::monitor::continuity::Continuity;
use crate::reference::{JudgedRate, Periods};

/// A score up to this is clearly nominal: half of the way from the nominal median to the threshold.
const CLEAR_SCORE: f64 = 0.5;
/// The road must be clearly nominal for this long before it is looked at more slowly, because what was just suspicious
/// may become suspicious again.
const CALM: Duration = Duration::from_secs(5);

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

    /// Time from the frame of this verdict to the next frame. Time in which the road was not seen does not count as
    /// calm.
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

/// A frame may come this much earlier than wanted.
const EARLY: Duration = Duration::from_millis(2);

/// Chooses the frames of a drive that a live monitor would judge: it has the same rates and the same alarm.
#[derive(Debug)]
pub struct Looks {
    policy: RatePolicy,
    alarm: Alarm,
    due: Duration,
}

impl Looks {
    /// For a rate at which the road is judged.
    pub fn new(rate: JudgedRate) -> Self {
        let periods = rate.periods();
        Self {
            policy: RatePolicy::new(periods),
            alarm: Alarm::with_frames_every(periods.idle),
            due: Duration::ZERO,
        }
    }

    /// Whether a frame of this time is judged.
    pub fn is_due(&self, at: Duration) -> bool {
        at + EARLY >= self.due
    }

    /// Takes the judgement of a frame, and its score if it has one.
    pub fn judged(&mut self, at: Duration, judgement: Judgement, score: Option<f64>) {
        self.alarm.step(at, judgement);
        // Frames that come a little late do not delay those after them.
        let planned = self.due.max(at.saturating_sub(EARLY));
        self.due = planned + self.policy.after(at, self.alarm.state(), score);
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
        // Passes ten frames a second up to a time in ms; returns the result of the last one.
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
}
