//! A picture, and why there is none.

use std::path::PathBuf;

/// Largest number of pixels of a picture that is decoded. A larger one is refused before memory is used for it. 8K
/// video has 33 million.
pub const PIXELS_MAX: u64 = 34_000_000;

/// An 8-bit RGB picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// `[height, width, 3]`, sRGB as the source gave it.
    pub rgb: Vec<u8>,
}

/// A picture that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {found}; wanted {wanted}", path.display())]
pub struct PictureError {
    pub(super) path: PathBuf,
    pub(super) found: String,
    pub(super) wanted: &'static str,
}
