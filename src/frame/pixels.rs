//! Buffers of cameras → RGB pictures.
//!
//! Owns the pixel formats. YCbCr is taken as BT.601 of limited range, what cameras with these formats send unless they say
//! otherwise; colours of a camera that sends BT.709 are slightly off.

use super::{PIXELS_MAX, Picture};

/// How a camera lays out its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelFormat {
    /// Y0 U Y1 V for two pixels in a row.
    Yuyv,
    /// A plane of Y, then one of UV pairs at half the size in both directions.
    Nv12,
    /// A JPEG image a frame.
    Mjpg,
    /// Red, green, blue.
    Rgb3,
    /// Blue, green, red.
    Bgr3,
}

impl PixelFormat {
    /// Of a name of four characters.
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
    /// Bytes from one row to the next; 0 if the camera leaves it open.
    pub stride: u32,
}

impl Layout {
    /// The picture in a buffer.
    ///
    /// # Errors
    /// What is wrong with the buffer: too short, or no JPEG image of the granted size.
    pub fn picture(&self, bytes: &[u8]) -> Result<Picture, String> {
        let Self {
            format,
            width,
            height,
            stride,
        } = *self;
        if width == 0 || height == 0 || u64::from(width) * u64::from(height) > PIXELS_MAX {
            return Err(format!("{width}x{height} pixels"));
        }
        if format == PixelFormat::Mjpg {
            return self.decode(bytes);
        }
        let (width, height) = (width as usize, height as usize);
        let row_bytes = match format {
            PixelFormat::Yuyv => 4 * width.div_ceil(2),
            PixelFormat::Nv12 => 2 * width.div_ceil(2),
            _ => 3 * width,
        };
        let stride = (stride as usize).max(row_bytes);
        let rows = match format {
            PixelFormat::Nv12 => height + height.div_ceil(2),
            _ => height,
        };
        // The last row may end with its pixels.
        let wanted = stride * (rows - 1) + row_bytes;
        if bytes.len() < wanted {
            return Err(format!(
                "a buffer of {} bytes, wanted {wanted}",
                bytes.len()
            ));
        }
        let mut rgb = Vec::with_capacity(3 * width * height);
        for y in 0..height {
            let row = &bytes[y * stride..][..row_bytes];
            match format {
                PixelFormat::Yuyv => {
                    for x in 0..width {
                        let pair = &row[x / 2 * 4..][..4];
                        rgb.extend(rgb_from(pair[x % 2 * 2], pair[1], pair[3]));
                    }
                }
                PixelFormat::Nv12 => {
                    let colours = &bytes[(height + y / 2) * stride..][..row_bytes];
                    for (x, &luma) in row[..width].iter().enumerate() {
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
        Ok(Picture {
            width: self.width,
            height: self.height,
            rgb,
        })
    }

    fn decode(&self, bytes: &[u8]) -> Result<Picture, String> {
        let decoded = image::load_from_memory_with_format(bytes, image::ImageFormat::Jpeg)
            .map_err(|error| format!("a buffer of {} bytes: {error}", bytes.len()))?
            .into_rgb8();
        let (width, height) = decoded.dimensions();
        if (width, height) != (self.width, self.height) {
            return Err(format!(
                "a JPEG image of {width}x{height}, wanted {}x{}",
                self.width, self.height
            ));
        }
        Ok(Picture {
            width,
            height,
            rgb: decoded.into_raw(),
        })
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
            let picture = layout(format, 3, 2, 16).picture(&bytes).unwrap();
            assert_eq!(picture.rgb, rgb, "{format:?}");
            let short = layout(format, 3, 2, 16).picture(&bytes[..17]).unwrap_err();
            assert!(short.contains("17 bytes"), "{short}");
        }
    }

    #[test]
    fn blue_comes_first_in_bgr() {
        let picture = layout(PixelFormat::Bgr3, 1, 1, 0).picture(&[1, 2, 3]);
        assert_eq!(picture.unwrap().rgb, [3, 2, 1]);
    }

    #[test]
    fn a_jpeg_image_of_another_size_or_none_at_all_is_refused() {
        let mut jpeg = std::io::Cursor::new(vec![]);
        image::RgbImage::from_pixel(32, 16, image::Rgb([200, 100, 50]))
            .write_to(&mut jpeg, image::ImageFormat::Jpeg)
            .unwrap();
        let jpeg = jpeg.into_inner();
        let of = |width| layout(PixelFormat::Mjpg, width, 16, 0);
        let picture = of(32).picture(&jpeg).unwrap();
        assert!(picture.rgb[0].abs_diff(200) <= 3);
        assert!(of(64).picture(&jpeg).unwrap_err().contains("32x16"));
        assert!(of(32).picture(&jpeg[..20]).is_err());
        assert!(of(32).picture(&[]).is_err());
    }

    #[test]
    fn impossible_sizes_are_refused() {
        for (width, height) in [(0, 4), (4, 0), (u32::MAX, u32::MAX)] {
            for format in [PixelFormat::Yuyv, PixelFormat::Mjpg] {
                assert!(layout(format, width, height, 0).picture(&[0; 64]).is_err());
            }
        }
    }
}
