//! What is nominal in one tapped block, and how far windows are from it.

use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::features::histogram::Binning;
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::lane_risk::LaneRisk;
use crate::reference::gap::moments::energy_levels;
use crate::reference::gap::{Comparison, Metric};
use crate::reference::span::{SPREAD_MIN, Span, SpanNorm};

/// Largest gap of a metric that compares histograms: the gap of a correlation of -1.
const GAP_MAX: f64 = 2.0;

/// Nominal attention of one tapped block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TapReference {
    /// Name of the tap.
    pub tap: String,
    /// Median over the images of the largest energy, squared activation units: the scale of this block.
    pub median_peak_energy: f64,
    /// Number of images.
    pub images: u64,
    /// What is nominal in these images.
    pub nominal: Nominal,
    /// Nominal gaps by the number of frames in the window, fewest first.
    pub scale: Vec<ScalePoint>,
    /// What is nominal over longer times; only for energies, and empty if the nominal drives are too short for it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spans: Vec<SpanNorm>,
}

/// What is taken from a frame, and its values on nominal frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Nominal {
    /// Counts of pixels by their energy.
    Histogram {
        /// How pixels are counted.
        binning: Binning,
        /// `[bins]`, pixels.
        counts: Vec<u64>,
    },
    /// Energies by channel and by cell.
    Energies(EnergyNorm),
    /// Energies by channel and by cell, and what the lane model loses with them.
    LaneRisk(LaneRisk),
}

/// Nominal gaps of windows of a number of frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScalePoint {
    /// Number of frames in a window.
    pub frames: usize,
    /// Number of windows.
    pub windows: usize,
    /// Median gap: score 0.
    pub median: f64,
    /// Alarm threshold: score 1.
    pub threshold: f64,
}

impl TapReference {
    /// What is wrong with it, if anything.
    pub(super) fn fault(&self, metric: Metric) -> Option<String> {
        if self.images == 0 {
            return Some("made of no images".to_owned());
        }
        if !(self.median_peak_energy.is_finite() && self.median_peak_energy > 0.0) {
            return Some(format!(
                "a median peak energy of {}",
                self.median_peak_energy
            ));
        }
        if let Some(fault) = self.nominal.fault(metric) {
            return Some(fault);
        }
        let rising = self
            .scale
            .windows(2)
            .all(|pair| pair[0].frames < pair[1].frames);
        let largest = match self.nominal {
            Nominal::Histogram { .. } => 2.0 * GAP_MAX,
            Nominal::Energies(_) | Nominal::LaneRisk(_) => f64::MAX,
        };
        let least = match self.nominal {
            // A forecast may be a little below 0 on an easy road.
            Nominal::LaneRisk(_) => f64::MIN,
            _ => -1e-9,
        };
        let usable = |p: &ScalePoint| {
            let in_range = |gap: f64| (least..=largest).contains(&gap);
            p.frames > 0
                && in_range(p.median)
                && p.threshold.is_finite()
                && p.threshold - p.median >= 0.5 * SPREAD_MIN
        };
        if self.scale.is_empty() || !rising || !self.scale.iter().all(usable) {
            return Some(
                "a scale without rising frame counts and medians below thresholds".to_owned(),
            );
        }
        self.span_fault()
    }

    /// Takes the margins of another domain: each threshold is as many times its median as there, not below the threshold
    /// there, and not below what it was. The spread of this domain contains that of the other one, so another road of this
    /// kind may differ from it as roads of the other domain differ.
    pub fn widen_like(&mut self, other: &Self) {
        let wider = |own: (f64, f64), of: (f64, f64)| {
            let times = of.1 / of.0.max(SPREAD_MIN);
            own.1.max(of.1).max(own.0 * times)
        };
        // A faster road has windows of more frames than those of the other domain.
        if !other.scale.is_empty() {
            for point in &mut self.scale {
                let margins = other.scale_for(point.frames);
                point.threshold = wider((point.median, point.threshold), margins);
            }
        }
        for (norm, of) in self.spans.iter_mut().zip(&other.spans) {
            let margins = (of.median, of.threshold);
            norm.threshold = wider((norm.median, norm.threshold), margins);
        }
    }

    /// Moves the thresholds of a part of the evidence (0 the window, then the spans) away from their medians by a
    /// factor.
    pub fn widen(&mut self, part: usize, factor: f64) {
        let wider = |median: f64, threshold: f64| median + factor * (threshold - median);
        match part.checked_sub(1) {
            None => {
                for point in &mut self.scale {
                    point.threshold = wider(point.median, point.threshold);
                }
            }
            Some(span) => {
                if let Some(norm) = self.spans.get_mut(span) {
                    norm.threshold = wider(norm.median, norm.threshold);
                }
            }
        }
    }

    fn span_fault(&self) -> Option<String> {
        if self.spans.is_empty() {
            return None;
        }
        if self.spans.len() != Span::ALL.len() || !matches!(self.nominal, Nominal::Energies(_)) {
            return Some(format!(
                "{} spans, not {} for energies or none",
                self.spans.len(),
                Span::ALL.len()
            ));
        }
        let mut spans = self.spans.iter().zip(Span::ALL);
        spans.find_map(|(norm, span)| norm.fault(span, self.nominal.len()))
    }

    /// Median and threshold for windows of `frames`, linear in `1 / frames` between the points of the scale, because
    /// the gap of an average of `n` histograms falls like `1 / n` towards the gap of infinitely many.
    #[allow(clippy::cast_precision_loss)]
    pub fn scale_for(&self, frames: usize) -> (f64, f64) {
        let next = self
            .scale
            .partition_point(|point| point.frames < frames)
            .min(self.scale.len() - 1);
        let (low, high) = (self.scale[next.saturating_sub(1)], self.scale[next]);
        if low.frames == high.frames {
            return (high.median, high.threshold);
        }
        let inverse = |frames: usize| 1.0 / frames as f64;
        let frames = frames.clamp(low.frames, high.frames);
        let share =
            (inverse(low.frames) - inverse(frames)) / (inverse(low.frames) - inverse(high.frames));
        (
            low.median + share * (high.median - low.median),
            low.threshold + share * (high.threshold - low.threshold),
        )
    }
}

impl Nominal {
    /// How many numbers are taken from a frame: bins or energies.
    pub fn len(&self) -> usize {
        match self {
            Self::Histogram { counts, .. } => counts.len(),
            Self::Energies(norm) => norm.energies(),
            Self::LaneRisk(risk) => risk.mean.len(),
        }
    }

    /// Whether nothing is taken from a frame; never true for a reference that was read without an error.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes what it needs from one block of a frame: `common` is its energy map at the common size, and `taken`
    /// `[len]` is the result. Allocates nothing.
    ///
    /// # Errors
    /// `ConstantMap` if the map is constant, `EnergyCount` if the block has another number of channels than the
    /// reference.
    pub fn take(
        &self,
        common: &EnergyMap,
        means: &BlockMeans,
        taken: &mut [u32],
    ) -> Result<(), Undefined> {
        match self {
            Self::Histogram { binning, .. } => {
                taken.fill(0);
                binning.count(common, taken)
            }
            Self::Energies(EnergyNorm { epsilon, .. })
            | Self::LaneRisk(LaneRisk { epsilon, .. }) => {
                if means.energy.len() != taken.len() {
                    return Err(Undefined::EnergyCount {
                        found: means.energy.len(),
                        wanted: taken.len(),
                    });
                }
                energy_levels(&means.energy, *epsilon, taken);
                Ok(())
            }
        }
    }

    /// Compares the sum over a window of `frames` frames with the nominal values.
    ///
    /// # Errors
    /// Why there is no value.
    pub fn compare(
        &self,
        metric: Metric,
        sums: &[u64],
        frames: usize,
    ) -> Result<Comparison, Undefined> {
        match self {
            Self::Histogram { counts, .. } => metric
                .divergence()
                .ok_or(Undefined::NoScore)?
                .compare(sums, counts),
            Self::Energies(norm) => {
                let distance = norm.distance(sums, frames);
                Ok(Comparison {
                    value: distance,
                    gap: distance,
                    similarity: 1.0 / (1.0 + distance),
                })
            }
            Self::LaneRisk(risk) => {
                let loss = risk.loss(sums, frames);
                Ok(Comparison {
                    value: loss,
                    gap: loss,
                    similarity: 1.0 - loss,
                })
            }
        }
    }

    fn fault(&self, metric: Metric) -> Option<String> {
        match (self, metric) {
            (Self::Energies(norm), Metric::Mahalanobis) => norm.fault(),
            (Self::LaneRisk(risk), Metric::LaneRisk) => risk.fault(),
            (
                Self::Histogram {
                    binning: binning @ Binning::LogEnergy { .. },
                    counts,
                },
                Metric::LogEnergy(_),
            )
            | (
                Self::Histogram {
                    binning: binning @ Binning::Attention { .. },
                    counts,
                },
                Metric::Attention(_) | Metric::Paper,
            ) => {
                if let Some(fault) = binning.fault() {
                    return Some(fault.to_owned());
                }
                if counts.len() != binning.bins() {
                    return Some(format!(
                        "{} counts for {} bins",
                        counts.len(),
                        binning.bins()
                    ));
                }
                counts
                    .iter()
                    .try_fold(0_u64, |sum, &n| sum.checked_add(n))
                    .is_none_or(|sum| sum == 0)
                    .then(|| "counts that do not add up".to_owned())
            }
            _ => Some(format!("nominal values of another kind than {metric} has")),
        }
    }
}
