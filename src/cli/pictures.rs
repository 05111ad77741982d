//! Pictures as files.

use std::fs;
use std::path::Path;

use anyhow::Context;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

/// Writes pixels as a PNG file; speed matters more than size.
pub fn write_png(
    path: &Path,
    pixels: &[u8],
    (width, height): (u32, u32),
    colour: ExtendedColorType,
) -> anyhow::Result<()> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Sub)
        .write_image(pixels, width, height, colour)
        .and_then(|()| Ok(fs::write(path, &bytes)?))
        .with_context(|| format!("cannot write {}", path.display()))
}
