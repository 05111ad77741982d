//! Pictures of random pixels, which have the largest gap in every table.

use super::pixels::Pixels;
use super::{Frame, FrameSource, Picture, SourceError, time_of};
use crate::statistics::random::SplitMix64;

const SIZE: (u32, u32) = (320, 160);
const FPS: f64 = 10.0;

/// Uniform random RGB pixels, `random:seed=1&frames=60`.
pub struct RandomSource {
    random: SplitMix64,
    next: u64,
    count: u64,
}

impl RandomSource {
    pub fn parse(name: &str, spec: &str) -> Result<Self, SourceError> {
        let mut source = Self {
            random: SplitMix64::new(1),
            next: 0,
            count: 60,
        };
        for parameter in spec.split('&').filter(|p| !p.is_empty()) {
            let wrong = || SourceError::Name {
                found: name.to_owned(),
                wanted: format!("{parameter:?} is not seed=N or frames=1..100000"),
            };
            match parameter.split_once('=') {
                Some(("seed", value)) => {
                    source.random = SplitMix64::new(value.parse().map_err(|_| wrong())?);
                }
                Some(("frames", value)) => {
                    source.count = value
                        .parse()
                        .ok()
                        .filter(|n| (1..=100_000).contains(n))
                        .ok_or_else(wrong)?;
                }
                _ => return Err(wrong()),
            }
        }
        Ok(source)
    }
}

impl FrameSource for RandomSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        if self.next == self.count {
            return Ok(None);
        }
        let (sequence, captured_at) = (self.next, time_of(self.next, FPS));
        self.next += 1;
        let bytes = SIZE.0 as usize * SIZE.1 as usize * 3;
        let rgb = (0..bytes.div_ceil(8))
            .flat_map(|_| self.random.bits().to_le_bytes())
            .take(bytes)
            .collect();
        Ok(Some(Frame {
            sequence,
            captured_at,
            picture: Ok(Pixels::from(Picture {
                width: SIZE.0,
                height: SIZE.1,
                rgb,
            })),
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.count)
    }
}
