//! Intervals by resampling whole scenes.

use crate::lane::Overlap;

/// Resamples drawn for an interval: the ends of a 95 % interval then rest on 25 each.
pub const ROUNDS: usize = 1_000;

/// 95 % percentile interval of the pooled intersection over union, from resampling scenes with replacement; the same for
/// the same scenes on every machine. `None` when no resample holds any lane.
pub fn interval(scenes: &[Overlap]) -> Option<(f64, f64)> {
    let mut dice = SplitMix64(0);
    let ious = (0..ROUNDS)
        .filter_map(|_| Overlap::iou((0..scenes.len()).map(|_| scenes[dice.below(scenes.len())])))
        .collect();
    percentile_interval(ious)
}

/// 95 % percentile interval of what resamples gave; `None` of none.
pub fn percentile_interval(mut values: Vec<f64>) -> Option<(f64, f64)> {
    values.sort_by(f64::total_cmp);
    let (low, high) = (values.len() * 25 / 1_000, values.len() * 975 / 1_000);
    Some((*values.get(low)?, *values.get(high.saturating_sub(1))?))
}

/// Standard normal deviate that 2.5 % lie above.
pub const Z: f64 = 1.959_963_985;

/// 95 % interval of a share (Wilson 1927).
#[allow(clippy::cast_precision_loss)]
pub fn binomial_interval(found: u64, all: u64) -> (f64, f64) {
    if all == 0 {
        return (0.0, 1.0);
    }
    let (n, p) = (all as f64, found as f64 / all as f64);
    let middle = p + Z * Z / (2.0 * n);
    let half = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    (
        ((middle - half) / scale).max(0.0),
        ((middle + half) / scale).min(1.0),
    )
}

/// Random numbers after Steele, Lea and Flood, *Fast Splittable Pseudorandom Number Generators* (2014).
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Numbers of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Uniform from 0 to 255.
    pub fn byte(&mut self) -> u8 {
        self.next().to_be_bytes()[0]
    }

    /// How often each of `count` things comes when as many are drawn with replacement.
    pub fn multiplicities(&mut self, count: usize) -> Vec<u32> {
        let mut times = vec![0; count];
        for _ in 0..count {
            times[self.below(count)] += 1;
        }
        times
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform from 0 to below `limit`.
    pub fn below(&mut self, limit: usize) -> usize {
        // The high half of a 64 by 64 bit product is below `limit`.
        #[allow(clippy::cast_possible_truncation)]
        {
            ((u128::from(self.next()) * limit as u128) >> 64) as usize
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn scenes_that_are_all_alike_leave_no_doubt() {
        let scenes = [Overlap { both: 3, either: 4 }; 9];
        assert_eq!(interval(&scenes), Some((0.75, 0.75)));
        assert_eq!(interval(&[]), None);
    }

    #[test]
    fn shares_have_wilsons_interval() {
        // Newcombe 1998: 81 of 263, 15 of 148, 0 of 20.
        for (found, all, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
        ] {
            let (l, h) = binomial_interval(found, all);
            assert!((l - low).abs() < 1e-4 && (h - high).abs() < 1e-4, "{l} {h}");
        }
    }

    #[test]
    fn the_interval_of_yes_and_no_is_that_of_the_binomial() {
        // 100 scenes of one pixel, half of them right: 0.5 +- 1.96 x 0.05.
        let scenes: Vec<Overlap> = (0..100)
            .map(|i| Overlap {
                both: i % 2,
                either: 1,
            })
            .collect();
        let (low, high) = interval(&scenes).unwrap();
        assert!(
            (low - 0.40).abs() <= 0.02 && (high - 0.60).abs() <= 0.02,
            "{low} {high}"
        );
    }
}
