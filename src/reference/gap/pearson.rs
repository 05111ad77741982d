//! Pearson's correlation of two histograms.

use crate::capture::undefined::Undefined;

/// `r = sum (a - mean a)(b - mean b) / sqrt(sum (a - mean a)^2 * sum (b - mean b)^2)` over the bins, -1..1.
///
/// # Errors
/// `EmptyHistogram` if a histogram has no count, `ConstantHistogram` if all bins of one are equal. (OpenCV's
/// `HISTCMP_CORREL` has the same formula, but returns 1 in this case.)
pub fn correlation(a: &[u64], b: &[u64]) -> Result<f64, Undefined> {
    let (da, db) = (deviations(a)?, deviations(b)?);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().map(|&n| da.of(n)).zip(b.iter().map(|&n| db.of(n))) {
        ab += x * y;
        aa += x * x;
        bb += y * y;
    }
    Ok((ab / (aa * bb).sqrt()).clamp(-1.0, 1.0))
}

/// A histogram as shares of its total, minus their mean, so that totals of any size correlate without overflow.
struct Deviations {
    total: f64,
    mean: f64,
}

#[allow(clippy::cast_precision_loss)]
impl Deviations {
    fn of(&self, count: u64) -> f64 {
        count as f64 / self.total - self.mean
    }
}

#[allow(clippy::cast_precision_loss)]
fn deviations(counts: &[u64]) -> Result<Deviations, Undefined> {
    let total: u64 = counts.iter().sum();
    if total == 0 {
        return Err(Undefined::EmptyHistogram);
    }
    if counts.iter().all(|count| count == &counts[0]) {
        return Err(Undefined::ConstantHistogram);
    }
    Ok(Deviations {
        total: total as f64,
        mean: 1.0 / counts.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_papers_formula_by_hand() {
        // a = (1, 2, 3), b = (1, 3, 2): deviations (-1, 0, 1) and (-1, 1, 0); r = 1 / sqrt(2 * 2) = 0.5.
        assert!((correlation(&[1, 2, 3], &[1, 3, 2]).unwrap() - 0.5).abs() < 1e-15);
        assert!((correlation(&[1, 2, 3], &[6, 4, 2]).unwrap() + 1.0).abs() < 1e-15);
    }

    #[test]
    fn without_variation_there_is_no_correlation() {
        assert_eq!(
            correlation(&[0, 0], &[1, 2]),
            Err(Undefined::EmptyHistogram)
        );
        assert_eq!(
            correlation(&[3, 3], &[1, 2]),
            Err(Undefined::ConstantHistogram)
        );
    }
}
