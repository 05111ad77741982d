//! Longer times than the short window: what is nominal for them, and which distances are.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::reference::gap::energy_norm::EnergyNorm;

/// Smallest distance of a threshold from its median.
pub const SPREAD_MIN: f64 = 1e-9;

/// A recent time that is compared with what is nominal, or with the time before it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// Length of the recent time, seconds.
    pub recent_s: f64,
    /// Length of the past before it, seconds: their difference is a change. `None`: the recent time itself is compared
    /// with what is nominal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub past_s: Option<f64>,
}

impl Span {
    /// All spans of a reference of energies.
    pub const ALL: [Self; 3] = [
        Self {
            recent_s: 5.0,
            past_s: None,
        },
        Self {
            recent_s: 2.0,
            past_s: Some(20.0),
        },
        Self {
            recent_s: 5.0,
            past_s: Some(30.0),
        },
    ];

    /// Recent time and past together, seconds.
    pub fn length_s(self) -> f64 {
        self.recent_s + self.past_s.unwrap_or_default()
    }

    /// Whether it says that the road has changed, and not that it is unknown.
    pub fn is_change(self) -> bool {
        self.past_s.is_some()
    }
}

/// What the road is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EvidenceKind {
    /// One window, whose nominal spread is that of single frames.
    Frames,
    /// Windows, with the nominal spread of windows, and changes against the past, if the metric is one of energies.
    Windows,
}

impl FromStr for EvidenceKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "frames" => Ok(Self::Frames),
            "windows" => Ok(Self::Windows),
            _ => Err("wanted frames or windows".to_owned()),
        }
    }
}

impl fmt::Display for EvidenceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Frames => "frames",
            Self::Windows => "windows",
        })
    }
}

/// What is nominal for one block in one span.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpanNorm {
    /// The span.
    pub span: Span,
    /// Nominal mean and spread of means over the recent time, or of differences.
    pub norm: EnergyNorm,
    /// Number of nominal distances.
    pub windows: usize,
    /// Median distance: score 0.
    pub median: f64,
    /// Distance from which on the past is held: what is being judged does not enter it.
    pub held_from: f64,
    /// Alarm threshold: score 1.
    pub threshold: f64,
}

impl SpanNorm {
    /// The score of a distance: 0 nominal median, 1 alarm threshold.
    pub fn score(&self, distance: f64) -> f64 {
        (distance - self.median) / (self.threshold - self.median)
    }

    /// What is wrong with it, if anything.
    pub(super) fn fault(&self, wanted: Span, energies: usize) -> Option<String> {
        if self.span != wanted {
            return Some(format!("span {:?} where {wanted:?} was wanted", self.span));
        }
        if self.norm.energies() != energies {
            return Some(format!(
                "{} energies in a span beside {energies}",
                self.norm.energies()
            ));
        }
        let above = |level: f64| level.is_finite() && level - self.median >= 0.5 * SPREAD_MIN;
        let usable = self.median.is_finite()
            && self.median >= 0.0
            && above(self.held_from)
            && above(self.threshold);
        (!usable)
            .then(|| "a span without a median below its thresholds".to_owned())
            .or_else(|| self.norm.fault())
    }
}
