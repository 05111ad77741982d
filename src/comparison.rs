//! Image sets against a reference set, metric by metric and block by block: the paper's table.

use serde::Serialize;

use crate::attention::EnergyMap;
use crate::calibration::{PaperBinning, TapHistogram, counts_of};
use crate::gap::Metric;
use crate::histogram::{Binning, HistogramSum};
use crate::survey::Survey;
use crate::undefined::Undefined;

/// The frames of a set, which may be several drives.
pub struct ImageSet {
    /// As the user named it.
    pub name: String,
    /// Its drives.
    pub surveys: Vec<Survey>,
}

/// A set's comparison by one metric.
#[derive(Debug)]
pub struct Row {
    /// Name of the set.
    pub set: String,
    /// The metric.
    pub metric: Metric,
    /// Images of the set.
    pub images: usize,
    /// Images of it that could be judged; the others are left out.
    pub judged: u64,
    /// The metric's own number for each tap, or why there is none.
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
    /// Images counted.
    pub images: u64,
    /// `[bins]`, pixels.
    pub counts: Vec<u64>,
}

/// Images of a reference that cannot be judged.
#[derive(Debug, thiserror::Error)]
pub enum ComparisonError {
    /// One of its images.
    #[error("reference {set}: image {number} in order cannot be judged: {why}")]
    Image {
        /// Name of the set.
        set: String,
        /// The image's number from 1.
        number: usize,
        /// Why.
        why: Undefined,
    },
    /// The set as a whole.
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
    /// One a metric and set, in that order.
    pub rows: Vec<Row>,
    /// One a metric, set (the reference first) and tap.
    pub histograms: Vec<HistogramRecord>,
}

impl ImageSet {
    /// How many images the set has.
    pub fn images(&self) -> usize {
        self.surveys.iter().map(|survey| survey.frames.len()).sum()
    }

    fn maps(&self, tap: usize) -> impl Iterator<Item = Result<EnergyMap, Undefined>> + '_ {
        self.surveys
            .iter()
            .flat_map(move |survey| survey.common_maps(tap))
    }

    /// The set as a reference: every image of it counts.
    fn fit(
        &self,
        tap: usize,
        metric: Metric,
        paper: PaperBinning,
    ) -> Result<TapHistogram, ComparisonError> {
        let maps = self.maps(tap).enumerate().map(|(index, map)| {
            map.map_err(|why| ComparisonError::Image {
                set: self.name.clone(),
                number: index + 1,
                why,
            })
        });
        TapHistogram::fit(&maps.collect::<Result<Vec<_>, _>>()?, metric, paper).map_err(|why| {
            ComparisonError::Set {
                set: self.name.clone(),
                why,
            }
        })
    }

    /// Counts of the images that can be judged, and why the first of the others cannot.
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
}

/// Compares sets with a reference by several metrics.
///
/// # Errors
/// When an image of the reference cannot be judged.
pub fn compare(
    reference: &ImageSet,
    sets: &[ImageSet],
    taps: &[String],
    metrics: &[Metric],
    paper: PaperBinning,
) -> Result<Comparisons, ComparisonError> {
    let mut all = Comparisons::default();
    for &metric in metrics {
        let fitted = (0..taps.len())
            .map(|tap| reference.fit(tap, metric, paper))
            .collect::<Result<Vec<_>, _>>()?;
        let record = |set: &ImageSet, tap: usize, sum: HistogramSum| HistogramRecord {
            set: set.name.clone(),
            metric,
            tap: taps[tap].clone(),
            median_peak_energy: fitted[tap].median_peak_energy,
            binning: fitted[tap].binning.clone(),
            images: sum.images,
            counts: sum.counts,
        };
        all.histograms.extend(
            fitted
                .iter()
                .enumerate()
                .map(|(tap, own)| record(reference, tap, own.sum.clone())),
        );
        for set in sets {
            let mut row = Row {
                set: set.name.clone(),
                metric,
                images: set.images(),
                judged: u64::MAX,
                values: vec![],
            };
            for (tap, nominal) in fitted.iter().enumerate() {
                let (sum, reason) = set.sum(tap, &nominal.binning);
                row.judged = row.judged.min(sum.images);
                row.values.push(match reason {
                    Some(reason) if sum.images == 0 => Err(reason),
                    _ => metric
                        .compare(&sum.counts, &nominal.sum.counts)
                        .map(|compared| compared.value),
                });
                all.histograms.push(record(set, tap, sum));
            }
            all.rows.push(row);
        }
    }
    Ok(all)
}
