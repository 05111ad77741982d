//! The sensor: exposure that follows the light, conversion of light into colour according to the look, noise, and 8
//! bits.

use std::sync::OnceLock;

use super::canvas::Canvas;
use super::conditions::{
    Condition, ConditionKind, GLARE_VEIL, NIGHT_DAYLIGHT, NOISE_SIGMA, SNOW_VERGE, Severities,
    TUNNEL_LIGHT, graded, severities_at,
};
use super::noise::{Draws, hash};
use super::world::{Look, World};

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
        if !self.adapts || conditions.is_empty() {
            return wanted_gain(&severities_at(conditions, t_s));
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for step in 0..STEPS {
            let ago = 0.25 * f64::from(step);
            let weight = libm::exp(-ago) as f32;
            let severities = severities_at(conditions, t_s - ago * ADAPTATION_S);
            sum += weight * libm::logf(wanted_gain(&severities));
            weights += weight;
        }
        libm::expf(sum / weights)
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
        let curve = srgb_curve();
        let (middle_x, middle_y) = (0.5 * canvas.width as f32, 0.5 * canvas.height as f32);
        let plain = self.contrast <= 0.0 && self.vignette <= 0.0 && self.is_neutral();
        for (i, (pixel, out)) in canvas.light.iter().zip(rgb.chunks_exact_mut(3)).enumerate() {
            let pixel = if plain {
                pixel.map(|light| light * gain)
            } else {
                let dx = ((i % canvas.width) as f32 - middle_x) / middle_x;
                let dy = ((i / canvas.width) as f32 - middle_y) / middle_x;
                self.graded(*pixel, gain * (1.0 - self.vignette * (dx * dx + dy * dy)))
            };
            for (channel, out) in out.iter_mut().enumerate() {
                let at = pixel[channel].clamp(0.0, 1.0) * (CURVE_STEPS - 1) as f32;
                let value = curve[at as usize];
                *out = if sigma > 0.0 {
                    (value + sigma * normal(hash(time_seed, i as i32, channel as i32)) + 0.5)
                        .clamp(0.0, 255.0) as u8
                } else {
                    (value + 0.5) as u8
                };
            }
        }
    }

    fn is_neutral(&self) -> bool {
        self.saturation.total_cmp(&1.0).is_eq()
            && self.cast.iter().all(|c| c.total_cmp(&1.0).is_eq())
    }

    /// Cast, saturation and tone curve of one pixel.
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

/// Gain that the present light requires; the sensor follows the light only over about two stops.
fn wanted_gain(severities: &Severities) -> f32 {
    let of = |table, kind| graded(table, severities.of(kind));
    let light = of(NIGHT_DAYLIGHT, ConditionKind::Night)
        * (of(TUNNEL_LIGHT, ConditionKind::Tunnel)
            + 0.25 * of(SNOW_VERGE, ConditionKind::Snow)
            + 0.5 * of(GLARE_VEIL, ConditionKind::Glare));
    1.25 / (light + 0.25)
}

const CURVE_STEPS: usize = 8_192;

/// The sRGB transfer curve (IEC 61966-2-1), 0..255.
fn srgb_curve() -> &'static [f32] {
    static CURVE: OnceLock<Vec<f32>> = OnceLock::new();
    CURVE.get_or_init(|| {
        (0..CURVE_STEPS)
            .map(|i| {
                let linear = i as f32 / (CURVE_STEPS - 1) as f32;
                255.0
                    * if linear <= 0.003_130_8 {
                        12.92 * linear
                    } else {
                        1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
                    }
            })
            .collect()
    })
}

/// A nearly normal number from one hash: the sum of its four bytes, scaled to variance 1 (Irwin-Hall of order 4).
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
