//! Image files: a folder in name order, or one image.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::{
    DynamicImage, ExtendedColorType, ImageDecoder, ImageEncoder, ImageFormat, ImageReader,
};

use super::names::name_order;
use super::pixels::Pixels;
use super::{
    FOLDER_FPS, Frame, FrameSource, PIXELS_MAX, Picture, PictureError, SourceError, time_of,
};

/// Quality of pictures that are written, of 100.
const JPEG_QUALITY: u8 = 85;

/// Whether the name ends like an image that can be read.
pub fn is_image(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default();
    ["png", "jpg", "jpeg"]
        .iter()
        .any(|known| extension.eq_ignore_ascii_case(known))
}

pub struct ImageSource {
    paths: Vec<PathBuf>,
    fps: f64,
    next: usize,
}

impl ImageSource {
    pub fn single(path: &Path) -> Self {
        Self {
            paths: vec![path.to_owned()],
            fps: FOLDER_FPS,
            next: 0,
        }
    }

    pub fn folder(folder: &Path, fps: f64) -> Result<Self, SourceError> {
        let unreadable = |error| SourceError::Unreadable {
            path: folder.to_owned(),
            error,
        };
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder).map_err(unreadable)? {
            let path = entry.map_err(unreadable)?.path();
            if is_image(&path) && path.is_file() {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            return Err(SourceError::Empty(folder.to_owned()));
        }
        paths.sort_by_cached_key(|path| {
            name_order(&path.file_name().unwrap_or_default().to_string_lossy())
        });
        Ok(Self {
            paths,
            fps,
            next: 0,
        })
    }
}

impl FrameSource for ImageSource {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let Some(path) = self.paths.get(self.next) else {
            return Ok(None);
        };
        let sequence = self.next as u64;
        self.next += 1;
        let picture = read(path).map(Pixels::from).map_err(|found| PictureError {
            path: path.clone(),
            found,
            wanted: "a whole PNG or JPEG image",
        });
        Ok(Some(Frame {
            sequence,
            captured_at: time_of(sequence, self.fps),
            picture,
        }))
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.paths.len() as u64)
    }
}

fn read(path: &Path) -> Result<Picture, String> {
    decoded(&fs::read(path).map_err(|error| error.to_string())?)
}

/// The picture in the bytes of a PNG or JPEG image, or what is wrong with them.
pub fn decoded(bytes: &[u8]) -> Result<Picture, String> {
    let format = image::guess_format(bytes)
        .map_err(|_| format!("{} bytes that are no image", bytes.len()))?;
    if !is_whole(format, bytes) {
        return Err(format!("an image cut off after {} bytes", bytes.len()));
    }
    let decoder = ImageReader::with_format(Cursor::new(bytes), format)
        .into_decoder()
        .map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    if u64::from(width) * u64::from(height) > PIXELS_MAX {
        return Err(format!("{width}x{height} pixels, more than {PIXELS_MAX}"));
    }
    let picture = DynamicImage::from_decoder(decoder)
        .map_err(|error| error.to_string())?
        .into_rgb8();
    Ok(Picture {
        width,
        height,
        rgb: picture.into_raw(),
    })
}

/// A picture as JPEG.
///
/// # Errors
/// When a picture has no pixels, or more than the format takes.
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

/// The last eight bytes of a PNG: the name of its end chunk and the checksum of that.
const PNG_END: &[u8] = b"IEND\xAE\x42\x60\x82";

/// Whether the format's end marker is there, in a JPEG after its last scan. The JPEG decoder fills what is missing with
/// grey without a word.
fn is_whole(format: ImageFormat, bytes: &[u8]) -> bool {
    let has =
        |bytes: &[u8], marker: &[u8]| bytes.windows(marker.len()).any(|window| window == marker);
    match format {
        ImageFormat::Png => has(bytes, PNG_END),
        ImageFormat::Jpeg => {
            let last_scan = bytes.windows(2).rposition(|marker| marker == [0xFF, 0xDA]);
            last_scan.is_some_and(|scan| has(&bytes[scan..], &[0xFF, 0xD9]))
        }
        // Anything else is left to its decoder, which this build does not have.
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = [
            "b_10.png",
            "b_9.png",
            "b_09.png",
            "a_100.png",
            "b_9_2.png",
            "b_9_10.png",
            "b_0.png",
            "b.png",
        ];
        names.sort_by_cached_key(|name| name_order(name));
        assert_eq!(
            names,
            [
                "a_100.png",
                "b.png",
                "b_0.png",
                "b_09.png",
                "b_9.png",
                "b_9_2.png",
                "b_9_10.png",
                "b_10.png"
            ]
        );
    }
}
