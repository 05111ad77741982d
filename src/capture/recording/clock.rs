//! Time stamps of images → time since the source began.

use std::time::Duration;

/// A longer step from one image to the next counts as a wrong time stamp.
const STEP_MAX: Duration = Duration::from_secs(3_600);
/// A stamp that lies further back than this, or further ahead of the time of recording than the stamps before, comes
/// from a clock that has been set. A smaller step back is an image out of order. Our own choice.
const SET_MIN: Duration = Duration::from_secs(1);

/// The stamps are too coarse for a clock if this many images have the same time as the image before. The count begins
/// anew after `MOVING` images in a row that do not. Our own choice.
const STILL_MAX: u32 = 3;
const MOVING: u32 = 10;

/// Places images by their own stamps where these can be used, and by the time of recording otherwise.
#[derive(Default)]
pub struct Clock {
    /// The first image's time since the epoch of the recording.
    began_at: Option<Duration>,
    /// Whether the images' own times are used; otherwise the times at which they were recorded are used.
    own: bool,
    /// Number of images that have the stamp of the image before although they were recorded later, and how many other
    /// images have followed since.
    still: u32,
    moving: u32,
    /// A stamp, and where it was placed: stamps that follow are placed as far behind it as they are later.
    anchor: (Duration, Duration),
    last_stamp: Duration,
    last_log_time: Duration,
    last: Duration,
    /// The smallest time from a stamp to the recording of its image, nanoseconds; clocks may differ, so it may be
    /// negative.
    delay_min: i128,
    /// A clock that was set has been reported.
    told: bool,
}

impl Clock {
    /// When the source began; known after the first image.
    pub fn began_at(&self) -> Option<Duration> {
        self.began_at
    }

    /// The time of an image with the stamp `own`; `None` or zero if it has none.
    ///
    /// An image without a stamp, or with the stamp of the image before, comes as long after the image before as it was
    /// recorded later; so does an image whose clock has just been set, and time continues from there. An image out of
    /// order gets the time of the image before, which the monitor treats as a fault of the camera. If stamps often stay
    /// the same, they are no clock: from then on, the time of recording is used.
    pub fn place(&mut self, log_time: Duration, own: Option<Duration>) -> Duration {
        let own = own.filter(|stamp| !stamp.is_zero());
        if self.began_at.is_none() {
            self.own = own.is_some();
            let began = own.unwrap_or(log_time);
            (self.began_at, self.anchor) = (Some(began), (began, Duration::ZERO));
            self.delay_min = delay(began, log_time);
            (self.last_stamp, self.last_log_time) = (began, log_time);
            return Duration::ZERO;
        }
        let recorded_later = log_time.saturating_sub(self.last_log_time);
        if self.own && !recorded_later.is_zero() {
            self.watch_stamps(own);
        }
        let by_recording = self.last + recorded_later.min(STEP_MAX);
        let at = match own.filter(|_| self.own) {
            Some(stamp) if stamp != self.last_stamp => {
                self.by_stamp(stamp, log_time, recorded_later, by_recording)
            }
            _ => by_recording,
        };
        self.last_log_time = log_time;
        self.last = at;
        at
    }

    fn by_stamp(
        &mut self,
        stamp: Duration,
        log_time: Duration,
        recorded_later: Duration,
        by_recording: Duration,
    ) -> Duration {
        let before = std::mem::replace(&mut self.last_stamp, stamp);
        let step = stamp.saturating_sub(before);
        let is_ahead = delay(stamp, log_time) + nanos(SET_MIN) < self.delay_min
            && step > recorded_later + SET_MIN
            && !recorded_later.is_zero();
        let was_set = is_ahead || step > STEP_MAX || before.saturating_sub(stamp) >= SET_MIN;
        if was_set {
            if !std::mem::replace(&mut self.told, true) {
                log::warn!(
                    "the clock of the stamps was set from {:.3} s to {:.3} s; images keep the distance in which they were recorded",
                    before.as_secs_f64(),
                    stamp.as_secs_f64()
                );
            }
            self.anchor = (stamp, by_recording);
            self.delay_min = delay(stamp, log_time);
            return by_recording;
        }
        self.delay_min = self.delay_min.min(delay(stamp, log_time));
        if stamp < before {
            return self.last;
        }
        let (anchor, placed) = self.anchor;
        let at =
            (placed + stamp.saturating_sub(anchor)).saturating_sub(anchor.saturating_sub(stamp));
        match at > self.last {
            true => at,
            // Images before it were placed by the time of recording, and a little late.
            false => by_recording,
        }
    }

    fn watch_stamps(&mut self, own: Option<Duration>) {
        if own == Some(self.last_stamp) {
            (self.still, self.moving) = (self.still + 1, 0);
        } else {
            self.moving += 1;
        }
        if self.moving >= MOVING {
            self.still = 0;
        }
        if self.still >= STILL_MAX {
            log::warn!(
                "the stamps of images often do not increase; from now on the time of recording is used"
            );
            self.own = false;
        }
    }
}

fn nanos(duration: Duration) -> i128 {
    i128::try_from(duration.as_nanos()).unwrap_or(i128::MAX)
}

/// Time from a stamp to the recording of its image, nanoseconds.
fn delay(stamp: Duration, log_time: Duration) -> i128 {
    nanos(log_time) - nanos(stamp)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)]
    use super::*;

    /// Times in seconds of images that were recorded every 0.1 s, from their stamps.
    fn placed(stamps: &[Option<f64>]) -> Vec<f64> {
        let mut clock = Clock::default();
        let images = (0_u32..).zip(stamps);
        let times = images.map(|(number, stamp)| {
            let log_time = Duration::from_secs(5_000) + number * Duration::from_millis(100);
            clock.place(log_time, stamp.map(Duration::from_secs_f64))
        });
        times
            .map(|time| (time.as_secs_f64() * 1e6).round() / 1e6)
            .collect()
    }

    #[test]
    fn time_goes_on_after_a_wrong_stamp() {
        let placed = placed(&[
            Some(1000.0),
            Some(1000.1),
            // An image that cannot be read.
            None,
            Some(1000.3),
            // A time far ahead, and then back.
            Some(2e9),
            Some(2e9 + 0.1),
            Some(1000.6),
            Some(1000.7),
        ]);
        assert_eq!(placed, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]);
    }

    #[test]
    fn a_clock_that_is_set_moves_no_image() {
        let step = |number: u32| 100.0 + 0.1 * f64::from(number);
        let wanted: Vec<f64> = (0..40).map(|number| f64::from(number) / 10.0).collect();
        for set_by in [-5.0, 4.0, 1e9] {
            let stamps = (0..40).map(|n| Some(step(n) + if n > 19 { set_by } else { 0.0 }));
            assert_eq!(placed(&stamps.collect::<Vec<_>>()), wanted, "{set_by}");
        }
    }

    #[test]
    fn a_pause_of_the_camera_stays_a_pause_when_the_disk_was_late() {
        // The recorder stops from 1 s to 6 s, then writes the ten images that it has kept, and one of the present.
        let mut clock = Clock::default();
        let mut place = |log_s: f64, own_s: f64| {
            let at = clock.place(
                Duration::from_secs_f64(log_s),
                Some(Duration::from_secs_f64(1_000.0 + own_s)),
            );
            (at.as_secs_f64() * 1e6).round() / 1e6
        };
        for number in 0..=10 {
            let at = 0.1 * f64::from(number);
            assert!((place(50.0 + at, at) - at).abs() < 1e-6);
        }
        for number in 11..=20 {
            let at = 0.1 * f64::from(number);
            assert!((place(56.0 + 0.001 * f64::from(number), at) - at).abs() < 1e-6);
        }
        assert_eq!([place(56.1, 6.1), place(56.2, 6.2)], [6.1, 6.2]);
    }

    #[test]
    fn an_image_out_of_order_has_the_time_of_the_one_before() {
        let stamps = [7.0, 7.1, 7.3, 7.2, 7.4].map(Some);
        assert_eq!(placed(&stamps), [0.0, 0.1, 0.3, 0.3, 0.4]);
    }

    #[test]
    fn images_without_a_stamp_lie_where_they_were_recorded() {
        assert_eq!(placed(&[Some(0.0); 3]), [0.0, 0.1, 0.2]);
        assert_eq!(placed(&[None, Some(9.0), Some(9.5)]), [0.0, 0.1, 0.2]);
        assert_eq!(placed(&[Some(9.0), Some(0.0), Some(9.2)]), [0.0, 0.1, 0.2]);
        let mut clock = Clock::default();
        clock.place(Duration::from_millis(500), Some(Duration::ZERO));
        assert_eq!(clock.began_at(), Some(Duration::from_millis(500)));
    }

    /// Times of images at 10 and 2 a second whose stamps are whole seconds.
    #[test]
    fn stamps_too_coarse_to_be_a_clock_are_left_for_the_time_of_recording() {
        for period in [100, 500] {
            let mut clock = Clock::default();
            let placed: Vec<Duration> = (0..100)
                .map(|n| {
                    let recorded = Duration::from_millis(1_500_000 + period * n);
                    clock.place(recorded, Some(Duration::from_secs(recorded.as_secs())))
                })
                .collect();
            let mut steps = placed.windows(2).map(|pair| pair[1] - pair[0]);
            assert!(
                steps.all(|step| step == Duration::from_millis(period)),
                "{placed:?}"
            );
        }
    }

    #[test]
    fn an_image_that_bears_the_stamp_of_the_one_before_lies_where_it_was_recorded() {
        let mut clock = Clock::default();
        let ms = Duration::from_millis;
        for n in 0..200 {
            let stamp = if n % 20 == 7 { n - 1 } else { n };
            let placed = clock.place(ms(1_000 + 100 * n), Some(ms(5_000 + 100 * stamp)));
            assert_eq!(placed, ms(100 * n));
        }
        assert!(clock.own);
    }
}
