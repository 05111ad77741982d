//! Energies of a tapped block, by channel and by cell of a coarse grid: one vector for each frame, its exact moments
//! over many frames.
//!
//! A block's energy, summed over channels, says where the encoder looks. Averaged over the map for each channel, it
//! says what the encoder finds there. Vectors are integers, so that sums of any number of frames are exact in any
//! order.

use nalgebra::{DMatrix, DVector};

use crate::capture::undefined::Undefined;

/// Steps for each nat of a channel's log energy.
pub const STEPS_PER_NAT: f64 = 1024.0;
/// Energy below which a channel counts as inactive, as a share of the block's median peak energy. Between 2e-6 and
/// 2e-3, no share of conditions found changes by more than one percentage point.
pub const EPSILON_SHARE: f64 = 2e-5;
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
    pub(super) fn second_moment(&self) -> DMatrix<f64> {
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

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::super::energy_norm::EnergyNorm;
    use super::*;
    use proptest::prelude::*;

    pub(in super::super) fn moments(frames: &[[u32; 2]]) -> Moments {
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
