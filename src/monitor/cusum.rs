//! Scores over time → drift: a cumulative sum of scores (CUSUM, Page 1954) for what is slowly approaching an alarm.

use std::time::Duration;

use crate::monitor::continuity::{Continuity, SLOWEST};

/// Score that is subtracted in the cumulative sum: drift is what stays above it. It is three quarters of the way from
/// the nominal median to the threshold, so that only what is nearly an alarm adds up.
const DRIFT_SLACK: f64 = 0.75;
/// A window adds at most this score to the sum, because short bursts are found by the window itself.
const DRIFT_SCORE_MAX: f64 = 2.0;
/// Sum above the slack, in score times seconds, that is a drift: 20 s at the threshold itself.
const DRIFT_LIMIT_S: f64 = 5.0;

/// Adds scores up over time. An interruption adds nothing, and after more than two seconds the sum begins anew.
#[derive(Clone, Debug, Default)]
pub struct Cusum {
    sum_s: f64,
    seen: Continuity,
    last: Option<Duration>,
}

impl Cusum {
    /// For frames that may come as slowly as one every `period`.
    pub fn with_frames_every(period: Duration) -> Self {
        Self {
            seen: Continuity::with_frames_every(period),
            ..Self::default()
        }
    }

    /// Adds the score of a window that was seen at `now`; returns the sum, which is 1 at its limit.
    pub fn add(&mut self, now: Duration, score: f64) -> f64 {
        let long = SLOWEST.max(self.seen.patience());
        if (self.last.replace(now)).is_some_and(|last| now.saturating_sub(last) > long) {
            self.sum_s = 0.0;
        }
        let since_s = self.seen.step(now).unwrap_or_default().as_secs_f64();
        let above = score.min(DRIFT_SCORE_MAX) - DRIFT_SLACK;
        // The sum stops at its limit, so that a drift ends soon after the high scores.
        self.sum_s = (self.sum_s + above * since_s).clamp(0.0, DRIFT_LIMIT_S);
        self.sum_s / DRIFT_LIMIT_S
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss)]
    use super::*;

    fn at(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn scores_below_the_threshold_add_up_to_a_drift_at_any_rate() {
        for step_ms in [20, 100, 500] {
            let first_drift_s = |score: f64| {
                let mut cusum = Cusum::default();
                (0..60_000 / step_ms)
                    .find(|&i| cusum.add(at(i * step_ms), score) >= 1.0)
                    .map(|i| (i * step_ms) as f64 / 1_000.0)
            };
            assert_eq!(first_drift_s(0.7), None);
            // The limit is a sum of 5 s above 0.75: 20 s at the threshold, 4 s at twice the threshold and more.
            for (score, wanted_s) in [(1.0, 20.0), (2.0, 4.0), (90.0, 4.0)] {
                let found_s = first_drift_s(score).unwrap();
                assert!((found_s - wanted_s).abs() <= 0.5, "{score}: {found_s} s");
            }
        }
    }

    #[test]
    fn a_drift_is_over_at_once_and_forgotten_within_seven_seconds() {
        let mut cusum = Cusum::default();
        (0..600).for_each(|i| {
            cusum.add(at(100 * i), 2.0);
        });
        let left: Vec<f64> = (600..670).map(|i| cusum.add(at(100 * i), 0.0)).collect();
        assert!(left[0] < 1.0 && left[69] <= 0.01, "{left:?}");
    }

    #[test]
    fn a_hole_adds_nothing_to_a_drift() {
        // 3 s at a score of 1.75 add 3.
        let drift_behind = |pause_ms: u64, slow: bool| {
            let mut cusum = if slow {
                Cusum::with_frames_every(at(1_000))
            } else {
                Cusum::default()
            };
            (0..=30).for_each(|i| {
                cusum.add(at(100 * i), 1.75);
            });
            cusum.add(at(3_000 + pause_ms), 1.75)
        };
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9;
        assert!(close(drift_behind(500, false), 0.7));
        assert!(close(drift_behind(501, false), 0.6));
        assert!(close(drift_behind(2_000, false), 0.6));
        assert!(close(drift_behind(2_001, false), 0.0));
        assert!(close(drift_behind(600_000, false), 0.0));
        assert!(close(drift_behind(1_500, true), 0.9));
        assert!(close(drift_behind(1_501, true), 0.6));
    }
}
