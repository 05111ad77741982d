//! Pixels by the names that ROS and Foxglove give to their encodings.

use super::bayer::{self, Colours};
use crate::capture::pixels::{Layout, PixelFormat, Pixels};
use crate::capture::{PIXELS_MAX, Picture};

/// The supported encodings, for error messages.
const WANTED: &str = "rgb8, bgr8, rgba8, bgra8 or mono8, the same with 16, 8UC1..4, 16UC1..4, bayer_rggb8 and its \
                      kin, yuv422, yuv422_yuy2, yuv420, nv12 or nv21";

/// Why a message holds no picture.
#[derive(Debug, thiserror::Error)]
pub enum NoPicture {
    /// Something is wrong with this message.
    #[error("{0}")]
    Damaged(String),
    /// It holds what is not read here, so those after it will hold the same.
    #[error("{0}")]
    Foreign(String),
}

impl From<String> for NoPicture {
    fn from(why: String) -> Self {
        Self::Damaged(why)
    }
}

/// Red, green and blue of a pixel's bytes.
type Colour = fn(&[u8]) -> [u8; 3];

/// Pixels as a message holds them.
#[derive(Clone, Copy)]
pub struct Raw<'a> {
    pub encoding: &'a str,
    pub width: u32,
    pub height: u32,
    /// Bytes from one row to the next; 0 if the message does not give it.
    pub step: u32,
    /// Order of the bytes of samples of 16 bits.
    pub is_bigendian: bool,
    pub data: &'a [u8],
}

impl Raw<'_> {
    /// The picture.
    ///
    /// # Errors
    /// `Foreign` for an encoding that is not supported; `Damaged` for too few bytes, or an impossible size.
    pub fn pixels(&self) -> Result<Pixels, NoPicture> {
        let Self { width, height, .. } = *self;
        if width == 0 || height == 0 || u64::from(width) * u64::from(height) > PIXELS_MAX {
            return Err(format!("{width}x{height} pixels").into());
        }
        let name = self.encoding.to_ascii_lowercase();
        match of_16_bits(&name) {
            Some(name) => self.narrowed()?.by_name(name),
            None => self.by_name(&name),
        }
    }

    fn by_name(&self, name: &str) -> Result<Pixels, NoPicture> {
        let layout = |format| Layout {
            format,
            width: self.width,
            height: self.height,
            stride: self.step,
        };
        let (channels, rgb): (usize, Colour) = match name {
            "rgb8" => return Ok(layout(PixelFormat::Rgb3).pixels(self.data)?),
            "bgr8" | "8uc3" => return Ok(layout(PixelFormat::Bgr3).pixels(self.data)?),
            "yuv422_yuy2" | "yuyv" => return Ok(layout(PixelFormat::Yuyv).pixels(self.data)?),
            "yuv422" | "uyvy" => {
                let pairs = self
                    .data
                    .chunks_exact(2)
                    .flat_map(|pair| [pair[1], pair[0]]);
                let pairs: Vec<u8> = pairs.collect();
                return Ok(layout(PixelFormat::Yuyv).pixels(&pairs)?);
            }
            "nv12" => return self.planes(Chroma::Pairs),
            "nv21" => return self.planes(Chroma::SwappedPairs),
            "yuv420" | "yuv420p" | "i420" | "iyuv" => return self.planes(Chroma::Planes),
            "yv12" => return self.planes(Chroma::SwappedPlanes),
            "mono8" | "8uc1" => (1, |pixel| [pixel[0]; 3]),
            "rgba8" => (4, |pixel| [pixel[0], pixel[1], pixel[2]]),
            "bgra8" | "8uc4" => (4, |pixel| [pixel[2], pixel[1], pixel[0]]),
            "bayer_rggb8" => return self.mosaic(bayer::RGGB),
            "bayer_bggr8" => return self.mosaic(bayer::BGGR),
            "bayer_gbrg8" => return self.mosaic(bayer::GBRG),
            "bayer_grbg8" => return self.mosaic(bayer::GRBG),
            _ => {
                return Err(NoPicture::Foreign(format!(
                    "encoding {:?}, wanted {WANTED}",
                    self.encoding
                )));
            }
        };
        let rows = self.rows(channels * self.width as usize)?;
        let pixels = rows.iter().flat_map(|row| row.chunks_exact(channels));
        Ok(Pixels::from(Picture {
            width: self.width,
            height: self.height,
            rgb: pixels.flat_map(rgb).collect(),
        }))
    }

    /// Rows without their padding; the last row may have none.
    fn rows(&self, row_bytes: usize) -> Result<Vec<&[u8]>, String> {
        let step = (self.step as usize).max(row_bytes);
        let wanted = step * (self.height as usize - 1) + row_bytes;
        if self.data.len() < wanted {
            return Err(format!(
                "{} bytes of pixels, wanted {wanted}",
                self.data.len()
            ));
        }
        let rows = self.data.chunks(step).take(self.height as usize);
        Ok(rows.map(|row| &row[..row_bytes]).collect())
    }

    fn mosaic(&self, colours: Colours) -> Result<Pixels, NoPicture> {
        let rows = self.rows(self.width as usize)?;
        Ok(Pixels::from(Picture {
            width: self.width,
            height: self.height,
            rgb: bayer::rgb(&rows, colours),
        }))
    }

    /// The upper bytes of samples of 16 bits.
    fn narrowed(&self) -> Result<Narrowed, String> {
        if self.step % 2 == 1 {
            return Err(format!(
                "rows of {} bytes for samples of 16 bits",
                self.step
            ));
        }
        let upper = usize::from(!self.is_bigendian);
        Ok(Narrowed {
            width: self.width,
            height: self.height,
            step: self.step / 2,
            data: self.data.iter().skip(upper).step_by(2).copied().collect(),
        })
    }

    /// A plane of luma, and colours of half its size in both directions behind it.
    fn planes(&self, chroma: Chroma) -> Result<Pixels, NoPicture> {
        let (width, height) = (self.width as usize, self.height as usize);
        let (across, down) = (width.div_ceil(2), height.div_ceil(2));
        // Rows of luma are as far apart as the message says; some drivers state something else although rows have no
        // padding.
        let fits = |luma: usize| {
            let (chroma_stride, planes) = match chroma {
                Chroma::Pairs | Chroma::SwappedPairs => (luma.max(2 * across), 1),
                Chroma::Planes | Chroma::SwappedPlanes => (luma.div_ceil(2), 2),
            };
            let wanted = luma * height + chroma_stride * down * planes;
            (wanted, chroma_stride)
        };
        let strides = [(self.step as usize).max(width), width];
        let Some(stride) = strides.into_iter().find(|&s| fits(s).0 <= self.data.len()) else {
            let (found, wanted) = (self.data.len(), fits(width).0);
            return Err(format!("{found} bytes of pixels, wanted {wanted}").into());
        };
        let chroma_stride = fits(stride).1;
        let (luma, colours) = self.data.split_at(stride * height);
        let mut nv12 = Vec::with_capacity(2 * across * (height + down));
        for row in luma.chunks_exact(stride) {
            nv12.extend_from_slice(&row[..width]);
            nv12.extend((width..2 * across).map(|_| 0));
        }
        for y in 0..down {
            let row = &colours[y * chroma_stride..];
            let other = || &colours[(down + y) * chroma_stride..];
            let pair = |x: usize| match chroma {
                Chroma::Pairs => [row[2 * x], row[2 * x + 1]],
                Chroma::SwappedPairs => [row[2 * x + 1], row[2 * x]],
                Chroma::Planes => [row[x], other()[x]],
                Chroma::SwappedPlanes => [other()[x], row[x]],
            };
            nv12.extend((0..across).flat_map(pair));
        }
        let layout = Layout {
            format: PixelFormat::Nv12,
            width: self.width,
            height: self.height,
            stride: 0,
        };
        Ok(layout.pixels(&nv12)?)
    }
}

/// Where the colours of a picture in planes are: U first unless they are swapped.
#[derive(Clone, Copy)]
enum Chroma {
    Pairs,
    SwappedPairs,
    Planes,
    SwappedPlanes,
}

/// Samples of 16 bits, of which 8 are left.
struct Narrowed {
    width: u32,
    height: u32,
    step: u32,
    data: Vec<u8>,
}

impl Narrowed {
    fn by_name(&self, name: &str) -> Result<Pixels, NoPicture> {
        let raw = Raw {
            encoding: name,
            width: self.width,
            height: self.height,
            step: self.step,
            is_bigendian: false,
            data: &self.data,
        };
        raw.by_name(name)
    }
}

/// The encoding of 8 bits with the same layout as one of 16 bits.
fn of_16_bits(name: &str) -> Option<&'static str> {
    Some(match name {
        "mono16" | "16uc1" => "mono8",
        "rgb16" => "rgb8",
        "bgr16" | "16uc3" => "bgr8",
        "rgba16" => "rgba8",
        "bgra16" | "16uc4" => "bgra8",
        "bayer_rggb16" => "bayer_rggb8",
        "bayer_bggr16" => "bayer_bggr8",
        "bayer_gbrg16" => "bayer_gbrg8",
        "bayer_grbg16" => "bayer_grbg8",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn picture(
        encoding: &str,
        width: u32,
        height: u32,
        step: u32,
        data: &[u8],
    ) -> Result<Pixels, String> {
        let raw = Raw {
            encoding,
            width,
            height,
            step,
            is_bigendian: false,
            data,
        };
        raw.pixels().map_err(|why| why.to_string())
    }

    #[test]
    fn pixels_by_the_names_of_their_encodings() {
        // Two rows of two pixels, with rows of 10 bytes: red and blue, then grey and black.
        let rows = |first: &[u8], second: &[u8]| {
            let padded = |row: &[u8]| [row, &[77; 10][row.len()..]].concat();
            [padded(first), padded(second)].concat()
        };
        let colours = [200, 10, 20, 30, 40, 220, 90, 90, 90, 0, 0, 0];
        for (encoding, data) in [
            ("rgb8", rows(&colours[..6], &colours[6..])),
            ("bgr8", rows(&[20, 10, 200, 220, 40, 30], &colours[6..])),
            (
                "RGBA8",
                rows(
                    &[200, 10, 20, 1, 30, 40, 220, 2],
                    &[90, 90, 90, 3, 0, 0, 0, 4],
                ),
            ),
            (
                "bgra8",
                rows(
                    &[20, 10, 200, 1, 220, 40, 30, 2],
                    &[90, 90, 90, 3, 0, 0, 0, 4],
                ),
            ),
        ] {
            let seen = picture(encoding, 2, 2, 10, &data).unwrap().picture();
            assert_eq!(seen.rgb, colours, "{encoding}");
            let short = picture(encoding, 2, 2, 10, &data[..12]).unwrap_err();
            assert!(short.contains("12 bytes"), "{short}");
        }
        let grey = picture("mono8", 2, 2, 10, &rows(&[1, 2], &[3, 4]))
            .unwrap()
            .picture();
        assert_eq!(grey.rgb, [1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4]);
        // White and black: luma first in YUYV, colour first in UYVY.
        let wanted = [255, 255, 255, 0, 0, 0];
        for (encoding, data) in [
            ("yuv422_yuy2", [235, 128, 16, 128]),
            ("yuyv", [235, 128, 16, 128]),
            ("yuv422", [128, 235, 128, 16]),
            ("uyvy", [128, 235, 128, 16]),
        ] {
            assert_eq!(
                picture(encoding, 2, 1, 4, &data).unwrap().picture().rgb,
                wanted,
                "{encoding}"
            );
        }
    }

    #[test]
    fn impossible_pictures_are_refused_before_they_cost_memory() {
        for encoding in [
            "rgb8",
            "mono8",
            "yuyv",
            "mono16",
            "bayer_rggb8",
            "nv21",
            "i420",
        ] {
            assert!(picture(encoding, 0, 5, 0, &[0; 64]).is_err());
            assert!(picture(encoding, u32::MAX, u32::MAX, 0, &[0; 64]).is_err());
            // Planes with an impossible step are taken without padding, and need 43 bytes here.
            let bytes = if matches!(encoding, "nv21" | "i420") {
                42
            } else {
                64
            };
            assert!(picture(encoding, 5, 5, u32::MAX, &[0; 64][..bytes]).is_err());
        }
        let unknown = picture("32FC1", 2, 2, 0, &[0; 64]).unwrap_err();
        assert!(
            unknown.contains("32FC1") && unknown.contains("rgb8"),
            "{unknown}"
        );
    }

    #[test]
    fn samples_of_16_bits_are_read_in_the_order_of_their_bytes() {
        let raw = |encoding, is_bigendian| Raw {
            encoding,
            width: 2,
            height: 1,
            step: 0,
            is_bigendian,
            data: &[1, 200, 2, 100, 3, 50, 4, 60, 5, 70, 6, 80],
        };
        let rgb = |raw: Raw<'_>| raw.pixels().unwrap().picture().rgb;
        assert_eq!(rgb(raw("rgb16", false)), [200, 100, 50, 60, 70, 80]);
        assert_eq!(rgb(raw("bgr16", true)), [3, 2, 1, 6, 5, 4]);
        assert_eq!(rgb(raw("16UC1", false)), [200, 200, 200, 100, 100, 100]);
        let odd = Raw {
            step: 13,
            ..raw("rgb16", false)
        };
        assert!(odd.pixels().unwrap_err().to_string().contains("13 bytes"));
    }

    #[test]
    fn colours_in_planes_lie_where_they_belong() {
        // Red and blue in three columns and rows, with rows of 4 bytes or without padding.
        let luma = [81, 81, 41];
        let (u, v) = ([90, 240], [240, 110]);
        let tight = |chroma: &[u8]| [&luma.repeat(3), chroma].concat();
        let [a, b] = [[u[0], v[0], u[1], v[1]], [v[0], u[0], v[1], u[1]]];
        let planes = [u, u, v, v].concat();
        let swapped = [v, v, u, u].concat();
        let wanted = picture("nv12", 3, 3, 3, &tight(&a.repeat(2)))
            .unwrap()
            .picture();
        let near = |found: &[u8], wanted: [u8; 3]| {
            found
                .iter()
                .zip(wanted)
                .all(|(found, wanted)| found.abs_diff(wanted) <= 1)
        };
        assert!(near(&wanted.rgb[..3], [255, 0, 0]) && near(&wanted.rgb[6..9], [0, 0, 255]));
        for (encoding, step, data) in [
            ("nv21", 3, tight(&b.repeat(2))),
            ("yuv420", 3, tight(&planes)),
            ("I420", 0, tight(&planes)),
            ("yv12", 3, tight(&swapped)),
            // A step that the rows do not have.
            ("i420", 5, tight(&planes)),
            (
                "nv21",
                4,
                [&[81, 81, 41, 7].repeat(3), b.repeat(2).as_slice()].concat(),
            ),
            (
                "i420",
                4,
                [&[81, 81, 41, 7].repeat(3), planes.as_slice()].concat(),
            ),
        ] {
            let found = picture(encoding, 3, 3, step, &data).unwrap().picture();
            assert_eq!(found, wanted, "{encoding}, rows of {step}");
            let short = picture(encoding, 3, 3, step, &data[..16]).unwrap_err();
            assert!(short.contains("16 bytes"), "{short}");
        }
    }
}
