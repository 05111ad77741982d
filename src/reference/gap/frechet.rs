//! Frechet distance of two sets of channel means: FID's formula, the paper's eq. 1.

use nalgebra::{DMatrix, SymmetricEigen};

use crate::capture::undefined::Undefined;

/// Smallest number of images for each channel: from fewer images, a covariance has no meaning.
const IMAGES_PER_CHANNEL: usize = 2;

/// `|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2))` of the sets' means and covariances; each image is the vector of its
/// channels' mean activations.
///
/// # Errors
/// `TooFewImages` if a set has fewer than two images for each channel; `NoScore` if the values leave the range of
/// floats.
///
/// Source: Dowson and Landau 1982; Heusel et al. 2017 (FID).
pub fn distance(a: &[Vec<f64>], b: &[Vec<f64>]) -> Result<f64, Undefined> {
    let channels = a.first().or(b.first()).map_or(0, Vec::len);
    let (found, wanted) = (a.len().min(b.len()), IMAGES_PER_CHANNEL * channels);
    if found < wanted.max(2) {
        return Err(Undefined::TooFewImages {
            found,
            wanted: wanted.max(2),
        });
    }
    let ((mean_a, cov_a), (mean_b, cov_b)) = (moments(a, channels), moments(b, channels));
    let apart: f64 = mean_a
        .iter()
        .zip(&mean_b)
        .map(|(a, b)| (a - b) * (a - b))
        .sum();
    // tr (S1 S2)^(1/2) = tr (S1^(1/2) S2 S1^(1/2))^(1/2): the roots of a symmetric matrix.
    let root = square_root(&cov_a);
    let between = &root * &cov_b * &root;
    let shared: f64 = eigenvalues(&between)
        .iter()
        .map(|v| v.max(0.0).sqrt())
        .sum();
    let distance = apart + cov_a.trace() + cov_b.trace() - 2.0 * shared;
    distance
        .is_finite()
        .then_some(distance.max(0.0))
        .ok_or(Undefined::NoScore)
}

#[allow(clippy::cast_precision_loss)]
fn moments(images: &[Vec<f64>], channels: usize) -> (Vec<f64>, DMatrix<f64>) {
    let n = images.len() as f64;
    let mean: Vec<f64> = (0..channels)
        .map(|channel| images.iter().map(|image| image[channel]).sum::<f64>() / n)
        .collect();
    let deviations = DMatrix::from_fn(images.len(), channels, |i, c| images[i][c] - mean[c]);
    let covariance = deviations.transpose() * &deviations / (n - 1.0);
    (mean, covariance)
}

fn eigenvalues(symmetric: &DMatrix<f64>) -> Vec<f64> {
    let symmetric = 0.5 * (symmetric + symmetric.transpose());
    SymmetricEigen::new(symmetric)
        .eigenvalues
        .as_slice()
        .to_vec()
}

fn square_root(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(covariance.clone());
    let roots = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
    &eigen.eigenvectors * DMatrix::from_diagonal(&roots) * eigen.eigenvectors.transpose()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn set(mean: f64, spread: f64) -> Vec<Vec<f64>> {
        // Two channels on the corners of a square: no covariance, variance 4 s^2 / 3 each.
        [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
            .map(|(x, y)| vec![mean + spread * x, spread * y])
            .to_vec()
    }

    #[test]
    fn distance_by_hand() {
        assert!(distance(&set(0.0, 1.0), &set(0.0, 1.0)).unwrap().abs() < 1e-12);
        assert!((distance(&set(0.0, 1.0), &set(3.0, 1.0)).unwrap() - 9.0).abs() < 1e-12);
        // (sqrt(4/3) - sqrt(16/3))^2 for each of two channels.
        let wanted = 2.0 * (4.0_f64 / 3.0);
        assert!((distance(&set(0.0, 1.0), &set(0.0, 2.0)).unwrap() - wanted).abs() < 1e-12);
    }

    #[test]
    fn distance_of_sets_whose_channels_go_together_in_other_ways() {
        // Covariances that do not commute: [[4, 2], [2, 2]] and [[2, -4], [-4, 10]], each of four images.
        let images = |rows: [[f64; 2]; 4]| -> Vec<Vec<f64>> {
            let scale = f64::sqrt(0.75);
            rows.map(|[x, y]| vec![1.0 + scale * x, scale * y]).to_vec()
        };
        let a = images([[2.0, 0.0], [-2.0, 0.0], [2.0, 2.0], [-2.0, -2.0]]);
        let b = images([[2.0, -4.0], [-2.0, 4.0], [0.0, 2.0], [0.0, -2.0]]);
        let of = |images: &[Vec<f64>]| moments(images, 2).1;
        let (cov_a, cov_b) = (of(&a), of(&b));
        let wanted_a = DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 2.0]);
        let wanted_b = DMatrix::from_row_slice(2, 2, &[2.0, -4.0, -4.0, 10.0]);
        assert!((cov_a - wanted_a).norm() < 1e-12 && (cov_b - wanted_b).norm() < 1e-12);
        // For a 2x2 matrix: tr M^(1/2) = sqrt(tr M + 2 sqrt(det M)); tr S1 S2 = 8 - 8 - 8 + 20, both determinants 4.
        let shared = f64::sqrt(12.0 + 2.0 * 4.0);
        let wanted = 6.0 + 12.0 - 2.0 * shared;
        assert!((distance(&a, &b).unwrap() - wanted).abs() < 1e-12);
    }

    #[test]
    fn too_few_images_are_undefined() {
        let one = &set(0.0, 1.0)[..3];
        assert_eq!(
            distance(one, &set(0.0, 1.0)),
            Err(Undefined::TooFewImages {
                found: 3,
                wanted: 4
            })
        );
        let three_channels = vec![vec![0.0; 3]; 5];
        assert_eq!(
            distance(&three_channels, &three_channels),
            Err(Undefined::TooFewImages {
                found: 5,
                wanted: 6
            })
        );
    }
}
