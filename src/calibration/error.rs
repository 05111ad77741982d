//! Why a calibration cannot be made.

use super::drive::StoreError;
use crate::capture::undefined::Undefined;
use crate::reference::gap::Metric;

/// What can be wrong with the sources of a reference.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// A frame cannot be judged.
    #[error("{source_name}: frame {frame} cannot be judged: {why}")]
    Frame {
        /// The source.
        source_name: String,
        /// The frame's number from 0.
        frame: usize,
        /// Why.
        why: Undefined,
    },
    /// There are too few frames.
    #[error("{0}")]
    TooFew(Undefined),
    /// A drive can no longer be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Causes cannot be learnt from what was given.
    #[error("--causes: {0}")]
    Causes(String),
    /// A forecast of lanes cannot be learnt from what was given.
    #[error("--labelled: {0}")]
    Lanes(String),
    /// Histograms cannot be compared.
    #[error("tap {tap}, metric {metric}: {why}")]
    Comparison {
        /// Name of the tap.
        tap: String,
        /// The metric that was asked for.
        metric: Metric,
        /// Why.
        why: Undefined,
    },
}

/// The error of one tap.
pub fn wrong(tap: &str, metric: Metric, why: Undefined) -> CalibrationError {
    CalibrationError::Comparison {
        tap: tap.to_owned(),
        metric,
        why,
    }
}
