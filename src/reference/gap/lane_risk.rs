//! The share of lanes that the lane model is expected to lose: a ridge regression of its loss on a block's log
//! energies.
//!
//! A domain gap is not always a failure, because the lane model tolerates some changes and not others. Rendered drives
//! have lane labels, so what the model loses on them is known, and the energies of its last block predict it.

use nalgebra::{Cholesky, DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::energy_norm::SPREAD_FLOOR;
use super::moments::{Moments, STEPS_PER_NAT, energy_levels};
use crate::capture::undefined::Undefined;

/// Deviations from nominal are limited to this number of spreads: far outside, a larger deviation does not mean a
/// larger loss.
const DEVIATION_MAX: f64 = 30.0;
/// Penalty on the weights, for each labelled frame. With a tenth of it or four times as much, the prediction of the
/// loss under conditions that were not fitted hardly changes.
const RIDGE: f64 = 0.5;

/// Fits a forecast to frames with lane labels, one after the other. Nominal frames have no loss, and together they have
/// the same weight as the labelled frames.
pub struct LaneRiskFit {
    epsilon: f64,
    mean: Vec<f64>,
    spread: Vec<f64>,
    /// Normal equations over the energies and a constant.
    matrix: DMatrix<f64>,
    target: DVector<f64>,
    row: DVector<f64>,
    levels: Vec<u32>,
}

impl LaneRiskFit {
    /// Begins with only the nominal frames; `labelled` is the number of labelled frames that will follow.
    ///
    /// # Errors
    /// `TooFewImages` without nominal or labelled frames.
    #[allow(clippy::cast_precision_loss)]
    pub fn new(epsilon: f64, nominal: &Moments, labelled: usize) -> Result<Self, Undefined> {
        nominal.check_frames()?;
        if labelled == 0 {
            return Err(Undefined::TooFewImages {
                found: 0,
                wanted: 1,
            });
        }
        let covariance = nominal.covariance();
        let mean = nominal.mean();
        let len = mean.len();
        let spread: Vec<f64> = (0..len)
            .map(|i| (covariance[(i, i)] + SPREAD_FLOOR * SPREAD_FLOOR).sqrt())
            .collect();
        let frames = labelled as f64;
        // The deviations of the nominal frames have the sum 0, so they fill only the block of the energies.
        let mut matrix = DMatrix::zeros(len + 1, len + 1);
        for row in 0..len {
            for column in 0..len {
                matrix[(row, column)] =
                    frames * covariance[(row, column)] / (spread[row] * spread[column]);
            }
            matrix[(row, row)] += RIDGE * frames;
        }
        matrix[(len, len)] = frames;
        Ok(Self {
            epsilon,
            levels: vec![0; len],
            mean,
            spread,
            matrix,
            target: DVector::zeros(len + 1),
            row: DVector::from_element(len + 1, 1.0),
        })
    }

    /// Learns from a frame's energies, `[energies]`, and what the lane model lost there, 0 to 1: 1 - F1 within the
    /// tolerance.
    pub fn add(&mut self, energies: &[f64], loss: f64) {
        energy_levels(energies, self.epsilon, &mut self.levels);
        for (index, &level) in self.levels.iter().enumerate() {
            let nats = f64::from(level) / STEPS_PER_NAT;
            self.row[index] = deviation(nats, self.mean[index], self.spread[index]);
        }
        self.matrix.ger(1.0, &self.row, &self.row, 1.0);
        self.target.axpy(loss, &self.row, 1.0);
    }

    /// Returns the forecast.
    ///
    /// # Errors
    /// `NoScore` if the equations cannot be solved.
    pub fn solve(self) -> Result<LaneRisk, Undefined> {
        let len = self.mean.len();
        // The matrix is positive definite: the penalty is above 0, and so is the entry of the constant.
        let solved = Cholesky::new(self.matrix)
            .ok_or(Undefined::NoScore)?
            .solve(&self.target);
        Ok(LaneRisk {
            epsilon: self.epsilon,
            mean: self.mean,
            spread: self.spread,
            weights: solved.as_slice()[..len].to_vec(),
            bias: solved[len],
        })
    }
}

/// A linear forecast of the loss from one block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneRisk {
    /// Energy below which a channel counts as inactive, squared activation units.
    pub epsilon: f64,
    /// `[energies]`, nominal mean of `ln(1 + e / epsilon)`, nats.
    pub mean: Vec<f64>,
    /// `[energies]`, nominal spread, nats.
    pub spread: Vec<f64>,
    /// `[energies]`, loss for each spread away from the mean.
    pub weights: Vec<f64>,
    /// Loss at the nominal mean.
    pub bias: f64,
}

impl LaneRisk {
    /// Forecast of the loss in a window of `frames` frames, where `sums` `[energies]` is the sum of their levels. It is
    /// about 0 to 1, and a little below 0 if the road is easier than the nominal road. Allocates nothing.
    #[allow(clippy::cast_precision_loss)]
    pub fn loss(&self, sums: &[u64], frames: usize) -> f64 {
        let scale = 1.0 / (STEPS_PER_NAT * frames.max(1) as f64);
        let nominal = self.mean.iter().zip(&self.spread).zip(&self.weights);
        let parts = sums
            .iter()
            .zip(nominal)
            .map(|(&sum, ((mean, spread), weight))| {
                weight * deviation(sum as f64 * scale, *mean, *spread)
            });
        self.bias + parts.sum::<f64>()
    }

    /// What is wrong with a forecast read from a file, if anything.
    pub fn fault(&self) -> Option<String> {
        let len = self.mean.len();
        let all = [&self.mean, &self.spread, &self.weights];
        let finite = all.iter().all(|v| v.iter().all(|x| x.is_finite())) && self.bias.is_finite();
        if len == 0 || all.iter().any(|v| v.len() != len) || !finite {
            return Some(format!(
                "{} means, {} spreads and {} weights, wanted as many finite ones of each",
                len,
                self.spread.len(),
                self.weights.len()
            ));
        }
        if self.spread.iter().any(|&spread| spread <= 0.0) {
            return Some("a spread that is not above 0".to_owned());
        }
        (!(self.epsilon.is_normal() && self.epsilon > 0.0))
            .then(|| format!("an epsilon of {}, wanted one above 0", self.epsilon))
    }
}

fn deviation(nats: f64, mean: f64, spread: f64) -> f64 {
    ((nats - mean) / spread).clamp(-DEVIATION_MAX, DEVIATION_MAX)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Nominal levels of two energies: 10 nats with a spread of 1.
    fn nominal() -> Moments {
        let mut moments = Moments::new(2);
        for levels in [[9, 9], [9, 11], [11, 9], [11, 11]] {
            moments.add(&levels.map(|nats: u32| 1024 * nats));
        }
        moments
    }

    /// Fits frames whose energies are raised by a number of nats, with their losses.
    fn fit(frames: &[([f64; 2], f64)]) -> LaneRisk {
        let mut fit = LaneRiskFit::new(1.0, &nominal(), frames.len()).unwrap();
        for (nats, loss) in frames {
            fit.add(&nats.map(f64::exp_m1), *loss);
        }
        fit.solve().unwrap()
    }

    #[test]
    fn a_loss_that_goes_with_one_energy_is_foretold() {
        // The first energy falls by 1 spread for each tenth of loss; the second one does not depend on the loss.
        let frames: Vec<([f64; 2], f64)> = (0..1_000_u32)
            .map(|i| {
                let tenths = f64::from(i % 11);
                ([10.0 - tenths, f64::from(9 + i % 3)], 0.1 * tenths)
            })
            .collect();
        let risk = fit(&frames);
        assert_eq!(risk.fault(), None);
        for tenths in [0_u64, 4, 8] {
            let found = risk.loss(&[1024 * (10 - tenths), 10_240], 1);
            let wanted = 0.1 * f64::from(u32::try_from(tenths).unwrap());
            assert!((found - wanted).abs() < 0.06, "{found} for {wanted}");
        }
        let twice = risk.loss(&[12_288, 20_480], 2);
        assert!((twice - risk.loss(&[6_144, 10_240], 1)).abs() < 1e-12);
    }

    #[test]
    fn the_loss_is_the_bias_and_the_weighted_deviations() {
        let risk = LaneRisk {
            epsilon: 1.0,
            mean: vec![10.0, 4.0],
            spread: vec![2.0, 0.5],
            weights: vec![0.25, -0.5],
            bias: 0.125,
        };
        // 4 nats above are two spreads, and half a nat below is one spread.
        assert!((risk.loss(&[1024 * 14, 512 * 7], 1) - (0.125 + 0.5 + 0.5)).abs() < 1e-12);
    }

    #[test]
    fn a_forecast_that_cannot_be_is_refused() {
        let whole = LaneRisk {
            epsilon: 1.0,
            mean: vec![1.0, 2.0],
            spread: vec![1.0, 1.0],
            weights: vec![0.5, 0.5],
            bias: 0.1,
        };
        assert_eq!(whole.fault(), None);
        let with = |change: &dyn Fn(&mut LaneRisk)| {
            let mut risk = whole.clone();
            change(&mut risk);
            risk.fault()
        };
        for (fault, says) in [
            (with(&|risk| risk.mean[0] = f64::NAN), "finite"),
            (with(&|risk| risk.weights[1] = f64::INFINITY), "finite"),
            (with(&|risk| risk.bias = f64::NAN), "finite"),
            (with(&|risk| risk.spread.truncate(1)), "1 spreads"),
            (with(&|risk| risk.weights.push(0.0)), "3 weights"),
            (with(&|risk| risk.spread[1] = 0.0), "spread that is not"),
            (with(&|risk| risk.epsilon = 0.0), "epsilon"),
            (with(&|risk| risk.epsilon = f64::INFINITY), "epsilon"),
        ] {
            assert!(fault.as_ref().unwrap().contains(says), "{fault:?} {says}");
        }
        let none = with(&|risk| {
            (risk.mean, risk.spread, risk.weights) = (vec![], vec![], vec![]);
        });
        assert!(none.is_some());
    }

    #[test]
    fn far_outside_is_not_without_end() {
        let risk = fit(&[([0.0, 0.0], 1.0)]);
        assert!(risk.loss(&[u64::from(u32::MAX), 0], 1).abs() < 60.0);
    }

    #[test]
    fn nothing_to_learn_from_is_refused() {
        assert!(LaneRiskFit::new(1.0, &nominal(), 0).is_err());
        assert!(LaneRiskFit::new(1.0, &Moments::new(2), 1).is_err());
    }
}
