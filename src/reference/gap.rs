//! Histograms or channel energies against a reference → gap: one number for each block, 0 for the same domain.

mod chi_square;
pub mod frechet;
mod hellinger;
mod jensen_shannon;
pub mod lane_risk;
pub mod moments;

pub mod energy_norm;
mod pearson;
mod shares;
mod wasserstein;

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::capture::undefined::Undefined;

/// Temperature of the paper's softmax, energy units (its eq. 3).
pub const PAPER_TEMPERATURE: f64 = 10.0;
/// Levels of the paper's histogram.
pub const PAPER_LEVELS: usize = 256;
/// First level that the paper counts: bins 0..100 are left out.
pub const PAPER_FIRST_LEVEL: usize = 101;

/// A gap metric: what is taken from a frame, and how it is compared with a reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Metric {
    /// As published: softmax attention at T = 10, bins 101..255, Pearson's correlation.
    Paper,
    /// Softmax attention at a temperature that fits the reference, all bins.
    Attention(Divergence),
    /// Logarithm of the energy in bins of equal mass on the reference.
    LogEnergy(Divergence),
    /// Frechet distance of the channels' means (FID's formula, the paper's eq. 1).
    Frechet,
    /// Squared Mahalanobis distance of log energies, by channel and by cell.
    Mahalanobis,
    /// Forecast of the share of lanes that the lane model loses, from log energies and labelled drives.
    LaneRisk,
}

/// How two histograms are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Divergence {
    /// Pearson's correlation.
    Pearson,
    /// Chi-square distance.
    ChiSquare,
    /// Jensen-Shannon divergence, bits.
    JensenShannon,
    /// Hellinger distance.
    Hellinger,
    /// First Wasserstein distance.
    Wasserstein,
}

impl Divergence {
    /// All ways to compare.
    pub const ALL: [Self; 5] = [
        Self::Pearson,
        Self::ChiSquare,
        Self::JensenShannon,
        Self::Hellinger,
        Self::Wasserstein,
    ];

    /// The end of a metric's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pearson => "pearson",
            Self::ChiSquare => "chi2",
            Self::JensenShannon => "js",
            Self::Hellinger => "hellinger",
            Self::Wasserstein => "w1",
        }
    }

    /// Compares two histograms, `[bins]` pixels each. Only their shapes count, and not their totals.
    ///
    /// # Errors
    /// `EmptyHistogram` or `ConstantHistogram` when the comparison has no value.
    pub fn compare(self, a: &[u64], b: &[u64]) -> Result<Comparison, Undefined> {
        let value = match self {
            Self::Pearson => {
                let r = pearson::correlation(a, b)?;
                return Ok(Comparison {
                    value: r,
                    gap: 1.0 - r,
                    similarity: r,
                });
            }
            Self::ChiSquare => chi_square::distance(a, b)?,
            Self::JensenShannon => jensen_shannon::divergence_bits(a, b)?,
            Self::Hellinger => hellinger::distance(a, b)?,
            Self::Wasserstein => wasserstein::distance(a, b)?,
        };
        Ok(Comparison {
            value,
            gap: value,
            similarity: 1.0 - value,
        })
    }
}

impl Metric {
    /// The default metric; `calibration/RESULTS.md` has a comparison of metrics.
    pub const DEFAULT: Self = Self::Mahalanobis;

    /// All metrics.
    pub fn all() -> Vec<Self> {
        let of = |kind: fn(Divergence) -> Self| Divergence::ALL.map(kind);
        [Self::Paper]
            .into_iter()
            .chain(of(Self::Attention))
            .chain(of(Self::LogEnergy))
            .chain([Self::Frechet, Self::Mahalanobis, Self::LaneRisk])
            .collect()
    }

    /// The metrics that compare any two sets of images: all but those that need labelled drives.
    pub fn of_sets() -> Vec<Self> {
        let mut all = Self::all();
        all.retain(|metric| metric.check_of_sets().is_ok());
        all
    }

    /// Checks that the metric can compare any two sets of images.
    ///
    /// # Errors
    /// When it must be learnt from labelled drives first.
    pub fn check_of_sets(self) -> Result<(), NeedsLabels> {
        match self {
            Self::LaneRisk => Err(NeedsLabels(self)),
            Self::Paper
            | Self::Attention(_)
            | Self::LogEnergy(_)
            | Self::Frechet
            | Self::Mahalanobis => Ok(()),
        }
    }

    /// The blocks whose largest score decides, of `blocks` tapped blocks. These are all blocks. For the forecast, it is
    /// the last block, which predicts the loss best because it is next to the lane head.
    pub fn deciding(self, blocks: usize) -> Range<usize> {
        match self {
            Self::LaneRisk => blocks.saturating_sub(1)..blocks,
            _ => 0..blocks,
        }
    }

    /// How its histograms are compared; `None` for a metric without histograms.
    pub fn divergence(self) -> Option<Divergence> {
        match self {
            Self::Paper => Some(Divergence::Pearson),
            Self::Attention(divergence) | Self::LogEnergy(divergence) => Some(divergence),
            Self::Frechet | Self::Mahalanobis | Self::LaneRisk => None,
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Paper => f.pad("paper"),
            Self::Attention(divergence) => f.pad(&format!("attention-{}", divergence.name())),
            Self::LogEnergy(divergence) => f.pad(&format!("log-energy-{}", divergence.name())),
            Self::Frechet => f.pad("frechet"),
            Self::Mahalanobis => f.pad("mahalanobis"),
            Self::LaneRisk => f.pad("lane-risk"),
        }
    }
}

impl FromStr for Metric {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let all = Self::all();
        all.iter()
            .copied()
            .find(|metric| metric.to_string() == text)
            .ok_or_else(|| {
                let names: Vec<String> = all.iter().map(ToString::to_string).collect();
                format!("wanted one of {}", names.join(", "))
            })
    }
}

impl TryFrom<String> for Metric {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Metric> for String {
    fn from(metric: Metric) -> Self {
        metric.to_string()
    }
}

/// A metric with which sets of images cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0} is learnt from labelled drives, which a comparison of sets of images does not have; wanted calibrate --metric {0} \
     --labelled scene:…, and replay --reference with the reference that it makes, or another metric"
)]
pub struct NeedsLabels(pub Metric);

/// What a metric says about two histograms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The value of the metric: a correlation, or a distance.
    pub value: f64,
    /// Larger is worse; 0 for equal histograms.
    pub gap: f64,
    /// Larger is better; 1 for equal histograms.
    pub similarity: f64,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_histogram_with_itself_has_similarity_1(counts in prop::collection::vec(0..10_000_u64, 4..80)) {
            for metric in Divergence::ALL {
                match metric.compare(&counts, &counts) {
                    Ok(same) => prop_assert!((same.similarity - 1.0).abs() < 1e-12 && same.gap.abs() < 1e-12),
                    Err(why) => prop_assert!(matches!(why, Undefined::EmptyHistogram | Undefined::ConstantHistogram)),
                }
            }
        }

        #[test]
        fn comparisons_are_symmetric_bounded_and_blind_to_totals(
            a in prop::collection::vec(0..1_000_u64, 16), b in prop::collection::vec(0..1_000_u64, 16), times in 2..9_u64
        ) {
            let more: Vec<u64> = a.iter().map(|n| n * times).collect();
            for metric in Divergence::ALL {
                let (Ok(ab), Ok(ba)) = (metric.compare(&a, &b), metric.compare(&b, &a)) else { continue };
                prop_assert!((ab.value - ba.value).abs() < 1e-12);
                prop_assert!((-1.0..=1.0).contains(&ab.value));
                prop_assert!((ab.similarity + ab.gap - 1.0).abs() < 1e-12);
                prop_assert!((metric.compare(&more, &b).unwrap().value - ab.value).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn sets_are_compared_by_all_metrics_but_the_one_that_needs_labelled_drives() {
        let of_sets = Metric::of_sets();
        let mut all = Metric::all();
        assert_eq!(all.len(), 1 + 2 * Divergence::ALL.len() + 3);
        all.retain(|metric| metric.to_string() != "lane-risk");
        assert_eq!(of_sets, all);
    }

    #[test]
    fn the_last_block_decides_a_forecast_and_every_block_anything_else() {
        assert_eq!(Metric::LaneRisk.deciding(3), 2..3);
        assert_eq!(Metric::LaneRisk.deciding(0), 0..0);
        assert_eq!(Metric::DEFAULT.deciding(3), 0..3);
    }

    #[test]
    fn metrics_that_count_histograms_say_how_these_are_compared() {
        let pearson = Some(Divergence::Pearson);
        assert_eq!(Metric::Paper.divergence(), pearson);
        let js = Divergence::JensenShannon;
        assert_eq!(Metric::LogEnergy(js).divergence(), Some(js));
        assert_eq!(Metric::Frechet.divergence(), None);
    }

    #[test]
    fn names_are_read_back() {
        for metric in Metric::all() {
            assert_eq!(String::from(metric).parse(), Ok(metric));
        }
        assert!("js".parse::<Metric>().unwrap_err().contains("attention-js"));
    }

    #[test]
    fn a_forecast_learnt_from_labels_compares_no_sets() {
        for metric in Metric::all() {
            let said = metric.check_of_sets().map_err(|why| why.to_string());
            if metric == Metric::LaneRisk {
                assert!(said.is_err_and(|said| said.contains("calibrate --metric lane-risk --labelled")));
                assert!(!Metric::of_sets().contains(&metric));
            } else {
                assert_eq!(said, Ok(()));
                assert!(Metric::of_sets().contains(&metric));
            }
        }
    }
}
