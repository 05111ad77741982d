//! Air, lens and sensor: what conditions do to the light of a scene before it becomes a frame.

use std::sync::OnceLock;

use super::Drive;
use super::canvas::Canvas;
use super::conditions::{
    BLUR_SIGMA, ConditionKind, DIRT_COVER, FOG_EXTINCTION, GLARE_VEIL, NIGHT_DAYLIGHT, NOISE_SIGMA,
    RAIN_DROPS, RAIN_EXTINCTION, RAIN_STREAKS, Severities, graded,
};
use super::light::{Colour, blended, scaled};
use super::noise::{hash, uniform, value_noise};
use super::projection::Projection;

/// Applies the conditions between scene and sensor, in the order light meets them; returns the exposure's gain.
pub fn apply(
    canvas: &mut Canvas,
    drive: &Drive,
    projection: &Projection,
    severities: &Severities,
    time_seed: u32,
) -> f32 {
    let daylight = graded(NIGHT_DAYLIGHT, severities.of(ConditionKind::Night));
    if daylight < 1.0 {
        night(canvas, projection, daylight);
    }
    let rain = severities.of(ConditionKind::Rain);
    let extinction =
        graded(FOG_EXTINCTION, severities.of(ConditionKind::Fog)) + graded(RAIN_EXTINCTION, rain);
    if extinction > 0.0 {
        haze(
            canvas,
            projection,
            extinction,
            scaled([0.74, 0.76, 0.79], daylight.max(0.03)),
        );
    }
    if rain > 0.0 {
        streaks(
            canvas,
            graded(RAIN_STREAKS, rain),
            daylight.max(0.08),
            time_seed,
        );
        drops(canvas, graded(RAIN_DROPS, rain), drive.seed);
    }
    let veil = graded(GLARE_VEIL, severities.of(ConditionKind::Glare));
    if veil > 0.0 {
        glare(canvas, projection, veil, drive.seed);
    }
    let cover = graded(DIRT_COVER, severities.of(ConditionKind::Dirt));
    if cover > 0.0 {
        dirt(canvas, cover, daylight, drive.seed);
    }
    let sigma_px = graded(BLUR_SIGMA, severities.of(ConditionKind::Blur)) * canvas.width as f32;
    if sigma_px > 0.0 {
        blur(canvas, sigma_px);
    }
    // The sensor follows the light, but only over about two stops.
    (1.0 / (daylight + 0.25)).max(0.8) / 0.8
}

/// Turns linear light into 8-bit RGB `[H, W, 3]`: exposure, sRGB curve, sensor noise.
pub fn expose(canvas: &Canvas, gain: f32, severities: &Severities, time_seed: u32, rgb: &mut [u8]) {
    let dim = 1.0 - graded(NIGHT_DAYLIGHT, severities.of(ConditionKind::Night));
    let sigma = graded(NOISE_SIGMA, severities.of(ConditionKind::Noise)) + 7.0 * dim;
    let curve = srgb_curve();
    for (i, (pixel, out)) in canvas.light.iter().zip(rgb.chunks_exact_mut(3)).enumerate() {
        for (channel, out) in out.iter_mut().enumerate() {
            let at = (pixel[channel] * gain).clamp(0.0, 1.0) * (CURVE_STEPS - 1) as f32;
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

/// Nearly normal from one hash: the sum of its four bytes, scaled to variance 1 (Irwin-Hall of order 4).
fn normal(bits: u32) -> f32 {
    let sum: u32 = bits.to_le_bytes().iter().map(|&b| u32::from(b)).sum();
    (sum as f32 - 510.0) / 147.8
}

fn night(canvas: &mut Canvas, projection: &Projection, daylight: f32) {
    let dark = 1.0 - daylight;
    let tint: Colour = [1.0 - 0.25 * dark, 1.0 - 0.12 * dark, 1.0];
    for (i, light) in canvas.light.iter_mut().enumerate() {
        let z_m = canvas.depth_m[i];
        let beam = if z_m < 60.0 {
            let x_m = ((i % canvas.width) as f32 - projection.centre_x) * z_m / projection.focal_px;
            let aside = (x_m / (2.2 + 0.16 * z_m)).abs().min(1.0);
            let far = 1.0 - z_m / 60.0;
            0.55 * dark * far * far * (1.0 - aside * aside)
        } else {
            0.0
        };
        *light = [0, 1, 2].map(|c| light[c] * (daylight * tint[c] + beam * [1.0, 0.95, 0.82][c]));
    }
    for lamp in std::mem::take(&mut canvas.lamps) {
        let reach = (4.0 * lamp.radius_px).max(1.5);
        for y in span(lamp.at.1, reach, canvas.height) {
            for x in span(lamp.at.0, reach, canvas.width) {
                let (dx, dy) = (x as f32 + 0.5 - lamp.at.0, y as f32 + 0.5 - lamp.at.1);
                let near = (1.0 - (dx * dx + dy * dy) / (reach * reach)).max(0.0);
                let light = &mut canvas.light[y * canvas.width + x];
                *light = [0, 1, 2].map(|c| light[c] + lamp.colour[c] * near * near * dark);
            }
        }
    }
}

fn span(middle: f32, reach: f32, limit: usize) -> std::ops::Range<usize> {
    let inside = |v: f32| v.clamp(0.0, limit as f32) as usize;
    inside(middle - reach)..inside(middle + reach + 1.0)
}

/// Scatters towards `air` with distance (Koschmieder); the sky is seen through a layer 70 m high.
fn haze(canvas: &mut Canvas, projection: &Projection, extinction: f32, air: Colour) {
    for y in 0..canvas.height {
        let elevation = ((projection.horizon_y - y as f32) / projection.focal_px).max(0.03);
        let sky_depth_m = 70.0 / elevation;
        let (mut last_depth, mut kept) = (f32::NAN, 1.0);
        for x in 0..canvas.width {
            let pixel = y * canvas.width + x;
            let depth = canvas.depth_m[pixel].min(sky_depth_m.max(300.0));
            if depth.total_cmp(&last_depth).is_ne() {
                (last_depth, kept) = (depth, libm::expf(-extinction * depth));
            }
            canvas.light[pixel] = blended(air, canvas.light[pixel], kept);
        }
    }
}

fn streaks(canvas: &mut Canvas, count_320: f32, brightness: f32, time_seed: u32) {
    let scale = canvas.width as f32 / 320.0;
    let slant = 0.25 * (uniform(time_seed, 0, 1) - 0.5);
    for i in 0..count_320 as usize {
        let (x, y) = (
            uniform(time_seed, i, 2) * canvas.width as f32,
            uniform(time_seed, i, 3) * canvas.height as f32,
        );
        let length = (5.0 + 13.0 * uniform(time_seed, i, 4)) * scale;
        let opacity = 0.10 + 0.22 * uniform(time_seed, i, 5);
        for step in 0..length as usize {
            let (column, row) = ((x + slant * step as f32) as usize, y as usize + step);
            for column in column..column + scale.round().max(1.0) as usize {
                if column < canvas.width && row < canvas.height {
                    let light = &mut canvas.light[row * canvas.width + column];
                    *light = blended(*light, scaled([0.85, 0.87, 0.9], brightness), opacity);
                }
            }
        }
    }
}

/// Drops on the lens: each shows the scene small and upside down.
fn drops(canvas: &mut Canvas, count: f32, seed: u32) {
    let behind = canvas.light.clone();
    let (width, height) = (canvas.width as f32, canvas.height as f32);
    for i in 0..count.round() as usize {
        let (cx, cy) = (uniform(seed, i, 11) * width, uniform(seed, i, 12) * height);
        let radius = (0.008 + 0.024 * uniform(seed, i, 13)) * width;
        for y in span(cy, radius, canvas.height) {
            for x in span(cx, radius, canvas.width) {
                let (dx, dy) = (x as f32 - cx, y as f32 - cy);
                let inside = 1.0 - (dx * dx + dy * dy) / (radius * radius);
                if inside > 0.0 {
                    let from_x = (cx - 4.0 * dx).clamp(0.0, width - 1.0) as usize;
                    let from_y = (cy - 4.0 * dy).clamp(0.0, height - 1.0) as usize;
                    let light = &mut canvas.light[y * canvas.width + x];
                    *light = blended(
                        *light,
                        scaled(behind[from_y * canvas.width + from_x], 1.1),
                        (3.0 * inside).min(0.9),
                    );
                }
            }
        }
    }
}

/// A low sun ahead: bloom around it and a veil over everything.
fn glare(canvas: &mut Canvas, projection: &Projection, veil: f32, seed: u32) {
    let (width, height) = (canvas.width as f32, canvas.height as f32);
    let sun_x = projection.centre_x + (uniform(seed, 0, 21) - 0.5) * 0.5 * width;
    let sun_y = projection.horizon_y - (0.10 + 0.15 * uniform(seed, 0, 22)) * height;
    for y in 0..canvas.height {
        for x in 0..canvas.width {
            let (dx, dy) = ((x as f32 - sun_x) / width, (y as f32 - sun_y) / width);
            let r2 = dx * dx + dy * dy;
            let glow =
                veil * (0.45 + 1.3 * 0.02 / (0.02 + r2)) + veil * 6.0 * 0.0006 / (0.0006 + r2);
            let light = &mut canvas.light[y * canvas.width + x];
            *light = [0, 1, 2].map(|c| light[c] + glow * [1.0, 0.93, 0.78][c]);
        }
    }
}

/// Smears that cover the wanted share of the lens, brown and nearly opaque.
fn dirt(canvas: &mut Canvas, cover: f32, daylight: f32, seed: u32) {
    let field = |x: usize, y: usize| {
        let (u, v) = (
            x as f64 / canvas.width as f64,
            y as f64 / canvas.width as f64,
        );
        0.6 * value_noise(seed ^ 31, u * 9.0, v * 9.0)
            + 0.4 * value_noise(seed ^ 32, u * 27.0, v * 27.0)
    };
    let mut sample: Vec<f32> = (0..canvas.height)
        .step_by((canvas.height / 20).max(1))
        .flat_map(|y| {
            (0..canvas.width)
                .step_by((canvas.width / 40).max(1))
                .map(move |x| (x, y))
        })
        .map(|(x, y)| field(x, y))
        .collect();
    sample.sort_by(f32::total_cmp);
    let edge = sample[((1.0 - cover) * (sample.len() - 1) as f32) as usize];
    let opacity: Vec<f32> = (0..canvas.width * canvas.height)
        .map(|i| {
            ((field(i % canvas.width, i / canvas.width) - edge) / 0.04 + 0.5).clamp(0.0, 1.0) * 0.88
        })
        .collect();
    let soil = scaled([0.11, 0.085, 0.06], daylight);
    for (light, opacity) in canvas.light.iter_mut().zip(opacity) {
        *light = blended(*light, soil, opacity);
    }
}

/// Gaussian blur of the light, one axis after the other; pixels beyond the edge repeat it.
fn blur(canvas: &mut Canvas, sigma_px: f32) {
    let reach = (3.0 * sigma_px).ceil() as isize;
    let mut kernel: Vec<f32> = (-reach..=reach)
        .map(|i| libm::expf(-0.5 * (i as f32 / sigma_px) * (i as f32 / sigma_px)))
        .collect();
    let total: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= total);
    let (width, height) = (canvas.width, canvas.height);
    for (count, length, stride, step) in [(height, width, width, 1), (width, height, 1, width)] {
        let mut line = vec![[0.0; 3]; length];
        for i in 0..count {
            let start = i * stride;
            for (j, pixel) in line.iter_mut().enumerate() {
                *pixel = canvas.light[start + j * step];
            }
            for j in 0..length {
                let mut sum = [0.0; 3];
                for (k, weight) in kernel.iter().enumerate() {
                    let from =
                        (j as isize + k as isize - reach).clamp(0, length as isize - 1) as usize;
                    (0..3).for_each(|c| sum[c] += weight * line[from][c]);
                }
                canvas.light[start + j * step] = sum;
            }
        }
    }
}
