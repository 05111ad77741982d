//! Picture → encoder input: the one place where simulator images and road images are brought to the same form.
//!
//! The steps are: crop, resize by convolution with an antialiased triangle kernel in 32-bit floats (Pillow's `BILINEAR`
//! on float images), scale to 0..1, and normalise. A camera's own format is converted to RGB after resizing. There is
//! no 8-bit rounding between the picture and the encoder. The way in which a picture is resized changes every statistic
//! of it, so the kernel is part of a reference's fingerprint.

mod resampling;

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::capture::Picture;
use crate::capture::pixels::{Layout, PixelFormat, Pixels};
use crate::capture::undefined::Undefined;
use crate::model::vectors::Vectors;
use resampling::{Axis, Column, ROWS, turn_back};

/// Name of the resize kernel, as written in references.
pub const RESIZE_KERNEL: &str = "antialiased bilinear, 32-bit float";

/// Smallest side of a picture that is judged, pixels.
const SIDE_MIN: u32 = 16;
/// A picture whose brightest value is at most this is black, because of a lens cap or a dead sensor. It is not a night:
/// the darkest rendered night shows headlights and sensor noise above 60.
const BLACK_MAX: u8 = 8;

/// How the encoder expects a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preprocessing {
    /// Width of the encoder's input, pixels.
    pub width: u32,
    /// Height of the encoder's input, pixels.
    pub height: u32,
    /// Mean that is subtracted from red, green and blue after scaling to 0..1.
    pub mean: [f32; 3],
    /// Standard deviation by which red, green and blue are then divided.
    pub std: [f32; 3],
    /// Part of the picture that is used: left, top, width and height, as shares of the picture.
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

impl Preprocessing {
    /// Normalises a value of 0..255.
    #[inline(always)]
    fn normalised(&self, channel: usize, value: f32) -> f32 {
        (value / 255.0 - self.mean[channel]) / self.std[channel]
    }
}

/// The whole picture, as a crop.
pub const CROP_NOTHING: [f64; 4] = [0.0, 0.0, 1.0, 1.0];

/// Turns pictures into encoder input; keeps its buffers.
pub struct Preprocessor {
    of: Preprocessing,
    kernel: Vectors,
    /// The plan for pictures of this layout.
    plan: Option<(Layout, Plan)>,
    /// Some output rows before their columns are summed up.
    wide: Vec<Column>,
    short: [Vec<Column>; 3],
    input: Vec<f32>,
}

/// How pictures of one layout are resized.
struct Plan {
    bands: Vec<Band>,
    colours: Colours,
}

/// Channels whose bytes are in the same rows.
struct Band {
    /// Bytes before its first row.
    origin: usize,
    /// Bytes of a row that are needed.
    columns: Range<usize>,
    rows: Axis,
    channels: Vec<Channel>,
}

/// One channel: every `step`-th value of a row, from `first` on.
struct Channel {
    index: usize,
    first: usize,
    step: usize,
    columns: Axis,
}

/// What the three channels are.
#[derive(Clone, Copy, PartialEq)]
enum Colours {
    Rgb,
    /// BT.601, limited range.
    Yuv,
}

impl Preprocessor {
    /// A preprocessor for one encoder.
    pub fn new(of: &Preprocessing) -> Self {
        let width = of.width as usize;
        Self {
            of: of.clone(),
            kernel: Vectors::fastest(),
            plan: None,
            wide: Vec::new(),
            short: std::array::from_fn(|_| vec![[0.0; ROWS]; width]),
            input: vec![0.0; 3 * width * of.height as usize],
        }
    }

    /// Encoder input `[3, height, width]`, normalised RGB, from a picture of any size. Allocates only if the layout
    /// changes.
    ///
    /// # Errors
    /// `TooSmall`, `Black` or `Uniform` if nothing can be seen in the picture.
    pub fn input(&mut self, pixels: &Pixels) -> Result<&[f32], Undefined> {
        check(pixels)?;
        let layout = pixels.layout();
        let plan = match self.plan.take() {
            Some((planned, plan)) if planned == layout => plan,
            _ => Plan::new(layout, &self.of),
        };
        let kernel = self.kernel;
        kernel.vectorised(
            #[inline(always)]
            || {
                for y in (0..self.of.height as usize).step_by(ROWS) {
                    self.rows(&plan, pixels, y);
                }
            },
        );
        self.plan = Some((layout, plan));
        Ok(&self.input)
    }

    /// Makes [`ROWS`] rows of the input, from `y` on.
    #[inline(always)]
    fn rows(&mut self, plan: &Plan, pixels: &Pixels, y: usize) {
        let (width, height) = (self.of.width as usize, self.of.height as usize);
        let stride = pixels.layout().stride as usize;
        for band in &plan.bands {
            let bytes = &pixels.bytes()[band.origin + band.columns.start..];
            let outputs = y..height.min(y + ROWS);
            self.wide.resize(band.columns.len(), [0.0; ROWS]);
            band.rows.stack(outputs, bytes, stride, &mut self.wide);
            for channel in &band.channels {
                let columns = &self.wide[channel.first..];
                let short = &mut self.short[channel.index];
                channel.columns.shorten(columns, channel.step, short);
            }
        }
        let of = &self.of;
        match plan.colours {
            Colours::Rgb => {
                for (channel, short) in self.short.iter_mut().enumerate() {
                    for value in short.as_flattened_mut() {
                        *value = of.normalised(channel, *value);
                    }
                }
            }
            Colours::Yuv => normalised_rgb(&mut self.short, of),
        }
        let planes = self.input.chunks_exact_mut(width * height);
        for (plane, short) in planes.zip(&self.short) {
            turn_back(short, width, &mut plane[y * width..]);
        }
    }
}

/// YCbCr to normalised RGB, BT.601 of limited range (ITU-R BT.601-7, 2.5).
#[inline(always)]
fn normalised_rgb([y, u, v]: &mut [Vec<Column>; 3], of: &Preprocessing) {
    let (y, u) = (y.as_flattened_mut(), u.as_flattened_mut());
    for ((y, u), v) in y.iter_mut().zip(u).zip(v.as_flattened_mut()) {
        let luma = 255.0 / 219.0 * (*y - 16.0);
        let (blue, red) = (255.0 / 112.0 * (*u - 128.0), 255.0 / 112.0 * (*v - 128.0));
        let rgb = [
            luma + 0.701 * red,
            luma - (0.886 * 0.114 / 0.587) * blue - (0.701 * 0.299 / 0.587) * red,
            luma + 0.886 * blue,
        ];
        let [red, green, blue] = rgb.map(|value| value.clamp(0.0, 255.0));
        *y = of.normalised(0, red);
        *u = of.normalised(1, green);
        *v = of.normalised(2, blue);
    }
}

impl Plan {
    fn new(layout: Layout, of: &Preprocessing) -> Self {
        let [left, top, width, height] = of.crop;
        let (full_width, full_height) = (layout.width as usize, layout.height as usize);
        let columns = axis(left, width, full_width, of.width as usize);
        let rows = axis(top, height, full_height, of.height as usize);
        let (bands, colours) = match layout.format {
            PixelFormat::Yuyv => {
                let pairs = columns.of_pairs();
                // Whole pairs of pixels, so that colours stay at their pixels.
                let needed = pairs.inputs();
                let band = Band::new(0, 4, needed, rows)
                    .with(0, 0, 2, &columns)
                    .with(1, 1, 4, &pairs)
                    .with(2, 3, 4, &pairs);
                (vec![band], Colours::Yuv)
            }
            PixelFormat::Nv12 => {
                let (pairs, stride) = (columns.of_pairs(), layout.stride as usize);
                let of_rows = rows.of_pairs();
                let luma = Band::new(0, 1, columns.inputs(), rows).with(0, 0, 1, &columns);
                let colour = Band::new(full_height * stride, 2, pairs.inputs(), of_rows)
                    .with(1, 0, 2, &pairs)
                    .with(2, 1, 2, &pairs);
                (vec![luma, colour], Colours::Yuv)
            }
            PixelFormat::Rgb3 | PixelFormat::Bgr3 | PixelFormat::Mjpg => {
                let red = if layout.format == PixelFormat::Bgr3 {
                    2
                } else {
                    0
                };
                let band = Band::new(0, 3, columns.inputs(), rows)
                    .with(0, red, 3, &columns)
                    .with(1, 1, 3, &columns)
                    .with(2, 2 - red, 3, &columns);
                (vec![band], Colours::Rgb)
            }
        };
        Self { bands, colours }
    }
}

/// Centres of the encoder's pixels on a side of the picture.
#[allow(clippy::cast_precision_loss)]
fn axis(from: f64, length: f64, full: usize, outputs: usize) -> Axis {
    let side = full as f64;
    // Rounding must not move the crop over the picture's edge.
    let (from, length) = (from * side, (length * side).min(side - from * side));
    Axis::new(from, length, full, outputs)
}

impl Band {
    /// Rows of groups of `group` bytes, where only the groups `needed` are read.
    fn new(origin: usize, group: usize, needed: Range<usize>, rows: Axis) -> Self {
        Self {
            origin,
            columns: group * needed.start..group * needed.end,
            rows,
            channels: Vec::new(),
        }
    }

    /// Adds a channel that is in every `step`-th byte from `first` on.
    fn with(mut self, index: usize, first: usize, step: usize, of: &Axis) -> Self {
        let skipped = self.columns.start / step;
        self.channels.push(Channel {
            index,
            first,
            step,
            columns: of.clone().counted_from(skipped),
        });
        self
    }
}

impl Preprocessor {
    /// The last picture as the encoder saw it: cropped and resized, in 8 bits.
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

/// Refuses pictures that no road can produce.
fn check(pixels: &Pixels) -> Result<(), Undefined> {
    let Layout { width, height, .. } = pixels.layout();
    if width.min(height) < SIDE_MIN {
        return Err(Undefined::TooSmall { width, height });
    }
    if pixels.is_at_most(BLACK_MAX) {
        return Err(Undefined::Black);
    }
    if pixels.is_uniform() {
        return Err(Undefined::Uniform);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::cast_precision_loss)]
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

    fn picture(width: u32, height: u32, value: impl Fn(u32, u32) -> [u8; 3]) -> Pixels {
        let rgb = (0..height)
            .flat_map(|y| (0..width).map(move |x| (x, y)))
            .flat_map(|(x, y)| value(x, y))
            .collect();
        Pixels::from(Picture { width, height, rgb })
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
        // One white column: the kernel of width 4 gives it the weight 3/8 in its own output column and 1/8 in the next.
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
        let lower = Pixels::from(Picture {
            width: 64,
            height: 32,
            rgb: whole.bytes()[64 * 32 * 3..].to_vec(),
        });
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
        // The kernel of the first row reaches over the edge of the crop, into pixels of the picture.
        for row in (1..16).chain(17..32).chain(33..48) {
            let cells = row * 32..row * 32 + 32;
            assert!(
                crop[cells.clone()] == part[cells],
                "row {row} of the planes one after the other"
            );
        }
    }

    /// Pixels with moderate colours and odd sizes, in every format.
    fn in_every_format(width: usize, height: usize) -> Vec<Pixels> {
        let noise = |n: usize| (n * 7_919 + n / 13 * 104_729) % 50;
        let byte = |n: usize| u8::try_from(100 + noise(n)).unwrap();
        let formats = [
            (PixelFormat::Yuyv, 4 * width.div_ceil(2), height),
            (
                PixelFormat::Nv12,
                2 * width.div_ceil(2),
                height + height.div_ceil(2),
            ),
            (PixelFormat::Rgb3, 3 * width, height),
            (PixelFormat::Bgr3, 3 * width, height),
        ];
        let pixels = |(format, row_bytes, rows): (PixelFormat, usize, usize)| {
            let stride = row_bytes + 12;
            let layout = Layout {
                format,
                width: u32::try_from(width).unwrap(),
                height: u32::try_from(height).unwrap(),
                stride: u32::try_from(stride).unwrap(),
            };
            let bytes: Vec<u8> = (0..rows * stride).map(byte).collect();
            layout.pixels(&bytes).unwrap()
        };
        formats.into_iter().map(pixels).collect()
    }

    #[test]
    fn every_format_gives_what_its_picture_in_rgb_gives() {
        for (size, of) in [
            ((97, 53), of(32, 16)),
            ((64, 48), of(64, 48)),
            ((33, 17), of(40, 20)),
        ] {
            let of = Preprocessing {
                crop: [0.1, 0.25, 0.8, 0.7],
                ..of
            };
            for pixels in in_every_format(size.0, size.1) {
                let mut preprocessor = Preprocessor::new(&of);
                let own = preprocessor.input(&pixels).unwrap().to_vec();
                let of_rgb = preprocessor.input(&pixels.picture().into()).unwrap();
                let plane = own.len() / 3;
                for (at, (own, of_rgb)) in own.iter().zip(of_rgb).enumerate() {
                    // The picture in RGB was rounded.
                    let levels = (own - of_rgb).abs() * 255.0 * of.std[at / plane];
                    assert!(levels < 0.7, "{:?}: {levels} levels", pixels.layout());
                }
            }
        }
    }

    #[test]
    fn resizing_agrees_with_a_plain_sum_in_64_bits() {
        let of = Preprocessing {
            crop: [0.1, 0.2, 0.7, 0.6],
            ..of(40, 20)
        };
        let (width, height) = (131, 77);
        let pixels = &in_every_format(width, height)[2];
        let mut preprocessor = Preprocessor::new(&of);
        let input = preprocessor.input(pixels).unwrap();
        let triangle = |input: usize, output: usize, from: f64, scale: f64| {
            let centre = from + (output as f64 + 0.5) * scale;
            (1.0 - (input as f64 + 0.5 - centre).abs() / scale.max(1.0)).max(0.0)
        };
        let rows: Vec<&[u8]> = pixels.rows().collect();
        for (channel, x, y) in [(0, 0, 0), (1, 20, 10), (2, 39, 19), (0, 39, 0), (1, 7, 3)] {
            let (mut sum, mut weights) = (0.0, 0.0);
            for (v, row) in rows.iter().enumerate() {
                for u in 0..width {
                    let across = triangle(u, x, 0.1 * width as f64, 0.7 * width as f64 / 40.0);
                    let down = triangle(v, y, 0.2 * height as f64, 0.6 * height as f64 / 20.0);
                    sum += across * down * f64::from(row[3 * u + channel]);
                    weights += across * down;
                }
            }
            let (mean, std) = (f64::from(of.mean[channel]), f64::from(of.std[channel]));
            let wanted = (sum / weights / 255.0 - mean) / std;
            let found = f64::from(input[(channel * 20 + y) * 40 + x]);
            assert!(
                (found - wanted).abs() < 1e-6,
                "{channel} {x} {y}: {found} {wanted}"
            );
        }
    }

    #[test]
    fn every_set_of_instructions_comes_to_the_same_bits() {
        for pixels in in_every_format(97, 53) {
            let of_kernel = |kernel| {
                let mut preprocessor = Preprocessor::new(&of(32, 16));
                preprocessor.kernel = kernel;
                preprocessor.input(&pixels).unwrap().to_vec()
            };
            for kernel in Vectors::available() {
                assert!(
                    of_kernel(kernel) == of_kernel(Vectors::Portable),
                    "{kernel:?}"
                );
            }
        }
    }

    #[test]
    fn pictures_that_show_nothing_are_named() {
        let mut preprocessor = Preprocessor::new(&of(32, 16));
        let mut verdict = |picture: &Pixels| preprocessor.input(picture).map(<[f32]>::len);
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
            width: 32,
            height: 16,
            rgb: vec![3; 100],
        };
        assert_eq!(
            verdict(&cut.into()),
            Err(Undefined::TooSmall {
                width: 0,
                height: 0
            })
        );
    }
}
