//! How well each metric distinguishes still images and short clips of other roads from a reference's own domain. There
//! is no rate per hour for these, so windows of `N` images are compared.
//!
//! Windows do not overlap and never span two sequences. Every set is divided into blocks of neighbouring images. A
//! window belongs to the block in which it begins, and intervals resample blocks. The reference is not resampled:
//! intervals say what other moments of the same sequences would give, and not what other roads would give.

use std::mem::discriminant;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::separation::separation;
use crate::calibration::survey::Survey;
use crate::calibration::{PaperBinning, TapHistogram};
use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::moments::{self, Moments};
use crate::reference::gap::{Metric, frechet};
use crate::reference::{Nominal, SPREAD_MIN};
use crate::statistics::quantile::median;

/// Numbers of images in a window.
pub const WINDOWS: [usize; 3] = [1, 5, 10];
/// Name of the largest score over the taps.
pub const FUSED: &str = "fused";

/// Sequences of images of one domain.
pub struct SequenceSet {
    /// Name of the set.
    pub name: String,
    /// The sequences.
    pub sequences: Vec<ImageSequence>,
    /// Number of roads or drives from which the sequences come. A statement about other roads can only be based on this
    /// number.
    pub drives: usize,
}

/// Images in their order; neighbours may show nearly the same.
pub struct ImageSequence {
    /// What the encoder saw of them.
    pub survey: Survey,
    /// Number of images in a block, after which images are independent. In a reference, it is a multiple of the largest
    /// window.
    pub block_images: usize,
}

/// A reference, unseen images of its own domain, and other sets.
pub struct Case<'a> {
    /// Every second block of it makes histograms or moments, and the others scale the gaps of the taps.
    pub reference: &'a SequenceSet,
    /// The set that must not be distinguished from it.
    pub nominal: &'a SequenceSet,
    /// The sets that should be distinguished from it.
    pub shifted: Vec<&'a SequenceSet>,
}

/// One set compared with a reference, by one metric and with one number of images in a window.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FieldSetRow {
    /// The reference.
    pub reference: String,
    /// Number of its images that made histograms or moments.
    pub fitted: usize,
    /// Number of its images that scale the gaps of the taps.
    pub scaled: usize,
    /// The nominal set.
    pub nominal: String,
    /// The set.
    pub set: String,
    /// Number of images in a window.
    pub images: usize,
    /// The metric.
    pub metric: Metric,
    /// Number of nominal windows, without those that have no gap.
    pub nominal_windows: usize,
    /// Number of blocks in which they are.
    pub nominal_blocks: usize,
    /// Number of roads or drives from which they come.
    pub nominal_drives: usize,
    /// Number of windows of the set.
    pub windows: usize,
    /// Number of blocks in which they are.
    pub blocks: usize,
    /// Number of roads or drives from which they come.
    pub drives: usize,
    /// One entry for each tap, and then one for the largest score over the taps.
    pub taps: Vec<TapSeparation>,
}

/// How well one tap, or all taps together, distinguish the sets.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TapSeparation {
    /// The tap, or `fused`.
    pub tap: String,
    /// Area under the ROC curve.
    pub auroc: Option<f64>,
    /// Its 95 % interval.
    pub auroc_interval: Option<(f64, f64)>,
    /// Share of the set's windows found at 5 % false positives.
    pub recall: Option<f64>,
    /// Its 95 % interval.
    pub recall_interval: Option<(f64, f64)>,
    /// Share of nominal windows above that threshold; 0 if there are fewer than 20.
    pub false_positives: Option<f64>,
    /// Why there is no value, or why some windows are missing.
    pub reason: Option<String>,
}

/// Gaps of the windows of a set, block by block.
type Gaps = Vec<Vec<Result<f64, Undefined>>>;

/// Gaps of one metric and tap.
struct Measured {
    /// `[WINDOWS]`, gaps of the reference's windows that scale.
    scale: Vec<Gaps>,
    /// `[sets][WINDOWS]`, with the nominal set first.
    sets: Vec<Vec<Gaps>>,
}

/// Rows of a case, for each metric, number of images and set. `seen` is called after each pair of a tap and a kind of
/// metric; [`steps`] gives the number of these pairs.
///
/// # Errors
/// When an image of the reference cannot be judged.
pub fn rows(
    case: &Case<'_>,
    taps: &[String],
    seen: &(dyn Fn() + Sync),
) -> Result<Vec<FieldSetRow>, FieldSetError> {
    let metrics = Metric::of_sets();
    let kinds: Vec<&[Metric]> = kinds(&metrics).collect();
    let jobs: Vec<(&[Metric], usize)> = kinds
        .iter()
        .flat_map(|&kind| (0..taps.len()).map(move |tap| (kind, tap)))
        .collect();
    let measured = jobs
        .par_iter()
        .map(|&(kind, tap)| {
            let measured = measure(case, kind, tap, &taps[tap])?;
            seen();
            Ok(measured)
        })
        .collect::<Result<Vec<Vec<Measured>>, FieldSetError>>()?;
    let mut wanted = Vec::new();
    for (kind, by_tap) in kinds.iter().zip(measured.chunks(taps.len())) {
        for (index, &metric) in kind.iter().enumerate() {
            let by_tap: Vec<&Measured> = by_tap.iter().map(|of| &of[index]).collect();
            for window in 0..WINDOWS.len() {
                wanted.extend(
                    (0..case.shifted.len()).map(|set| (metric, by_tap.clone(), window, set)),
                );
            }
        }
    }
    Ok(wanted
        .par_iter()
        .map(|(metric, by_tap, window, set)| row(case, taps, *metric, by_tap, *window, *set))
        .collect())
}

/// How often `seen` is called for a model with `taps` taps.
pub fn steps(taps: usize) -> usize {
    kinds(&Metric::of_sets()).count() * taps
}

/// Groups of metrics that take the same from a frame.
fn kinds(metrics: &[Metric]) -> impl Iterator<Item = &[Metric]> {
    metrics.chunk_by(|a, b| discriminant(a) == discriminant(b))
}

/// An image of a reference cannot be judged.
#[derive(Debug, thiserror::Error)]
#[error("reference {set}, tap {tap}: {why}")]
pub struct FieldSetError {
    set: String,
    tap: String,
    why: Undefined,
}

impl ImageSequence {
    /// Its blocks, in order.
    pub(super) fn blocks(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let (images, step) = (self.survey.frames.len(), self.block_images.max(1));
        (0..images)
            .step_by(step)
            .map(move |from| from..from.saturating_add(step).min(images))
    }
}

impl SequenceSet {
    /// Number of images of all sequences.
    pub fn images(&self) -> usize {
        let counts = self.sequences.iter().map(|of| of.survey.frames.len());
        counts.sum()
    }

    /// Its blocks: sequence and images, for fitting (every second one) or for scaling.
    fn half(&self, fitting: bool) -> Vec<(usize, Range<usize>)> {
        let all = self.sequences.iter().enumerate();
        all.flat_map(|(index, sequence)| sequence.blocks().map(move |block| (index, block)))
            .enumerate()
            .filter(|(number, _)| number.is_multiple_of(2) == fitting)
            .map(|(_, block)| block)
            .collect()
    }
}

/// What a kind of metric takes from the images of one tap.
enum Kind {
    /// Counts or levels, which are summed over a window and compared with nominal ones.
    Sums(Nominal),
    /// Channel means of the reference's images.
    Activations(Vec<Vec<f64>>),
}

/// What was taken from one image.
enum Taken {
    Numbers(Vec<u32>),
    Activation(Vec<f64>),
}

impl Kind {
    fn fit(reference: &SequenceSet, metric: Metric, tap: usize) -> Result<Self, Undefined> {
        let fitting = reference.half(true);
        let frames = || {
            let of = |(index, block): &(usize, Range<usize>)| {
                reference.sequences[*index].survey.frames[block.clone()].iter()
            };
            fitting.iter().flat_map(of)
        };
        if metric == Metric::Frechet {
            let activations = frames().map(|frame| {
                let frame = frame.as_ref().map_err(Undefined::clone)?;
                Ok(frame.means[tap].activation.clone())
            });
            return Ok(Self::Activations(activations.collect::<Result<_, _>>()?));
        }
        if metric == Metric::Mahalanobis {
            let (mut peaks, mut energies) = (Vec::new(), Vec::new());
            for frame in frames() {
                let frame = frame.as_ref().map_err(Undefined::clone)?;
                peaks.push(frame.peaks[tap]);
                energies.push(frame.means[tap].energy.as_slice());
            }
            let epsilon = moments::EPSILON_SHARE * median(peaks).unwrap_or(1.0);
            let moments = Moments::of(energies.into_iter(), epsilon);
            let norm = EnergyNorm::fit(epsilon, &moments, None)?;
            return Ok(Self::Sums(Nominal::Energies(norm)));
        }
        let mut maps = Vec::new();
        for (index, sequence) in reference.sequences.iter().enumerate() {
            let own = || fitting.iter().filter(|(of, _)| *of == index);
            if own().next().is_none() {
                continue;
            }
            for (image, map) in sequence.survey.common_maps(tap).enumerate() {
                if own().any(|(_, block)| block.contains(&image)) {
                    maps.push(map?);
                }
            }
        }
        let maps: Vec<&EnergyMap> = maps.iter().collect();
        let fitted = TapHistogram::fit(&maps, metric, PaperBinning::PUBLISHED)?;
        Ok(Self::Sums(Nominal::Histogram {
            binning: fitted.binning,
            counts: fitted.sum.counts,
        }))
    }

    /// What is taken from every image of a sequence.
    fn take(&self, survey: &Survey, tap: usize) -> Vec<Result<Taken, Undefined>> {
        match self {
            Self::Activations(_) => {
                let frames = survey.frames.iter();
                frames
                    .map(|frame| match frame {
                        Ok(seen) => Ok(Taken::Activation(seen.means[tap].activation.clone())),
                        Err(why) => Err(why.clone()),
                    })
                    .collect()
            }
            Self::Sums(nominal @ Nominal::Energies(_)) => {
                let nothing = EnergyMap::default();
                let frames = survey.frames.iter();
                frames
                    .map(|frame| {
                        let seen = frame.as_ref().map_err(Undefined::clone)?;
                        let mut numbers = vec![0; nominal.len()];
                        nominal.take(&nothing, &seen.means[tap], &mut numbers)?;
                        Ok(Taken::Numbers(numbers))
                    })
                    .collect()
            }
            Self::Sums(nominal) => {
                let nothing = crate::features::energies::BlockMeans::default();
                let maps = survey.common_maps(tap);
                maps.map(|map| {
                    let mut numbers = vec![0; nominal.len()];
                    nominal.take(&map?, &nothing, &mut numbers)?;
                    Ok(Taken::Numbers(numbers))
                })
                .collect()
            }
        }
    }

    /// Gaps of the windows of some blocks, for each metric of the kind and number of images.
    fn gaps(
        &self,
        of: &SequenceSet,
        chosen: &dyn Fn(usize) -> bool,
        kind: &[Metric],
        tap: usize,
    ) -> Vec<Vec<Gaps>> {
        let mut gaps = vec![vec![Gaps::new(); WINDOWS.len()]; kind.len()];
        let mut number = 0;
        for sequence in &of.sequences {
            let taken = self.take(&sequence.survey, tap);
            for block in sequence.blocks() {
                number += 1;
                if !chosen(number - 1) {
                    continue;
                }
                for (window, &images) in WINDOWS.iter().enumerate() {
                    // Windows are consecutive from the first image of the sequence on.
                    let starts = (block.start.next_multiple_of(images)..block.end).step_by(images);
                    let windows = starts.filter_map(|from| taken.get(from..from + images));
                    let compared: Vec<Vec<Result<f64, Undefined>>> =
                        windows.map(|window| self.compare(kind, window)).collect();
                    for (index, by_window) in gaps.iter_mut().enumerate() {
                        let own = compared.iter().map(|by_metric| by_metric[index].clone());
                        by_window[window].push(own.collect());
                    }
                }
            }
        }
        gaps
    }

    /// The gap of one window by each metric of the kind.
    fn compare(
        &self,
        kind: &[Metric],
        window: &[Result<Taken, Undefined>],
    ) -> Vec<Result<f64, Undefined>> {
        let (mut sums, mut activations) = (Vec::new(), Vec::new());
        for image in window {
            match image {
                Err(why) => return vec![Err(why.clone()); kind.len()],
                Ok(Taken::Activation(activation)) => activations.push(activation.clone()),
                Ok(Taken::Numbers(numbers)) => {
                    sums.resize(numbers.len(), 0_u64);
                    let pairs = sums.iter_mut().zip(numbers);
                    pairs.for_each(|(sum, &number)| *sum += u64::from(number));
                }
            }
        }
        let gap = |&metric: &Metric| match self {
            Self::Activations(reference) => frechet::distance(reference, &activations),
            Self::Sums(nominal) => nominal
                .compare(metric, &sums, window.len())
                .map(|compared| compared.gap),
        };
        kind.iter().map(gap).collect()
    }
}

fn measure(
    case: &Case<'_>,
    kind: &[Metric],
    tap: usize,
    name: &str,
) -> Result<Vec<Measured>, FieldSetError> {
    let wrong = |why| FieldSetError {
        set: case.reference.name.clone(),
        tap: name.to_owned(),
        why,
    };
    let Some(&first) = kind.first() else {
        return Ok(Vec::new());
    };
    let fitted = Kind::fit(case.reference, first, tap).map_err(wrong)?;
    let scale = fitted.gaps(case.reference, &|block| block % 2 == 1, kind, tap);
    let sets: Vec<Vec<Vec<Gaps>>> = std::iter::once(&case.nominal)
        .chain(&case.shifted)
        .map(|set| fitted.gaps(set, &|_| true, kind, tap))
        .collect();
    Ok(scale
        .into_iter()
        .enumerate()
        .map(|(index, scale)| Measured {
            scale,
            sets: sets
                .iter()
                .map(|by_metric| by_metric[index].clone())
                .collect(),
        })
        .collect())
}

fn row(
    case: &Case<'_>,
    taps: &[String],
    metric: Metric,
    by_tap: &[&Measured],
    window: usize,
    set: usize,
) -> FieldSetRow {
    let images = WINDOWS[window];
    let of_set = |set: usize| -> Vec<&Gaps> {
        let gaps = by_tap.iter().map(|of| &of.sets[set][window]);
        gaps.collect()
    };
    let (nominal, shifted) = (of_set(0), of_set(set + 1));
    let mut separations: Vec<TapSeparation> = taps
        .iter()
        .zip(nominal.iter().zip(&shifted))
        .map(|(tap, (nominal, shifted))| TapSeparation::of(tap, nominal, shifted))
        .collect();
    let scales: Result<Vec<(f64, f64)>, Undefined> = by_tap
        .iter()
        .map(|of| scale_of(&of.scale[window]))
        .collect();
    separations.push(match scales {
        Ok(scales) => {
            TapSeparation::of(FUSED, &fused(&nominal, &scales), &fused(&shifted, &scales))
        }
        Err(why) => TapSeparation::undefined(FUSED, &why),
    });
    let counts = |of: &[&Gaps]| {
        let judged = |block: &Vec<Result<f64, Undefined>>| block.iter().flatten().count();
        let blocks = of.first().map_or(&[][..], |gaps| gaps.as_slice());
        (
            blocks.iter().map(judged).sum::<usize>(),
            blocks.iter().filter(|block| judged(block) > 0).count(),
        )
    };
    let half = |fitting| -> usize {
        let blocks = case.reference.half(fitting);
        blocks.iter().map(|(_, block)| block.len()).sum()
    };
    let ((nominal_windows, nominal_blocks), (windows, blocks)) =
        (counts(&nominal), counts(&shifted));
    FieldSetRow {
        reference: case.reference.name.clone(),
        fitted: half(true),
        scaled: half(false),
        nominal: case.nominal.name.clone(),
        set: case.shifted[set].name.clone(),
        images,
        metric,
        nominal_windows,
        nominal_blocks,
        nominal_drives: case.nominal.drives,
        windows,
        blocks,
        drives: case.shifted[set].drives,
        taps: separations,
    }
}

/// Median and threshold of the windows that scale a tap, as in references: the threshold is above 99 % of the gaps.
fn scale_of(gaps: &Gaps) -> Result<(f64, f64), Undefined> {
    let mut values: Vec<f64> = gaps
        .iter()
        .flatten()
        .cloned()
        .collect::<Result<_, Undefined>>()?;
    values.sort_by(f64::total_cmp);
    let high = (99 * values.len().saturating_sub(1)).div_ceil(100);
    match (values.get(high).copied(), values.len()) {
        (Some(high), found @ 2..) => {
            let median = 0.5 * (values[(found - 1) / 2] + values[found / 2]);
            Ok((median, high.max(median + SPREAD_MIN)))
        }
        (_, found) => Err(Undefined::TooFewImages { found, wanted: 2 }),
    }
}

/// The largest score over the taps, for each window.
fn fused(by_tap: &[&Gaps], scales: &[(f64, f64)]) -> Gaps {
    let Some(first) = by_tap.first() else {
        return Gaps::new();
    };
    let score = |block: usize, window: usize| {
        let scores = by_tap
            .iter()
            .zip(scales)
            .map(|(gaps, (median, threshold))| {
                let gap = gaps[block][window].clone()?;
                Ok((gap - median) / (threshold - median))
            });
        scores.reduce(|a: Result<f64, Undefined>, b| Ok(a?.max(b?)))
    };
    first
        .iter()
        .enumerate()
        .map(|(block, windows)| {
            let windows = 0..windows.len();
            windows.filter_map(|window| score(block, window)).collect()
        })
        .collect()
}

impl TapSeparation {
    fn undefined(tap: &str, why: &impl ToString) -> Self {
        Self {
            tap: tap.to_owned(),
            auroc: None,
            auroc_interval: None,
            recall: None,
            recall_interval: None,
            false_positives: None,
            reason: Some(why.to_string()),
        }
    }

    fn of(tap: &str, nominal: &Gaps, shifted: &Gaps) -> Self {
        let judged = |gaps: &Gaps| -> Vec<Vec<f64>> {
            let blocks = gaps.iter();
            blocks
                .map(|block| block.iter().flatten().copied().collect())
                .collect()
        };
        let all = || nominal.iter().chain(shifted).flatten();
        let reason = all().find_map(|gap| gap.as_ref().err());
        let Some(found) = separation(&judged(nominal), &judged(shifted)) else {
            return match reason {
                Some(why) => Self::undefined(tap, why),
                None => Self::undefined(tap, &"a set has no window with this number of images"),
            };
        };
        let missing = all().filter(|gap| gap.is_err()).count();
        let rounded = |value: f64| (1e4 * value).round() / 1e4;
        let both = |(low, high): (f64, f64)| (rounded(low), rounded(high));
        Self {
            tap: tap.to_owned(),
            auroc: Some(rounded(found.auroc)),
            auroc_interval: Some(both(found.auroc_interval)),
            recall: Some(rounded(found.recall)),
            recall_interval: Some(both(found.recall_interval)),
            false_positives: Some(rounded(found.false_positives)),
            reason: reason.map(|why| format!("{missing} windows have no gap: {why}")),
        }
    }
}

#[cfg(test)]
pub(super) mod tests;
