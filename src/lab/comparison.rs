//! Compares image sets with a reference set, for each metric and block: the paper's table.

use serde::Serialize;

use crate::calibration::survey::Survey;
use crate::calibration::{PaperBinning, TapHistogram, counts_of};
use crate::capture::undefined::Undefined;
use crate::features::attention::EnergyMap;
use crate::features::energies::BlockMeans;
use crate::features::histogram::{Binning, HistogramSum};
use crate::reference::gap::energy_norm::EnergyNorm;
use crate::reference::gap::moments::{self, Moments};
use crate::reference::gap::{Divergence, Metric, NeedsLabels, frechet};
use crate::statistics::quantile::median;

/// The frames of a set, which may consist of several drives.
pub struct ImageSet {
    /// As the user named it.
    pub name: String,
    /// Its drives.
    pub surveys: Vec<Survey>,
}

/// The comparison of a set by one metric.
#[derive(Debug)]
pub struct Row {
    /// Name of the set.
    pub set: String,
    /// The metric.
    pub metric: Metric,
    /// Images of the set.
    pub images: usize,
    /// Number of its images that could be judged; the others are left out.
    pub judged: u64,
    /// The value of the metric for each tap, or why there is none.
    pub values: Vec<Result<f64, Undefined>>,
}

/// A set's histogram of one tap.
#[derive(Debug, Serialize)]
pub struct HistogramRecord {
    /// Name of the set.
    pub set: String,
    /// The metric that it was counted for.
    pub metric: Metric,
    /// Name of the tap.
    pub tap: String,
    /// Median peak energy of the reference, squared activation units.
    pub median_peak_energy: f64,
    /// How pixels were counted.
    pub binning: Binning,
    /// Number of images counted.
    pub images: u64,
    /// `[bins]`, pixels.
    pub counts: Vec<u64>,
}

/// Sets that cannot be compared with this metric, or because images of the reference cannot be judged.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// The metric cannot compare sets of images.
    #[error(transparent)]
    Metric(#[from] NeedsLabels),
    /// One image of the reference cannot be judged.
    #[error("reference {set}: image number {number} cannot be judged: {why}")]
    Image {
        /// Name of the set.
        set: String,
        /// The image's number from 1.
        number: usize,
        /// Why.
        why: Undefined,
    },
    /// The reference as a whole cannot be used.
    #[error("reference {set}: {why}")]
    Set {
        /// Name of the set.
        set: String,
        /// Why.
        why: Undefined,
    },
}

/// Rows and histograms of a comparison.
#[derive(Debug, Default)]
pub struct Comparisons {
    /// One row for each metric and set, in this order.
    pub rows: Vec<Row>,
    /// One histogram for each metric, set (the reference first) and tap.
    pub histograms: Vec<HistogramRecord>,
}

impl ImageSet {
    /// Number of images of the set.
    pub fn images(&self) -> usize {
        self.surveys.iter().map(|survey| survey.frames.len()).sum()
    }

    fn maps(&self, tap: usize) -> impl Iterator<Item = Result<EnergyMap, Undefined>> + '_ {
        self.surveys
            .iter()
            .flat_map(move |survey| survey.common_maps(tap))
    }

    /// Means of one tap, image by image.
    fn means(&self, tap: usize) -> impl Iterator<Item = Result<&BlockMeans, Undefined>> {
        let frames = self.surveys.iter().flat_map(|survey| &survey.frames);
        frames.map(move |frame| match frame {
            Ok(seen) => Ok(&seen.means[tap]),
            Err(why) => Err(why.clone()),
        })
    }

    /// The set as a reference: every image must have a value.
    ///
    /// # Errors
    /// The first image that has no value.
    fn every<T>(
        &self,
        items: impl Iterator<Item = Result<T, Undefined>>,
    ) -> Result<Vec<T>, ComparisonError> {
        let named = items.enumerate().map(|(index, item)| {
            item.map_err(|why| ComparisonError::Image {
                set: self.name.clone(),
                number: index + 1,
                why,
            })
        });
        named.collect()
    }

    fn wrong(&self, why: Undefined) -> ComparisonError {
        ComparisonError::Set {
            set: self.name.clone(),
            why,
        }
    }

    /// Counts of the images that can be judged, and why the first of the other images cannot.
    fn sum(&self, tap: usize, binning: &Binning) -> (HistogramSum, Option<Undefined>) {
        let (mut sum, mut reason) = (HistogramSum::new(binning.bins()), None);
        for map in self.maps(tap) {
            match map.and_then(|map| counts_of(binning, &map)) {
                Ok(counts) => sum.add(&counts),
                Err(why) => {
                    reason.get_or_insert(why);
                }
            }
        }
        (sum, reason)
    }

    /// Means of the images that can be judged, and why the first of the other images cannot.
    fn judged_means(&self, tap: usize) -> (Vec<&BlockMeans>, Option<Undefined>) {
        let (mut judged, mut reason) = (Vec::new(), None);
        for image in self.means(tap) {
            match image {
                Ok(means) => judged.push(means),
                Err(why) => {
                    reason.get_or_insert(why);
                }
            }
        }
        (judged, reason)
    }
}

/// What a metric compares sets with: one tap of the reference set.
enum Against<'a> {
    Histogram(Divergence, TapHistogram),
    Means(Vec<&'a BlockMeans>),
    Norm(EnergyNorm),
}

impl<'a> Against<'a> {
    fn of(
        reference: &'a ImageSet,
        tap: usize,
        metric: Metric,
        paper: PaperBinning,
    ) -> Result<Self, ComparisonError> {
        match (metric, metric.divergence()) {
            (_, Some(divergence)) => {
                let maps = reference.every(reference.maps(tap))?;
                let maps: Vec<&EnergyMap> = maps.iter().collect();
                TapHistogram::fit(&maps, metric, paper)
                    .map(|fitted| Self::Histogram(divergence, fitted))
                    .map_err(|why| reference.wrong(why))
            }
            (Metric::Frechet, None) => Ok(Self::Means(reference.every(reference.means(tap))?)),
            (Metric::Mahalanobis, None) => {
                let means = reference.every(reference.means(tap))?;
                let maps = reference.every(reference.maps(tap))?;
                let peaks = maps.iter().map(|map| map.range().1).collect();
                let epsilon = median(peaks).unwrap_or(1.0) * moments::EPSILON_SHARE;
                let norm = EnergyNorm::fit(epsilon, &moments_of(&means, epsilon), None);
                norm.map(Self::Norm).map_err(|why| reference.wrong(why))
            }
            (
                Metric::LaneRisk | Metric::Paper | Metric::Attention(_) | Metric::LogEnergy(_),
                None,
            ) => Err(NeedsLabels(metric).into()),
        }
    }

    /// The value of the metric for a set, how many of its images could be judged, and its counts if there are any.
    fn compare(
        &self,
        set: &ImageSet,
        tap: usize,
    ) -> (Result<f64, Undefined>, u64, Option<HistogramSum>) {
        if let Self::Histogram(divergence, nominal) = self {
            let (sum, reason) = set.sum(tap, &nominal.binning);
            let value = match reason {
                Some(reason) if sum.images == 0 => Err(reason),
                _ => divergence
                    .compare(&sum.counts, &nominal.sum.counts)
                    .map(|compared| compared.value),
            };
            return (value, sum.images, Some(sum));
        }
        let (judged, reason) = set.judged_means(tap);
        let images = judged.len() as u64;
        let value = match (self, reason) {
            (_, Some(reason)) if judged.is_empty() => Err(reason),
            (Self::Means(reference), _) => {
                let activations = |of: &[&BlockMeans]| -> Vec<Vec<f64>> {
                    of.iter().map(|image| image.activation.clone()).collect()
                };
                frechet::distance(&activations(reference), &activations(&judged))
            }
            (Self::Norm(norm), _) => {
                let sum = moments_of(&judged, norm.epsilon);
                Ok(norm.distance(sum.sums(), judged.len()))
            }
            (Self::Histogram(..), _) => Err(Undefined::NoScore),
        };
        (value, images, None)
    }
}

fn moments_of(images: &[&BlockMeans], epsilon: f64) -> Moments {
    Moments::of(images.iter().map(|image| image.energy.as_slice()), epsilon)
}

/// Compares sets with a reference by several metrics.
///
/// # Errors
/// When a metric needs labelled drives, or when an image of the reference cannot be judged.
pub fn compare(
    reference: &ImageSet,
    sets: &[ImageSet],
    taps: &[String],
    metrics: &[Metric],
    paper: PaperBinning,
) -> Result<Comparisons, ComparisonError> {
    let mut all = Comparisons::default();
    for &metric in metrics {
        let against = (0..taps.len())
            .map(|tap| Against::of(reference, tap, metric, paper))
            .collect::<Result<Vec<_>, _>>()?;
        let record = |set: &str, tap: usize, sum: HistogramSum| match &against[tap] {
            Against::Histogram(_, nominal) => Some(HistogramRecord {
                set: set.to_owned(),
                metric,
                tap: taps[tap].clone(),
                median_peak_energy: nominal.median_peak_energy,
                binning: nominal.binning.clone(),
                images: sum.images,
                counts: sum.counts,
            }),
            _ => None,
        };
        for (tap, own) in against.iter().enumerate() {
            if let Against::Histogram(_, nominal) = own {
                all.histograms
                    .extend(record(&reference.name, tap, nominal.sum.clone()));
            }
        }
        for set in sets {
            let mut row = Row {
                set: set.name.clone(),
                metric,
                images: set.images(),
                judged: u64::MAX,
                values: vec![],
            };
            for (tap, own) in against.iter().enumerate() {
                let (value, judged, sum) = own.compare(set, tap);
                row.judged = row.judged.min(judged);
                row.values.push(value);
                all.histograms
                    .extend(sum.and_then(|sum| record(&set.name, tap, sum)));
            }
            all.rows.push(row);
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_needs_labels_is_refused_and_not_measured_by_another_metric() {
        let sets = ImageSet {
            name: "sets".to_owned(),
            surveys: Vec::new(),
        };
        let taps = ["e2".to_owned()];
        let compared = compare(
            &sets,
            &[],
            &taps,
            &[Metric::LaneRisk],
            PaperBinning::PUBLISHED,
        );
        let refused = matches!(
            compared,
            Err(ComparisonError::Metric(NeedsLabels(Metric::LaneRisk)))
        );
        assert!(refused, "{compared:?}");
    }
}
