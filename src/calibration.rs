//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use std::ops::Range;
use std::time::Duration;

use crate::alarm::Reason;
use crate::attention::{EnergyMap, Upsampler};
use crate::detector::Detector;
use crate::energies::BlockMeans;
use crate::gap::lane_risk::{Labelled, LaneRisk};
use crate::gap::moments::{self, EnergyNorm, Moments, energy_levels};
use crate::gap::{Metric, PAPER_FIRST_LEVEL, PAPER_LEVELS, PAPER_TEMPERATURE};
use crate::histogram::{Binning, HistogramSum};
use crate::intake::Intake;
use crate::reference::{
    Component, FalseAlarms, Nominal, SPREAD_MIN, ScalePoint, SourceUse, TapReference,
};
use crate::survey::{Survey, SurveyFrame};
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
            Metric::Frechet | Metric::Mahalanobis | Metric::LaneRisk => {
                return Err(Undefined::NoScore);
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

/// A frame with lane labels: what the encoder saw, and what the lane model lost.
#[derive(Clone, Debug)]
pub struct LabelledMeans {
    /// Means of each block.
    pub means: Vec<BlockMeans>,
    /// 1 - IoU / IoU of the same frame in plain day, 0 to 1.
    pub loss: f64,
}

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// Every second drive of each domain makes histograms or moments, the others scale the gaps of windows. The rate is set on
/// three of every four drives of `held_out` and judged on the fourth; without any, the drives that scale the gaps serve for both,
/// and the reference says so. `labelled` frames are for the metric `lane-risk` alone.
///
/// # Errors
/// When a frame cannot be judged or too few are at hand.
pub fn calibrate(
    domains: &[Domain<'_>],
    held_out: &[Survey],
    labelled: &[LabelledMeans],
    taps: &[String],
    wanted: Wanted,
) -> Result<Calibrated, CalibrationError> {
    let mut sources = Vec::new();
    let mut components: Vec<Component> = Vec::new();
    let mut scaling: Vec<Part<'_>> = Vec::new();
    let mut simulation: Option<Vec<Moments>> = None;
    for domain in domains {
        let splits = split(domain.drives);
        sources.extend(splits.iter().map(|split| SourceUse {
            source: split.survey.source.clone(),
            frames: split.survey.frames.len() as u64,
            fitted: split.fitted as u64,
            held_out: (split.survey.frames.len() - split.fitted) as u64,
        }));
        let mut fitted = Vec::new();
        let mut scaled = Vec::new();
        for Split { survey, fitted: n } in &splits {
            fitted.extend(Part::of(survey, 0..*n)?.frames);
            let rest = Part::of(survey, *n..survey.frames.len())?;
            if !rest.frames.is_empty() {
                scaled.push(rest);
            }
        }
        let found: usize = scaled.iter().map(|part| part.frames.len()).sum();
        if found < HELD_OUT_MIN {
            return Err(CalibrationError::TooFew(Undefined::TooFewImages {
                found,
                wanted: HELD_OUT_MIN,
            }));
        }
        let common_size = domain.drives[0].common_size;
        let moments = match wanted.metric.divergence() {
            Some(_) => Vec::new(),
            None => fitted_moments(&fitted, taps.len(), components.first()),
        };
        let drives = splits.iter().filter(|split| split.fitted > 0).count();
        let nominal = taps.iter().enumerate().map(|(index, tap)| {
            let of = Fitted {
                index,
                frames: &fitted,
                common_size,
                moments: moments.get(index),
                wider: simulation.as_ref().map(|all| (&all[index], drives)),
                simulation: components.first(),
                labelled,
            };
            of.tap_reference(tap, wanted.metric)
        });
        let mut component = Component {
            name: domain.name.clone(),
            taps: nominal.collect::<Result<_, _>>()?,
        };
        let tracks = scaled
            .iter()
            .map(|part| part.track(wanted.metric, std::slice::from_ref(&component)))
            .collect::<Result<Vec<_>, _>>()?;
        let mut from = 0;
        for tap in &mut component.taps {
            let columns = from..from + tap.nominal.len();
            from = columns.end;
            let points = WINDOW_FRAMES.into_iter().filter_map(|frames| {
                scale_point(&tracks, columns.clone(), frames, &tap.nominal, wanted).transpose()
            });
            tap.scale = points
                .collect::<Result<_, _>>()
                .map_err(|why| wrong(&tap.tap, wanted.metric, why))?;
        }
        if simulation.is_none() && !moments.is_empty() {
            simulation = Some(moments);
        }
        components.push(component);
        scaling.extend(scaled);
    }
    let optimistic = held_out.is_empty();
    let held_out = held_out
        .iter()
        .map(|survey| Part::of(survey, 0..survey.frames.len()))
        .collect::<Result<Vec<_>, _>>()?;
    sources.extend(held_out.iter().map(|part| SourceUse {
        source: part.survey.source.clone(),
        frames: part.frames.len() as u64,
        fitted: 0,
        held_out: part.frames.len() as u64,
    }));
    let drives = if optimistic { &scaling } else { &held_out }
        .iter()
        .map(|part| part.scores(wanted, &components))
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

fn wrong(tap: &str, metric: Metric, why: Undefined) -> CalibrationError {
    CalibrationError::Comparison {
        tap: tap.to_owned(),
        metric,
        why,
    }
}

/// Frames of one drive, all of which can be judged.
struct Part<'a> {
    survey: &'a Survey,
    /// Number of the first frame in the drive.
    first: usize,
    frames: Vec<&'a SurveyFrame>,
}

impl<'a> Part<'a> {
    fn of(survey: &'a Survey, range: Range<usize>) -> Result<Self, CalibrationError> {
        let first = range.start;
        let frames = survey.frames[range]
            .iter()
            .enumerate()
            .map(|(index, frame)| {
                frame.as_ref().map_err(|why| CalibrationError::Frame {
                    source_name: survey.source.clone(),
                    frame: first + index,
                    why: why.clone(),
                })
            });
        Ok(Self {
            survey,
            first,
            frames: frames.collect::<Result<_, _>>()?,
        })
    }

    fn wrong(&self, index: usize, why: Undefined) -> CalibrationError {
        CalibrationError::Frame {
            source_name: self.survey.source.clone(),
            frame: self.first + index,
            why,
        }
    }

    /// What the domains take of each frame.
    fn track(&self, metric: Metric, components: &[Component]) -> Result<Track, CalibrationError> {
        let width = Component::taken_len(components);
        let mut intake = Intake::new(metric, components[0].taps.len(), self.survey.common_size);
        let mut taken = vec![0; width * self.frames.len()];
        let rows = taken.chunks_exact_mut(width.max(1));
        for (index, (frame, row)) in self.frames.iter().zip(rows).enumerate() {
            intake
                .take(&frame.maps, &frame.means, components, row)
                .map_err(|why| self.wrong(index, why))?;
        }
        Ok(Track {
            at: self.survey.times[self.first..][..self.frames.len()].to_vec(),
            width,
            taken,
        })
    }

    /// The drive through the detector from its reset: the score of each frame.
    fn scores(
        &self,
        wanted: Wanted,
        components: &[Component],
    ) -> Result<DriveScores, CalibrationError> {
        let track = self.track(wanted.metric, components)?;
        let mut detector = Detector::of(wanted.metric, components.to_vec(), wanted.window_s);
        let mut drive = DriveScores::default();
        for (index, (&at, taken)) in track.at.iter().zip(track.rows(0..track.len())).enumerate() {
            let evidence = detector
                .observe(at, taken)
                .map_err(|why| self.wrong(index, why))?;
            drive.add(at, evidence.score, evidence.fill >= 1.0);
        }
        Ok(drive)
    }
}

/// A survey through the detector from its reset: the score of each frame, or why it has none.
pub fn drive_scores(
    survey: &Survey,
    metric: Metric,
    window_s: f64,
    components: &[Component],
) -> DriveScores {
    let mut intake = Intake::new(metric, components[0].taps.len(), survey.common_size);
    let mut detector = Detector::of(metric, components.to_vec(), window_s);
    let mut taken = vec![0; detector.taken_len()];
    let mut drive = DriveScores::default();
    for (&at, frame) in survey.times.iter().zip(&survey.frames) {
        let evidence = frame.as_ref().map_err(Undefined::clone).and_then(|frame| {
            intake.take(&frame.maps, &frame.means, components, &mut taken)?;
            detector.observe(at, &taken)
        });
        match evidence {
            Ok(evidence) => drive.add(at, evidence.score, evidence.fill >= 1.0),
            Err(why) => drive.add_unjudged(at, Reason::from(&why)),
        }
    }
    drive
}

/// What was taken of the frames of a drive.
struct Track {
    at: Vec<Duration>,
    /// Numbers taken of a frame.
    width: usize,
    /// `[frames, width]`
    taken: Vec<u32>,
}

impl Track {
    fn len(&self) -> usize {
        self.at.len()
    }

    fn rows(&self, frames: Range<usize>) -> impl Iterator<Item = &[u32]> {
        self.taken[frames.start * self.width..frames.end * self.width]
            .chunks_exact(self.width.max(1))
    }

    /// Windows one after the other, each the frames within `window_s` of its first.
    fn windows(&self, window_s: f64) -> impl Iterator<Item = Range<usize>> {
        let mut next = 0;
        std::iter::from_fn(move || {
            let from = next;
            let first = *self.at.get(from)?;
            let within = |at: &Duration| at.saturating_sub(first).as_secs_f64() < window_s;
            next = from
                + self.at[from..]
                    .iter()
                    .take_while(|at| within(at))
                    .count()
                    .max(1);
            Some(from..next)
        })
    }
}

/// What the nominal values of one tap are made of.
struct Fitted<'a> {
    index: usize,
    frames: &'a [&'a SurveyFrame],
    common_size: (usize, usize),
    /// Of the energies, for a metric on them.
    moments: Option<&'a Moments>,
    /// The simulation's moments and the own drives, of an accepted domain.
    wider: Option<(&'a Moments, usize)>,
    /// The simulation's component, of an accepted domain.
    simulation: Option<&'a Component>,
    labelled: &'a [LabelledMeans],
}

/// The energies' moments of all taps; with the epsilon of the simulation when there is one.
fn fitted_moments(
    fitted: &[&SurveyFrame],
    taps: usize,
    simulation: Option<&Component>,
) -> Vec<Moments> {
    (0..taps)
        .map(|tap| {
            let epsilon = epsilon_of(fitted, tap, simulation);
            let energies = fitted.iter().map(|seen| seen.means[tap].energy.as_slice());
            Moments::of(energies, epsilon)
        })
        .collect()
}

fn epsilon_of(fitted: &[&SurveyFrame], tap: usize, simulation: Option<&Component>) -> f64 {
    if let Some(Nominal::Energies(norm)) = simulation.map(|of| &of.taps[tap].nominal) {
        return norm.epsilon;
    }
    moments::EPSILON_SHARE
        * median(fitted.iter().map(|seen| seen.peaks[tap]).collect()).unwrap_or(1.0)
}

impl Fitted<'_> {
    /// What is nominal of the tap; its gaps are not scaled yet.
    fn tap_reference(&self, tap: &str, metric: Metric) -> Result<TapReference, CalibrationError> {
        let wrong = |why| wrong(tap, metric, why);
        let (median_peak_energy, images, nominal) = match self.moments {
            Some(moments) => {
                let peaks = self
                    .frames
                    .iter()
                    .map(|seen| seen.peaks[self.index])
                    .collect();
                let peak = median(peaks).ok_or(wrong(Undefined::NoScore))?;
                let nominal = self.energies(moments, metric).map_err(wrong)?;
                (peak, moments.frames(), nominal)
            }
            None => {
                let maps = self.common_maps();
                let maps: Vec<&EnergyMap> = maps.iter().collect();
                let fitted =
                    TapHistogram::fit(&maps, metric, PaperBinning::PUBLISHED).map_err(wrong)?;
                let nominal = Nominal::Histogram {
                    binning: fitted.binning,
                    counts: fitted.sum.counts,
                };
                (fitted.median_peak_energy, fitted.sum.images, nominal)
            }
        };
        Ok(TapReference {
            tap: tap.to_owned(),
            median_peak_energy,
            images,
            nominal,
            scale: Vec::new(),
        })
    }

    fn energies(&self, moments: &Moments, metric: Metric) -> Result<Nominal, Undefined> {
        let epsilon = epsilon_of(self.frames, self.index, self.simulation);
        if metric != Metric::LaneRisk {
            return EnergyNorm::fit(epsilon, moments, self.wider).map(Nominal::Energies);
        }
        let levels: Vec<Vec<u32>> = self
            .labelled
            .iter()
            .map(|frame| {
                let energy = &frame.means[self.index].energy;
                let mut levels = vec![0; energy.len()];
                energy_levels(energy, epsilon, &mut levels);
                levels
            })
            .collect();
        let labelled: Vec<Labelled<'_>> = levels
            .iter()
            .zip(self.labelled)
            .map(|(levels, frame)| Labelled {
                levels,
                loss: frame.loss,
            })
            .collect();
        LaneRisk::fit(epsilon, moments, &labelled).map(Nominal::LaneRisk)
    }

    fn common_maps(&self) -> Vec<EnergyMap> {
        let maps = self.frames.iter().map(|frame| &frame.maps[self.index]);
        let mut upsampler = None;
        maps.map(|map| {
            let upsampler = upsampler
                .get_or_insert_with(|| Upsampler::new((map.width, map.height), self.common_size));
            let mut common = EnergyMap::default();
            upsampler.resample(map, &mut common);
            common
        })
        .collect()
    }
}

/// Median and threshold over windows of which `frames` frames are taken, evenly spread; `None` without enough windows.
fn scale_point(
    tracks: &[Track],
    columns: Range<usize>,
    frames: usize,
    nominal: &Nominal,
    wanted: Wanted,
) -> Result<Option<ScalePoint>, Undefined> {
    let mut gaps = Vec::new();
    for track in tracks {
        for window in track.windows(wanted.window_s) {
            if window.len() < frames {
                continue;
            }
            let rows: Vec<&[u32]> = track.rows(window).collect();
            let mut sums = vec![0_u64; columns.len()];
            for index in 0..frames {
                let row = &rows[index * rows.len() / frames][columns.clone()];
                sums.iter_mut()
                    .zip(row)
                    .for_each(|(sum, &value)| *sum += u64::from(value));
            }
            gaps.push(nominal.compare(wanted.metric, &sums, frames)?.gap);
        }
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
