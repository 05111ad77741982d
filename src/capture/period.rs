//! How often a frame is wanted.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// The time from one frame to the next that the judge wants now; the camera reads it.
#[derive(Debug)]
pub struct WantedPeriod(AtomicU64);

impl WantedPeriod {
    /// Begins with this period.
    pub fn new(period: Duration) -> Self {
        let wanted = Self(AtomicU64::new(0));
        wanted.set(period);
        wanted
    }

    /// Sets the period from now on.
    pub fn set(&self, period: Duration) {
        let nanos = u64::try_from(period.as_nanos()).unwrap_or(u64::MAX);
        self.0.store(nanos, Ordering::Relaxed);
    }

    /// The present period.
    pub fn get(&self) -> Duration {
        Duration::from_nanos(self.0.load(Ordering::Relaxed))
    }
}

/// Chooses frames at a wanted rate from frames that come at another rate.
#[derive(Debug, Default)]
pub struct Pace {
    /// Time of the last chosen frame on the grid of wanted times.
    last: Option<Duration>,
}

impl Pace {
    /// Whether a frame at `now` is wanted, if frames are wanted every `period`.
    pub fn is_due(&mut self, now: Duration, period: Duration) -> bool {
        // Frames do not come exactly at these times: a quarter of a period too early is on time.
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
    fn a_pace_keeps_its_rate_and_changes_it_within_a_frame() {
        let mut pace = Pace::default();
        let mut chosen = |from: u32, to: u32, period: u32| {
            let frames = (from..to).map(|n| n * 33 * MS);
            let due = frames.filter(|&at| pace.is_due(at, period * MS));
            due.map(|at| at.as_millis()).collect::<Vec<u128>>()
        };
        assert_eq!(chosen(0, 31, 100).len(), 11);
        assert_eq!(chosen(31, 91, 500).len(), 4);
        // The last time on the grid was 3.0 s.
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
