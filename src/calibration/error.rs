//! Why a calibration cannot be made.

use super::distance::DriveDistance;
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
    /// Drives are far from all domains, among the distances of all drives.
    #[error("{}", far_drives(.0))]
    Far(Vec<DriveDistance>),
    /// No held-out drive is nearest to the simulation, whose thresholds they would set.
    #[error(
        "all {held_out} held-out drives are nearest to accepted roads, so none can set the thresholds of the simulation; wanted --held-out drives of the simulation too, or none"
    )]
    NoneOfSimulation {
        /// Number of held-out drives.
        held_out: usize,
    },
    /// The model gives other numbers of energies than the reference has.
    #[error(
        "{source_name}: the model gives {found:?} energies in its blocks, but the reference has {wanted:?}; wanted a reference that was made with this model"
    )]
    Energies {
        /// The source.
        source_name: String,
        /// Number for each block.
        found: Vec<usize>,
        /// The same of the reference.
        wanted: Vec<usize>,
    },
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

/// Number of far drives that an error names.
const FAR_NAMED_MAX: usize = 3;

/// The drives that are far, and what would do.
fn far_drives(distances: &[DriveDistance]) -> String {
    let far: Vec<&DriveDistance> = distances.iter().filter(|of| of.is_far()).collect();
    let (first, rest) = far.split_at(far.len().min(FAR_NAMED_MAX));
    let mut named: Vec<String> = first.iter().map(ToString::to_string).collect();
    if !rest.is_empty() {
        named.push(format!("{} more drives are far", rest.len()));
    }
    format!(
        "{}: leave such a drive out, make it a domain of its own with --accept-as NAME=DRIVE, or use it all the same with --allow-far",
        named.join("; ")
    )
}
