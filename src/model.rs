//! The lane model: its file, how pictures are prepared for it, and its encoder.

mod data_files;

mod onnx_file;

mod spec;

pub(crate) mod vectors;

pub mod preprocess;

pub mod encoder;

pub use data_files::DataFile;
pub use onnx_file::ONNX_BYTES_MAX;
pub use spec::*;
