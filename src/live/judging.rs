//! The judge's side of the live loop: whether to judge frames, what is known, and when the next frame is wanted.

use std::time::Duration;

use super::{Orders, Word};
use crate::monitor::judge::{Judge, Sighting, Verdict};
use crate::monitor::rate::RatePolicy;
use crate::monitor::warn::WarnOn;
use crate::reference::Periods;

/// What the judge knows between frames.
#[derive(Debug)]
pub struct Judging {
    judge: Judge,
    policy: RatePolicy,
    periods: Periods,
    period: Duration,
    parked: bool,
}

impl Judging {
    /// A judge that has seen nothing, for which some answers raise the warning.
    pub fn new(periods: Periods, warn: WarnOn) -> Self {
        Self {
            judge: Judge::with_frames_every(periods.idle).warning_on(warn),
            policy: RatePolicy::new(periods),
            periods,
            period: periods.full,
            parked: false,
        }
    }

    /// Begins a round at `now`: follows the teller's orders, and reports the result of a request to clear.
    pub fn obey(&mut self, now: Duration, orders: Orders) -> Option<Word> {
        if orders.parked {
            self.judge.rest(now);
            self.period = self.periods.idle;
        } else if self.parked {
            self.period = self.periods.full;
        }
        self.parked = orders.parked;
        orders
            .clear
            .then(|| Word::Cleared(self.judge.clear_stored()))
    }

    /// Whether a frame is to be judged. While the car is parked, frames are taken but not judged, so that no frame is
    /// old when the car drives off.
    pub fn looks(&self) -> bool {
        !self.parked
    }

    /// The verdict on a frame that was looked at, and before it the verdict on the silence, if the silence was too
    /// long.
    pub fn frame(&mut self, seen: Sighting) -> (Option<Verdict>, Verdict) {
        let silence = self.judge.silence(seen.at);
        let verdict = self.judge.judge(seen);
        self.period = self.policy.after(verdict.at, verdict.state, verdict.score);
        (silence, verdict)
    }

    /// What is known at `now` when no frame came.
    pub fn no_frame(&mut self, now: Duration) -> Option<Verdict> {
        let silence = self.looks().then(|| self.judge.silence(now)).flatten();
        if silence.is_some() {
            self.period = self.periods.full;
        }
        silence
    }

    /// Time from the last frame to the next one that is wanted.
    pub fn period(&self) -> Duration {
        self.period
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::undefined::Undefined;
    use crate::monitor::alarm::{AlarmState, Reason};
    use crate::monitor::detector::Evidence;

    const MS: Duration = Duration::from_millis(1);
    const PERIODS: Periods = Periods {
        full: Duration::from_millis(100),
        idle: Duration::from_millis(250),
    };
    const DRIVES: Orders = Orders {
        parked: false,
        clear: false,
    };
    const PARKED: Orders = Orders {
        parked: true,
        clear: false,
    };
    const CLEAR: Orders = Orders {
        parked: false,
        clear: true,
    };

    /// What was seen in a frame that was taken at a time in ms.
    fn seen(at: u32, score: f64) -> Sighting {
        Sighting {
            at: at * MS,
            sequence: at.into(),
            quality: None,
            evidence: Ok(Evidence::of_gap(score)),
        }
    }

    /// Looks at ten frames a second of this score, with times in ms; returns the last verdict.
    fn look(judging: &mut Judging, from: u32, until: u32, score: f64) -> Verdict {
        let frames = (from..=until).step_by(100);
        let mut verdicts = frames.map(|at| judging.frame(seen(at, score)).1);
        let first = verdicts.next().expect("a frame");
        verdicts.last().unwrap_or(first)
    }

    #[test]
    fn a_request_to_clear_is_answered_and_refused_in_a_gap() {
        let mut judging = Judging::new(PERIODS, WarnOn::default());
        assert_eq!(judging.obey(Duration::ZERO, DRIVES), None);
        assert_eq!(
            judging.obey(Duration::ZERO, CLEAR),
            Some(Word::Cleared(true))
        );
        let gap = look(&mut judging, 0, 2_000, 9.0);
        assert_eq!((gap.state, gap.gap_stored), (AlarmState::Gap, true));
        assert_eq!(judging.obey(2_000 * MS, CLEAR), Some(Word::Cleared(false)));
        let after = look(&mut judging, 2_100, 5_000, 0.0);
        assert_eq!((after.state, after.gap_stored), (AlarmState::Ok, true));
        assert_eq!(judging.obey(5_000 * MS, CLEAR), Some(Word::Cleared(true)));
        assert!(!look(&mut judging, 5_100, 5_100, 0.0).gap_stored);
    }

    #[test]
    fn nobody_looks_while_the_car_is_parked_and_then_at_full_rate() {
        let mut judging = Judging::new(PERIODS, WarnOn::default());
        assert_eq!((judging.looks(), judging.period()), (true, PERIODS.full));
        judging.obey(Duration::ZERO, PARKED);
        assert_eq!((judging.looks(), judging.period()), (false, PERIODS.idle));
        judging.obey(1_000 * MS, DRIVES);
        assert_eq!((judging.looks(), judging.period()), (true, PERIODS.full));
    }

    #[test]
    fn a_clear_road_is_looked_at_slowly_until_something_is_seen_or_nothing_comes() {
        let mut judging = Judging::new(PERIODS, WarnOn::default());
        look(&mut judging, 0, 4_900, 0.1);
        assert_eq!(judging.period(), PERIODS.full);
        look(&mut judging, 5_000, 5_000, 0.1);
        assert_eq!(judging.period(), PERIODS.idle);
        // That the car continues to drive is no reason.
        judging.obey(5_000 * MS, DRIVES);
        assert_eq!(judging.no_frame(5_500 * MS), None);
        assert_eq!(judging.period(), PERIODS.idle);
        let silence = judging.no_frame(5_501 * MS);
        let wanted = Verdict {
            at: 5_500 * MS,
            state: AlarmState::Unavailable,
            reason: Reason::Stale,
            undefined: Some(Undefined::Silence),
            fault_detection_counter: -128,
            ..Verdict::nothing_yet()
        };
        assert_eq!(silence, Some(wanted));
        assert_eq!(judging.period(), PERIODS.full);
        assert_eq!(judging.no_frame(9_000 * MS), None, "told once");
    }

    #[test]
    fn a_frame_after_a_silence_tells_of_that_first() {
        let mut judging = Judging::new(PERIODS, WarnOn::default());
        let (silence, first) = judging.frame(seen(0, 0.1));
        assert_eq!((silence, first.sequence), (None, Some(0)));
        assert_eq!((first.state, first.score), (AlarmState::Ok, Some(0.1)));
        let (silence, next) = judging.frame(seen(600, 3.0));
        let silence = silence.map(|it| (it.at, it.reason, it.sequence));
        assert_eq!(silence, Some((500 * MS, Reason::Stale, None)));
        let next = (next.at, next.state, next.sequence, next.score);
        let wanted = (600 * MS, AlarmState::Suspect, Some(600), Some(3.0));
        assert_eq!(next, wanted);
    }

    #[test]
    fn to_be_parked_is_no_silence() {
        let mut judging = Judging::new(PERIODS, WarnOn::default());
        judging.frame(seen(0, 0.1));
        judging.obey(100 * MS, PARKED);
        assert_eq!(judging.no_frame(9_000 * MS), None);
        judging.obey(9_000 * MS, PARKED);
        judging.obey(9_100 * MS, DRIVES);
        let (silence, verdict) = judging.frame(seen(9_200, 0.1));
        assert_eq!((silence, verdict.state), (None, AlarmState::Ok));
    }
}
