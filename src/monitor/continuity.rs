//! Verdicts over time → how much time each verdict represents.
//!
//! Defines what an interruption is (a *hole* in the names of the code). A verdict represents the time since the verdict
//! before it, unless nothing was seen for so long that it is not known what happened in between. Then it represents no
//! time, and what was counted before says nothing about the present.

use std::time::Duration;

/// Time without a verdict after which the state says that there is none.
pub const STALE: Duration = Duration::from_millis(500);
/// Frames that come as slowly as this are still continuous if they come steadily: two windows of the detector.
pub const SLOWEST: Duration = Duration::from_secs(2);

/// Distinguishes steps in time from interruptions.
#[derive(Clone, Debug)]
pub struct Continuity {
    patience: Duration,
    last: Option<Duration>,
    /// Time between the last two verdicts.
    pause: Option<Duration>,
}

impl Default for Continuity {
    fn default() -> Self {
        Self::with_frames_every(Duration::ZERO)
    }
}

impl Continuity {
    /// For frames that may come as slowly as one every `period`: an interruption is longer than one and a half periods,
    /// and longer than 500 ms.
    pub fn with_frames_every(period: Duration) -> Self {
        Self {
            patience: STALE.max(period * 3 / 2),
            last: None,
            pause: None,
        }
    }

    /// Longest time without a verdict that is not an interruption.
    pub fn patience(&self) -> Duration {
        self.patience
    }

    /// Takes a verdict at `now`, and returns the time since the one before; `None` for the first verdict, and after an
    /// interruption. Slow frames that come steadily are continuous: each pause may be one and a half times the pause
    /// before it, and at most [`SLOWEST`].
    pub fn step(&mut self, now: Duration) -> Option<Duration> {
        let since = now.saturating_sub(self.last.replace(now)?);
        let before = self.pause.replace(since);
        let steady = before.is_some_and(|before| since <= before * 3 / 2) && since <= SLOWEST;
        if since <= self.patience || steady {
            return Some(since);
        }
        self.pause = (since <= SLOWEST).then_some(since);
        None
    }

    /// Nothing can be seen: the next verdict comes after an interruption.
    pub fn interrupt(&mut self) {
        (self.last, self.pause) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The time that a verdict at each of these times in ms represents.
    fn steps(continuity: &mut Continuity, times: &[u64]) -> Vec<Option<u128>> {
        let step = |&ms| continuity.step(Duration::from_millis(ms));
        let since = times.iter().map(step);
        since
            .map(|since| since.map(|since| since.as_millis()))
            .collect()
    }

    #[test]
    fn up_to_the_patience_time_counts_and_beyond_it_is_a_hole() {
        let mut continuity = Continuity::default();
        assert_eq!(
            steps(&mut continuity, &[0, 100, 600, 1_301, 1_401]),
            [None, Some(100), Some(500), Some(701), Some(100)],
            "701 ms are half as long again as 500 ms at most"
        );
        let mut continuity = Continuity::default();
        assert_eq!(
            steps(&mut continuity, &[0, 100, 601, 701]),
            [None, Some(100), None, Some(100)]
        );
        let mut slow = Continuity::with_frames_every(Duration::from_secs(2));
        assert_eq!(slow.patience(), Duration::from_secs(3));
        assert_eq!(
            steps(&mut slow, &[0, 3_000, 6_001]),
            [None, Some(3_000), None]
        );
    }

    #[test]
    fn steady_slow_frames_follow_each_other_from_the_second_pause_on() {
        let mut continuity = Continuity::default();
        assert_eq!(
            steps(&mut continuity, &[0, 1_000, 2_000, 3_500, 5_500, 7_501]),
            [None, None, Some(1_000), Some(1_500), Some(2_000), None]
        );
        // After an interruption of more than 2 s it begins anew.
        assert_eq!(
            steps(&mut continuity, &[607_501, 608_501, 609_501]),
            [None, None, Some(1_000)]
        );
        // A pause of 2 s may be the first of many.
        continuity.interrupt();
        assert_eq!(
            steps(&mut continuity, &[0, 2_000, 4_000]),
            [None, None, Some(2_000)]
        );
        continuity.interrupt();
        assert_eq!(
            steps(&mut continuity, &[0, 2_001, 4_001]),
            [None, None, None]
        );
    }

    #[test]
    fn after_an_interruption_it_begins_anew() {
        let mut continuity = Continuity::default();
        steps(&mut continuity, &[0, 100]);
        continuity.interrupt();
        assert_eq!(
            steps(&mut continuity, &[200, 900, 1_600]),
            [None, None, Some(700)]
        );
    }
}
