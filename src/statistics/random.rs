//! Random numbers that are the same for the same seed on every machine.

/// Random numbers after Steele, Lea and Flood, *Fast Splittable Pseudorandom Number Generators* (2014).
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// A generator with a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Uniform from 0 to 255.
    pub fn byte(&mut self) -> u8 {
        self.bits().to_be_bytes()[0]
    }

    /// How often each of `count` items is drawn if `count` items are drawn with replacement.
    pub fn multiplicities(&mut self, count: usize) -> Vec<u32> {
        let mut times = vec![0; count];
        for _ in 0..count {
            times[self.below(count)] += 1;
        }
        times
    }

    /// Uniform over all numbers of 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform from 0 to `limit` - 1.
    pub fn below(&mut self, limit: usize) -> usize {
        // The high half of a 64 by 64 bit product is below `limit`.
        #[allow(clippy::cast_possible_truncation)]
        {
            ((u128::from(self.bits()) * limit as u128) >> 64) as usize
        }
    }
}
