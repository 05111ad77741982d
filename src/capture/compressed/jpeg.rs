//! JPEG through libjpeg-turbo, as `mozjpeg` brings it.
//!
//! libjpeg decodes whatever is left of a damaged file, and warns. Here a file of which libjpeg warns is damaged, unless
//! nothing of the picture is missing. What stands behind the picture is ignored.

use std::cell::Cell;
use std::ffi::c_int;
use std::io::{self, Read};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::ptr;
use std::sync::LazyLock;

use image::metadata::Orientation;
use image::{DynamicImage, RgbImage};
use mozjpeg::{ColorSpace, Compress, Decompress};
use mozjpeg_sys::{jpeg_common_struct, jpeg_error_mgr};

use super::segments::{EOI, Outline, cut_off};
use super::surplus::is_only_surplus;
use crate::capture::{PIXELS_MAX, Picture};

/// Quality of pictures that are written, from 1 to 100.
const QUALITY: f32 = 85.0;

/// An end marker, for files that have none.
const END: &[u8] = &[0xFF, EOI];

/// Decodes a JPEG image, of this size if it is given, and turns it upright.
///
/// # Errors
/// What is wrong with it. An image of another size is not decoded.
pub fn decoded(bytes: &[u8], size: Option<(u32, u32)>) -> Result<Picture, String> {
    let outline = Outline::of(bytes)?;
    let (width, height) = (outline.width, outline.height);
    if let Some(wanted) = size.filter(|&size| size != (width, height)) {
        return Err(format!(
            "a JPEG image of {width}x{height}, wanted {}x{}",
            wanted.0, wanted.1
        ));
    }
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels, more than {PIXELS_MAX}"));
    }
    let lost = || match outline.ended {
        true => format!("a JPEG image of {} bytes that is damaged", outline.length),
        false => cut_off(bytes.len()),
    };
    if !outline.is_complete() {
        return Err(lost());
    }
    let bytes = &bytes[..outline.length];
    let (rgb, warnings) = pixels(bytes).map_err(|why| match outline.ended {
        true => why,
        false => cut_off(bytes.len()),
    })?;
    if warnings > 0 && !is_only_surplus(bytes, &outline, &STANDARD) {
        return Err(lost());
    }
    upright(width, height, rgb, outline.orientation).ok_or_else(lost)
}

/// The picture as it is to be looked at.
pub fn upright(width: u32, height: u32, rgb: Vec<u8>, orientation: Orientation) -> Option<Picture> {
    let mut image = DynamicImage::ImageRgb8(RgbImage::from_raw(width, height, rgb)?);
    image.apply_orientation(orientation);
    Some(Picture {
        width: image.width(),
        height: image.height(),
        rgb: image.into_rgb8().into_raw(),
    })
}

/// Pixels in RGB, and how often libjpeg warned of the data.
fn pixels(bytes: &[u8]) -> Result<(Vec<u8>, u32), String> {
    let decode = || -> io::Result<(Vec<u8>, u32)> {
        let image = Decompress::builder()
            .with_err(errors())
            .from_reader(bytes.chain(END))?;
        // What it warns of in the headers is not of the picture.
        WARNINGS.set(0);
        let is_cmyk = matches!(
            image.color_space(),
            ColorSpace::JCS_CMYK | ColorSpace::JCS_YCCK
        );
        let mut image = match is_cmyk {
            true => image.to_colorspace(ColorSpace::JCS_CMYK)?,
            false => image.rgb()?,
        };
        let mut rows = image.read_scanlines()?;
        image.finish()?;
        if is_cmyk {
            rows = rgb_from_cmyk(&rows);
        }
        Ok((rows, WARNINGS.get()))
    };
    match catch_unwind(AssertUnwindSafe(decode)) {
        Ok(read) => read.map_err(|error| error.to_string()),
        Err(_) => Err(why_not(bytes)),
    }
}

/// What libjpeg says of a file that it does not decode.
fn why_not(bytes: &[u8]) -> String {
    let decode = || -> io::Result<Vec<u8>> {
        let image = Decompress::new_reader(bytes.chain(END))?;
        image.rgb()?.read_scanlines()
    };
    let unwound = catch_unwind(AssertUnwindSafe(decode)).err();
    let said = unwound.and_then(|said| said.downcast::<String>().ok());
    let said = said.map_or_else(|| "libjpeg cannot read it".to_owned(), |said| *said);
    format!("a JPEG image: {said}")
}

/// Colours as files with four components have them: inverted, as Adobe's programs write them.
fn rgb_from_cmyk(cmyk: &[u8]) -> Vec<u8> {
    let scaled = |ink: u8, black: u8| {
        let product = u32::from(ink) * u32::from(black);
        u8::try_from((product + 127) / 255).unwrap_or(u8::MAX)
    };
    let pixels = cmyk.chunks_exact(4);
    pixels
        .flat_map(|of| [of[0], of[1], of[2]].map(|ink| scaled(ink, of[3])))
        .collect()
}

thread_local! {
    /// Warnings of the file that this thread decodes.
    static WARNINGS: Cell<u32> = const { Cell::new(0) };
}

extern "C-unwind" fn stop(_: &mut jpeg_common_struct) {
    // Unlike a panic, this is not reported.
    resume_unwind(Box::new(()));
}

extern "C-unwind" fn count(_: &mut jpeg_common_struct, level: c_int) {
    if level < 0 {
        WARNINGS.set(WARNINGS.get().saturating_add(1));
    }
}

extern "C-unwind" fn ignore(_: &mut jpeg_common_struct) {}

extern "C-unwind" fn no_text(_: &mut jpeg_common_struct, _: &[u8; 80]) {}

/// Counts warnings, and unwinds from errors.
fn errors() -> jpeg_error_mgr {
    jpeg_error_mgr {
        error_exit: Some(stop),
        emit_message: Some(count),
        output_message: Some(ignore),
        format_message: Some(no_text),
        reset_error_mgr: Some(ignore),
        msg_code: 0,
        msg_parm: Default::default(),
        trace_level: 0,
        num_warnings: 0,
        jpeg_message_table: ptr::null(),
        last_jpeg_message: 0,
        addon_message_table: ptr::null(),
        first_addon_message: 0,
        last_addon_message: 0,
    }
}

/// A file with the standard Huffman tables, which files without tables mean.
static STANDARD: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let rgb = vec![90, 120, 150];
    let (width, height) = (1, 1);
    encoded(&Picture { width, height, rgb }).unwrap_or_default()
});

/// A picture as JPEG.
///
/// # Errors
/// When a picture has no pixels, or more than the format allows.
pub fn encoded(picture: &Picture) -> io::Result<Vec<u8>> {
    let Picture { width, height, rgb } = picture;
    let (across, down) = (*width as usize, *height as usize);
    let sides = 1..=usize::from(u16::MAX);
    if !sides.contains(&across) || !sides.contains(&down) || rgb.len() != 3 * across * down {
        let why = format!("{width}x{height} pixels cannot be a JPEG image");
        return Err(io::Error::other(why));
    }
    let encode = || -> io::Result<Vec<u8>> {
        let mut image = Compress::new(ColorSpace::JCS_RGB);
        image.set_fastest_defaults();
        image.set_size(across, down);
        image.set_quality(QUALITY);
        image.set_chroma_sampling_pixel_sizes((1, 1), (1, 1));
        let mut image = image.start_compress(Vec::new())?;
        image.write_scanlines(rgb)?;
        image.finish()
    };
    catch_unwind(AssertUnwindSafe(encode))
        .unwrap_or_else(|_| Err(io::Error::other("libjpeg cannot write it")))
}
