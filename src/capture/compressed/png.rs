//! PNG.

use std::io::Cursor;

use image::codecs::png::PngDecoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder};

use super::jpeg::upright;
use super::segments::cut_off;
use crate::capture::{PIXELS_MAX, Picture};

/// Bytes that every PNG file begins with.
const SIGNATURE: usize = 8;
/// Bytes of a chunk beside its data: length, name and check sum.
const AROUND: usize = 12;

/// Decodes a PNG image and turns it upright. Alpha is dropped; 16 bits become 8.
///
/// # Errors
/// What is wrong with it.
pub fn decoded(bytes: &[u8]) -> Result<Picture, String> {
    let orientation = orientation(bytes)?;
    let decoder = PngDecoder::new(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels, more than {PIXELS_MAX}"));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
    let rgb = image.into_rgb8().into_raw();
    upright(width, height, rgb, orientation).ok_or_else(|| cut_off(bytes.len()))
}

/// How the picture must be turned.
///
/// # Errors
/// When the chunk that ends the file is missing; the decoder would fill up what is cut off.
fn orientation(bytes: &[u8]) -> Result<Orientation, String> {
    let mut orientation = None;
    let mut at = SIGNATURE;
    loop {
        let chunk = bytes.get(at..).and_then(|rest| {
            let (length, rest) = rest.split_first_chunk()?;
            let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
            let (name, rest) = rest.split_first_chunk::<4>()?;
            // The check sum must be there too.
            let data = rest.get(..length.checked_add(4)?)?;
            Some((name, &data[..length]))
        });
        match chunk.ok_or_else(|| cut_off(bytes.len()))? {
            (b"IEND", _) => break,
            (b"eXIf", exif) => {
                let tiff = exif.strip_prefix(b"Exif\0\0").unwrap_or(exif);
                orientation = orientation.or_else(|| Orientation::from_exif_chunk(tiff));
                at += AROUND + exif.len();
            }
            (_, data) => at += AROUND + data.len(),
        }
    }
    Ok(orientation.unwrap_or(Orientation::NoTransforms))
}
