//! Frames over time → whether the camera is to be believed, before anything is judged by them.
//!
//! Owns what no road makes: a picture that does not change by a single bit, and a lens that is black over more than half of
//! its area. Refuses to judge light and weather: night, fog, rain, glare, blur and dirt are gaps, and a fault would hide
//! them; a test holds it to that on rendered drives.

use std::time::Duration;

use crate::frame::{Frame, Picture};
use crate::undefined::Undefined;

/// A picture that stays the same for this long is frozen: the noise of a sensor changes every frame. The alarm waits as
/// long again. Our own choice.
const FROZEN: Duration = Duration::from_millis(500);
/// Blocks across and down, for the share of the lens that is covered.
const BLOCKS: (usize, usize) = (16, 8);
/// A block whose brightest value is at most this is covered, as a whole picture is black.
const BLACK_MAX: u8 = 8;
/// More of the blocks than this share, and the lens is covered.
const COVERED_PERCENT: u8 = 50;

/// Remembers the last picture.
#[derive(Debug, Default)]
pub struct CameraHealth {
    last: Vec<u8>,
    /// When the last picture was first seen.
    since: Duration,
}

impl CameraHealth {
    /// Whether a frame may be judged. A frame without picture is not looked at.
    ///
    /// # Errors
    /// `Frozen` or `Covered`.
    pub fn check(&mut self, frame: &Frame) -> Result<(), Undefined> {
        let Ok(picture) = &frame.picture else {
            return Ok(());
        };
        if picture.rgb == self.last {
            let still = frame.captured_at.saturating_sub(self.since);
            // A picture of one colour has its own name.
            let uniform = || {
                let mut pixels = picture.rgb.chunks_exact(3);
                pixels.all(|pixel| pixel == &picture.rgb[..3])
            };
            if still >= FROZEN && !uniform() {
                return Err(Undefined::Frozen(still));
            }
        } else {
            self.last.clone_from(&picture.rgb);
            self.since = frame.captured_at;
        }
        let percent = covered_percent(picture);
        // All of it is black, which is said by its own name.
        if percent > COVERED_PERCENT && percent < 100 {
            return Err(Undefined::Covered { percent });
        }
        Ok(())
    }
}

/// Share of the blocks that are black, rounded up.
fn covered_percent(picture: &Picture) -> u8 {
    let (across, down) = BLOCKS;
    let (width, height) = (picture.width as usize, picture.height as usize);
    if width < across || height < down || picture.rgb.len() != 3 * width * height {
        return 0;
    }
    let mut brightest = vec![0_u8; across * down];
    for (y, row) in picture.rgb.chunks_exact(3 * width).enumerate() {
        let blocks = &mut brightest[y * down / height * across..][..across];
        for (column, block) in blocks.iter_mut().enumerate() {
            let (from, to) = (column * width / across, (column + 1) * width / across);
            let highest = row[3 * from..3 * to].iter().max();
            *block = (*block).max(highest.copied().unwrap_or(0));
        }
    }
    let black = brightest.iter().filter(|&&value| value <= BLACK_MAX);
    u8::try_from((100 * black.count()).div_ceil(brightest.len())).unwrap_or(100)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::frame::open;

    fn frame(millis: u64, value: impl Fn(u32, u32) -> u8) -> Frame {
        let (width, height) = (64, 32);
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| [value(x, y); 3])
            .collect();
        Frame {
            sequence: millis / 100,
            captured_at: Duration::from_millis(millis),
            picture: Ok(Picture { width, height, rgb }),
        }
    }

    #[test]
    fn a_picture_that_stays_the_same_for_half_a_second_is_frozen_until_it_changes() {
        let mut health = CameraHealth::default();
        let still = |millis| frame(millis, |x, _| 100 + u8::try_from(x).unwrap());
        for millis in (0..500).step_by(100) {
            assert_eq!(health.check(&still(millis)), Ok(()), "{millis} ms");
        }
        for millis in [500, 600, 5_000] {
            let frozen = Undefined::Frozen(Duration::from_millis(millis));
            assert_eq!(health.check(&still(millis)), Err(frozen));
        }
        let moved = frame(5_100, |x, y| u8::from(x + y == 3) + 100);
        assert_eq!(health.check(&moved), Ok(()));
        assert_eq!(health.check(&still(5_200)), Ok(()));
    }

    #[test]
    fn a_lens_is_covered_when_more_than_half_of_it_is_black() {
        let covered_to = |millis, edge| {
            frame(millis, move |x, y| {
                if x < edge {
                    5
                } else {
                    u8::try_from(60 + x + y).unwrap()
                }
            })
        };
        let mut health = CameraHealth::default();
        assert_eq!(health.check(&covered_to(0, 0)), Ok(()));
        assert_eq!(health.check(&covered_to(100, 32)), Ok(()));
        assert_eq!(
            health.check(&covered_to(200, 36)),
            Err(Undefined::Covered { percent: 57 })
        );
    }

    #[test]
    fn weather_light_and_dirt_up_to_severity_4_are_no_fault() {
        for kind in [
            "night", "fog", "rain", "glare", "blur", "dirt", "snow", "tunnel",
        ] {
            for look in ["sim", "sim-realistic", "game"] {
                let name = format!("scene:{look}?seed=5&seconds=1&fps=10&condition={kind}:4");
                let mut source = open(&name).unwrap();
                let mut health = CameraHealth::default();
                while let Some(frame) = source.next_frame().unwrap() {
                    assert_eq!(health.check(&frame), Ok(()), "{name}");
                    let percent = covered_percent(frame.picture.as_ref().unwrap());
                    assert!(percent < 25, "{name}: {percent} % of the blocks are black");
                }
            }
        }
    }
}
