//! Nominal drives to a reference.

pub mod survey;

mod calibrate;
mod false_alarms;

pub mod shard;

pub use calibrate::*;
pub use false_alarms::{DriveScores, is_judging};
