//! Intervals by resampling whole scenes.

use crate::features::lane::Overlap;
use crate::statistics::bootstrap::{ROUNDS, percentile_interval};
use crate::statistics::random::SplitMix64;

/// 95 % percentile interval of the pooled intersection over union, from resampling scenes with replacement. It is the
/// same for the same scenes on every machine. `None` if there is no lane in any resample.
pub fn interval(scenes: &[Overlap]) -> Option<(f64, f64)> {
    let mut dice = SplitMix64::new(0);
    let ious = (0..ROUNDS)
        .filter_map(|_| Overlap::iou((0..scenes.len()).map(|_| scenes[dice.below(scenes.len())])))
        .collect();
    percentile_interval(ious)
}

/// Standard normal deviate above which 2.5 % are.
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
