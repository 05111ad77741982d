//! What is nominal: the metrics of a gap, and the reference file with nominal values and thresholds.
//!
//! ```
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // `None` is the reference inside the program, which knows only rendered roads.
//! let reference = gapwatch::reference::Reference::read(None)?;
//! assert!(reference.strict);
//! println!("{}", reference.false_alarms.said());
//! # Ok(())
//! # }
//! ```

pub mod gap;

pub mod cause;

mod causes;
mod nominal;
mod rate;
mod span;

mod lanes;

mod file;
mod pretty;

pub use causes::*;
pub use file::*;
pub use lanes::*;
pub use nominal::*;
pub use rate::*;
pub use span::*;
