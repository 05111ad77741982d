//! Pictures as PNG or JPEG.

mod jpeg;
mod png;
mod segments;
mod surplus;

use image::ImageFormat;

use super::Picture;

pub use jpeg::encoded as jpeg;

/// Decodes a PNG or JPEG image and turns it upright, or returns what is wrong with it.
pub fn decoded(bytes: &[u8]) -> Result<Picture, String> {
    match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) => jpeg::decoded(bytes, None),
        Ok(ImageFormat::Png) => png::decoded(bytes),
        Ok(other) => Err(format!("a {other:?} image")),
        Err(_) => Err(format!("{} bytes that are not an image", bytes.len())),
    }
}

/// Decodes a JPEG image of this size. An image of another size is not decoded.
pub fn decoded_jpeg(bytes: &[u8], size: (u32, u32)) -> Result<Picture, String> {
    jpeg::decoded(bytes, Some(size))
        .map_err(|error| format!("a buffer of {} bytes: {error}", bytes.len()))
}
