//! What the encoder saw → how dark, flat, clipped and blurred it is. These numbers are shown beside a verdict, and
//! never change it.

use crate::model::preprocess::Preprocessing;
use crate::model::vectors::Vectors;

/// Luma that is at most this far from black or white is clipped: two of 255 steps, which is the effect of rounding and
/// resizing on a clipped pixel.
const CLIPPED: f32 = 2.0 / 255.0;

/// How good a picture is, at the size and in the region that the encoder sees. Luma is as in BT.601, from 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageQuality {
    /// Mean luma.
    pub brightness: f64,
    /// Standard deviation of luma (RMS contrast, Peli 1990).
    pub contrast: f64,
    /// Share of pixels that are almost black or almost white.
    pub clipped: f64,
    /// Standard deviation of the Laplacian of luma (Pech-Pacheco et al. 2000); it is small in a blurred picture, and in
    /// a picture with few details.
    pub sharpness: f64,
}

/// Measures pictures of one size; keeps its buffer.
pub struct QualityMeter {
    width: usize,
    /// Factors of red, green and blue of the encoder's input for luma, and the constant that is added.
    shares: [f32; 3],
    offset: f32,
    luma: Vec<f32>,
    /// The Laplacian of one row.
    laplacian: Vec<f32>,
}

impl QualityMeter {
    /// A meter for encoder input with this normalisation.
    pub fn new(of: &Preprocessing) -> Self {
        const LUMA: [f32; 3] = [0.299, 0.587, 0.114];
        Self {
            width: of.width as usize,
            shares: std::array::from_fn(|channel| LUMA[channel] * of.std[channel]),
            offset: (0..3).map(|channel| LUMA[channel] * of.mean[channel]).sum(),
            luma: vec![0.0; of.width as usize * of.height as usize],
            laplacian: vec![0.0; of.width as usize],
        }
    }

    /// Measures the encoder's input, `[3, height, width]`, normalised RGB.
    pub fn measure(&mut self, input: &[f32]) -> ImageQuality {
        let mut measured = ImageQuality::default();
        Vectors::fastest().vectorised(
            #[inline(always)]
            || measured = self.measure_with_vectors(input),
        );
        measured
    }

    #[inline(always)]
    fn measure_with_vectors(&mut self, input: &[f32]) -> ImageQuality {
        let pixels = self.luma.len();
        let (red, rest) = input.split_at(pixels);
        let (green, blue) = rest.split_at(pixels);
        let [r, g, b] = self.shares;
        let (mut sum, mut squares, mut clipped, mut edges) = (0.0, 0.0, 0.0, 0.0);
        for (y, start) in (0..pixels).step_by(self.width).enumerate() {
            let of_row = start..start + self.width;
            let row = &mut self.luma[of_row.clone()];
            let colours = red[of_row.clone()].iter().zip(&green[of_row.clone()]);
            for (luma, ((red, green), blue)) in row.iter_mut().zip(colours.zip(&blue[of_row])) {
                *luma = self.offset + r * red + g * green + b * blue;
            }
            sum += sum_of(row, |luma| luma);
            squares += sum_of(row, |luma| luma * luma);
            let is_clipped = |luma: f32| (luma - 0.5).abs() >= 0.5 - CLIPPED;
            clipped += sum_of(row, |luma| f32::from(u8::from(is_clipped(luma))));
            if y >= 2 {
                let row = |back: usize| &self.luma[start - back * self.width..][..self.width];
                let (above, here, below) = (row(2), row(1), row(0));
                for x in 1..self.width - 1 {
                    let around = above[x] + below[x] + here[x - 1] + here[x + 1];
                    self.laplacian[x] = around - 4.0 * here[x];
                }
                edges += sum_of(&self.laplacian[1..self.width - 1], |value| value * value);
            }
        }
        // Far below 2^52.
        #[allow(clippy::cast_precision_loss)]
        let count = pixels as f64;
        let brightness = sum / count;
        ImageQuality {
            brightness,
            contrast: (squares / count - brightness * brightness).max(0.0).sqrt(),
            clipped: clipped / count,
            sharpness: (edges / count).sqrt(),
        }
    }
}

/// A sum over many values, in parts that are small enough for 32-bit floats.
#[inline(always)]
fn sum_of(values: &[f32], of: impl Fn(f32) -> f32) -> f64 {
    const LANES: usize = 8;
    const PART: usize = 512;
    let mut sum = 0.0;
    for part in values.chunks(PART) {
        let mut lanes = [0.0_f32; LANES];
        let whole = part.chunks_exact(LANES);
        let rest = whole.remainder();
        for values in whole {
            for (lane, &value) in lanes.iter_mut().zip(values) {
                *lane += of(value);
            }
        }
        let rest = rest.iter().map(|&value| of(value));
        sum += f64::from(lanes.into_iter().chain(rest).sum::<f32>());
    }
    sum
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::capture::{Picture, open};
    use crate::model::preprocess::{CROP_NOTHING, Preprocessor};

    fn of(width: u32, height: u32) -> Preprocessing {
        Preprocessing {
            width,
            height,
            mean: [0.4, 0.5, 0.3],
            std: [0.2, 0.3, 0.25],
            crop: CROP_NOTHING,
        }
    }

    fn quality(width: u32, height: u32, grey: impl Fn(u32, u32) -> u8) -> ImageQuality {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let rgb = pixels.flat_map(|(x, y)| [grey(x, y); 3]).collect();
        let of = of(width, height);
        let picture = Picture { width, height, rgb };
        let mut preprocessor = Preprocessor::new(&of);
        let input = preprocessor.input(&picture.into()).unwrap();
        QualityMeter::new(&of).measure(input)
    }

    #[test]
    fn numbers_of_a_checkerboard_by_hand() {
        // Half the pixels 51 (0.2), half 204 (0.8): contrast 0.3, every Laplacian 4 x 0.6; pixels of the edge have no
        // Laplacian.
        let found = quality(32, 16, |x, y| if (x + y) % 2 == 0 { 51 } else { 204 });
        let inside = 30.0 * 14.0 / (32.0 * 16.0);
        let wanted = ImageQuality {
            brightness: 0.5,
            contrast: 0.3,
            clipped: 0.0,
            sharpness: 2.4 * f64::sqrt(inside),
        };
        for (found, wanted) in [
            (found.brightness, wanted.brightness),
            (found.contrast, wanted.contrast),
            (found.clipped, wanted.clipped),
            (found.sharpness, wanted.sharpness),
        ] {
            assert!((found - wanted).abs() < 1e-5, "{found} {wanted}");
        }
        let half = quality(
            32,
            16,
            |x, y| if x < 16 { [0, 255][y as usize % 2] } else { 90 },
        );
        assert!((half.clipped - 0.5).abs() < 1e-9);
    }

    #[test]
    #[cfg(feature = "lab")]
    fn night_is_dark_fog_is_flat_blur_is_soft_and_a_low_sun_clips() {
        crate::lab::register();
        let of = of(320, 160);
        let mean = |condition: &str| {
            let drive = format!("scene:sim?seed=5&seconds=2&fps=5{condition}");
            let mut source = open(&drive).unwrap();
            let mut preprocessor = Preprocessor::new(&of);
            let mut meter = QualityMeter::new(&of);
            let mut sums = ImageQuality::default();
            while let Some(frame) = source.next_frame().unwrap() {
                let input = preprocessor.input(&frame.picture.unwrap()).unwrap();
                let one = meter.measure(input);
                sums.brightness += one.brightness / 10.0;
                sums.contrast += one.contrast / 10.0;
                sums.clipped += one.clipped / 10.0;
                sums.sharpness += one.sharpness / 10.0;
            }
            sums
        };
        let day = mean("");
        assert!(mean("&condition=night:4").brightness < 0.5 * day.brightness);
        assert!(mean("&condition=fog:4").contrast < 0.7 * day.contrast);
        assert!(mean("&condition=blur:4").sharpness < 0.5 * day.sharpness);
        assert!(mean("&condition=glare:4").clipped > day.clipped + 0.05);
    }
}
