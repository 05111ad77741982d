//! Moments of nominal energies → how far a window, or a change, is from them: squared Mahalanobis distances.

use nalgebra::{Cholesky, DMatrix};
use serde::{Deserialize, Serialize};

use super::moments::{FRAMES_MIN, Moments, STEPS_PER_NAT};
use crate::capture::undefined::Undefined;

/// Weight of the identity in the shrunk correlation matrix (Ledoit and Wolf 2004 shrink towards the same target).
/// Between 0.02 and 0.3, the share of conditions found differs by a few percentage points.
const SHRINKAGE: f64 = 0.1;
/// Spread that is added to the spread of every channel, nats, because a channel that is never active in simulation is
/// not enough evidence alone.
pub(super) const SPREAD_FLOOR: f64 = 0.05;

/// Nominal energies of one block, with which Mahalanobis distances are measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnergyNorm {
    /// Energy below which a channel counts as inactive, squared activation units.
    pub epsilon: f64,
    /// `[energies]`, mean of `ln(1 + e / epsilon)`, nats; 0 for differences.
    pub mean: Vec<f64>,
    /// `[energies (energies + 1) / 2]`: lower triangle, row by row, of the matrix that whitens deviations from the mean.
    pub whitening: Vec<f32>,
}

impl EnergyNorm {
    /// The norm of a set of frames. With `wider`, the norm of a larger set of nominal frames, the spread is wider: the fewer
    /// `drives` this set has, the more the larger set counts.
    ///
    /// # Errors
    /// `TooFewImages` below two frames.
    pub fn fit(
        epsilon: f64,
        own: &Moments,
        wider: Option<(&Self, usize)>,
    ) -> Result<Self, Undefined> {
        own.check_frames()?;
        let mut covariance = own.covariance();
        if let Some((wider, drives)) = wider {
            covariance = mixed(&covariance, &wider.covariance()?, drives);
        }
        Self::with_spread(epsilon, own.mean(), &covariance)
    }

    /// The norm of differences of levels, which nominally have no mean. With `wider`, the norm of differences of a larger set
    /// of nominal drives: if there are at least [`SPANS_OWN`] independent `spans` of their own, the spread is a mixture of
    /// both, as in [`fit`](Self::fit). Otherwise it is that of the larger set, widened by the own differences and by the
    /// spread of the own `windows`: to pass from any part of an accepted road to any other part is nominal.
    ///
    /// # Errors
    /// `TooFewImages` without enough differences.
    pub fn fit_changes(
        epsilon: f64,
        own: &Moments,
        windows: &Moments,
        spans: usize,
        wider: Option<&Self>,
    ) -> Result<Self, Undefined> {
        let covariance = match wider {
            None => {
                own.check_frames()?;
                own.covariance()
            }
            Some(wider) if spans >= SPANS_OWN => {
                mixed(&own.covariance(), &wider.covariance()?, spans)
            }
            Some(wider) => {
                let mut widened = wider.covariance()?;
                if windows.frames() >= FRAMES_MIN {
                    widened += windows.covariance();
                }
                if own.frames() > 0 {
                    widened += own.second_moment();
                }
                widened
            }
        };
        Self::with_spread(epsilon, vec![0.0; covariance.nrows()], &covariance)
    }

    fn with_spread(
        epsilon: f64,
        mean: Vec<f64>,
        covariance: &DMatrix<f64>,
    ) -> Result<Self, Undefined> {
        Ok(Self {
            epsilon,
            mean,
            whitening: whitening_of(covariance, SHRINKAGE)?,
        })
    }

    /// Number of energies: channels and cells.
    pub fn energies(&self) -> usize {
        self.mean.len()
    }

    /// Squared Mahalanobis distance of the mean level vector of `frames` frames, where `sums` `[energies]` is their
    /// sum, divided by the number of energies: about 1 for a nominal frame. Allocates nothing.
    #[allow(clippy::cast_precision_loss)]
    pub fn distance(&self, sums: &[u64], frames: usize) -> f64 {
        let scale = 1.0 / (STEPS_PER_NAT * frames.max(1) as f64);
        self.whitened(|column| sums[column] as f64 * scale - self.mean[column])
    }

    /// The same of a vector of mean levels, or of differences of levels, nats `[energies]`. `deviations` is at least as
    /// long, and is written to. Allocates nothing.
    pub fn distance_of(&self, levels: &[f64], deviations: &mut [f64]) -> f64 {
        let apart = deviations.iter_mut().zip(levels).zip(&self.mean);
        apart.for_each(|((deviation, level), mean)| *deviation = level - mean);
        self.whitened(|column| deviations[column])
    }

    #[inline(always)]
    fn whitened(&self, deviation: impl Fn(usize) -> f64) -> f64 {
        let mut total = 0.0;
        each_whitened(&self.whitening, self.mean.len(), deviation, |_, across| {
            total += across * across;
        });
        total / self.mean.len().max(1) as f64
    }

    /// Calls `each` with the place and the value of every whitened deviation from the mean, of a vector of mean levels
    /// or of differences of levels, nats. Allocates nothing.
    pub fn whiten(&self, level: impl Fn(usize) -> f64, each: impl FnMut(usize, f64)) {
        let deviation = |column: usize| level(column) - self.mean[column];
        each_whitened(&self.whitening, self.mean.len(), deviation, each);
    }

    /// The covariance with which the norm was made, nats squared, as precise as its 32-bit weights.
    fn covariance(&self) -> Result<DMatrix<f64>, Undefined> {
        let len = self.mean.len();
        let mut weights = self.whitening.iter();
        let mut lower = DMatrix::zeros(len, len);
        for row in 0..len {
            for (column, &weight) in (0..=row).zip(weights.by_ref()) {
                lower[(row, column)] = f64::from(weight);
            }
        }
        let mut unwhitening = DMatrix::identity(len, len);
        if !lower.solve_lower_triangular_mut(&mut unwhitening) {
            return Err(Undefined::NoScore);
        }
        let shrunk = &unwhitening * unwhitening.transpose();
        Ok(DMatrix::from_fn(len, len, |row, column| {
            if row == column {
                (shrunk[(row, row)] - SHRINKAGE * SPREAD_FLOOR * SPREAD_FLOOR).max(0.0)
            } else {
                shrunk[(row, column)] / (1.0 - SHRINKAGE)
            }
        }))
    }

    /// Nominal spread of each energy, nats: `[energies]`, the square roots of the diagonal of the covariance that distances
    /// are measured with.
    pub fn spreads(&self) -> Vec<f64> {
        let len = self.mean.len();
        let mut whitening = DMatrix::zeros(len, len);
        let places = (0..len).flat_map(|row| (0..=row).map(move |column| (row, column)));
        for (place, &weight) in places.zip(&self.whitening) {
            whitening[place] = f64::from(weight);
        }
        // The whitening matrix is the inverse of a Cholesky factor of the covariance.
        let mut factor = DMatrix::identity(len, len);
        whitening.solve_lower_triangular_mut(&mut factor);
        factor.row_iter().map(|row| row.norm()).collect()
    }

    /// What is wrong with a norm read from a file, if anything.
    pub fn fault(&self) -> Option<String> {
        let len = self.mean.len();
        let wanted = len * (len + 1) / 2;
        let finite =
            self.mean.iter().all(|m| m.is_finite()) && self.whitening.iter().all(|w| w.is_finite());
        if len == 0 || self.whitening.len() != wanted || !finite {
            return Some(format!(
                "{} whitening weights for {len} energies, wanted {wanted} finite ones",
                self.whitening.len()
            ));
        }
        (!(self.epsilon.is_normal() && self.epsilon > 0.0))
            .then(|| format!("an epsilon of {}, wanted one above 0", self.epsilon))
    }
}

/// Multiplies a lower triangle, row by row, with a vector of `len` numbers. Allocates nothing.
#[inline(always)]
pub(crate) fn each_whitened(
    mut whitening: &[f32],
    len: usize,
    deviation: impl Fn(usize) -> f64,
    mut each: impl FnMut(usize, f64),
) {
    for row in 0..len {
        let (weights, rest) = whitening.split_at(row + 1);
        whitening = rest;
        let parts = weights.iter().enumerate();
        let across: f64 = parts
            .map(|(column, &weight)| f64::from(weight) * deviation(column))
            .sum();
        each(row, across);
    }
}

/// The matrix that whitens the spread inside classes, as a lower triangle, row by row: every class counts alike.
///
/// # Errors
/// `TooFewImages` if a class is too small for a spread.
pub fn pooled_whitening(classes: &[Moments], shrinkage: f64) -> Result<Vec<f32>, Undefined> {
    let len = classes.first().map_or(0, Moments::energies);
    let mut pooled = DMatrix::zeros(len, len);
    for class in classes {
        class.check_frames()?;
        pooled += class.covariance();
    }
    // There are few classes.
    #[allow(clippy::cast_precision_loss)]
    let share = 1.0 / classes.len().max(1) as f64;
    whitening_of(&(share * pooled), shrinkage)
}

/// The matrix that whitens a spread, as a lower triangle, row by row. The correlation matrix is shrunk towards the
/// identity.
fn whitening_of(covariance: &DMatrix<f64>, shrinkage: f64) -> Result<Vec<f32>, Undefined> {
    let len = covariance.nrows();
    let spreads: Vec<f64> = (0..len)
        .map(|i| (covariance[(i, i)] + SPREAD_FLOOR * SPREAD_FLOOR).sqrt())
        .collect();
    let shrunk = DMatrix::from_fn(len, len, |i, j| {
        let correlation = covariance[(i, j)] / (spreads[i] * spreads[j]);
        (1.0 - shrinkage) * correlation + if i == j { shrinkage } else { 0.0 }
    });
    // The matrix is positive definite: it is a correlation matrix plus a multiple of the identity.
    let lower = Cholesky::new(shrunk).ok_or(Undefined::NoScore)?.l();
    let mut whitening = DMatrix::identity(len, len);
    if !lower.solve_lower_triangular_mut(&mut whitening) {
        return Err(Undefined::NoScore);
    }
    #[allow(clippy::cast_possible_truncation)]
    Ok((0..len)
        .flat_map(|row| (0..=row).map(move |column| (row, column)))
        .map(|(row, column)| (whitening[(row, column)] / spreads[column]) as f32)
        .collect())
}

/// Number of drives of an accepted domain at which half of the simulation's spread is still added to its own.
const PRIOR_DRIVES: f64 = 20.0;
/// Number of independent spans from which on changes of an accepted domain have a spread of their own.
pub const SPANS_OWN: usize = 20;

/// The own spread, and beside it as much of the wider set's as a number of own drives or spans leaves in doubt.
#[allow(clippy::cast_precision_loss)]
fn mixed(own: &DMatrix<f64>, wider: &DMatrix<f64>, drives: usize) -> DMatrix<f64> {
    let doubt = PRIOR_DRIVES / (drives as f64 + PRIOR_DRIVES);
    own + doubt * wider
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::super::moments::tests::moments;
    use super::*;

    fn assert_variances(norm: &EnergyNorm, variances: [f64; 2]) {
        for (spread, variance) in norm.spreads().into_iter().zip(variances) {
            let floor = SPREAD_FLOOR * SPREAD_FLOOR;
            let wanted = (1.0 - SHRINKAGE) * variance + SHRINKAGE * (variance + floor);
            assert!((spread * spread - wanted).abs() < 1e-4, "{spread}");
        }
    }

    /// Levels that are 0 or 2 spreads, whose variances are 1 for 2048 steps, 4 for 4096, 9 for 6144 and 16 for 8192.
    fn spreads_of(x: u32, y: u32) -> Moments {
        moments(&[[0, 0], [x, 0], [0, y], [x, y]])
    }

    #[test]
    fn the_distance_is_that_of_independent_channels_by_hand() {
        let norm = EnergyNorm::fit(
            1.0,
            &moments(&[[0, 0], [2048, 0], [0, 4096], [2048, 4096]]),
            None,
        )
        .unwrap();
        // Spreads of sqrt(1 + 0.05^2) and sqrt(4 + 0.05^2); the shrunk correlation matrix has 0.9 s^2 / (s^2 + 0.05^2) + 0.1
        // on its diagonal.
        let part = |deviation: f64, variance: f64| {
            let spread2 = variance + 0.0025;
            deviation * deviation / spread2 / (0.9 * variance / spread2 + 0.1)
        };
        let wanted = 0.5 * (part(3.0, 1.0) + part(-1.0, 4.0));
        assert_eq!(norm.energies(), 2);
        assert!((norm.distance(&[4096, 1024], 1) - wanted).abs() < 1e-6 * wanted);
        // The mean of two frames counts, not their number.
        assert_eq!(
            norm.distance(&[8192, 2048], 2),
            norm.distance(&[4096, 1024], 1)
        );
        assert!(norm.distance(&[1024, 2048], 1) < 1e-12);
    }

    #[test]
    fn spreads_come_back_from_the_whitening() {
        let frames = moments(&[[0, 100], [2048, 1500], [300, 4096], [1048, 2096]]);
        let norm = EnergyNorm::fit(1.0, &frames, None).unwrap();
        let covariance = frames.covariance();
        assert_eq!(norm.spreads().len(), 2);
        for (i, spread) in norm.spreads().into_iter().enumerate() {
            // The correlation matrix is shrunk towards the identity, whose diagonal is 1; its own falls short of 1 by what the
            // floor adds to the spread.
            let spread2 = covariance[(i, i)] + SPREAD_FLOOR * SPREAD_FLOOR;
            let diagonal = (1.0 - SHRINKAGE) * covariance[(i, i)] / spread2 + SHRINKAGE;
            let wanted = (spread2 * diagonal).sqrt();
            assert!((spread - wanted).abs() < 1e-5 * wanted, "{spread} {wanted}");
        }
    }

    #[test]
    fn channels_that_never_move_are_no_division_by_zero() {
        let norm = EnergyNorm::fit(1.0, &moments(&[[7, 7], [7, 7]]), None).unwrap();
        assert_eq!(norm.fault(), None);
        assert!(norm.distance(&[1024, 1024], 1).is_finite());
        assert!(EnergyNorm::fit(1.0, &moments(&[[7, 7]]), None).is_err());
    }

    #[test]
    fn a_lone_accepted_drive_borrows_the_spread_of_the_simulation() {
        let wide = moments(&[[0, 0], [2048, 2048], [0, 2048], [2048, 0]]);
        let lone = moments(&[[5000, 5000], [5001, 5001]]);
        let narrow = EnergyNorm::fit(1.0, &lone, None).unwrap();
        let wide = EnergyNorm::fit(1.0, &wide, None).unwrap();
        let blended = EnergyNorm::fit(1.0, &lone, Some((&wide, 1))).unwrap();
        let near = [5300, 5300];
        assert!(blended.distance(&near, 1) < 0.1 * narrow.distance(&near, 1));
    }

    #[test]
    fn the_own_spread_counts_whole_and_that_of_the_simulation_by_half_after_twenty_drives() {
        let (own, wider) = (spreads_of(2048, 4096), spreads_of(6144, 8192));
        let wider = EnergyNorm::fit(1.0, &wider, None).unwrap();
        let blended = EnergyNorm::fit(1.0, &own, Some((&wider, 20))).unwrap();
        assert_variances(&blended, [1.0 + 4.5, 4.0 + 8.0]);
        // The mean is only that of the own frames.
        assert_eq!(blended.mean, own.mean());
    }

    #[test]
    fn a_covariance_comes_back_from_the_whitening() {
        let own = moments(&[[0, 100], [2048, 4000], [300, 900], [5000, 7000]]);
        let found = EnergyNorm::fit(1.0, &own, None)
            .unwrap()
            .covariance()
            .unwrap();
        let wanted = own.covariance();
        assert!((found - &wanted).norm() < 1e-5 * wanted.norm());
    }

    #[test]
    fn few_changes_of_an_accepted_road_are_as_wide_as_its_windows_and_the_simulation() {
        let (windows, wider) = (spreads_of(2048, 4096), spreads_of(6144, 8192));
        let wider = EnergyNorm::fit(1.0, &wider, None).unwrap();
        let mut own = Moments::new(2);
        own.add_differences(&[1.0, 2.0], &mut [0; 2]);
        let norm = EnergyNorm::fit_changes(1.0, &own, &windows, 1, Some(&wider)).unwrap();
        assert_variances(&norm, [1.0 + 9.0 + 1.0, 4.0 + 16.0 + 4.0]);
        // A road without one whole span has its windows.
        let none = Moments::new(0);
        let norm = EnergyNorm::fit_changes(1.0, &none, &windows, 0, Some(&wider)).unwrap();
        assert_variances(&norm, [1.0 + 9.0, 4.0 + 16.0]);
    }

    #[test]
    fn a_norm_that_cannot_be_is_refused() {
        let whole = EnergyNorm {
            epsilon: 1.0,
            mean: vec![1.0, 2.0],
            whitening: vec![1.0, 0.0, 1.0],
        };
        assert_eq!(whole.fault(), None);
        let with = |change: &dyn Fn(&mut EnergyNorm)| {
            let mut norm = whole.clone();
            change(&mut norm);
            norm.fault()
        };
        for epsilon in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-310] {
            let fault = with(&|norm| norm.epsilon = epsilon);
            assert!(fault.unwrap().contains("epsilon"));
        }
        for fault in [
            with(&|norm| norm.mean[1] = f64::NAN),
            with(&|norm| norm.whitening[0] = f32::INFINITY),
            with(&|norm| norm.whitening.truncate(2)),
            with(&|norm| norm.mean.push(0.0)),
            with(&|norm| (norm.mean, norm.whitening) = (vec![], vec![])),
        ] {
            assert!(fault.unwrap().contains("whitening weights"));
        }
        // Three energies have a triangle of six.
        let three = |weights| {
            with(&|norm| (norm.mean, norm.whitening) = (vec![0.0; 3], vec![1.0; weights]))
        };
        assert!(three(6).is_none() && three(5).is_some());
    }
}
