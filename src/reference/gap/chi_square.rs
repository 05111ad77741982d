//! Chi-square distance of two histograms.

use crate::capture::undefined::Undefined;

use super::shares::shares;

/// `chi2 = 1/2 sum (p - q)^2 / (p + q)` over the bins that are not empty in both, with shares `p` and `q`: 0 to 1,
/// symmetric.
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count.
pub fn distance(a: &[u64], b: &[u64]) -> Result<f64, Undefined> {
    let sum: f64 = shares(a, b)?
        .filter(|(p, q)| p + q > 0.0)
        .map(|(p, q)| (p - q) * (p - q) / (p + q))
        .sum();
    Ok((0.5 * sum).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn distance_by_hand() {
        // p = (1, 0), q = (1/2, 1/2): (1/4 / (3/2) + 1/4 / (1/2)) / 2 = (1/6 + 1/2) / 2.
        assert!((distance(&[3, 0], &[2, 2]).unwrap() - 1.0 / 3.0).abs() < 1e-15);
        assert!((distance(&[3, 0], &[0, 1]).unwrap() - 1.0).abs() < 1e-15);
        // A bin that is empty in both does not count.
        assert!((distance(&[0, 3, 0], &[0, 2, 2]).unwrap() - 1.0 / 3.0).abs() < 1e-15);
        assert_eq!(distance(&[0, 0], &[0, 1]), Err(Undefined::EmptyHistogram));
    }
}
