//! What causes a gap, for people: a window beside its reference, number by number and region by region.

use serde::{Deserialize, Serialize};

use crate::features::energies::CELLS;
use crate::reference::gap::moments::STEPS_PER_NAT;
use crate::reference::{Nominal, TapReference};

/// Largest number of values in a profile that is read from a file.
pub const NUMBERS_MAX: usize = 8_192;

/// What one tap's window shows, and what it shows on nominal roads.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TapProfile {
    /// Name of the tap.
    pub tap: String,
    /// What the numbers are.
    pub kind: ProfileKind,
    /// Numbers of the window.
    pub live: Vec<f64>,
    /// Numbers of the reference, as many as in `live`.
    pub nominal: Vec<f64>,
    /// Nominal spreads of energies, as many as in `live`; empty for histograms.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spread: Vec<f64>,
}

/// What the numbers of a profile are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProfileKind {
    /// Shares of the counted pixels by bin; their sum is 1.
    Histogram,
    /// Log energies `ln(1 + e / epsilon)`, nats: those of the channels, then those of the cells of the coarse grid, row
    /// by row.
    Energies,
}

/// Nominal spreads of a tap's energies, nats; empty for histograms. The result should be kept, because for energies a
/// matrix is inverted.
pub fn spreads_of(reference: &TapReference) -> Vec<f64> {
    match &reference.nominal {
        Nominal::Histogram { .. } => Vec::new(),
        Nominal::Energies(norm) => norm.spreads(),
        Nominal::LaneRisk(risk) => risk.spread.clone(),
    }
}

impl TapProfile {
    /// The profile of a window of `frames` frames, whose sum is `sums` `[reference.nominal.len()]`; `spread` is that of
    /// the reference ([`spreads_of`]).
    #[allow(clippy::cast_precision_loss)]
    pub fn new(reference: &TapReference, spread: &[f64], sums: &[u64], frames: usize) -> Self {
        let shares = |counts: &[u64]| -> Vec<f64> {
            let total = counts.iter().sum::<u64>().max(1) as f64;
            counts.iter().map(|&count| count as f64 / total).collect()
        };
        let nats = || {
            let scale = 1.0 / (STEPS_PER_NAT * frames.max(1) as f64);
            sums.iter().map(|&sum| sum as f64 * scale).collect()
        };
        let (kind, live, nominal) = match &reference.nominal {
            Nominal::Histogram { counts, .. } => {
                (ProfileKind::Histogram, shares(sums), shares(counts))
            }
            Nominal::Energies(norm) => (ProfileKind::Energies, nats(), norm.mean.clone()),
            Nominal::LaneRisk(risk) => (ProfileKind::Energies, nats(), risk.mean.clone()),
        };
        Self {
            tap: reference.tap.clone(),
            kind,
            live,
            nominal,
            spread: spread.to_vec(),
        }
    }

    /// Whether its numbers belong together. This must be checked for a profile that was read.
    pub fn is_whole(&self) -> bool {
        let spreads = match self.kind {
            ProfileKind::Histogram => 0,
            ProfileKind::Energies => self.live.len(),
        };
        (1..=NUMBERS_MAX).contains(&self.live.len())
            && self.nominal.len() == self.live.len()
            && self.spread.len() == spreads
    }

    /// How far each energy is from its nominal mean, in nominal spreads; empty for histograms.
    pub fn deviations(&self) -> Vec<f64> {
        let nominal = self.nominal.iter().zip(&self.spread);
        let apart = self.live.iter().zip(nominal);
        apart
            .map(|(live, (mean, spread))| (live - mean) / spread.max(f64::MIN_POSITIVE))
            .collect()
    }

    /// Deviations of the channels, which come before the cells; empty for histograms.
    pub fn channel_deviations(&self) -> Vec<f64> {
        let mut deviations = self.deviations();
        deviations.truncate(deviations.len().saturating_sub(CELLS));
        deviations
    }

    /// Deviations of the cells of the coarse grid, row by row; `None` for histograms, which have no places.
    pub fn cell_deviations(&self) -> Option<[f64; CELLS]> {
        let deviations = self.deviations();
        let cells = deviations.len().checked_sub(CELLS)?;
        deviations[cells..].try_into().ok()
    }

    /// Which part of the picture differs: the share of each cell in the sum of the squared deviations of the cells. The
    /// shares add up to 1. `None` if there are no deviations, or if nothing differs.
    pub fn cell_shares(&self) -> Option<[f64; CELLS]> {
        let squares = self
            .cell_deviations()?
            .map(|deviation| deviation * deviation);
        let sum: f64 = squares.iter().sum();
        (sum.is_finite() && sum > 0.0).then(|| squares.map(|square| square / sum))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    fn energies(live: Vec<f64>) -> TapProfile {
        let len = live.len();
        TapProfile {
            tap: "e2".to_owned(),
            kind: ProfileKind::Energies,
            nominal: vec![1.0; len],
            spread: vec![0.5; len],
            live,
        }
    }

    #[test]
    fn shares_of_cells_are_of_their_squared_deviations() {
        // A channel with a large deviation, which has no place, and two cells with deviations of one and two spreads.
        let mut live = vec![1.0; 1 + CELLS];
        (live[0], live[1], live[CELLS]) = (9.0, 1.5, 0.0);
        let profile = energies(live);
        assert!(profile.is_whole());
        let shares = profile.cell_shares().unwrap();
        assert_eq!((shares[0], shares[CELLS - 1]), (0.2, 0.8));
        assert_eq!(shares.iter().sum::<f64>(), 1.0);
        assert_eq!(profile.cell_deviations().unwrap()[CELLS - 1], -2.0);
    }

    #[test]
    fn what_has_no_cells_or_no_deviation_has_no_shares() {
        assert_eq!(energies(vec![1.0; 1 + CELLS]).cell_shares(), None);
        assert_eq!(energies(vec![2.0; CELLS - 1]).cell_shares(), None);
        let mut histogram = energies(vec![0.5; 2 * CELLS]);
        (histogram.kind, histogram.spread) = (ProfileKind::Histogram, vec![]);
        assert!(histogram.is_whole() && histogram.cell_shares().is_none());
        histogram.nominal.pop();
        assert!(!histogram.is_whole());
    }
}
