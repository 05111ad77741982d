//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use std::time::Duration;

use crate::attention::{EnergyMap, Upsampler};
use crate::detector::Detector;
use crate::energies::ChannelMeans;
use crate::gap::moments::{self, ChannelNorm, Moments};
use crate::gap::{Metric, PAPER_FIRST_LEVEL, PAPER_LEVELS, PAPER_TEMPERATURE};
use crate::histogram::{Binning, HistogramSum};
use crate::reference::{
    Component, FalseAlarms, Nominal, SPREAD_MIN, ScalePoint, SourceUse, TapReference,
};
use crate::survey::Survey;
use crate::undefined::Undefined;

mod false_alarms;

pub use false_alarms::{DEMONSTRATED, DriveScores, poisson_interval};

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
/// Share of held-out windows below the threshold before the rate of false alarms moves all thresholds together: it sets
/// how the taps and window lengths weigh against each other.
const THRESHOLD_QUANTILE: f64 = 0.99;

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
    pub fn fit(
        maps: &[&EnergyMap],
        metric: Metric,
        paper: PaperBinning,
    ) -> Result<Self, Undefined> {
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
            Metric::Attention(_) => Binning::Attention {
                temperature: TEMPERATURE_SHARE * median_peak_energy,
                levels: PAPER_LEVELS,
                first: 0,
            },
            Metric::LogEnergy(_) => {
                let epsilon = EPSILON_SHARE * median_peak_energy;
                Binning::LogEnergy {
                    epsilon,
                    edges: equal_mass_edges(maps, epsilon),
                }
            }
            Metric::Frechet | Metric::Mahalanobis => return Err(Undefined::NoScore),
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
fn equal_mass_edges(maps: &[&EnergyMap], epsilon: f64) -> Vec<f64> {
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

/// What a reference is to be like.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// How gaps are measured.
    pub metric: Metric,
    /// Length of the detector's window, seconds.
    pub window_s: f64,
    /// Entries into `Gap` an hour of nominal driving.
    pub false_alarms_per_hour: f64,
}

/// Nominal drives of one domain.
pub struct Domain<'a> {
    /// `simulation`, or the accepted source as typed.
    pub name: String,
    /// Its drives.
    pub drives: &'a [Survey],
}

/// What came of a calibration.
pub struct Calibrated {
    /// The nominal domains with their thresholds.
    pub components: Vec<Component>,
    /// How often nominal drives enter `Gap`.
    pub false_alarms: FalseAlarms,
    /// What was looked at.
    pub sources: Vec<SourceUse>,
}

/// A drive of which the frames before `fitted` make histograms or moments, and the others scale gaps.
struct Split<'a> {
    survey: &'a Survey,
    fitted: usize,
}

/// With several drives every second one is held out whole; of a single one, its last third.
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

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// Every second drive of each domain makes histograms or moments, the others scale the gaps of windows. The rate is set on
/// every second drive of `held_out` and judged on the others; without any, the drives that scale the gaps serve for both,
/// and the reference says so.
///
/// # Errors
/// When a frame cannot be judged or too few are at hand.
pub fn calibrate(
    domains: &[Domain<'_>],
    held_out: &[Survey],
    taps: &[String],
    wanted: Wanted,
) -> Result<Calibrated, CalibrationError> {
    let mut sources = Vec::new();
    let mut components = Vec::new();
    let mut scaling: Vec<Track<'_>> = Vec::new();
    let mut simulation: Option<Vec<Moments>> = None;
    for domain in domains {
        let splits = split(domain.drives);
        sources.extend(splits.iter().map(|split| SourceUse {
            source: split.survey.source.clone(),
            frames: split.survey.frames.len() as u64,
            fitted: split.fitted as u64,
            held_out: (split.survey.frames.len() - split.fitted) as u64,
        }));
        let (mut fitted, mut scaled) = (Vec::new(), Vec::new());
        for split in &splits {
            let track = Track::of(split.survey, wanted.metric)?;
            let (fit, scale) = track.split_at(split.fitted);
            fitted.extend(fit.frames);
            if !scale.frames.is_empty() {
                scaled.push(scale);
            }
        }
        let found: usize = scaled.iter().map(|track| track.frames.len()).sum();
        if found < HELD_OUT_MIN {
            return Err(CalibrationError::TooFew(Undefined::TooFewImages {
                found,
                wanted: HELD_OUT_MIN,
            }));
        }
        let drives = splits.iter().filter(|split| split.fitted > 0).count();
        let moments = fitted_moments(&fitted, taps.len(), components.first());
        let component = taps
            .iter()
            .enumerate()
            .map(|(index, tap)| {
                let wider = simulation.as_ref().map(|all| (&all[index], drives));
                let nominal = TapNominal {
                    index,
                    fitted: &fitted,
                    moments: moments.get(index),
                    wider,
                    simulation: components.first(),
                };
                tap_reference(&nominal, &scaled, tap, wanted)
            })
            .collect::<Result<Vec<_>, _>>()?;
        if simulation.is_none() && !moments.is_empty() {
            simulation = Some(moments);
        }
        components.push(Component {
            name: domain.name.clone(),
            taps: component,
        });
        scaling.extend(scaled);
    }
    let optimistic = held_out.is_empty();
    let held_out: Vec<Track<'_>> = held_out
        .iter()
        .map(|survey| Track::of(survey, wanted.metric))
        .collect::<Result<_, _>>()?;
    sources.extend(held_out.iter().map(|track| SourceUse {
        source: track.source.to_owned(),
        frames: track.frames.len() as u64,
        fitted: 0,
        held_out: track.frames.len() as u64,
    }));
    let tracks = if optimistic { &scaling } else { &held_out };
    let drives = tracks
        .iter()
        .map(|track| track.scores(wanted, &components))
        .collect::<Result<Vec<_>, _>>()?;
    let false_alarms = false_alarms::calibrated(&drives, wanted.false_alarms_per_hour, optimistic);
    for tap in components
        .iter_mut()
        .flat_map(|component| &mut component.taps)
    {
        for point in &mut tap.scale {
            point.threshold = point.median + false_alarms.factor * (point.threshold - point.median);
        }
    }
    Ok(Calibrated {
        components,
        false_alarms,
        sources,
    })
}

/// What the encoder saw of one frame, as a reference takes it.
struct Seen<'a> {
    at: Duration,
    /// By tap, at the common size; empty of a metric that needs channels alone.
    common: Vec<EnergyMap>,
    peaks: &'a [f64],
    channels: &'a [ChannelMeans],
}

/// The frames of one drive.
struct Track<'a> {
    source: &'a str,
    frames: Vec<Seen<'a>>,
}

impl<'a> Track<'a> {
    fn of(survey: &'a Survey, metric: Metric) -> Result<Self, CalibrationError> {
        let needs_maps = metric.divergence().is_some();
        let mut upsamplers: Vec<Upsampler> = Vec::new();
        let frames = survey.frames.iter().enumerate().map(|(index, frame)| {
            let frame = frame.as_ref().map_err(|why| CalibrationError::Frame {
                source_name: survey.source.clone(),
                frame: index,
                why: why.clone(),
            })?;
            let mut common = Vec::new();
            if needs_maps {
                if upsamplers.is_empty() {
                    let sizes = frame.maps.iter().map(|map| (map.width, map.height));
                    upsamplers = sizes
                        .map(|from| Upsampler::new(from, survey.common_size))
                        .collect();
                }
                for (map, upsampler) in frame.maps.iter().zip(&upsamplers) {
                    let mut resampled = EnergyMap::default();
                    upsampler.resample(map, &mut resampled);
                    common.push(resampled);
                }
            }
            Ok(Seen {
                at: frame.at,
                common,
                peaks: &frame.peaks,
                channels: &frame.channels,
            })
        });
        Ok(Self {
            source: &survey.source,
            frames: frames.collect::<Result<_, CalibrationError>>()?,
        })
    }

    fn split_at(mut self, at: usize) -> (Self, Self) {
        let rest = self.frames.split_off(at);
        let source = self.source;
        (
            self,
            Self {
                source,
                frames: rest,
            },
        )
    }

    /// Windows one after the other, each the frames within `window_s` of its first.
    fn windows(&self, window_s: f64) -> impl Iterator<Item = &[Seen<'a>]> {
        let mut rest = self.frames.as_slice();
        std::iter::from_fn(move || {
            let first = rest.first()?.at;
            let end = rest
                .iter()
                .position(|seen| (seen.at.saturating_sub(first)).as_secs_f64() >= window_s);
            let (window, later) = rest.split_at(end.unwrap_or(rest.len()));
            rest = later;
            Some(window)
        })
    }

    /// The drive through the detector from its reset: the score of each frame.
    fn scores(
        &self,
        wanted: Wanted,
        components: &[Component],
    ) -> Result<DriveScores, CalibrationError> {
        let mut detector = Detector::of(wanted.metric, components.to_vec(), wanted.window_s);
        let mut taken = vec![0; detector.taken_len()];
        let mut drive = DriveScores::default();
        for (index, seen) in self.frames.iter().enumerate() {
            let wrong = |why| CalibrationError::Frame {
                source_name: self.source.to_owned(),
                frame: index,
                why,
            };
            let mut left = taken.as_mut_slice();
            for component in components {
                for (tap_index, tap) in component.taps.iter().enumerate() {
                    let (own, rest) = left.split_at_mut(tap.nominal.len());
                    seen.take(tap_index, &tap.nominal, own).map_err(wrong)?;
                    left = rest;
                }
            }
            let evidence = detector.observe(seen.at, &taken).map_err(wrong)?;
            drive.add(seen.at, evidence.score, evidence.fill >= 1.0);
        }
        Ok(drive)
    }
}

impl Seen<'_> {
    fn take(&self, tap: usize, nominal: &Nominal, taken: &mut [u32]) -> Result<(), Undefined> {
        let nothing = EnergyMap::default();
        nominal.take(
            self.common.get(tap).unwrap_or(&nothing),
            &self.channels[tap],
            taken,
        )
    }
}

/// What the nominal values of one tap are made of.
struct TapNominal<'a> {
    index: usize,
    fitted: &'a [Seen<'a>],
    /// Of the channels, for a metric on them.
    moments: Option<&'a Moments>,
    /// The simulation's moments and the own drives, of an accepted domain.
    wider: Option<(&'a Moments, usize)>,
    /// The simulation's component, of an accepted domain.
    simulation: Option<&'a Component>,
}

/// The channels' moments of all taps; with the epsilon of the simulation when there is one, or none for a metric on maps.
fn fitted_moments(
    fitted: &[Seen<'_>],
    taps: usize,
    simulation: Option<&Component>,
) -> Vec<Moments> {
    if fitted.iter().any(|seen| !seen.common.is_empty()) {
        return Vec::new();
    }
    (0..taps)
        .map(|tap| {
            let epsilon = epsilon_of(fitted, tap, simulation);
            let energies = fitted
                .iter()
                .map(|seen| seen.channels[tap].energy.as_slice());
            Moments::of(energies, epsilon)
        })
        .collect()
}

fn epsilon_of(fitted: &[Seen<'_>], tap: usize, simulation: Option<&Component>) -> f64 {
    if let Some(Nominal::Channels(norm)) = simulation.map(|of| &of.taps[tap].nominal) {
        return norm.epsilon;
    }
    moments::EPSILON_SHARE
        * median(fitted.iter().map(|seen| seen.peaks[tap]).collect()).unwrap_or(1.0)
}

fn tap_reference(
    of: &TapNominal<'_>,
    scaled: &[Track<'_>],
    tap: &str,
    wanted: Wanted,
) -> Result<TapReference, CalibrationError> {
    let metric = wanted.metric;
    let wrong = |why| CalibrationError::Comparison {
        tap: tap.to_owned(),
        metric,
        why,
    };
    let (median_peak_energy, images, nominal) = match of.moments {
        Some(moments) => {
            let peaks = of.fitted.iter().map(|seen| seen.peaks[of.index]).collect();
            let epsilon = epsilon_of(of.fitted, of.index, of.simulation);
            let norm = ChannelNorm::fit(epsilon, moments, of.wider).map_err(wrong)?;
            let peak = median(peaks).ok_or(wrong(Undefined::NoScore))?;
            (peak, moments.frames(), Nominal::Channels(norm))
        }
        None => {
            let maps: Vec<&EnergyMap> = of
                .fitted
                .iter()
                .map(|seen| &seen.common[of.index])
                .collect();
            let fitted =
                TapHistogram::fit(&maps, metric, PaperBinning::PUBLISHED).map_err(wrong)?;
            let nominal = Nominal::Histogram {
                binning: fitted.binning,
                counts: fitted.sum.counts,
            };
            (fitted.median_peak_energy, fitted.sum.images, nominal)
        }
    };
    let scale: Vec<ScalePoint> = WINDOW_FRAMES
        .into_iter()
        .filter_map(|frames| scale_point(scaled, frames, of.index, &nominal, wanted).transpose())
        .collect::<Result<_, _>>()
        .map_err(wrong)?;
    Ok(TapReference {
        tap: tap.to_owned(),
        median_peak_energy,
        images,
        nominal,
        scale,
    })
}

/// Median and threshold over windows of which `frames` frames are taken, evenly spread; `None` without enough windows.
fn scale_point(
    tracks: &[Track<'_>],
    frames: usize,
    tap: usize,
    nominal: &Nominal,
    wanted: Wanted,
) -> Result<Option<ScalePoint>, Undefined> {
    let mut gaps = Vec::new();
    let mut taken = vec![0; nominal.len()];
    let windows = tracks
        .iter()
        .flat_map(|track| track.windows(wanted.window_s));
    for window in windows.filter(|window| window.len() >= frames) {
        let mut sums = vec![0_u64; nominal.len()];
        for index in 0..frames {
            window[index * window.len() / frames].take(tap, nominal, &mut taken)?;
            sums.iter_mut()
                .zip(&taken)
                .for_each(|(sum, &value)| *sum += u64::from(value));
        }
        gaps.push(nominal.compare(wanted.metric, &sums, frames)?.gap);
    }
    let windows = gaps.len();
    gaps.sort_by(f64::total_cmp);
    let high = quantile(&gaps, THRESHOLD_QUANTILE);
    let (Some(median), Some(high)) = (median(gaps), high) else {
        return Ok(None);
    };
    if windows < 2 {
        return Ok(None);
    }
    // A metric that cannot tell windows apart still gets a threshold above its median.
    let threshold = high.max(median + SPREAD_MIN);
    Ok(Some(ScalePoint {
        frames,
        windows,
        median,
        threshold,
    }))
}

/// The value that a share of rising values does not exceed.
#[allow(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
fn quantile(rising: &[f64], share: f64) -> Option<f64> {
    let last = rising.len().checked_sub(1)?;
    rising.get((share * last as f64).ceil() as usize).copied()
}

/// The middle value; the mean of the two middle ones for an even count.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = values[(values.len() - 1) / 2];
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;
    use crate::gap::Divergence;

    const LOG_ENERGY: Metric = Metric::LogEnergy(Divergence::JensenShannon);
    const ATTENTION: Metric = Metric::Attention(Divergence::JensenShannon);

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
        // Three quarters of the pixels have no energy: they fill one bin, and the rest shares the other 16 or so.
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

    #[test]
    fn medians_of_even_and_odd_counts() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(vec![]), None);
    }
}
