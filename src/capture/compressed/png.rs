//! PNG.

use std::borrow::Cow;
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
    let (chunks, orientation) = chunks(bytes)?;
    let decoder = PngDecoder::new(Cursor::new(&*chunks)).map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels, more than {PIXELS_MAX}"));
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
    let rgb = image.into_rgb8().into_raw();
    upright(width, height, rgb, orientation).ok_or_else(|| cut_off(bytes.len()))
}

/// The file without colour profiles, which are not used and which the decoder would inflate to any size; and how the picture
/// must be turned.
///
/// # Errors
/// When the chunk that ends the file is missing; the decoder would fill up what is cut off.
fn chunks(bytes: &[u8]) -> Result<(Cow<'_, [u8]>, Orientation), String> {
    let mut orientation = None;
    let mut without: Option<Vec<u8>> = None;
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
        let (name, data) = chunk.ok_or_else(|| cut_off(bytes.len()))?;
        let end = at + AROUND + data.len();
        if name == b"eXIf" {
            let tiff = data.strip_prefix(b"Exif\0\0").unwrap_or(data);
            orientation = orientation.or_else(|| Orientation::from_exif_chunk(tiff));
        }
        if name == b"iCCP" {
            without.get_or_insert_with(|| bytes[..at].to_vec());
        } else if let Some(without) = &mut without {
            without.extend_from_slice(&bytes[at..end]);
        }
        if name == b"IEND" {
            break;
        }
        at = end;
    }
    let chunks = without.map_or(Cow::Borrowed(bytes), Cow::Owned);
    Ok((chunks, orientation.unwrap_or(Orientation::NoTransforms)))
}
