//! What share of its lanes the model is forecast to lose, from the energies of its last block.

use serde::{Deserialize, Serialize};

use super::gap::lane_risk::LaneRisk;
use super::nominal::{Nominal, TapReference};

/// A forecast, learnt from rendered drives with lane labels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LaneForecast {
    /// Labelled frames from which it was learnt.
    pub frames: usize,
    /// How well it foretells what it was not learnt from.
    pub judged: JudgedForecast,
    /// The forecast from the energies that the first domain takes from its last tap.
    pub risk: LaneRisk,
}

/// A forecast learnt from every second labelled drive, judged on the others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JudgedForecast {
    /// Labelled frames on which it was judged.
    pub frames: usize,
    /// Mean absolute difference between forecast and loss.
    pub mean_absolute_error: f64,
    /// The same of a forecast that is always the mean loss.
    pub of_the_mean: f64,
}

impl LaneForecast {
    /// Forecast of the share of lanes that the model loses, 0 to 1, in a window of `frames` frames; `sums` are the sums of
    /// levels of all `taps` of the first domain. Allocates nothing.
    pub fn share(&self, taps: &[TapReference], sums: &[u64], frames: usize) -> Option<f64> {
        let (last, before) = taps.split_last()?;
        let from: usize = before.iter().map(|tap| tap.nominal.len()).sum();
        let own = sums.get(from..from + last.nominal.len())?;
        Some(self.risk.loss(own, frames).clamp(0.0, 1.0))
    }

    /// What is wrong with it, if anything.
    pub(super) fn fault(&self, taps: &[TapReference]) -> Option<String> {
        let Some((tap, Nominal::Energies(norm))) = taps.last().map(|tap| (tap, &tap.nominal))
        else {
            return Some("a forecast from energies beside a last tap without energies".to_owned());
        };
        if self.risk.mean.len() != norm.energies() {
            return Some(format!(
                "a forecast from {} energies beside {} of tap {}",
                self.risk.mean.len(),
                norm.energies(),
                tap.tap
            ));
        }
        // Levels are taken once for both, with the epsilon of the tap.
        if self.risk.epsilon.to_bits() != norm.epsilon.to_bits() {
            return Some(format!(
                "a forecast with an epsilon of {} beside {} of tap {}",
                self.risk.epsilon, norm.epsilon, tap.tap
            ));
        }
        let judged = [self.judged.mean_absolute_error, self.judged.of_the_mean];
        if judged.iter().any(|error| !error.is_finite()) {
            return Some(format!("mean errors of {} and {}", judged[0], judged[1]));
        }
        self.risk.fault()
    }
}
