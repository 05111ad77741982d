//! How well scores order losses.

/// Ranks from 1; equal values get the mean of their ranks.
#[allow(clippy::cast_precision_loss)]
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut below = 0;
    for tied in order.chunk_by(|&a, &b| values[a].total_cmp(&values[b]).is_eq()) {
        let rank = below as f64 + 0.5 * (tied.len() as f64 + 1.0);
        tied.iter().for_each(|&index| ranks[index] = rank);
        below += tied.len();
    }
    ranks
}

/// Area under the ROC curve of scores for losses above `failure`.
#[allow(clippy::cast_precision_loss)]
pub fn auroc(seconds: &[(f64, f64)], failure: f64) -> Option<f64> {
    let scores: Vec<f64> = seconds.iter().map(|(score, _)| *score).collect();
    let ranks = ranks(&scores);
    let failed = seconds
        .iter()
        .zip(&ranks)
        .filter(|((_, loss), _)| *loss > failure);
    let (count, sum) = failed.fold((0, 0.0), |(n, sum), (_, rank)| (n + 1, sum + rank));
    let others = seconds.len() - count;
    let (n, m) = (count as f64, others as f64);
    (count > 0 && others > 0).then(|| (sum - n * (n + 1.0) / 2.0) / (n * m))
}

/// Rank correlation of scores with losses.
#[allow(clippy::cast_precision_loss)]
pub fn spearman(seconds: &[(f64, f64)]) -> Option<f64> {
    let (scores, losses): (Vec<f64>, Vec<f64>) = seconds.iter().copied().unzip();
    let (a, b) = (ranks(&scores), ranks(&losses));
    let mean = (seconds.len() as f64 + 1.0) / 2.0;
    let sum = |x: &[f64], y: &[f64]| -> f64 {
        let parts = x.iter().zip(y).map(|(x, y)| (x - mean) * (y - mean));
        parts.sum()
    };
    let scale = (sum(&a, &a) * sum(&b, &b)).sqrt();
    (scale > 0.0).then(|| sum(&a, &b) / scale)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn ranks_of_ties_are_shared() {
        assert_eq!(ranks(&[3.0, 1.0, 3.0, 2.0]), [3.5, 1.0, 3.5, 2.0]);
    }

    #[test]
    fn auroc_and_spearman_by_hand() {
        let seconds = [(0.1, 0.0), (0.4, 0.9), (0.3, 0.6), (0.35, 0.2)];
        // One of the 2 x 2 pairs is in the wrong order.
        assert_eq!(auroc(&seconds, 0.5), Some(0.75));
        // Rank differences 0, 0, 1, 1: 1 - 6 x 2 / (4 x 15).
        assert!((spearman(&seconds).unwrap() - 0.8).abs() < 1e-12);
        assert_eq!(auroc(&seconds[..1], 0.5), None);
        assert_eq!(spearman(&seconds[..1]), None);
    }
}
