//! Pictures of random pixels: the far end of every table of gaps.

use super::pixels::Pixels;
use super::{Frame, FrameSource, Picture, SourceError, time_of};

const SIZE: (u32, u32) = (320, 160);
const FPS: f64 = 10.0;

/// Uniform random RGB pixels, `random:seed=1&frames=60`.
pub struct RandomSource {
    state: u64,
    next: u64,
    count: u64,
}

impl RandomSource {
    pub fn parse(name: &str, spec: &str) -> Result<Self, SourceError> {
        let mut source = Self {
            state: 1,
            next: 0,
            count: 60,
        };
        for parameter in spec.split('&').filter(|p| !p.is_empty()) {
            let wrong = || SourceError::Name {
                found: name.to_owned(),
                wanted: format!("{parameter:?} is not seed=N or frames=1..100000"),
            };
            match parameter.split_once('=') {
                Some(("seed", value)) => source.state = value.parse().map_err(|_| wrong())?,
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

    /// SplitMix64 (Steele, Lea and Flood 2014).
    fn next_bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
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
            .flat_map(|_| self.next_bits().to_le_bytes())
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
