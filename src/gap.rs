//! Histograms against a reference → gap: one number a block, 0 for the same domain.

mod jensen_shannon;
mod pearson;

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::undefined::Undefined;

/// Temperature of the paper's softmax, energy units (its eq. 3).
pub const PAPER_TEMPERATURE: f64 = 10.0;
/// Levels of the paper's histogram.
pub const PAPER_LEVELS: usize = 256;
/// First level that the paper counts: bins 0..100 are left out.
pub const PAPER_FIRST_LEVEL: usize = 101;

/// A gap metric: how pixels are counted, and how two histograms are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// As published: softmax attention at T = 10, bins 101..255, Pearson's correlation.
    Paper,
    /// Softmax attention at a temperature that fits the reference, all bins, Jensen-Shannon divergence.
    AttentionJs,
    /// Logarithm of the energy in bins of equal mass on the reference, Jensen-Shannon divergence.
    LogEnergyJs,
}

impl Metric {
    /// All metrics.
    pub const ALL: [Self; 3] = [Self::Paper, Self::AttentionJs, Self::LogEnergyJs];

    /// The name used in commands and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::AttentionJs => "attention-js",
            Self::LogEnergyJs => "log-energy-js",
        }
    }

    /// Compares two histograms, `[bins]` pixels each; only their shapes count, not their totals.
    ///
    /// # Errors
    /// `EmptyHistogram` or `ConstantHistogram` when the comparison has no value.
    pub fn compare(self, a: &[u64], b: &[u64]) -> Result<Comparison, Undefined> {
        match self {
            Self::Paper => pearson::correlation(a, b).map(|r| Comparison {
                value: r,
                gap: 1.0 - r,
                similarity: r,
            }),
            Self::AttentionJs | Self::LogEnergyJs => {
                jensen_shannon::divergence_bits(a, b).map(|d| Comparison {
                    value: d,
                    gap: d,
                    similarity: 1.0 - d,
                })
            }
        }
    }
}

impl fmt::Display for Metric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Metric {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let names = Self::ALL.map(Self::name).join(", ");
        Self::ALL
            .into_iter()
            .find(|m| m.name() == text)
            .ok_or_else(|| format!("wanted one of {names}"))
    }
}

/// What a metric says of two histograms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// The metric's own number: a correlation for `paper`, a divergence in bits for the others.
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
            for metric in Metric::ALL {
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
            for metric in Metric::ALL {
                let (Ok(ab), Ok(ba)) = (metric.compare(&a, &b), metric.compare(&b, &a)) else { continue };
                prop_assert!((ab.value - ba.value).abs() < 1e-12);
                prop_assert!((-1.0..=1.0).contains(&ab.value));
                prop_assert!((metric.compare(&more, &b).unwrap().value - ab.value).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn names_are_read_back() {
        for metric in Metric::ALL {
            assert_eq!(metric.name().parse(), Ok(metric));
        }
        assert!("js".parse::<Metric>().unwrap_err().contains("attention-js"));
    }
}
