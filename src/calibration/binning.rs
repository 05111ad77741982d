//! How pixels are counted: temperatures, edges of equal mass, and the counts of nominal images.

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::histogram::{Binning, HistogramSum};
use crate::reference::gap::{Metric, PAPER_FIRST_LEVEL, PAPER_LEVELS, PAPER_TEMPERATURE};
use crate::statistics::quantile::median;

/// Softmax temperature of the attention histogram, as a share of the median peak energy. With a trained network, a
/// fixed temperature of 10 keeps only about one pixel of each image (`calibration/RESULTS.md`, field_sets, has both).
pub const TEMPERATURE_SHARE: f64 = 0.2;
/// Value that is added to energies before the logarithm, as a share of the median peak energy.
pub const EPSILON_SHARE: f64 = 1e-6;
/// Number of bins of equal mass in the log-energy histogram.
pub const LOG_ENERGY_BINS: usize = 64;
/// Number of cells of the fine grid on which bin edges are chosen.
const GRID_CELLS: usize = 1 << 16;
/// A temperature as a user gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Temperature {
    /// In units of energy.
    Absolute(f64),
    /// As a multiple of the reference's median peak energy.
    OfPeak(f64),
}

/// How the metric `paper` counts, if it is changed from the paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperBinning {
    /// Softmax temperature.
    pub temperature: Temperature,
    /// Levels of the histogram.
    pub levels: usize,
    /// First level that is counted.
    pub first: usize,
}

impl PaperBinning {
    /// As in the paper.
    pub const PUBLISHED: Self = Self {
        temperature: Temperature::Absolute(PAPER_TEMPERATURE),
        levels: PAPER_LEVELS,
        first: PAPER_FIRST_LEVEL,
    };
}

/// Nominal histograms of one tap, without thresholds: the common part of references and comparisons.
#[derive(Clone, Debug)]
pub struct TapHistogram {
    /// Median over the images of the largest energy.
    pub median_peak_energy: f64,
    /// How pixels are counted.
    pub binning: Binning,
    /// The reference's counts.
    pub sum: HistogramSum,
}

impl TapHistogram {
    /// Finds scale and edges, and counts the maps, which have the common size.
    ///
    /// # Errors
    /// `TooFewImages` without any map, `ConstantMap` for a constant map.
    pub fn fit(
        maps: &[&EnergyMap],
        metric: Metric,
        paper: PaperBinning,
    ) -> Result<Self, Undefined> {
        let cut = Cut::of(
            maps.iter().map(|map| map.range().1).collect(),
            metric,
            paper,
        )?;
        let mut masses = cut.masses();
        for map in maps {
            masses.add(map);
        }
        let mut fitted = cut.nothing_counted(&masses);
        for map in maps {
            fitted.add(map)?;
        }
        Ok(fitted)
    }

    /// Counts one more map.
    ///
    /// # Errors
    /// `ConstantMap` for a constant map.
    pub fn add(&mut self, map: &EnergyMap) -> Result<(), Undefined> {
        self.sum.add(&counts_of(&self.binning, map)?);
        Ok(())
    }
}

/// What the peaks of all images say about how to count pixels. This is the first of three passes over the images; the
/// second one sums the masses from which the edges follow, and the third one counts.
pub struct Cut {
    median_peak_energy: f64,
    by: CutBy,
}

enum CutBy {
    Levels(Binning),
    /// Edges of equal mass of `ln(energy + epsilon)`, up to the largest energy.
    Mass {
        epsilon: f64,
        peak: f64,
    },
}

impl Cut {
    /// Made from the largest energy of each image at the common size.
    ///
    /// # Errors
    /// `TooFewImages` without any image, `NoScore` for a metric without histograms.
    pub fn of(peaks: Vec<f64>, metric: Metric, paper: PaperBinning) -> Result<Self, Undefined> {
        let peak = peaks.iter().copied().fold(0.0, f64::max);
        let median_peak_energy = median(peaks).ok_or(Undefined::TooFewImages {
            found: 0,
            wanted: 1,
        })?;
        let by = match metric {
            Metric::Paper => CutBy::Levels(Binning::Attention {
                temperature: match paper.temperature {
                    Temperature::Absolute(t) => t,
                    Temperature::OfPeak(share) => share * median_peak_energy,
                },
                levels: paper.levels,
                first: paper.first,
            }),
            Metric::Attention(_) => CutBy::Levels(Binning::Attention {
                temperature: TEMPERATURE_SHARE * median_peak_energy,
                levels: PAPER_LEVELS,
                first: 0,
            }),
            Metric::LogEnergy(_) => CutBy::Mass {
                epsilon: EPSILON_SHARE * median_peak_energy,
                peak,
            },
            Metric::Frechet | Metric::Mahalanobis | Metric::LaneRisk => {
                return Err(Undefined::NoScore);
            }
        };
        Ok(Self {
            median_peak_energy,
            by,
        })
    }

    /// Masses with nothing summed yet; without cells for attention, which needs none.
    #[allow(clippy::cast_precision_loss)]
    pub fn masses(&self) -> Masses {
        match self.by {
            CutBy::Levels(_) => Masses {
                epsilon: 0.0,
                low: 0.0,
                cell: 1.0,
                grid: Vec::new(),
            },
            CutBy::Mass { epsilon, peak } => {
                let low = epsilon.ln();
                let high = (peak + epsilon).ln().max(low);
                Masses {
                    epsilon,
                    low,
                    cell: (high - low) / GRID_CELLS as f64,
                    grid: vec![0; GRID_CELLS + 1],
                }
            }
        }
    }

    /// How pixels are counted, with no counts yet.
    pub fn nothing_counted(&self, masses: &Masses) -> TapHistogram {
        let binning = match &self.by {
            CutBy::Levels(binning) => binning.clone(),
            CutBy::Mass { epsilon, .. } => Binning::LogEnergy {
                epsilon: *epsilon,
                edges: masses.equal_edges(),
            },
        };
        TapHistogram {
            median_peak_energy: self.median_peak_energy,
            sum: HistogramSum::new(binning.bins()),
            binning,
        }
    }
}

/// Pixels by `ln(energy + epsilon)` in cells of a fine grid.
#[derive(Clone)]
pub struct Masses {
    epsilon: f64,
    low: f64,
    cell: f64,
    pub grid: Vec<u64>,
}

impl Masses {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub fn add(&mut self, map: &EnergyMap) {
        if self.grid.is_empty() {
            return;
        }
        for &g in &map.energy {
            let index = (((g + self.epsilon).ln() - self.low) / self.cell) as usize;
            self.grid[index.min(GRID_CELLS)] += 1;
        }
    }

    pub fn merge(&mut self, other: &Self) {
        let cells = self.grid.iter_mut().zip(&other.grid);
        cells.for_each(|(own, others)| *own += others);
    }

    /// Inner edges of bins of equal mass, on cells of the grid; edges that tie are merged.
    #[allow(clippy::cast_precision_loss)]
    fn equal_edges(&self) -> Vec<f64> {
        let total: u64 = self.grid.iter().sum();
        let mut edges = Vec::with_capacity(LOG_ENERGY_BINS - 1);
        let (mut below, mut next) = (0_u64, 1_u64);
        for (index, &count) in self.grid.iter().enumerate() {
            below += count;
            if below * LOG_ENERGY_BINS as u64 >= next * total && below < total {
                edges.push(self.low + (index + 1) as f64 * self.cell);
                next = below * LOG_ENERGY_BINS as u64 / total + 1;
            }
        }
        edges
    }
}

/// The counts of one map.
///
/// # Errors
/// `ConstantMap` for a constant map.
pub fn counts_of(binning: &Binning, map: &EnergyMap) -> Result<Vec<u32>, Undefined> {
    let mut counts = vec![0; binning.bins()];
    binning.count(map, &mut counts).map(|()| counts)
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;
    use crate::reference::gap::Divergence;

    const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);
    const ATTENTION: Metric = Metric::Attention(Divergence::JensenShannon);

    /// A map of one row whose energies grow.
    pub fn ramp(from: usize, to: usize) -> EnergyMap {
        let energy: Vec<f64> = (from..to).map(|i| (i as f64 / 1_000.0).exp()).collect();
        EnergyMap {
            width: energy.len(),
            height: 1,
            energy,
        }
    }

    #[test]
    fn edges_cut_the_reference_into_equal_masses() {
        let fitted =
            TapHistogram::fit(&[&ramp(0, 6_400)], LOG_ENERGY, PaperBinning::PUBLISHED).unwrap();
        assert_eq!(fitted.sum.counts.len(), LOG_ENERGY_BINS);
        assert!(
            fitted.sum.counts.iter().all(|&n| (98..=102).contains(&n)),
            "{:?}",
            fitted.sum.counts
        );
    }

    #[test]
    fn edges_that_tie_are_merged() {
        // Three quarters of the pixels have no energy: they fill one bin, and the others share about 16 bins.
        let mut map = ramp(0, 1_600);
        map.energy.extend(vec![0.0; 4_800]);
        let fitted = TapHistogram::fit(&[&map], LOG_ENERGY, PaperBinning::PUBLISHED).unwrap();
        assert_eq!(fitted.sum.counts[0], 4_800);
        assert!(
            (15..=18).contains(&fitted.sum.counts.len()),
            "{}",
            fitted.sum.counts.len()
        );
        assert!(fitted.sum.counts.iter().all(|&n| n > 0));
    }

    #[test]
    fn the_median_peak_sets_the_temperature() {
        let peak = |p: f64| EnergyMap {
            width: 2,
            height: 1,
            energy: vec![0.0, p],
        };
        let maps = [peak(10.0), peak(1_000.0), peak(30.0)];
        let fitted =
            TapHistogram::fit(&maps.each_ref(), ATTENTION, PaperBinning::PUBLISHED).unwrap();
        assert_eq!(fitted.median_peak_energy, 30.0);
        assert!(matches!(
            fitted.binning,
            Binning::Attention {
                temperature: 6.0,
                levels: 256,
                first: 0
            }
        ));
    }
}
