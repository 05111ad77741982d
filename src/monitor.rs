//! The chain: a frame becomes a verdict, with the time as an argument.
//!
//! ```
//! use gapwatch::capture::open;
//! use gapwatch::model::encoder::Encoder;
//! use gapwatch::model::{ModelOptions, ModelSpec};
//! use gapwatch::monitor::alarm::AlarmState;
//! use gapwatch::monitor::pipeline::Monitor;
//! use gapwatch::reference::Reference;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let encoder = Encoder::load(&ModelSpec::new(None, ModelOptions::default())?)?;
//! let mut monitor = Monitor::new(&encoder, &Reference::read(None)?)?;
//! // Random pixels are far from any road: a second of them is a gap.
//! let mut source = open("random:seed=1&frames=60")?;
//! let mut state = AlarmState::Init;
//! while let Some(frame) = source.next_frame()? {
//!     state = monitor.step(&frame).state;
//! }
//! assert_eq!(state, AlarmState::Gap);
//! # Ok(())
//! # }
//! ```

pub mod camera_health;

pub mod extraction;
pub mod profile;

pub mod continuity;
pub mod cusum;
pub mod history;
pub mod unrest;

pub mod span_watch;

pub mod detector;
pub mod scorer;

pub mod warn;

pub mod alarm;
pub mod rate;
pub mod timing;

pub mod judge;

pub mod pipeline;
