//! How well the monitor keeps up: judged frames a second, and the time from frame to verdict.

use std::time::Duration;

use heapless::HistoryBuf;

/// Number of frames from which the figures are calculated.
const FRAMES: usize = 128;
/// The judged rate is that of the last second.
const RATE_SPAN: Duration = Duration::from_secs(1);

/// Figures of the last frames. Allocates nothing.
#[derive(Debug, Default)]
pub struct Timing {
    latencies: HistoryBuf<Duration, FRAMES>,
    judged_at: HistoryBuf<Duration, FRAMES>,
}

impl Timing {
    /// Records a frame: when it was taken, how long it took, and whether it could be judged.
    pub fn note(&mut self, at: Duration, latency: Duration, judged: bool) {
        self.latencies.write(latency);
        if judged {
            self.judged_at.write(at);
        }
    }

    /// Judged frames a second over the last second before `now`.
    #[allow(clippy::cast_precision_loss)]
    pub fn judged_rate_hz(&self, now: Duration) -> f64 {
        let recent = |at: &&Duration| now.saturating_sub(**at) < RATE_SPAN;
        self.judged_at.iter().filter(recent).count() as f64
    }

    /// The latency that a share of the last frames did not exceed; `None` before the first frame.
    #[allow(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )]
    pub fn latency(&self, share: f64) -> Option<Duration> {
        let mut sorted: heapless::Vec<Duration, FRAMES> = self.latencies.iter().copied().collect();
        sorted.sort_unstable();
        let last = sorted.len().checked_sub(1)?;
        sorted.get((share * last as f64).ceil() as usize).copied()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)]
    use super::*;

    #[test]
    fn rates_and_percentiles_of_the_last_frames() {
        let mut health = Timing::default();
        assert_eq!(health.latency(0.5), None);
        for i in 0..500_u64 {
            health.note(
                Duration::from_millis(100 * i),
                Duration::from_millis(i),
                i % 2 == 0,
            );
        }
        assert_eq!(health.judged_rate_hz(Duration::from_millis(49_900)), 5.0);
        // The last 128 latencies are 372..=499 ms.
        assert_eq!(health.latency(0.5), Some(Duration::from_millis(436)));
        assert_eq!(health.latency(0.99), Some(Duration::from_millis(498)));
    }
}
