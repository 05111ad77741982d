//! Surveys of nominal sources → reference: what is nominal, medians, and thresholds for a wanted rate of false alarms.

use std::borrow::Cow;
use std::ops::Range;
use std::time::Duration;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::false_alarms::{self, DriveScores};
use crate::calibration::survey::store::StoreError;
use crate::calibration::survey::{Survey, SurveyFrame};
use crate::capture::undefined::Undefined;
use crate::features::attention::{EnergyMap, Upsampler};
use crate::features::energies::BlockMeans;
use crate::features::histogram::{Binning, HistogramSum};
use crate::monitor::alarm::Reason;
use crate::monitor::detector::Detector;
use crate::monitor::intake::Intake;
use crate::reference::gap::lane_risk::LaneRiskFit;
use crate::reference::gap::moments::{self, EnergyNorm, Moments};
use crate::reference::gap::{Metric, PAPER_FIRST_LEVEL, PAPER_LEVELS, PAPER_TEMPERATURE};
use crate::reference::{
    Component, FalseAlarms, Nominal, Role, SPREAD_MIN, ScalePoint, SourceUse, TapReference,
};

/// Softmax temperature of the attention histogram, share of the median peak energy. A fixed temperature of 10 keeps about
/// one pixel an image of a trained net (`calibration/RESULTS.md`, field_sets, has both).
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
    /// A drive that can no longer be read.
    #[error(transparent)]
    Store(#[from] StoreError),
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
    /// `ConstantMap`.
    fn add(&mut self, map: &EnergyMap) -> Result<(), Undefined> {
        self.sum.add(&counts_of(&self.binning, map)?);
        Ok(())
    }
}

/// What the peaks of all images say about how pixels are to be counted: the first of three looks at them. The second sums
/// the masses between which edges lie, the third counts.
struct Cut {
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
    /// From the largest energy of each image at the common size.
    ///
    /// # Errors
    /// `TooFewImages` without any, `NoScore` of a metric without histograms.
    fn of(peaks: Vec<f64>, metric: Metric, paper: PaperBinning) -> Result<Self, Undefined> {
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

    /// Masses with nothing summed yet; of attention, which needs none, without cells.
    #[allow(clippy::cast_precision_loss)]
    fn masses(&self) -> Masses {
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

    /// How pixels are counted, and no counts yet.
    fn nothing_counted(&self, masses: &Masses) -> TapHistogram {
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
struct Masses {
    epsilon: f64,
    low: f64,
    cell: f64,
    grid: Vec<u64>,
}

impl Masses {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    fn add(&mut self, map: &EnergyMap) {
        if self.grid.is_empty() {
            return;
        }
        for &g in &map.energy {
            let index = (((g + self.epsilon).ln() - self.low) / self.cell) as usize;
            self.grid[index.min(GRID_CELLS)] += 1;
        }
    }

    fn merge(&mut self, other: &Self) {
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

/// Counts of one map.
///
/// # Errors
/// `ConstantMap`.
pub fn counts_of(binning: &Binning, map: &EnergyMap) -> Result<Vec<u32>, Undefined> {
    let mut counts = vec![0; binning.bins()];
    binning.count(map, &mut counts).map(|()| counts)
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

/// A drive that can be looked at as often as needed: in memory, or kept on disk.
pub trait Drive: Sync {
    /// As typed.
    fn source(&self) -> &str;

    /// Frames of the whole drive.
    fn frames(&self) -> usize;

    /// What the encoder saw of it.
    ///
    /// # Errors
    /// When it can no longer be read.
    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError>;
}

impl Drive for Survey {
    fn source(&self) -> &str {
        &self.source
    }

    fn frames(&self) -> usize {
        self.frames.len()
    }

    fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
        Ok(Cow::Borrowed(self))
    }
}

/// Frames with lane labels that can be looked at as often as needed: in memory, or kept on disk.
pub trait LabelledDrive: Sync {
    /// How many.
    fn frames(&self) -> usize;

    /// The frames.
    ///
    /// # Errors
    /// When they can no longer be read.
    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError>;
}

impl LabelledDrive for LabelledMeans {
    fn frames(&self) -> usize {
        1
    }

    fn means(&self) -> Result<Cow<'_, [LabelledMeans]>, StoreError> {
        Ok(Cow::Borrowed(std::slice::from_ref(self)))
    }
}

/// Nominal drives of one domain.
pub struct Domain<'a, D> {
    /// `simulation`, or the accepted source as typed.
    pub name: String,
    /// Its drives.
    pub drives: &'a [D],
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
struct Split<'a, D> {
    drive: &'a D,
    fitted: usize,
}

/// With several drives every second one is held out whole; of a single one, its last third.
fn split<D: Drive>(drives: &[D]) -> Vec<Split<'_, D>> {
    let alone = drives.len() == 1;
    let share = |index: usize, frames: usize| match (alone, index % 2) {
        (true, _) => frames - frames / 3,
        (false, 0) => frames,
        (false, _) => 0,
    };
    drives
        .iter()
        .enumerate()
        .map(|(i, drive)| Split {
            drive,
            fitted: share(i, drive.frames()),
        })
        .collect()
}

impl<'a, D: Drive> Split<'a, D> {
    fn fitted(&self) -> Stretch<'a, D> {
        Stretch {
            drive: self.drive,
            range: 0..self.fitted,
        }
    }

    fn rest(&self) -> Stretch<'a, D> {
        Stretch {
            drive: self.drive,
            range: self.fitted..self.drive.frames(),
        }
    }
}

/// Some frames of a drive, looked at anew whenever they are needed.
struct Stretch<'a, D> {
    drive: &'a D,
    range: Range<usize>,
}

impl<D: Drive> Stretch<'_, D> {
    /// Looks at the frames, all of which must be such as can be judged.
    fn look<T>(
        &self,
        at: impl FnOnce(&Part<'_>) -> Result<T, CalibrationError>,
    ) -> Result<T, CalibrationError> {
        let survey = self.drive.survey()?;
        at(&Part::of(&survey, self.range.clone())?)
    }
}

/// Looks at many stretches, one a thread at a time; what came of each, in their order.
fn look_at_all<D: Drive, T: Send>(
    stretches: &[Stretch<'_, D>],
    at: impl Fn(&Part<'_>) -> Result<T, CalibrationError> + Sync,
) -> Result<Vec<T>, CalibrationError> {
    let seen: Vec<_> = stretches
        .par_iter()
        .map(|stretch| stretch.look(&at))
        .collect();
    seen.into_iter().collect()
}

/// Sums over many stretches, one a thread at a time. `merge` must not care for order, as sums of integers do not.
fn sum_over_all<D: Drive, T: Send + Sync + Clone>(
    stretches: &[Stretch<'_, D>],
    nothing: &T,
    add: impl Fn(&mut T, &Part<'_>) -> Result<(), CalibrationError> + Sync,
    merge: impl Fn(&mut T, &T) + Sync,
) -> Result<T, CalibrationError> {
    stretches
        .par_iter()
        .try_fold(
            || nothing.clone(),
            |mut sum, stretch| stretch.look(|part| add(&mut sum, part)).map(|()| sum),
        )
        .try_reduce(
            || nothing.clone(),
            |mut sum, other| {
                merge(&mut sum, &other);
                Ok(sum)
            },
        )
}

/// A frame with lane labels: what the encoder saw, and what the lane model lost.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LabelledMeans {
    /// Means of each block.
    pub means: Vec<BlockMeans>,
    /// 1 - IoU / IoU of the same frame in plain day, 0 to 1.
    pub loss: f64,
}

/// How often [`calibrate`] looks at drives in all, once for each drive each time.
pub fn looks<D: Drive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    metric: Metric,
) -> u64 {
    // Peaks, then masses and counts of histograms, or moments.
    let of_fitted = match metric {
        Metric::LogEnergy(_) => 3,
        _ => 2,
    };
    let (mut fitted, mut scaled) = (0, 0);
    for split in domains.iter().flat_map(|domain| split(domain.drives)) {
        fitted += usize::from(split.fitted > 0);
        scaled += usize::from(split.fitted < split.drive.frames());
    }
    let scored = if held_out.is_empty() {
        scaled
    } else {
        held_out.len()
    };
    (of_fitted * fitted + scaled + scored + labelled.len()) as u64
}

/// Makes the nominal domains of a reference and the thresholds that keep the wanted rate of false alarms.
///
/// The first domain is the simulation. Every second drive of each domain makes histograms or moments, the others scale the
/// gaps of windows. The rate is set on three of every four drives of `held_out` and judged on the fourth; without any, the
/// drives that scale the gaps serve for both, and the reference says so. `labelled` frames are for the metric `lane-risk`
/// alone.
///
/// Drives are looked at several times, one a thread at a time; what is kept of them meanwhile is less than 100 bytes a
/// frame. The result does not depend on the number of threads.
///
/// # Errors
/// When a frame cannot be judged, too few are at hand, or a drive can no longer be read.
pub fn calibrate<D: Drive, L: LabelledDrive>(
    domains: &[Domain<'_, D>],
    held_out: &[D],
    labelled: &[L],
    taps: &[String],
    wanted: Wanted,
) -> Result<Calibrated, CalibrationError> {
    let mut sources = Vec::new();
    let mut components: Vec<Component> = Vec::new();
    let mut scaling: Vec<Stretch<'_, D>> = Vec::new();
    let mut simulation: Option<Vec<Moments>> = None;
    for (index, domain) in domains.iter().enumerate() {
        let splits = split(domain.drives);
        sources.extend(splits.iter().map(|split| SourceUse {
            source: split.drive.source().to_owned(),
            role: Some(match index {
                0 => Role::Simulation,
                _ => Role::Accepted,
            }),
            frames: split.drive.frames() as u64,
            fitted: split.fitted as u64,
            held_out: split.rest().range.len() as u64,
        }));
        let some = |stretch: &Stretch<'_, D>| !stretch.range.is_empty();
        let fitted: Vec<_> = splits.iter().map(Split::fitted).filter(some).collect();
        let scaled: Vec<_> = splits.iter().map(Split::rest).filter(some).collect();
        let found: usize = scaled.iter().map(|stretch| stretch.range.len()).sum();
        if found < HELD_OUT_MIN {
            return Err(CalibrationError::TooFew(Undefined::TooFewImages {
                found,
                wanted: HELD_OUT_MIN,
            }));
        }
        let fitting = Fitting {
            fitted: &fitted,
            taps,
            metric: wanted.metric,
        };
        let taps = match wanted.metric.divergence() {
            Some(_) => fitting.histograms()?,
            None => {
                let (peaks, moments) = fitting.moments(components.first())?;
                let taps = fitting.energies(
                    &peaks,
                    &moments,
                    simulation.as_deref(),
                    components.first(),
                    labelled,
                )?;
                simulation.get_or_insert(moments);
                taps
            }
        };
        let mut component = Component {
            name: domain.name.clone(),
            taps,
        };
        scale(&mut component, &scaled, wanted)?;
        components.push(component);
        scaling.extend(scaled);
    }
    sources.extend(held_out.iter().map(|drive| SourceUse {
        source: drive.source().to_owned(),
        role: Some(Role::HeldOut),
        frames: drive.frames() as u64,
        fitted: 0,
        held_out: drive.frames() as u64,
    }));
    let optimistic = held_out.is_empty();
    if !optimistic {
        let whole = held_out.iter().map(|drive| Stretch {
            drive,
            range: 0..drive.frames(),
        });
        scaling = whole.collect();
    }
    let drives = look_at_all(&scaling, |part| part.scores(wanted, &components))?;
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

    /// The maps of one tap at the common size, frame by frame.
    fn common_maps(&self, tap: usize, mut each: impl FnMut(&EnergyMap)) {
        let mut upsampler = None;
        let mut common = EnergyMap::default();
        for frame in &self.frames {
            let map = &frame.maps[tap];
            let size = (map.width, map.height);
            let upsampler =
                upsampler.get_or_insert_with(|| Upsampler::new(size, self.survey.common_size));
            upsampler.resample(map, &mut common);
            each(&common);
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

    /// Gaps of the windows of which `frames` frames are taken, evenly spread.
    fn gaps(
        &self,
        columns: Range<usize>,
        frames: usize,
        nominal: &Nominal,
        wanted: Wanted,
    ) -> Result<Vec<f64>, Undefined> {
        let mut gaps = Vec::new();
        for window in self.windows(wanted.window_s) {
            if window.len() < frames {
                continue;
            }
            let rows: Vec<&[u32]> = self.rows(window).collect();
            let mut sums = vec![0_u64; columns.len()];
            for index in 0..frames {
                let row = &rows[index * rows.len() / frames][columns.clone()];
                sums.iter_mut()
                    .zip(row)
                    .for_each(|(sum, &value)| *sum += u64::from(value));
            }
            gaps.push(nominal.compare(wanted.metric, &sums, frames)?.gap);
        }
        Ok(gaps)
    }
}

/// What the nominal values of a domain are made of.
struct Fitting<'a, D> {
    fitted: &'a [Stretch<'a, D>],
    taps: &'a [String],
    metric: Metric,
}

impl<D: Drive> Fitting<'_, D> {
    fn wrong(&self, tap: usize, why: Undefined) -> CalibrationError {
        wrong(&self.taps[tap], self.metric, why)
    }

    /// By tap, what each stretch has of each frame, in order.
    fn peaks(
        &self,
        of: impl Fn(&Part<'_>, usize) -> Vec<f64> + Sync,
    ) -> Result<Vec<Vec<f64>>, CalibrationError> {
        let taps = 0..self.taps.len();
        let seen = look_at_all(self.fitted, |part| {
            Ok(taps.clone().map(|tap| of(part, tap)).collect::<Vec<_>>())
        })?;
        let of_tap = |tap: usize| seen.iter().flat_map(move |part| part[tap].iter().copied());
        Ok(taps.map(|tap| of_tap(tap).collect()).collect())
    }

    /// What is nominal of each tap, by its histogram; the gaps are not scaled yet.
    fn histograms(&self) -> Result<Vec<TapReference>, CalibrationError> {
        let peaks = self.peaks(|part, tap| {
            let mut peaks = Vec::with_capacity(part.frames.len());
            part.common_maps(tap, |map| peaks.push(map.range().1));
            peaks
        })?;
        let cut = |(tap, peaks)| {
            Cut::of(peaks, self.metric, PaperBinning::PUBLISHED).map_err(|why| self.wrong(tap, why))
        };
        let cuts: Vec<Cut> = peaks
            .into_iter()
            .enumerate()
            .map(cut)
            .collect::<Result<_, _>>()?;
        let mut masses: Vec<Masses> = cuts.iter().map(Cut::masses).collect();
        if masses.iter().any(|masses| !masses.grid.is_empty()) {
            masses = sum_over_all(
                self.fitted,
                &masses,
                |sums, part| {
                    for (tap, sum) in sums.iter_mut().enumerate() {
                        part.common_maps(tap, |map| sum.add(map));
                    }
                    Ok(())
                },
                |sums, others| sums.iter_mut().zip(others).for_each(|(a, b)| a.merge(b)),
            )?;
        }
        let nothing: Vec<TapHistogram> = cuts
            .iter()
            .zip(&masses)
            .map(|(cut, masses)| cut.nothing_counted(masses))
            .collect();
        let counted = sum_over_all(
            self.fitted,
            &nothing,
            |sums, part| {
                for (tap, sum) in sums.iter_mut().enumerate() {
                    let mut counted = Ok(());
                    part.common_maps(tap, |map| {
                        if counted.is_ok() {
                            counted = sum.add(map);
                        }
                    });
                    counted.map_err(|why| self.wrong(tap, why))?;
                }
                Ok(())
            },
            |sums, others| {
                let sums = sums.iter_mut().zip(others);
                sums.for_each(|(a, b)| a.sum.merge(&b.sum));
            },
        )?;
        let nominal = self
            .taps
            .iter()
            .zip(counted)
            .map(|(tap, fitted)| TapReference {
                tap: tap.clone(),
                median_peak_energy: fitted.median_peak_energy,
                images: fitted.sum.images,
                nominal: Nominal::Histogram {
                    binning: fitted.binning,
                    counts: fitted.sum.counts,
                },
                scale: Vec::new(),
            });
        Ok(nominal.collect())
    }

    /// Median peak energy and moments of each tap; with the epsilon of the simulation when there is one.
    fn moments(
        &self,
        simulation: Option<&Component>,
    ) -> Result<(Vec<f64>, Vec<Moments>), CalibrationError> {
        let peaks =
            self.peaks(|part, tap| part.frames.iter().map(|seen| seen.peaks[tap]).collect())?;
        let medians = peaks
            .into_iter()
            .enumerate()
            .map(|(tap, peaks)| median(peaks).ok_or_else(|| self.wrong(tap, Undefined::NoScore)));
        let peaks: Vec<f64> = medians.collect::<Result<_, _>>()?;
        let epsilons: Vec<f64> = peaks
            .iter()
            .enumerate()
            .map(|(tap, peak)| epsilon_of(*peak, tap, simulation))
            .collect();
        let nothing = vec![Moments::new(0); self.taps.len()];
        let moments = sum_over_all(
            self.fitted,
            &nothing,
            |sums, part| {
                for (tap, (sum, &epsilon)) in sums.iter_mut().zip(&epsilons).enumerate() {
                    let energies = part
                        .frames
                        .iter()
                        .map(|seen| seen.means[tap].energy.as_slice());
                    sum.merge(&Moments::of(energies, epsilon));
                }
                Ok(())
            },
            |sums, others| sums.iter_mut().zip(others).for_each(|(a, b)| a.merge(b)),
        )?;
        Ok((peaks, moments))
    }

    /// What is nominal of each tap, by its energies; the gaps are not scaled yet. `wider` and `simulation` are there for an
    /// accepted domain.
    fn energies<L: LabelledDrive>(
        &self,
        peaks: &[f64],
        moments: &[Moments],
        wider: Option<&[Moments]>,
        simulation: Option<&Component>,
        labelled: &[L],
    ) -> Result<Vec<TapReference>, CalibrationError> {
        let epsilon = |tap: usize| epsilon_of(peaks[tap], tap, simulation);
        let nominal: Vec<Nominal> = if self.metric == Metric::LaneRisk {
            let frames = labelled.iter().map(LabelledDrive::frames).sum();
            let mut fits = (0..self.taps.len())
                .map(|tap| {
                    LaneRiskFit::new(epsilon(tap), &moments[tap], frames)
                        .map_err(|why| self.wrong(tap, why))
                })
                .collect::<Result<Vec<_>, _>>()?;
            for drive in labelled {
                for frame in drive.means()?.iter() {
                    for (fit, means) in fits.iter_mut().zip(&frame.means) {
                        fit.add(&means.energy, frame.loss);
                    }
                }
            }
            let fitted = fits.into_iter().enumerate().map(|(tap, fit)| {
                let risk = fit.solve().map_err(|why| self.wrong(tap, why))?;
                Ok(Nominal::LaneRisk(risk))
            });
            fitted.collect::<Result<_, CalibrationError>>()?
        } else {
            let norms = (0..self.taps.len()).map(|tap| {
                let wider = wider.map(|all| (&all[tap], self.fitted.len()));
                EnergyNorm::fit(epsilon(tap), &moments[tap], wider)
                    .map(Nominal::Energies)
                    .map_err(|why| self.wrong(tap, why))
            });
            norms.collect::<Result<_, _>>()?
        };
        let taps = self.taps.iter().zip(nominal).enumerate();
        let references = taps.map(|(index, (tap, nominal))| TapReference {
            tap: tap.clone(),
            median_peak_energy: peaks[index],
            images: moments[index].frames(),
            nominal,
            scale: Vec::new(),
        });
        Ok(references.collect())
    }
}

fn epsilon_of(median_peak_energy: f64, tap: usize, simulation: Option<&Component>) -> f64 {
    match simulation.map(|of| &of.taps[tap].nominal) {
        Some(Nominal::Energies(norm)) => norm.epsilon,
        _ => moments::EPSILON_SHARE * median_peak_energy,
    }
}

/// Scales the gaps of a domain by those of windows of its own drives.
fn scale<D: Drive>(
    component: &mut Component,
    scaled: &[Stretch<'_, D>],
    wanted: Wanted,
) -> Result<(), CalibrationError> {
    let own = std::slice::from_ref(&*component);
    // [drives][taps][window lengths][windows]
    let gaps = look_at_all(scaled, |part| {
        let track = part.track(wanted.metric, own)?;
        let mut from = 0;
        let of_taps = own[0].taps.iter().map(|tap| {
            let columns = from..from + tap.nominal.len();
            from = columns.end;
            let lengths = WINDOW_FRAMES
                .iter()
                .map(|&frames| track.gaps(columns.clone(), frames, &tap.nominal, wanted));
            let gaps: Result<Vec<_>, _> = lengths.collect();
            gaps.map_err(|why| wrong(&tap.tap, wanted.metric, why))
        });
        of_taps.collect::<Result<Vec<_>, _>>()
    })?;
    for (index, tap) in component.taps.iter_mut().enumerate() {
        let points = WINDOW_FRAMES.into_iter().enumerate();
        tap.scale = points
            .filter_map(|(length, frames)| {
                let of_drives = gaps.iter().flat_map(|drive| &drive[index][length]);
                scale_point(of_drives.copied().collect(), frames)
            })
            .collect();
    }
    Ok(())
}

/// Median and threshold of the gaps of windows of `frames` frames; `None` without enough windows.
fn scale_point(mut gaps: Vec<f64>, frames: usize) -> Option<ScalePoint> {
    let windows = gaps.len();
    gaps.sort_by(f64::total_cmp);
    let high = quantile(&gaps, THRESHOLD_QUANTILE);
    let (Some(median), Some(high)) = (median(gaps), high) else {
        return None;
    };
    // A metric that cannot tell windows apart still gets a threshold above its median.
    let threshold = high.max(median + SPREAD_MIN);
    (windows >= 2).then_some(ScalePoint {
        frames,
        windows,
        median,
        threshold,
    })
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
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = values[(values.len() - 1) / 2];
    Some(0.5 * (lower + upper))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_precision_loss)]
    use super::*;
    use crate::reference::gap::Divergence;

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

    /// A drive that counts how often it is looked at.
    struct Counted(Survey, std::sync::atomic::AtomicU64);

    impl Drive for Counted {
        fn source(&self) -> &str {
            &self.0.source
        }

        fn frames(&self) -> usize {
            self.0.frames.len()
        }

        fn survey(&self) -> Result<Cow<'_, Survey>, StoreError> {
            self.1.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(Cow::Borrowed(&self.0))
        }
    }

    /// A drive of 60 frames, each with another map.
    fn counted(seed: usize) -> Counted {
        let frames = (0..60).map(|frame| {
            let map = ramp(100 * (seed + frame), 100 * (seed + frame) + 64);
            let energy = map.energy.iter().take(20).copied().collect();
            Ok(SurveyFrame {
                peaks: vec![map.range().1],
                means: vec![BlockMeans {
                    activation: vec![1.0; 4],
                    energy,
                }],
                maps: vec![map],
            })
        });
        let survey = Survey {
            source: format!("drive {seed}"),
            times: (0..60).map(|i| Duration::from_millis(100 * i)).collect(),
            frames: frames.collect(),
            common_size: (64, 1),
        };
        Counted(survey, Default::default())
    }

    #[test]
    fn looks_are_as_many_as_were_foretold() {
        for metric in [Metric::Mahalanobis, LOG_ENERGY, ATTENTION] {
            for (fitting, held_out) in [(1, 0), (4, 0), (5, 3)] {
                let drives: Vec<Counted> = (0..fitting).map(counted).collect();
                let held_out: Vec<Counted> = (0..held_out).map(|i| counted(20 + i)).collect();
                let domain = Domain {
                    name: "simulation".to_owned(),
                    drives: &drives,
                };
                let wanted = Wanted {
                    metric,
                    window_s: 1.0,
                    false_alarms_per_hour: 1.0,
                };
                let domains = [domain];
                let none: &[LabelledMeans] = &[];
                let foretold = looks(&domains, &held_out, none, metric);
                calibrate(&domains, &held_out, none, &["e2".to_owned()], wanted).unwrap();
                let all = drives.iter().chain(&held_out);
                let looked: u64 = all
                    .map(|d| d.1.load(std::sync::atomic::Ordering::Relaxed))
                    .sum();
                assert_eq!(looked, foretold, "{metric}, {fitting} drives");
            }
        }
    }

    #[test]
    fn medians_of_even_and_odd_counts() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(median(vec![]), None);
    }
}
