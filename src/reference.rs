//! What is nominal: the metrics of a gap, and the reference file with nominal values and thresholds.

pub mod gap;

mod nominal;

mod file;
mod pretty;

pub use file::*;
pub use nominal::*;
