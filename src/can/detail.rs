//! The details of a verdict: message `GapDetail`, only on buses with CAN FD.
//!
//! It defines the message and its cycle. It does not wait: a frame that the bus does not accept is dropped, because the
//! next frame is newer.

use std::time::Duration;

use super::e2e::E2eSender;
use super::generated;
use super::message::steps;
use super::{CanSettings, SinkError, WarningSink};
use crate::features::image_quality::ImageQuality;

/// Bytes of the message.
pub const LENGTH: usize = 24;
/// A share of 1 on the bus.
const SHARE_STEP: f64 = 0.005;
/// Largest code of a share; the next one means not available.
const LARGEST: u8 = 254;
const NOT_AVAILABLE: u8 = 255;
const FINE_SCORE_STEP: f64 = 0.001;
/// Code of a fine score that is not available.
const NO_SCORE: i16 = i16::MIN;

/// The details of a verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GapDetail {
    /// Frames in the detector's window; on the bus at most 254.
    pub window_frames: Option<usize>,
    /// Index in the reference of the nominal domain that is nearest to the window, from 0; on the bus at most 254.
    pub nominal_domain: Option<usize>,
    /// How far the scores have added up; 1 is a drift.
    pub drift: Option<f64>,
    /// How good the picture was. Shares of 1, on the bus 0 to 127 % in steps of 0.5 %.
    pub quality: Option<ImageQuality>,
    /// Similarity of each tap, 1 for equal.
    pub similarities: [Option<f64>; 3],
    /// Score of each tap, in finer steps than in `GapStatus` and also below 0: -32.767 to 32.767.
    pub scores: [Option<f64>; 3],
}

impl GapDetail {
    /// The bytes of the frame, counter and CRC 0. Never panics, whatever the numbers are.
    pub fn to_bytes(&self) -> [u8; LENGTH] {
        let mut message = generated::GapDetail::try_from([0; LENGTH].as_slice())
            .expect("a message of its length");
        let count = |count: Option<usize>| {
            count.map_or(NOT_AVAILABLE, |n| {
                u8::try_from(n).unwrap_or(LARGEST).min(LARGEST)
            })
        };
        let share = |value| steps(value, SHARE_STEP, LARGEST);
        let quality = |of: fn(&ImageQuality) -> f64| share(self.quality.as_ref().map(of));
        message.set_window_frames_raw_val(count(self.window_frames));
        message.set_nominal_domain_raw_val(count(self.nominal_domain));
        message.set_drift_raw_val(share(self.drift));
        message.set_brightness_raw_val(quality(|q| q.brightness));
        message.set_contrast_raw_val(quality(|q| q.contrast));
        message.set_clipped_raw_val(quality(|q| q.clipped));
        message.set_sharpness_raw_val(quality(|q| q.sharpness));
        let [tap1, tap2, tap3] = self.similarities.map(share);
        message.set_similarity_tap1_raw_val(tap1);
        message.set_similarity_tap2_raw_val(tap2);
        message.set_similarity_tap3_raw_val(tap3);
        let [tap1, tap2, tap3] = self.scores.map(fine);
        message.set_fine_score_tap1_raw_val(tap1);
        message.set_fine_score_tap2_raw_val(tap2);
        message.set_fine_score_tap3_raw_val(tap3);
        *message.raw()
    }
}

/// Nearest number of steps; NaN and `None` are not available.
#[expect(clippy::cast_possible_truncation)]
fn fine(score: Option<f64>) -> i16 {
    let largest = f64::from(i16::MAX);
    match score {
        Some(score) if !score.is_nan() => {
            (score / FINE_SCORE_STEP).round().clamp(-largest, largest) as i16
        }
        _ => NO_SCORE,
    }
}

/// Sends the newest [`GapDetail`] once in a period.
pub struct DetailSender {
    id: u16,
    period: Duration,
    e2e: E2eSender<LENGTH>,
    next: Duration,
}

impl DetailSender {
    /// `None` when the settings do not ask for it.
    pub fn new(settings: &CanSettings) -> Option<Self> {
        settings.fd.then(|| Self {
            id: settings.detail.id,
            period: settings.detail_period,
            e2e: E2eSender::new(settings.detail.data_id),
            next: Duration::ZERO,
        })
    }

    /// Sends `detail` if it is due.
    ///
    /// # Errors
    /// The refusal of the sink.
    pub fn poll(
        &mut self,
        now: Duration,
        detail: &GapDetail,
        sink: &mut dyn WarningSink,
    ) -> Result<(), SinkError> {
        if now < self.next || !sink.is_ready(now) {
            return Ok(());
        }
        self.next = (self.next + self.period).max(now + self.period / 2);
        let id = self.id;
        let send = |data: [u8; LENGTH]| sink.send_fd(now, id, &data);
        self.e2e.protect(detail.to_bytes(), send)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::can::CanFrame;
    use crate::can::e2e::{E2eReceiver, Sequence};

    const DETAIL: GapDetail = GapDetail {
        window_frames: Some(10),
        nominal_domain: Some(0),
        drift: Some(0.25),
        quality: Some(ImageQuality {
            brightness: 0.5,
            contrast: 0.2,
            clipped: 0.0,
            sharpness: 0.1,
        }),
        similarities: [Some(1.0), Some(0.005), None],
        scores: [Some(1.0), Some(-0.002), None],
    };

    #[test]
    fn detail_has_the_bytes_computed_by_hand() {
        let shares = [50, 100, 40, 0, 20, 200, 1, 255];
        let scores = [0xE8, 0x03, 0xFE, 0xFF, 0x00, 0x80];
        let wanted = [&[0, 0, 10, 0], &shares[..], &scores[..], &[0; 6]].concat();
        assert_eq!(DETAIL.to_bytes()[..], wanted);
        let nothing = GapDetail::default().to_bytes();
        assert_eq!(nothing[2..12], [255; 10]);
    }

    #[test]
    fn numbers_out_of_range_are_the_largest_and_nan_is_not_available() {
        let mut detail = DETAIL;
        detail.window_frames = Some(usize::MAX);
        detail.drift = Some(f64::NAN);
        detail.scores = [Some(f64::INFINITY), Some(-1e9), Some(f64::NAN)];
        let bytes = detail.to_bytes();
        assert_eq!((bytes[2], bytes[4]), (254, 255));
        assert_eq!(bytes[12..18], [0xFF, 0x7F, 0x01, 0x80, 0x00, 0x80]);
    }

    /// Accepts every second frame.
    #[derive(Default)]
    struct Bus {
        offered: usize,
        taken: Vec<(Duration, Vec<u8>)>,
    }

    impl WarningSink for Bus {
        fn send(&mut self, _: Duration, _: &CanFrame) -> Result<(), SinkError> {
            unreachable!("a classic frame");
        }

        fn send_fd(&mut self, at: Duration, id: u16, data: &[u8]) -> Result<(), SinkError> {
            assert_eq!(id, 0x5D2);
            self.offered += 1;
            if self.offered.is_multiple_of(2) {
                return Err(SinkError::Refused {
                    sink: "bus".to_owned(),
                    source: std::io::ErrorKind::NetworkDown.into(),
                });
            }
            self.taken.push((at, data.to_vec()));
            Ok(())
        }
    }

    #[test]
    fn what_the_bus_takes_comes_once_a_second_and_its_counter_has_no_hole() {
        let settings = CanSettings {
            fd: true,
            ..CanSettings::default()
        };
        let mut sender = DetailSender::new(&settings).unwrap();
        let mut bus = Bus::default();
        for ms in (0..10_000).step_by(10) {
            let _ = sender.poll(Duration::from_millis(ms), &DETAIL, &mut bus);
        }
        assert_eq!((bus.offered, bus.taken.len()), (10, 5));
        let mut receiver = E2eReceiver::<LENGTH>::new(0x5D2);
        for (n, (at, data)) in bus.taken.iter().enumerate() {
            assert_eq!(*at, Duration::from_secs(2 * n as u64));
            let sequence = receiver.check(data.as_slice().try_into().unwrap());
            let wanted = if n == 0 {
                Sequence::First
            } else {
                Sequence::Next
            };
            assert_eq!(sequence, Ok(wanted));
        }
        assert!(DetailSender::new(&CanSettings::default()).is_none());
    }
}
