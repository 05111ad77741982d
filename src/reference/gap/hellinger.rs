//! Hellinger distance of two histograms.

use crate::capture::undefined::Undefined;

use super::shares::shares;

/// `H = sqrt(1/2 sum (sqrt p - sqrt q)^2)` of shares `p` and `q`: 0 to 1. This form, unlike `sqrt(1 - sum sqrt(p q))`,
/// does not lose precision for histograms that are almost equal.
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count.
pub fn distance(a: &[u64], b: &[u64]) -> Result<f64, Undefined> {
    let sum: f64 = shares(a, b)?
        .map(|(p, q)| (p.sqrt() - q.sqrt()).powi(2))
        .sum();
    Ok((0.5 * sum).sqrt().clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn distance_by_hand() {
        // p = (1, 0), q = (1/2, 1/2): 1 - sum sqrt(p q) = 1 - sqrt(1/2).
        let wanted = (1.0 - 0.5_f64.sqrt()).sqrt();
        assert!((distance(&[3, 0], &[2, 2]).unwrap() - wanted).abs() < 1e-15);
        assert!((distance(&[3, 0], &[0, 1]).unwrap() - 1.0).abs() < 1e-15);
        assert_eq!(distance(&[0, 0], &[0, 1]), Err(Undefined::EmptyHistogram));
    }

    #[test]
    fn histograms_that_differ_by_one_in_a_billion_are_told_apart() {
        let n = 1_000_000_000;
        let found = distance(&[n, n], &[n + 1, n - 1]).unwrap();
        // sqrt(1/2 * 2 * (d / (2 sqrt p))^2) with d = 1 / 2n and p = 1/2.
        let wanted = 0.5e-9 / (2.0 * 0.5_f64.sqrt());
        assert!((found / wanted - 1.0).abs() < 1e-6, "{found}");
    }
}
