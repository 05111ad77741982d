//! Energies of a tapped block, by channel and by cell of a coarse grid: one vector for each frame, its exact moments
//! over many frames, and how far a window is from them.
//!
//! A block's energy, summed over channels, says where the encoder looks. Averaged over the map for each channel, it
//! says what the encoder finds there. Vectors are integers, so that sums of any number of frames are exact in any
//! order.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;

/// Steps for each nat of a channel's log energy.
pub const STEPS_PER_NAT: f64 = 1024.0;
/// Energy below which a channel counts as inactive, as a share of the block's median peak energy. Between 2e-6 and
/// 2e-3, no share of conditions found changes by more than one percentage point.
pub const EPSILON_SHARE: f64 = 2e-5;
/// Weight of the identity in the shrunk correlation matrix (Ledoit and Wolf 2004 shrink towards the same target).
/// Between 0.02 and 0.3, the share of conditions found differs by a few percentage points.
const SHRINKAGE: f64 = 0.1;
/// Spread that is added to the spread of every channel, nats, because a channel that is never active in simulation is
/// not enough evidence alone.
pub(super) const SPREAD_FLOOR: f64 = 0.05;
/// The level that stands for no difference: above any difference of levels.
pub const NO_DIFFERENCE: u32 = 1 << 20;
/// Smallest number of frames for moments.
pub const FRAMES_MIN: u64 = 2;

/// Writes `ln(1 + e / epsilon)` of each channel's mean energy `e`, `[energies]`, in steps of 1 / 1024 nat.
pub fn energy_levels(energies: &[f64], epsilon: f64, levels: &mut [u32]) {
    for (level, energy) in levels.iter_mut().zip(energies) {
        // The value is finite and not negative: at most ln(1 + 1e77 / 1e-45), far below 2^32 steps.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        {
            *level = (STEPS_PER_NAT * (energy / epsilon).ln_1p()).round() as u32;
        }
    }
}

/// Sums and sums of products of level vectors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moments {
    frames: u64,
    /// `[energies]`
    sums: Vec<u64>,
    /// `[energies (energies + 1) / 2]`, the lower triangle row by row.
    products: Vec<u64>,
}

impl Moments {
    /// Moments with nothing summed yet.
    pub fn new(energies: usize) -> Self {
        Self {
            frames: 0,
            sums: vec![0; energies],
            products: vec![0; energies * (energies + 1) / 2],
        }
    }

    /// The moments of frames' energies, each `[energies]`.
    pub fn of<'a>(frames: impl Iterator<Item = &'a [f64]>, epsilon: f64) -> Self {
        let mut frames = frames.peekable();
        let len = frames.peek().map_or(0, |frame| frame.len());
        let mut moments = Self::new(len);
        let mut levels = vec![0; len];
        for frame in frames {
            energy_levels(frame, epsilon, &mut levels);
            moments.add(&levels);
        }
        moments
    }

    /// Number of frames summed.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Number of energies.
    pub fn energies(&self) -> usize {
        self.sums.len()
    }

    /// Sum of the levels, `[energies]`.
    pub fn sums(&self) -> &[u64] {
        &self.sums
    }

    /// Adds a frame's levels, `[energies]`.
    pub fn add(&mut self, levels: &[u32]) {
        self.frames += 1;
        let mut products = self.products.iter_mut();
        for (row, &level) in levels.iter().enumerate() {
            self.sums[row] += u64::from(level);
            for (&other, product) in levels[..=row].iter().zip(products.by_ref()) {
                *product += u64::from(level) * u64::from(other);
            }
        }
    }

    /// Adds differences of levels, nats `[energies]`, each as a level that is [`NO_DIFFERENCE`] without a difference.
    pub fn add_differences(&mut self, differences: &[f64], levels: &mut [u32]) {
        for (level, difference) in levels.iter_mut().zip(differences) {
            let steps = (STEPS_PER_NAT * difference).round() + f64::from(NO_DIFFERENCE);
            // Differences of levels are far smaller than `NO_DIFFERENCE` steps.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            {
                *level = steps as u32;
            }
        }
        self.add(levels);
    }

    /// Mean of differences that were added with [`add_differences`](Self::add_differences), nats.
    pub fn mean_difference(&self) -> Vec<f64> {
        let off = f64::from(NO_DIFFERENCE) / STEPS_PER_NAT;
        self.mean().into_iter().map(|mean| mean - off).collect()
    }

    /// Adds the frames of another set. If there are no frames yet, the number of energies is taken from the other set.
    pub fn merge(&mut self, other: &Self) {
        if self.frames == 0 {
            self.clone_from(other);
            return;
        }
        self.frames += other.frames;
        let add = |own: &mut Vec<u64>, others: &[u64]| {
            own.iter_mut().zip(others).for_each(|(a, b)| *a += b);
        };
        add(&mut self.sums, &other.sums);
        add(&mut self.products, &other.products);
    }

    /// # Errors
    /// `TooFewImages` if there are too few frames for a spread.
    pub(super) fn check_frames(&self) -> Result<(), Undefined> {
        if self.frames >= FRAMES_MIN {
            return Ok(());
        }
        Err(Undefined::TooFewImages {
            found: usize::try_from(self.frames).unwrap_or(usize::MAX),
            wanted: usize::try_from(FRAMES_MIN).unwrap_or(usize::MAX),
        })
    }

    /// Mean, nats.
    #[allow(clippy::cast_precision_loss)]
    pub(super) fn mean(&self) -> Vec<f64> {
        let scale = STEPS_PER_NAT * self.frames as f64;
        self.sums.iter().map(|&sum| sum as f64 / scale).collect()
    }

    /// Mean square of differences that were added with [`add_differences`](Self::add_differences), nats squared.
    fn second_moment(&self) -> DMatrix<f64> {
        let mean = DVector::from_vec(self.mean_difference());
        self.covariance() + &mean * mean.transpose()
    }

    /// Covariance, nats squared. Differences are calculated with integers, so that there is no cancellation.
    #[allow(clippy::cast_precision_loss)]
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        let len = self.sums.len();
        let n = i128::from(self.frames);
        let scale = (self.frames as f64 * STEPS_PER_NAT).powi(2);
        let mut covariance = DMatrix::zeros(len, len);
        let mut products = self.products.iter();
        for row in 0..len {
            for (column, &product) in (0..=row).zip(products.by_ref()) {
                let apart = n * i128::from(product)
                    - i128::from(self.sums[row]) * i128::from(self.sums[column]);
                let value = apart as f64 / scale;
                covariance[(row, column)] = value;
                covariance[(column, row)] = value;
            }
        }
        covariance
    }
}

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
    /// The norm of a set of frames. With `wider`, a larger set of nominal frames, the spread is a mixture of both sets:
    /// the fewer `drives` this set has, the more the larger set counts.
    ///
    /// # Errors
    /// `TooFewImages` below two frames.
    pub fn fit(
        epsilon: f64,
        own: &Moments,
        wider: Option<(&Moments, usize)>,
    ) -> Result<Self, Undefined> {
        own.check_frames()?;
        let mut covariance = own.covariance();
        if let Some((wider, drives)) = wider {
            covariance = mixed(&covariance, &wider.covariance(), drives);
        }
        Self::with_spread(epsilon, own.mean(), &covariance)
    }

    /// The norm of differences of levels, which nominally have no mean. With `wider`, the differences of a larger set of
    /// nominal drives: if there are at least [`SPANS_OWN`] independent `spans` of their own, the spread is a mixture of
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
        wider: Option<&Moments>,
    ) -> Result<Self, Undefined> {
        let covariance = match wider {
            None => {
                own.check_frames()?;
                own.covariance()
            }
            Some(wider) if spans >= SPANS_OWN => {
                mixed(&own.covariance(), &wider.covariance(), spans)
            }
            Some(wider) => {
                let mut widened = wider.covariance();
                if windows.frames >= FRAMES_MIN {
                    widened += windows.covariance();
                }
                if own.frames > 0 {
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

/// Number of drives of an accepted domain at which its spread is half its own and half that of the simulation.
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
    use super::*;
    use proptest::prelude::*;

    fn moments(frames: &[[u32; 2]]) -> Moments {
        let mut moments = Moments::new(2);
        frames.iter().for_each(|levels| moments.add(levels));
        moments
    }

    #[test]
    fn levels_are_log_energies_in_steps() {
        let mut levels = [0; 3];
        energy_levels(&[0.0, 1.0, 1e6], 1.0, &mut levels);
        // 1024 ln 2 and 1024 ln 1000001.
        assert_eq!(levels, [0, 710, 14_147]);
        // With an epsilon twice as large: 1024 ln 1.5 and 1024 ln 500001.
        energy_levels(&[0.0, 1.0, 1e6], 2.0, &mut levels);
        assert_eq!(levels, [0, 415, 13_437]);
    }

    #[test]
    fn mean_and_covariance_by_hand() {
        // (0, 0), (2, 0), (0, 4), (2, 4) nats: means 1 and 2, variances 1 and 4, no covariance.
        let corners = moments(&[[0, 0], [2048, 0], [0, 4096], [2048, 4096]]);
        assert_eq!(corners.frames(), 4);
        assert_eq!(corners.sums(), [4096, 8192]);
        assert_eq!(corners.mean(), [1.0, 2.0]);
        assert_eq!(corners.covariance().as_slice(), [1.0, 0.0, 0.0, 4.0]);
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
        let blended = EnergyNorm::fit(1.0, &lone, Some((&wide, 1))).unwrap();
        let near = [5300, 5300];
        assert!(blended.distance(&near, 1) < 0.1 * narrow.distance(&near, 1));
    }

    #[test]
    fn after_twenty_drives_a_spread_is_half_its_own() {
        let spreads_of = |x: u32, y: u32| moments(&[[0, 0], [x, 0], [0, y], [x, y]]);
        // Variances of 1 and 4, and of 9 and 16: mixed in halves, they are 5 and 10.
        let (own, wider) = (spreads_of(2048, 4096), spreads_of(6144, 8192));
        let blended = EnergyNorm::fit(1.0, &own, Some((&wider, 20))).unwrap();
        for (spread, variance) in blended.spreads().into_iter().zip([5.0, 10.0]) {
            let floor = SPREAD_FLOOR * SPREAD_FLOOR;
            let wanted = (1.0 - SHRINKAGE) * variance + SHRINKAGE * (variance + floor);
            assert!((spread * spread - wanted).abs() < 1e-5, "{spread}");
        }
        // The mean is only that of the own frames.
        assert_eq!(blended.mean, own.mean());
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

    proptest! {
        #[test]
        fn moments_are_the_same_in_any_order_and_grouping(
            frames in prop::collection::vec([0..30_000_u32, 0..30_000_u32], 2..40), cut in 0..40_usize
        ) {
            let whole = moments(&frames);
            let (a, b) = frames.split_at(cut.min(frames.len()));
            let mut merged = moments(b);
            merged.merge(&moments(a));
            prop_assert_eq!(&merged, &whole);
            let norm = EnergyNorm::fit(1.0, &whole, None).unwrap();
            prop_assert!(frames.iter().all(|f| norm.distance(&f.map(u64::from), 1).is_finite()));
        }
    }
}
