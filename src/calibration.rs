//! Surveys of nominal sources → reference: temperature, bin edges, counts, medians and thresholds.

use crate::attention::EnergyMap;
use crate::gap::{Metric, PAPER_FIRST_LEVEL, PAPER_LEVELS, PAPER_TEMPERATURE};
use crate::histogram::{Binning, HistogramSum};
use crate::reference::{SPREAD_MIN, ScalePoint, SourceUse, TapReference};
use crate::survey::Survey;
use crate::undefined::Undefined;

/// Softmax temperature of the attention histogram, share of the median peak energy (design study: AUROC 0.97 of
/// telling other sets from unseen scenes, against 0.54 at a fixed T of 10).
pub const TEMPERATURE_SHARE: f64 = 0.2;
/// Added to energies before the logarithm, share of the median peak energy.
pub const EPSILON_SHARE: f64 = 1e-6;
/// Bins of equal mass of the log-energy histogram.
pub const LOG_ENERGY_BINS: usize = 64;
/// Cells of the fine grid on which bin edges may lie.
const GRID_CELLS: usize = 1 << 16;
/// Window lengths, frames, for which medians and thresholds are kept.
const WINDOW_FRAMES: [usize; 5] = [1, 2, 5, 10, 20];
/// Fewest held-out frames that a scale is made from.
const HELD_OUT_MIN: usize = 20;
/// The threshold lies this many times as far above the median as the worst held-out window.
pub const THRESHOLD_MARGIN: f64 = 1.5;

/// What can be said against the sources of a reference.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Frames that cannot be judged.
    #[error("{source_name}: frame {frame} cannot be judged: {why}")]
    Frame {
        /// The source.
        source_name: String,
        /// The frame's number from 0.
        frame: usize,
        /// Why.
        why: Undefined,
    },
    /// Too few frames.
    #[error("{0}")]
    TooFew(Undefined),
    /// Histograms that cannot be compared.
    #[error("tap {tap}, metric {metric}: {why}")]
    Comparison {
        /// Name of the tap.
        tap: String,
        /// The metric asked for.
        metric: Metric,
        /// Why.
        why: Undefined,
    },
}

/// A temperature as a user gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Temperature {
    /// Energy units.
    Absolute(f64),
    /// Times the reference's median peak energy.
    OfPeak(f64),
}

/// How the metric `paper` counts, when not as published.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperBinning {
    /// Softmax temperature.
    pub temperature: Temperature,
    /// Levels of the histogram.
    pub levels: usize,
    /// First level counted.
    pub first: usize,
}

impl PaperBinning {
    /// As published.
    pub const PUBLISHED: Self = Self {
        temperature: Temperature::Absolute(PAPER_TEMPERATURE),
        levels: PAPER_LEVELS,
        first: PAPER_FIRST_LEVEL,
    };
}

/// Nominal histograms of one tap before thresholds: the common part of references and comparisons.
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
    /// Scale, edges and counts of maps of the common size.
    ///
    /// # Errors
    /// `TooFewImages` without any map, `ConstantMap` for a constant one.
    pub fn fit(maps: &[EnergyMap], metric: Metric, paper: PaperBinning) -> Result<Self, Undefined> {
        let median_peak_energy = median(maps.iter().map(|map| map.range().1).collect()).ok_or(
            Undefined::TooFewImages {
                found: 0,
                wanted: 1,
            },
        )?;
        let binning = match metric {
            Metric::Paper => Binning::Attention {
                temperature: match paper.temperature {
                    Temperature::Absolute(t) => t,
                    Temperature::OfPeak(share) => share * median_peak_energy,
                },
                levels: paper.levels,
                first: paper.first,
            },
            Metric::AttentionJs => Binning::Attention {
                temperature: TEMPERATURE_SHARE * median_peak_energy,
                levels: PAPER_LEVELS,
                first: 0,
            },
            Metric::LogEnergyJs => {
                let epsilon = EPSILON_SHARE * median_peak_energy;
                Binning::LogEnergy {
                    epsilon,
                    edges: equal_mass_edges(maps, epsilon),
                }
            }
        };
        let mut sum = HistogramSum::new(binning.bins());
        for map in maps {
            sum.add(&counts_of(&binning, map)?);
        }
        Ok(Self {
            median_peak_energy,
            binning,
            sum,
        })
    }
}

/// Counts of one map.
///
/// # Errors
/// `ConstantMap`.
pub fn counts_of(binning: &Binning, map: &EnergyMap) -> Result<Vec<u32>, Undefined> {
    let mut counts = vec![0; binning.bins()];
    binning.count(map, &mut counts).map(|()| counts)
}

/// Inner edges of bins of equal mass, on cells of a fine grid; edges that tie are merged.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn equal_mass_edges(maps: &[EnergyMap], epsilon: f64) -> Vec<f64> {
    let low = epsilon.ln();
    let high = maps
        .iter()
        .map(|map| (map.range().1 + epsilon).ln())
        .fold(low, f64::max);
    let cell = (high - low) / GRID_CELLS as f64;
    let mut grid = vec![0_u64; GRID_CELLS + 1];
    for &g in maps.iter().flat_map(|map| &map.energy) {
        grid[((((g + epsilon).ln() - low) / cell) as usize).min(GRID_CELLS)] += 1;
    }
    let total: u64 = grid.iter().sum();
    let mut edges = Vec::with_capacity(LOG_ENERGY_BINS - 1);
    let (mut below, mut next) = (0_u64, 1_u64);
    for (index, &count) in grid.iter().enumerate() {
        below += count;
        if below * LOG_ENERGY_BINS as u64 >= next * total && below < total {
            edges.push(low + (index + 1) as f64 * cell);
            next = below * LOG_ENERGY_BINS as u64 / total + 1;
        }
    }
    edges
}

/// How a survey is used: to fit histograms, or held out to scale gaps.
struct Split<'a> {
    survey: &'a Survey,
    /// Frames before this one are fitted, the others are held out.
    fitted: usize,
}

/// With several sources every second one is held out whole; of a single one, its last third.
fn split(surveys: &[Survey]) -> Vec<Split<'_>> {
    let alone = surveys.len() == 1;
    let share = |index: usize, frames: usize| match (alone, index % 2) {
        (true, _) => frames - frames / 3,
        (false, 0) => frames,
        (false, _) => 0,
    };
    surveys
        .iter()
        .enumerate()
        .map(|(i, survey)| Split {
            survey,
            fitted: share(i, survey.frames.len()),
        })
        .collect()
}

/// Nominal attention of every tap, from surveys of nominal sources.
///
/// # Errors
/// When a frame cannot be judged or too few are at hand.
pub fn calibrate(
    surveys: &[Survey],
    taps: &[String],
    metric: Metric,
) -> Result<(Vec<TapReference>, Vec<SourceUse>), CalibrationError> {
    let splits = split(surveys);
    let uses: Vec<SourceUse> = splits
        .iter()
        .map(|split| SourceUse {
            source: split.survey.source.clone(),
            frames: split.survey.frames.len() as u64,
            fitted: split.fitted as u64,
            held_out: (split.survey.frames.len() - split.fitted) as u64,
        })
        .collect();
    let held_out: u64 = uses.iter().map(|u| u.held_out).sum();
    if held_out < HELD_OUT_MIN as u64 {
        let found = usize::try_from(held_out).unwrap_or(usize::MAX);
        return Err(CalibrationError::TooFew(Undefined::TooFewImages {
            found,
            wanted: HELD_OUT_MIN,
        }));
    }
    let references = taps
        .iter()
        .enumerate()
        .map(|(index, tap)| tap_reference(&splits, index, tap, metric))
        .collect::<Result<Vec<_>, _>>()?;
    Ok((references, uses))
}

fn tap_reference(
    splits: &[Split<'_>],
    index: usize,
    tap: &str,
    metric: Metric,
) -> Result<TapReference, CalibrationError> {
    let wrong = |why| CalibrationError::Comparison {
        tap: tap.to_owned(),
        metric,
        why,
    };
    let (mut fitted, mut held_out) = (Vec::new(), Vec::new());
    for split in splits {
        let mut kept = Vec::new();
        for (frame, map) in split.survey.common_maps(index).enumerate() {
            let map = map.map_err(|why| CalibrationError::Frame {
                source_name: split.survey.source.clone(),
                frame,
                why,
            })?;
            if frame < split.fitted {
                fitted.push(map)
            } else {
                kept.push(map)
            }
        }
        held_out.push(kept);
    }
    let TapHistogram {
        median_peak_energy,
        binning,
        sum,
    } = TapHistogram::fit(&fitted, metric, PaperBinning::PUBLISHED).map_err(wrong)?;
    drop(fitted);
    let counts: Vec<Vec<Vec<u32>>> = held_out
        .iter()
        .map(|maps| maps.iter().map(|map| counts_of(&binning, map)).collect())
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    let scale: Vec<ScalePoint> = WINDOW_FRAMES
        .into_iter()
        .filter_map(|frames| scale_point(&counts, frames, &sum, metric).transpose())
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    Ok(TapReference {
        tap: tap.to_owned(),
        median_peak_energy,
        binning,
        images: sum.images,
        counts: sum.counts,
        scale,
    })
}

/// Median and threshold over windows of `frames` consecutive held-out frames; `None` without enough windows.
fn scale_point(
    sources: &[Vec<Vec<u32>>],
    frames: usize,
    nominal: &HistogramSum,
    metric: Metric,
) -> Result<Option<ScalePoint>, Undefined> {
    let mut gaps = Vec::new();
    for window in sources
        .iter()
        .flat_map(|counts| counts.chunks_exact(frames))
    {
        let mut sum = HistogramSum::new(nominal.counts.len());
        window.iter().for_each(|counts| sum.add(counts));
        gaps.push(metric.compare(&sum.counts, &nominal.counts)?.gap);
    }
    let windows = gaps.len();
    let worst = gaps.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let Some(median) = median(gaps).filter(|_| windows >= 2) else {
        return Ok(None);
    };
    // A metric that cannot tell windows apart still gets a threshold above its median.
    let threshold = (median + THRESHOLD_MARGIN * (worst - median)).max(median + SPREAD_MIN);
    Ok(Some(ScalePoint {
        frames,
        windows,
        median,
        threshold,
    }))
}

/// The middle value; the mean of the two middle ones for an even count.
fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = values[(values.len() - 1) / 2];
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;

    fn ramp(from: usize, to: usize) -> EnergyMap {
        let energy: Vec<f64> = (from..to).map(|i| (i as f64 / 1_000.0).exp()).collect();
        EnergyMap {
            width: energy.len(),
            height: 1,
            energy,
        }
    }

    #[test]
    fn edges_cut_the_reference_into_equal_masses() {
        let fitted = TapHistogram::fit(
            &[ramp(0, 6_400)],
            Metric::LogEnergyJs,
            PaperBinning::PUBLISHED,
        )
        .unwrap();
        assert_eq!(fitted.sum.counts.len(), LOG_ENERGY_BINS);
        assert!(
            fitted.sum.counts.iter().all(|&n| (98..=102).contains(&n)),
            "{:?}",
            fitted.sum.counts
        );
    }

    #[test]
    fn edges_that_tie_are_merged() {
        // Three quarters of the pixels have no energy: they fill one bin, and the rest shares the other 16 or so.
        let mut map = ramp(0, 1_600);
        map.energy.extend(vec![0.0; 4_800]);
        let fitted =
            TapHistogram::fit(&[map], Metric::LogEnergyJs, PaperBinning::PUBLISHED).unwrap();
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
            TapHistogram::fit(&maps, Metric::AttentionJs, PaperBinning::PUBLISHED).unwrap();
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

    #[test]
    fn medians_of_even_and_odd_counts() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(vec![]), None);
    }
}
