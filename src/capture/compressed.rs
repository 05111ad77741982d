//! Pictures as PNG or JPEG.

use std::io::Cursor;

use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat, ImageReader,
};

use super::{PIXELS_MAX, Picture};

/// JPEG quality of pictures that are written, from 1 to 100.
const JPEG_QUALITY: u8 = 85;

/// Decodes a PNG or JPEG image, or returns what is wrong with it.
pub fn decoded(bytes: &[u8]) -> Result<Picture, String> {
    let format = image::guess_format(bytes)
        .map_err(|_| format!("{} bytes that are not an image", bytes.len()))?;
    whole(format, bytes)?;
    let decoder = ImageReader::with_format(Cursor::new(bytes), format)
        .into_decoder()
        .map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels, more than {PIXELS_MAX}"));
    }
    picture(decoder)
}

/// Decodes a JPEG image of this size. An image of another size is not decoded.
pub fn decoded_jpeg(bytes: &[u8], size: (u32, u32)) -> Result<Picture, String> {
    let about = |error| format!("a buffer of {} bytes: {error}", bytes.len());
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|error| about(error.to_string()))?;
    let (width, height) = decoder.dimensions();
    if (width, height) != size {
        return Err(format!(
            "a JPEG image of {width}x{height}, wanted {}x{}",
            size.0, size.1
        ));
    }
    whole(ImageFormat::Jpeg, bytes)?;
    picture(decoder).map_err(about)
}

fn picture(decoder: impl ImageDecoder) -> Result<Picture, String> {
    let (width, height) = decoder.dimensions();
    let pixels = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
    Ok(Picture {
        width,
        height,
        rgb: pixels.into_rgb8().into_raw(),
    })
}

/// A picture as JPEG.
///
/// # Errors
/// When a picture has no pixels, or more than the format allows.
pub fn jpeg(picture: &Picture) -> image::ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).write_image(
        &picture.rgb,
        picture.width,
        picture.height,
        ExtendedColorType::Rgb8,
    )?;
    Ok(bytes)
}

/// The last eight bytes of a PNG: the name of its end chunk and its checksum.
const PNG_END: &[u8] = b"IEND\xAE\x42\x60\x82";

/// Returns an error unless the format's end marker is there (in a JPEG, after its last scan). The JPEG decoder silently
/// fills missing parts with grey.
fn whole(format: ImageFormat, bytes: &[u8]) -> Result<(), String> {
    let has =
        |bytes: &[u8], marker: &[u8]| bytes.windows(marker.len()).any(|window| window == marker);
    let ends = match format {
        ImageFormat::Png => has(bytes, PNG_END),
        ImageFormat::Jpeg => {
            let last_scan = bytes.windows(2).rposition(|marker| marker == [0xFF, 0xDA]);
            last_scan.is_some_and(|scan| has(&bytes[scan..], &[0xFF, 0xD9]))
        }
        // Any other format is left to its decoder, which this build does not have.
        _ => true,
    };
    match ends {
        true => Ok(()),
        false => Err(format!("an image cut off after {} bytes", bytes.len())),
    }
}
