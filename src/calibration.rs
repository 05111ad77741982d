//! Makes a reference from nominal drives: what the encoder saw of them, what is nominal, and the thresholds for a rate
//! of false alarms.

pub mod survey;

mod distance;
pub mod drive;
mod error;
mod target;

mod binning;
mod false_alarms;
mod windows;

mod stretch;

mod timed;

mod fitting;
mod spans;
mod thresholds;

mod facts;
mod far;

mod component;
mod pair;

mod accept;
mod calibrate;

mod cause_names;
mod causes;

mod lanes;

pub mod shard;

pub use accept::{Accepted, Shown, accept, looks_to_accept};
pub use binning::{
    EPSILON_SHARE, LOG_ENERGY_BINS, PaperBinning, TEMPERATURE_SHARE, TapHistogram, Temperature,
    counts_of,
};
pub use calibrate::{Calibrated, FarDrives, calibrate, calibrate_with, looks};
pub use cause_names::{CauseName, cause_of, with_conditions};
pub use causes::{LearntCauses, learn_causes};
pub use component::Domain;
pub use distance::DriveDistance;
pub use drive::{LabelledDrive, LabelledMeans, SurveyedDrive};
pub use error::CalibrationError;
pub use facts::{DriveFacts, facts_of};
pub use false_alarms::{DriveScores, is_judging};
pub use lanes::learn_lanes;
pub use target::Target;
pub use windows::{drive_evidence, drive_scores};
