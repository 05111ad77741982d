//! Times of frames in a file → time since the first frame, which always increases.

use std::time::Duration;

/// A time that lies further back than this, or further ahead than `AHEAD_MAX`, belongs to another clock: files were put
/// behind each other, or the stamp is wrong. Our own choices.
const BACK_MAX: i64 = 1_000_000;
const AHEAD_MAX: i64 = 3_600_000_000;
/// How much later than the frame before a frame is placed whose own time is not later, microseconds.
const NUDGE: i64 = 1;

/// Places frames. All numbers are microseconds.
#[derive(Debug)]
pub struct Timeline {
    /// Time from one frame to the next, where a frame has no time that can be used.
    period: i64,
    /// What is subtracted from the times of the file.
    offset: i64,
    last: Option<i64>,
    corrected: u64,
}

impl Timeline {
    /// For a file with about `fps` frames a second.
    pub fn new(fps: f64) -> Self {
        let period = Duration::from_secs_f64(1.0 / fps).as_micros();
        Self {
            period: i64::try_from(period).unwrap_or(i64::MAX).max(NUDGE),
            offset: 0,
            last: None,
            corrected: 0,
        }
    }

    /// The number of frames whose own time was not used.
    pub fn corrected(&self) -> u64 {
        self.corrected
    }

    /// The time of the next frame: its own, or one behind the frame before if its own is missing or does not follow.
    pub fn place(&mut self, own: Option<i64>) -> Duration {
        let at = match (self.last, own) {
            (None, own) => {
                self.offset = own.unwrap_or(0);
                0
            }
            (Some(last), None) => {
                self.corrected += 1;
                last.saturating_add(self.period)
            }
            (Some(last), Some(own)) => {
                let at = own.saturating_sub(self.offset);
                let step = at.saturating_sub(last);
                if (1..=AHEAD_MAX).contains(&step) {
                    at
                } else if (-BACK_MAX..=0).contains(&step) {
                    self.corrected += 1;
                    last.saturating_add(NUDGE)
                } else {
                    self.corrected += 1;
                    let at = last.saturating_add(self.period);
                    self.offset = own.saturating_sub(at);
                    at
                }
            }
        };
        self.last = Some(at);
        Duration::from_micros(u64::try_from(at).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(own: &[Option<i64>]) -> (Vec<u128>, u64) {
        let mut timeline = Timeline::new(10.0);
        let times = own.iter().map(|&own| timeline.place(own).as_micros());
        (times.collect(), timeline.corrected())
    }

    #[test]
    fn frames_keep_their_own_times_from_the_first_on() {
        let (times, corrected) = placed(&[-40_000, 0, 33_333, 5_000_000].map(Some));
        assert_eq!((times, corrected), (vec![0, 40_000, 73_333, 5_040_000], 0));
    }

    #[test]
    fn a_frame_without_a_time_that_follows_lies_behind_the_one_before() {
        let own = [Some(0), None, Some(200_000), Some(200_000), Some(100_000)];
        let (times, corrected) = placed(&[&own[..], &[Some(300_000)]].concat());
        assert_eq!(times, [0, 100_000, 200_000, 200_001, 200_002, 300_000]);
        assert_eq!(corrected, 3);
    }

    #[test]
    fn another_clock_goes_on_a_frame_later() {
        let day = 86_400_000_000;
        let (times, corrected) =
            placed(&[0, 100_000, day, day + 50_000, 7, 100_007, i64::MIN].map(Some));
        assert_eq!(
            times,
            [0, 100_000, 200_000, 250_000, 350_000, 450_000, 550_000]
        );
        assert_eq!(corrected, 3);
    }
}
