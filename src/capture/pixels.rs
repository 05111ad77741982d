//! Pixels as a source gives them: RGB, or the formats of cameras.
//!
//! It defines the pixel formats. YCbCr is read as BT.601 with limited range, which cameras with these formats send
//! unless they say otherwise. The colours of a camera that sends BT.709 are slightly wrong.

use std::sync::Arc;

use super::compressed::decoded_jpeg;
use super::{PIXELS_MAX, Picture};

/// How a camera lays out its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Y0 U Y1 V for two pixels in a row.
    Yuyv,
    /// A plane of Y, then a plane of UV pairs with half the size in both directions.
    Nv12,
    /// A JPEG image for each frame.
    Mjpg,
    /// Red, green, blue.
    Rgb3,
    /// Blue, green, red.
    Bgr3,
}

impl PixelFormat {
    /// The format with this name of four characters.
    pub fn from_fourcc(fourcc: [u8; 4]) -> Option<Self> {
        match &fourcc {
            b"YUYV" => Some(Self::Yuyv),
            b"NV12" => Some(Self::Nv12),
            b"MJPG" | b"JPEG" => Some(Self::Mjpg),
            b"RGB3" => Some(Self::Rgb3),
            b"BGR3" => Some(Self::Bgr3),
            _ => None,
        }
    }

    /// Bytes of pixels in a row; for NV12, in a row of each of its planes.
    fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Yuyv => 4 * width.div_ceil(2),
            Self::Nv12 => 2 * width.div_ceil(2),
            Self::Rgb3 | Self::Bgr3 | Self::Mjpg => 3 * width,
        }
    }
}

/// What a camera has granted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Order of the bytes.
    pub format: PixelFormat,
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Bytes from one row to the next; 0 if the camera does not give it.
    pub stride: u32,
}

/// A picture as its source gave it, never compressed. It is complete and cheap to copy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pixels {
    layout: Layout,
    bytes: Arc<Vec<u8>>,
}

impl Layout {
    /// The pixels in a camera's buffer. The buffer is copied or, if it holds a JPEG image, decoded.
    ///
    /// # Errors
    /// What is wrong with the buffer: it is too short, or it is not a complete JPEG image of the granted size.
    pub fn pixels(&self, bytes: &[u8]) -> Result<Pixels, String> {
        let Self {
            format,
            width,
            height,
            ..
        } = *self;
        if width == 0 || height == 0 || u64::from(width) * u64::from(height) > PIXELS_MAX {
            return Err(format!("{width}x{height} pixels"));
        }
        if format == PixelFormat::Mjpg {
            return decoded_jpeg(bytes, (width, height)).map(Pixels::from);
        }
        let (width, height) = (width as usize, height as usize);
        let row_bytes = format.row_bytes(width);
        let stride = (self.stride as usize).max(row_bytes);
        let rows = match format {
            PixelFormat::Nv12 => height + height.div_ceil(2),
            _ => height,
        };
        // The last row may have no padding.
        let wanted = stride * (rows - 1) + row_bytes;
        let whole = bytes
            .get(..wanted)
            .ok_or_else(|| format!("a buffer of {} bytes, wanted {wanted}", bytes.len()))?;
        let stride = u32::try_from(stride).map_err(|_| format!("rows of {stride} bytes"))?;
        Ok(Pixels {
            layout: Self { stride, ..*self },
            bytes: Arc::new(whole.to_vec()),
        })
    }
}

/// A picture with missing pixels becomes an empty picture.
impl From<Picture> for Pixels {
    fn from(picture: Picture) -> Self {
        let whole = picture.rgb.len() == 3 * picture.width as usize * picture.height as usize;
        let (width, height, bytes) = match whole {
            true => (picture.width, picture.height, picture.rgb),
            false => (0, 0, vec![]),
        };
        let layout = Layout {
            format: PixelFormat::Rgb3,
            width,
            height,
            stride: width.saturating_mul(3),
        };
        Self {
            layout,
            bytes: Arc::new(bytes),
        }
    }
}

/// Luma of black and of white, BT.601 of limited range.
const LUMA: (u8, u8) = (16, 235);

/// Where the brightness is in a row: one byte in every `step` bytes, beginning with the first. In an RGB row, all bytes
/// count.
#[derive(Clone, Copy, Debug)]
pub struct Brightness {
    /// Bytes from one value to the next.
    pub step: usize,
    /// Number of these bytes for each pixel.
    pub a_pixel: usize,
    /// The bytes of black and of white.
    pub range: (u8, u8),
}

impl Brightness {
    /// A byte, or a mean of some bytes, on the scale from 0 (black) to 255 (white).
    pub fn of_255(&self, byte: u64) -> u8 {
        let (black, white) = (u64::from(self.range.0), u64::from(self.range.1));
        let level = byte.saturating_sub(black) * 255 / (white - black);
        u8::try_from(level).unwrap_or(u8::MAX)
    }
}

impl Pixels {
    /// The layout of the bytes; its stride is never 0.
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// All bytes, [`Layout::stride`] bytes for each row.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Where the brightness is in [`rows`](Self::rows).
    pub fn brightness(&self) -> Brightness {
        let (step, a_pixel, range) = match self.layout.format {
            PixelFormat::Yuyv => (2, 2, LUMA),
            PixelFormat::Nv12 => (1, 1, LUMA),
            PixelFormat::Rgb3 | PixelFormat::Bgr3 | PixelFormat::Mjpg => (1, 3, (0, 255)),
        };
        Brightness {
            step,
            a_pixel,
            range,
        }
    }

    /// Rows of pixels without padding; for NV12, the rows of luma.
    pub fn rows(&self) -> impl Iterator<Item = &[u8]> {
        let Brightness { a_pixel, .. } = self.brightness();
        let row_bytes = a_pixel * self.layout.width as usize;
        let rows = self.bytes.chunks((self.layout.stride as usize).max(1));
        rows.take(self.layout.height as usize)
            .map(move |row| &row[..row_bytes.min(row.len())])
    }

    /// Whether nothing is brighter than `level`, from 0 to 255.
    pub fn is_at_most(&self, level: u8) -> bool {
        let brightness = self.brightness();
        let is_dark = |&byte: &u8| brightness.of_255(byte.into()) <= level;
        let mut rows = self.rows();
        rows.all(|row| row.iter().step_by(brightness.step).all(is_dark))
    }

    /// Whether all pixels are of one colour.
    pub fn is_uniform(&self) -> bool {
        let group = match self.layout.format {
            PixelFormat::Yuyv => 4,
            PixelFormat::Nv12 => 1,
            PixelFormat::Rgb3 | PixelFormat::Bgr3 | PixelFormat::Mjpg => 3,
        };
        let same = |row: &[u8]| row.chunks_exact(group).all(|g| g == &self.bytes[..group]);
        let (width, height) = (self.layout.width as usize, self.layout.height as usize);
        match self.layout.format {
            PixelFormat::Yuyv if width > 1 && self.bytes[0] != self.bytes[2] => false,
            PixelFormat::Nv12 if self.rows().all(same) => {
                let stride = self.layout.stride as usize;
                let colours = self.bytes[height * stride..].chunks(stride);
                let pair = &self.bytes[height * stride..][..2];
                let mut pairs = colours.flat_map(|row| row.chunks_exact(2).take(width.div_ceil(2)));
                pairs.all(|uv| uv == pair)
            }
            _ => self.rows().all(same),
        }
    }

    /// The picture in RGB, for people.
    pub fn picture(&self) -> Picture {
        let (width, height) = (self.layout.width as usize, self.layout.height as usize);
        let stride = self.layout.stride as usize;
        let mut rgb = Vec::with_capacity(3 * width * height);
        for (y, row) in self.rows().enumerate() {
            match self.layout.format {
                PixelFormat::Yuyv => {
                    // A row of odd width ends in half a pair, whose colours are present.
                    let whole = &self.bytes[y * stride..][..4 * width.div_ceil(2)];
                    for x in 0..width {
                        let pair = &whole[x / 2 * 4..][..4];
                        rgb.extend(rgb_from(pair[x % 2 * 2], pair[1], pair[3]));
                    }
                }
                PixelFormat::Nv12 => {
                    let colours = &self.bytes[(height + y / 2) * stride..];
                    for (x, &luma) in row.iter().enumerate() {
                        let pair = &colours[x / 2 * 2..][..2];
                        rgb.extend(rgb_from(luma, pair[0], pair[1]));
                    }
                }
                PixelFormat::Bgr3 => {
                    rgb.extend(row.chunks_exact(3).flat_map(|bgr| [bgr[2], bgr[1], bgr[0]]));
                }
                PixelFormat::Rgb3 | PixelFormat::Mjpg => rgb.extend_from_slice(row),
            }
        }
        Picture {
            width: self.layout.width,
            height: self.layout.height,
            rgb,
        }
    }
}

/// BT.601, limited range, in 8-bit fixed point.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn rgb_from(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (
        298 * (i32::from(y) - 16),
        i32::from(u) - 128,
        i32::from(v) - 128,
    );
    [y + 409 * v, y - 100 * u - 208 * v, y + 516 * u]
        .map(|value| ((value + 128) >> 8).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::capture::jpeg;

    fn layout(format: PixelFormat, width: u32, height: u32, stride: u32) -> Layout {
        Layout {
            format,
            width,
            height,
            stride,
        }
    }

    #[test]
    fn colours_of_bt_601() {
        for (yuv, rgb) in [
            ((16, 128, 128), [0, 0, 0]),
            ((235, 128, 128), [255, 255, 255]),
            ((126, 128, 128), [128, 128, 128]),
            ((81, 90, 240), [255, 0, 0]),
            ((145, 54, 34), [0, 255, 0]),
            ((41, 240, 110), [0, 0, 255]),
        ] {
            let (y, u, v) = yuv;
            for (found, wanted) in rgb_from(y, u, v).into_iter().zip(rgb) {
                assert!(found.abs_diff(wanted) <= 1, "{yuv:?}: {found} {wanted}");
            }
        }
    }

    #[test]
    fn rows_are_found_behind_their_padding_in_every_format() {
        // Two rows of three pixels: white, black, white and black, white, black.
        let luma = [[235, 16, 235], [16, 235, 16]];
        let rgb: Vec<u8> = luma
            .iter()
            .flatten()
            .flat_map(|&y| [if y == 16 { 0 } else { 255 }; 3])
            .collect();
        let padded = |rows: Vec<Vec<u8>>, stride: usize| -> Vec<u8> {
            rows.into_iter()
                .flat_map(|mut row| {
                    row.resize(stride, 77);
                    row
                })
                .collect()
        };
        let [a, b] = luma;
        let yuyv = |row: [u8; 3]| vec![row[0], 128, row[1], 128, row[2], 128, 99, 128];
        let packed = |row: [u8; 3]| {
            row.iter()
                .flat_map(|&y| [if y == 16 { 0 } else { 255 }; 3])
                .collect::<Vec<u8>>()
        };
        for (format, rows) in [
            (PixelFormat::Yuyv, vec![yuyv(a), yuyv(b)]),
            (
                PixelFormat::Nv12,
                vec![a.to_vec(), b.to_vec(), vec![128; 4]],
            ),
            (PixelFormat::Rgb3, vec![packed(a), packed(b)]),
            (PixelFormat::Bgr3, vec![packed(a), packed(b)]),
        ] {
            let bytes = padded(rows, 16);
            let picture = layout(format, 3, 2, 16).pixels(&bytes).unwrap();
            assert_eq!(picture.picture().rgb, rgb, "{format:?}");
            let short = layout(format, 3, 2, 16).pixels(&bytes[..17]).unwrap_err();
            assert!(short.contains("17 bytes"), "{short}");
        }
    }

    #[test]
    fn blue_comes_first_in_bgr() {
        let picture = layout(PixelFormat::Bgr3, 1, 1, 0).pixels(&[1, 2, 3]);
        assert_eq!(picture.unwrap().picture().rgb, [3, 2, 1]);
    }

    #[test]
    fn a_jpeg_image_of_another_size_or_none_at_all_is_refused() {
        let jpeg = jpeg(&Picture {
            width: 32,
            height: 16,
            rgb: [200, 100, 50].repeat(32 * 16),
        });
        let jpeg = jpeg.unwrap();
        let of = |width| layout(PixelFormat::Mjpg, width, 16, 0);
        let picture = of(32).pixels(&jpeg).unwrap().picture();
        assert!(picture.rgb[0].abs_diff(200) <= 3);
        assert!(of(64).pixels(&jpeg).unwrap_err().contains("32x16"));
        assert!(of(32).pixels(&jpeg[..20]).is_err());
        let cut = of(32).pixels(&jpeg[..jpeg.len() - 8]).unwrap_err();
        assert!(cut.contains("cut off"), "{cut}");
        // Some cameras fill their buffers up with zeros.
        let filled = [jpeg.as_slice(), &[0; 64]].concat();
        assert!(of(32).pixels(&filled).is_ok());
        assert!(of(32).pixels(&[]).is_err());
    }

    #[test]
    fn impossible_sizes_are_refused() {
        for (width, height) in [(0, 4), (4, 0), (u32::MAX, u32::MAX)] {
            for format in [PixelFormat::Yuyv, PixelFormat::Mjpg] {
                assert!(layout(format, width, height, 0).pixels(&[0; 64]).is_err());
            }
        }
    }
}
