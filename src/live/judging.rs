//! The judge's side of the live loop: whether to look, what is known, and when the next frame is wanted.

use std::time::Duration;

use super::{Orders, Word};
use crate::monitor::judge::{Judge, Sighting, Verdict};
use crate::monitor::rate::{Periods, RatePolicy};

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
    /// Has seen nothing.
    pub fn new(periods: Periods) -> Self {
        Self {
            judge: Judge::with_frames_every(periods.idle),
            policy: RatePolicy::new(periods),
            periods,
            period: periods.full,
            parked: false,
        }
    }

    /// Begins a round at `now`: follows the teller's orders, and says what came of a request to clear.
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

    /// Whether a frame is to be looked at. While the car is parked none is, but the newest is taken, so that none is old when
    /// the car drives off.
    pub fn looks(&self) -> bool {
        !self.parked
    }

    /// What a frame tells that was looked at, and before it, if that was too long, the silence.
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
