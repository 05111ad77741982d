//! The sensor: exposure that follows the light, conversion of light into colour according to the look, noise, and 8
//! bits.

use std::sync::OnceLock;

use super::canvas::Canvas;
use super::conditions::{
    Condition, ConditionKind, GLARE_VEIL, NIGHT_DAYLIGHT, NOISE_SIGMA, SNOW_VERGE, Severities,
    TUNNEL_LIGHT, graded, severities_at,
};
use super::light::Colour;
use super::noise::{BLOCK, Draws, hash, whole};
use super::world::{Look, World};
use crate::model::vectors::Vectors;

/// Time in which the exposure follows the light by 63 %, seconds; automotive sensors need some tenths of a second to
/// one second.
const ADAPTATION_S: f64 = 0.6;
/// Number of steps in which the past light is used, each a quarter of that time.
const STEPS: u32 = 16;

/// How the camera of a look turns light into pixels. The camera of the plain look applies only the sRGB curve.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    /// Standard deviation of the softness of the lens, as a share of the picture's width.
    pub softness: f32,
    /// Share of light that is lost in the corners.
    vignette: f32,
    /// Standard deviation of noise, 8-bit steps.
    noise: f32,
    /// Strength of an S-shaped tone curve, 0 to 1.
    contrast: f32,
    saturation: f32,
    /// Gains of red, green and blue.
    cast: [f32; 3],
    /// Whether the exposure follows the light slowly; otherwise it follows at once.
    adapts: bool,
}

impl Sensor {
    /// The sensor of a drive.
    pub fn new(draws: Draws, world: &World) -> Self {
        let plain = Self {
            softness: 0.0,
            vignette: 0.0,
            noise: 0.0,
            contrast: 0.0,
            saturation: 1.0,
            cast: [1.0; 3],
            adapts: world.has(super::world::Element::Exposure),
        };
        match world.look {
            Look::Sim => plain,
            Look::Realistic => Self {
                softness: draws.range("softness", 0.0008, 0.0018),
                vignette: draws.range("vignette", 0.08, 0.35),
                noise: draws.range("noise", 1.0, 3.5),
                contrast: draws.range("contrast", 0.1, 0.5),
                saturation: draws.range("saturation", 0.7, 1.05),
                cast: [
                    draws.range("red", 0.94, 1.06),
                    1.0,
                    draws.range("blue", 0.92, 1.08),
                ],
                ..plain
            },
            Look::Game => Self {
                contrast: draws.range("contrast", 0.3, 0.6),
                saturation: draws.range("saturation", 1.25, 1.5),
                cast: [1.04, 1.0, 0.94],
                ..plain
            },
        }
    }

    /// Gain that the exposure has reached at `t_s` under `conditions`: a mean of the gains that the past light
    /// required, in stops, weighted by age.
    pub fn gain(&self, conditions: &[Condition], t_s: f64) -> f32 {
        follow(self.adapts && !conditions.is_empty(), |ago_s| {
            wanted_gain(&severities_at(conditions, t_s - ago_s))
        })
    }

    /// Turns linear light into 8-bit RGB `[H, W, 3]`.
    pub fn expose(
        &self,
        canvas: &Canvas,
        gain: f32,
        severities: &Severities,
        time_seed: u32,
        rgb: &mut [u8],
    ) {
        let dim = 1.0 - graded(NIGHT_DAYLIGHT, severities.of(ConditionKind::Night));
        let added = graded(NOISE_SIGMA, severities.of(ConditionKind::Noise)) + 7.0 * dim;
        let sigma = (added * added + self.noise * self.noise).sqrt();
        let (middle_x, middle_y) = (0.5 * canvas.width as f32, 0.5 * canvas.height as f32);
        let rows = canvas.light.chunks_exact(canvas.width);
        for (y, (light, rgb)) in rows.zip(rgb.chunks_exact_mut(3 * canvas.width)).enumerate() {
            let dy = (y as f32 - middle_y) / middle_x;
            let blocks = light.chunks(BLOCK).zip(rgb.chunks_mut(3 * BLOCK));
            for (first, (light, rgb)) in (0..).step_by(BLOCK).zip(blocks) {
                let corner = |n: usize| {
                    let dx = ((first + n) as f32 - middle_x) / middle_x;
                    dx * dx + dy * dy
                };
                Vectors::fastest().vectorised(
                    #[inline(always)]
                    || {
                        let seen = self.seen(light, gain, corner);
                        if sigma > 0.0 {
                            let first = (y * canvas.width + first) as i32;
                            digitise_noisily(&seen, sigma, (time_seed, first), rgb);
                        } else {
                            digitise(&seen, rgb);
                        }
                    },
                );
            }
        }
    }

    /// Up to [`BLOCK`] pixels as the look shows them; `corner` is how much a pixel is in a corner of the picture.
    #[inline(always)]
    fn seen(&self, light: &[Colour], gain: f32, corner: impl Fn(usize) -> f32) -> [Colour; BLOCK] {
        let mut seen = [[0.0; 3]; BLOCK];
        if self.contrast <= 0.0 && self.vignette <= 0.0 && self.is_neutral() {
            for (seen, light) in seen.iter_mut().zip(light) {
                *seen = light.map(|light| light * gain);
            }
        } else {
            for (n, (seen, light)) in seen.iter_mut().zip(light).enumerate() {
                *seen = self.graded(*light, gain * (1.0 - self.vignette * corner(n)));
            }
        }
        seen
    }

    fn is_neutral(&self) -> bool {
        self.saturation.total_cmp(&1.0).is_eq()
            && self.cast.iter().all(|c| c.total_cmp(&1.0).is_eq())
    }

    /// Cast, saturation and tone curve of one pixel.
    #[inline(always)]
    fn graded(&self, pixel: [f32; 3], gain: f32) -> [f32; 3] {
        let light = [0, 1, 2].map(|c| (pixel[c] * self.cast[c] * gain).clamp(0.0, 1.0));
        // Luminance after ITU-R BT.709.
        let grey = 0.2126 * light[0] + 0.7152 * light[1] + 0.0722 * light[2];
        light.map(|c| {
            let c = (grey + self.saturation * (c - grey)).clamp(0.0, 1.0);
            // The curve is applied to approximately what the eye sees: the square root of the light.
            let seen = c.sqrt();
            let curved = seen * seen * (3.0 - 2.0 * seen);
            let seen = seen + self.contrast * (curved - seen);
            seen * seen
        })
    }
}

/// Gain that an exposure has reached, from the gains that the light of the past requires; one that does not adapt slowly
/// follows at once.
pub fn follow(adapts: bool, wanted: impl Fn(f64) -> f32) -> f32 {
    if !adapts {
        return wanted(0.0);
    }
    let (mut sum, mut weights) = (0.0, 0.0);
    for step in 0..STEPS {
        let ago = 0.25 * f64::from(step);
        let weight = libm::exp(-ago) as f32;
        sum += weight * libm::logf(wanted(ago * ADAPTATION_S));
        weights += weight;
    }
    libm::expf(sum / weights)
}

/// Gain that the present light requires; the sensor follows the light only over about two stops.
fn wanted_gain(severities: &Severities) -> f32 {
    let of = |table, kind| graded(table, severities.of(kind));
    let light = of(NIGHT_DAYLIGHT, ConditionKind::Night)
        * (of(TUNNEL_LIGHT, ConditionKind::Tunnel)
            + 0.25 * of(SNOW_VERGE, ConditionKind::Snow)
            + 0.5 * of(GLARE_VEIL, ConditionKind::Glare));
    1.25 / (light + 0.25)
}

/// Turns light into 8 bits.
#[inline(always)]
fn digitise(seen: &[Colour; BLOCK], rgb: &mut [u8]) {
    let bytes = &srgb_curve().bytes;
    for (out, step) in rgb.iter_mut().zip(&curve_steps(seen)) {
        *out = bytes[*step as usize % CURVE_STEPS];
    }
}

/// Turns light into 8 bits with noise of a standard deviation of `sigma`; `first` is the number of the first pixel.
#[inline(always)]
fn digitise_noisily(
    seen: &[Colour; BLOCK],
    sigma: f32,
    (time_seed, first): (u32, i32),
    rgb: &mut [u8],
) {
    let values = &srgb_curve().values;
    let mut noises = [[0.0; 3]; BLOCK];
    for (n, noises) in noises.iter_mut().enumerate() {
        let pixel = first + n as i32;
        *noises = [0, 1, 2].map(|channel| normal(hash(time_seed, pixel, channel)));
    }
    let noiseless = curve_steps(seen).map(|step| values[step as usize % CURVE_STEPS]);
    let noises = noises.as_flattened();
    for (out, (value, noise)) in rgb.iter_mut().zip(noiseless.iter().zip(noises)) {
        *out = whole((value + sigma * noise + 0.5).clamp(0.0, 255.0)) as u8;
    }
}

const CURVE_STEPS: usize = 8_192;

/// Steps of the sRGB curve that light reaches.
#[inline(always)]
fn curve_steps(seen: &[Colour; BLOCK]) -> [u32; 3 * BLOCK] {
    let mut steps = [0; 3 * BLOCK];
    for (step, light) in steps.iter_mut().zip(seen.as_flattened()) {
        *step = whole(light.clamp(0.0, 1.0) * (CURVE_STEPS - 1) as f32);
    }
    steps
}

/// The sRGB transfer curve (IEC 61966-2-1).
struct Curve {
    /// 0..255.
    values: [f32; CURVE_STEPS],
    /// The same, rounded.
    bytes: [u8; CURVE_STEPS],
}

fn srgb_curve() -> &'static Curve {
    static CURVE: OnceLock<Box<Curve>> = OnceLock::new();
    CURVE.get_or_init(|| {
        let values = std::array::from_fn(|i| {
            let linear = i as f32 / (CURVE_STEPS - 1) as f32;
            255.0
                * if linear <= 0.003_130_8 {
                    12.92 * linear
                } else {
                    1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
                }
        });
        Box::new(Curve {
            values,
            bytes: values.map(|value| (value + 0.5) as u8),
        })
    })
}

/// The linear light that becomes this byte of sRGB, 0..1.
pub fn light_of(byte: u8) -> f32 {
    static LIGHTS: OnceLock<Vec<f32>> = OnceLock::new();
    let lights = LIGHTS.get_or_init(|| {
        let curve = &srgb_curve().values;
        (0..=255_u8)
            .map(|byte| {
                let first = curve.partition_point(|&value| value + 0.5 < f32::from(byte));
                let end = curve.partition_point(|&value| value + 0.5 < f32::from(byte) + 1.0);
                (0.5 * (first + end) as f32) / (CURVE_STEPS - 1) as f32
            })
            .collect()
    });
    lights[usize::from(byte)]
}

/// A nearly normal number from one hash: the sum of its four bytes, scaled to variance 1 (Irwin-Hall of order 4).
#[inline(always)]
fn normal(bits: u32) -> f32 {
    let sum: u32 = bits.to_le_bytes().iter().map(|&b| u32::from(b)).sum();
    (sum as f32 - 510.0) / 147.8
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_exposure_follows_the_light_with_delay_and_comes_back() {
        let sensor = Sensor::new(Draws(1), &World::default());
        let dusk = ["night:3@10-20".parse().unwrap()];
        let (before, at_once, later, after) = (
            sensor.gain(&dusk, 5.0),
            sensor.gain(&dusk, 10.0),
            sensor.gain(&dusk, 15.0),
            sensor.gain(&dusk, 30.0),
        );
        assert!((before - 1.0).abs() < 1e-3 && (after - 1.0).abs() < 1e-3);
        assert!(at_once > 1.2 && later > 1.15 * at_once, "{at_once} {later}");
    }
}
