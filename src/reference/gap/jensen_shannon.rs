//! Jensen-Shannon divergence of two histograms.

use crate::capture::undefined::Undefined;

use super::shares::shares;

/// `JS = (KL(p | m) + KL(q | m)) / 2` with `m = (p + q) / 2` and logarithms of base 2: 0 to 1 bit, without the square
/// root and without smoothing (Lin 1991).
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count.
pub fn divergence_bits(a: &[u64], b: &[u64]) -> Result<f64, Undefined> {
    let mut bits = 0.0;
    for (p, q) in shares(a, b)? {
        let middle = 0.5 * (p + q);
        for share in [p, q] {
            if share > 0.0 {
                bits += 0.5 * share * (share / middle).log2();
            }
        }
    }
    Ok(bits.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn divergence_by_hand() {
        assert!((divergence_bits(&[5, 0], &[0, 9]).unwrap() - 1.0).abs() < 1e-15);
        // p = (1, 0), q = (1/2, 1/2), m = (3/4, 1/4): (log2(4/3) + (log2(2/3) + 1) / 2) / 2.
        let wanted = 0.5 * ((4.0_f64 / 3.0).log2() + 0.5 * ((2.0_f64 / 3.0).log2() + 1.0));
        assert!((divergence_bits(&[4, 0], &[3, 3]).unwrap() - wanted).abs() < 1e-15);
    }

    #[test]
    fn empty_histograms_are_undefined() {
        assert_eq!(
            divergence_bits(&[0, 0], &[0, 9]),
            Err(Undefined::EmptyHistogram)
        );
    }
}
