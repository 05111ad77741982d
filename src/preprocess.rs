//! Picture → encoder input: the one place where simulator images and road images are made alike.
//!
//! Crop, resize by convolution with an antialiased triangle kernel in 32-bit floats (what Pillow calls `BILINEAR` on
//! float images), scale to 0..1, normalise. No 8-bit rounding lies between the picture and the encoder. How a picture is
//! resized moves every statistic taken from it, so the kernel is part of a reference's fingerprint.

use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::F32x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};
use serde::{Deserialize, Serialize};

use crate::frame::Picture;
use crate::undefined::Undefined;

/// Name of the resize kernel, as written in references.
pub const RESIZE_KERNEL: &str = "antialiased bilinear, 32-bit float";

/// Smallest side of a picture that is judged, pixels.
const SIDE_MIN: u32 = 16;
/// A picture whose brightest value is at most this is black: a capped lens or a dead sensor, not a night (the darkest
/// rendered night shows headlights and sensor noise above 60).
const BLACK_MAX: u8 = 8;

/// What the encoder expects of a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preprocessing {
    /// Width of the encoder's input, pixels.
    pub width: u32,
    /// Height of the encoder's input, pixels.
    pub height: u32,
    /// Subtracted from red, green, blue after scaling to 0..1.
    pub mean: [f32; 3],
    /// Divides red, green, blue after that.
    pub std: [f32; 3],
    /// Part of the picture used: left, top, width, height as shares of the picture.
    pub crop: [f64; 4],
}

impl std::fmt::Display for Preprocessing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            width,
            height,
            mean,
            std,
            crop,
        } = self;
        write!(
            f,
            "{width}x{height}, mean {mean:?}, std {std:?}, crop {crop:?}"
        )
    }
}

/// The whole picture, as a crop.
pub const CROP_NOTHING: [f64; 4] = [0.0, 0.0, 1.0, 1.0];

/// Turns pictures into encoder input; keeps its buffers.
pub struct Preprocessor {
    of: Preprocessing,
    resizer: Resizer,
    wide: Vec<F32x3>,
    small: TypedImage<'static, F32x3>,
    input: Vec<f32>,
}

impl Preprocessor {
    /// For one encoder's expectations.
    pub fn new(of: &Preprocessing) -> Self {
        Self {
            of: of.clone(),
            resizer: Resizer::new(),
            wide: Vec::new(),
            small: TypedImage::new(of.width, of.height),
            input: vec![0.0; 3 * of.width as usize * of.height as usize],
        }
    }

    /// Encoder input `[3, height, width]` of a picture of any size, normalised RGB.
    ///
    /// # Errors
    /// `TooSmall`, `Black` or `Uniform` when the picture holds nothing to look at.
    pub fn input(&mut self, picture: &Picture) -> Result<&[f32], Undefined> {
        check(picture)?;
        self.wide.clear();
        self.wide.extend(
            picture
                .rgb
                .chunks_exact(3)
                .map(|rgb| F32x3::new([rgb[0], rgb[1], rgb[2]].map(f32::from))),
        );
        let [left, top, width, height] = self.of.crop;
        // Rounding must not push the crop over the picture's edge.
        let within = |from: f64, length: f64, full: f64| {
            (from * full, (length * full).min(full - from * full))
        };
        let (full_width, full_height) = (f64::from(picture.width), f64::from(picture.height));
        let (left_px, width_px) = within(left, width, full_width);
        let (top_px, height_px) = within(top, height, full_height);
        let options = ResizeOptions::new()
            .resize_alg(ResizeAlg::Convolution(FilterType::Bilinear))
            .crop(left_px, top_px, width_px, height_px)
            .use_alpha(false);
        // Only this pixel type is named, so only its kernels are compiled.
        TypedImageRef::new(picture.width, picture.height, &self.wide)
            .ok()
            .and_then(|wide| {
                self.resizer
                    .resize_typed(&wide, &mut self.small, &options)
                    .ok()
            })
            .ok_or(Undefined::TooSmall {
                width: picture.width,
                height: picture.height,
            })?;
        let plane = self.of.width as usize * self.of.height as usize;
        for (index, pixel) in self.small.pixels().iter().enumerate() {
            for (channel, value) in pixel.0.into_iter().enumerate() {
                self.input[channel * plane + index] =
                    (value / 255.0 - self.of.mean[channel]) / self.of.std[channel];
            }
        }
        Ok(&self.input)
    }
}

impl Preprocessor {
    /// What the encoder saw of the last picture: cropped and resized, in 8 bits.
    pub fn seen(&self) -> Picture {
        let plane = self.of.width as usize * self.of.height as usize;
        let mut rgb = Vec::with_capacity(3 * plane);
        for pixel in 0..plane {
            for channel in 0..3 {
                let value = self.input[channel * plane + pixel] * self.of.std[channel]
                    + self.of.mean[channel];
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                rgb.push((255.0 * value).round().clamp(0.0, 255.0) as u8);
            }
        }
        Picture {
            width: self.of.width,
            height: self.of.height,
            rgb,
        }
    }
}

/// Refuses pictures that no road makes.
fn check(picture: &Picture) -> Result<(), Undefined> {
    let (width, height) = (picture.width, picture.height);
    let whole = picture.rgb.len() == 3 * width as usize * height as usize;
    if !whole || width.min(height) < SIDE_MIN {
        return Err(Undefined::TooSmall { width, height });
    }
    if picture.rgb.iter().all(|&value| value <= BLACK_MAX) {
        return Err(Undefined::Black);
    }
    let first = &picture.rgb[..3];
    if picture.rgb.chunks_exact(3).all(|pixel| pixel == first) {
        return Err(Undefined::Uniform);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn of(width: u32, height: u32) -> Preprocessing {
        Preprocessing {
            width,
            height,
            mean: [0.5, 0.0, 0.0],
            std: [0.5, 1.0, 2.0],
            crop: CROP_NOTHING,
        }
    }

    fn picture(width: u32, height: u32, value: impl Fn(u32, u32) -> [u8; 3]) -> Picture {
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| value(x, y))
            .collect();
        Picture { width, height, rgb }
    }

    #[test]
    fn a_picture_of_the_encoders_size_is_only_normalised() {
        let picture = picture(32, 16, |x, y| {
            [
                u8::try_from(x * 8).unwrap(),
                u8::try_from(y * 16).unwrap(),
                51,
            ]
        });
        let mut preprocessor = Preprocessor::new(&of(32, 16));
        let input = preprocessor.input(&picture).unwrap();
        let plane = 32 * 16;
        for (x, y) in [(0_u8, 0_u8), (5, 3), (31, 15)] {
            let at = usize::from(y) * 32 + usize::from(x);
            assert!((input[at] - (f32::from(x) * 8.0 / 255.0 - 0.5) / 0.5).abs() < 1e-6);
            assert!((input[plane + at] - f32::from(y) * 16.0 / 255.0).abs() < 1e-6);
            assert!((input[2 * plane + at] - 0.1).abs() < 1e-6);
        }
    }

    #[test]
    fn halving_averages_neighbours_with_the_triangle_kernel() {
        // One white column: the kernel of width 4 weighs it 3/8 in its own output column and 1/8 in the next.
        let picture = picture(64, 32, |x, _| if x == 21 { [255; 3] } else { [0; 3] });
        let mut preprocessor = Preprocessor::new(&of(32, 16));
        let input = preprocessor.input(&picture).unwrap();
        let green = |x: usize| input[32 * 16 + 8 * 32 + x];
        for (x, share) in [(9, 0.0), (10, 0.375), (11, 0.125), (12, 0.0)] {
            assert!((green(x) - share).abs() < 1e-6, "column {x}: {}", green(x));
        }
    }

    #[test]
    fn a_crop_is_the_picture_of_its_part() {
        let whole = picture(64, 64, |x, y| {
            [
                u8::try_from(x * 3).unwrap(),
                u8::try_from(y * 3).unwrap(),
                0,
            ]
        });
        let lower = Picture {
            width: 64,
            height: 32,
            rgb: whole.rgb[64 * 32 * 3..].to_vec(),
        };
        let cropped = Preprocessing {
            crop: [0.0, 0.5, 1.0, 0.5],
            ..of(32, 16)
        };
        let (mut of_crop, mut of_part) =
            (Preprocessor::new(&cropped), Preprocessor::new(&of(32, 16)));
        let (crop, part) = (
            of_crop.input(&whole).unwrap(),
            of_part.input(&lower).unwrap(),
        );
        // The kernel of the first row reaches over the edge of the crop, into pixels that are there.
        for row in (1..16).chain(17..32).chain(33..48) {
            let cells = row * 32..row * 32 + 32;
            assert!(
                crop[cells.clone()] == part[cells],
                "row {row} of the planes one after the other"
            );
        }
    }

    #[test]
    fn pictures_that_show_nothing_are_named() {
        let mut preprocessor = Preprocessor::new(&of(32, 16));
        let mut verdict = |picture: &Picture| preprocessor.input(picture).map(<[f32]>::len);
        assert_eq!(
            verdict(&picture(32, 16, |_, _| [0; 3])),
            Err(Undefined::Black)
        );
        assert_eq!(
            verdict(&picture(32, 16, |_, _| [255; 3])),
            Err(Undefined::Uniform)
        );
        assert_eq!(
            verdict(&picture(32, 16, |_, _| [90, 120, 30])),
            Err(Undefined::Uniform)
        );
        assert_eq!(
            verdict(&picture(1, 1, |_, _| [90; 3])),
            Err(Undefined::TooSmall {
                width: 1,
                height: 1
            })
        );
        let cut = Picture {
            rgb: vec![3; 100],
            ..picture(32, 16, |_, _| [9; 3])
        };
        assert_eq!(
            verdict(&cut),
            Err(Undefined::TooSmall {
                width: 32,
                height: 16
            })
        );
    }
}
