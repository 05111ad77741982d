//! First Wasserstein distance of two histograms.

use crate::capture::undefined::Undefined;

use super::shares::shares;

/// `W1 = sum |P - Q| / (bins - 1)` of cumulated shares `P` and `Q`: the mean distance by which a pixel is moved, as a
/// share of the distance from the first bin to the last, 0 to 1. Bins count as evenly spaced, whatever their edges are.
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count.
#[allow(clippy::cast_precision_loss)]
pub fn distance(a: &[u64], b: &[u64]) -> Result<f64, Undefined> {
    let mut ahead = 0.0;
    let moved: f64 = shares(a, b)?
        .map(|(p, q)| {
            ahead += p - q;
            f64::abs(ahead)
        })
        .sum();
    Ok((moved / (a.len().max(2) - 1) as f64).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn distance_by_hand() {
        // Everything moves by one of two steps.
        assert!((distance(&[1, 1, 0], &[0, 3, 3]).unwrap() - 0.5).abs() < 1e-15);
        assert!((distance(&[5, 0, 0], &[0, 0, 1]).unwrap() - 1.0).abs() < 1e-15);
        assert_eq!(distance(&[0, 0], &[0, 1]), Err(Undefined::EmptyHistogram));
    }
}
