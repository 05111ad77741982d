//! What is nominal: the metrics of a gap, and the reference file that holds them with their thresholds.

pub mod gap;

mod nominal;

mod file;
mod pretty;

pub use file::*;
pub use nominal::*;
