//! The lane model: its file, how pictures are prepared for it, and its encoder.

mod spec;

pub(crate) mod vectors;

pub mod preprocess;

pub mod encoder;

pub use spec::*;
