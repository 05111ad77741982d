//! The lens: what is on it, what shines into it, how it is held, and how sharp it is.

use super::canvas::{Canvas, Lamp};
use super::conditions::{
    ASKEW_ROLL_DEG, BLUR_SIGMA, ConditionKind, DIRT_COVER, GLARE_VEIL, NIGHT_DAYLIGHT, RAIN_DROPS,
    Severities, graded,
};
use super::light::{blended, scaled};
use super::noise::{Draws, uniform, value_noise};
use super::projection::Projection;
use super::weather::span;

/// Applies drops, glare, dirt and blur; `softness` is that of the lens, as a share of the picture's width.
pub fn apply(
    canvas: &mut Canvas,
    projection: &Projection,
    severities: &Severities,
    softness: f32,
    seed: u32,
) {
    let rain = severities.of(ConditionKind::Rain);
    if rain > 0.0 {
        drops(canvas, graded(RAIN_DROPS, rain), seed);
    }
    let veil = graded(GLARE_VEIL, severities.of(ConditionKind::Glare));
    if veil > 0.0 {
        glare(canvas, projection, veil, seed);
    }
    let cover = graded(DIRT_COVER, severities.of(ConditionKind::Dirt));
    if cover > 0.0 {
        let daylight = graded(NIGHT_DAYLIGHT, severities.of(ConditionKind::Night));
        dirt(canvas, cover, daylight, seed);
    }
    let blurred = graded(BLUR_SIGMA, severities.of(ConditionKind::Blur));
    let sigma_px = (blurred * blurred + softness * softness).sqrt() * canvas.width as f32;
    if sigma_px > 0.0 {
        blur(canvas, sigma_px);
    }
}

/// How far a camera out of its place is rolled, turned and tipped, radians.
#[derive(Clone, Copy, Default)]
pub struct Askew {
    /// Around the viewing axis.
    pub roll: f32,
    /// To the side.
    pub turned: f32,
    /// Up.
    pub tipped: f32,
}

impl Askew {
    /// The angles of a drive at one moment; their signs depend on the drive.
    pub fn of(severities: &Severities, seed: u32) -> Self {
        let angle = graded(ASKEW_ROLL_DEG, severities.of(ConditionKind::Askew)).to_radians();
        let side = |name| {
            if Draws(seed).chance(name, 0.5) {
                1.0
            } else {
                -1.0
            }
        };
        Self {
            roll: angle * side("roll"),
            turned: 0.5 * angle * side("turn"),
            tipped: angle / 3.0 * side("tip"),
        }
    }

    /// Number of pixels by which a picture must be larger on every side, so that the rolled picture is complete.
    pub fn margin_px(self, width: usize, height: usize) -> usize {
        if self.roll.abs() < 1e-6 {
            return 0;
        }
        let half_diagonal = 0.5 * ((width * width + height * height) as f32).sqrt();
        (half_diagonal * libm::sinf(self.roll).abs()).ceil() as usize + 1
    }

    /// Cuts the rolled picture and labels out of larger ones that have `margin_px` more pixels on every side.
    pub fn roll_into(
        self,
        (from, from_mask): (&Canvas, &[u8]),
        margin_px: usize,
        (to, to_mask): (&mut Canvas, &mut [u8]),
    ) {
        let (sin, cos) = (libm::sinf(self.roll), libm::cosf(self.roll));
        let (middle_x, middle_y) = (0.5 * to.width as f32, 0.5 * to.height as f32);
        let margin = margin_px as f32;
        for y in 0..to.height {
            for x in 0..to.width {
                let (dx, dy) = (x as f32 + 0.5 - middle_x, y as f32 + 0.5 - middle_y);
                let at_x = middle_x + margin + cos * dx - sin * dy - 0.5;
                let at_y = middle_y + margin + sin * dx + cos * dy - 0.5;
                let (x0, y0) = (
                    (at_x.max(0.0) as usize).min(from.width - 2),
                    (at_y.max(0.0) as usize).min(from.height - 2),
                );
                let (tx, ty) = (
                    (at_x - x0 as f32).clamp(0.0, 1.0),
                    (at_y - y0 as f32).clamp(0.0, 1.0),
                );
                let row = |y: usize| {
                    blended(
                        from.light[y * from.width + x0],
                        from.light[y * from.width + x0 + 1],
                        tx,
                    )
                };
                let nearest =
                    (y0 + usize::from(ty > 0.5)) * from.width + x0 + usize::from(tx > 0.5);
                let pixel = y * to.width + x;
                to.light[pixel] = blended(row(y0), row(y0 + 1), ty);
                to.depth_m[pixel] = from.depth_m[nearest];
                to_mask[pixel] = from_mask[nearest];
            }
        }
        to.lamps = from
            .lamps
            .iter()
            .map(|lamp| {
                let (dx, dy) = (lamp.at.0 - margin - middle_x, lamp.at.1 - margin - middle_y);
                Lamp {
                    at: (
                        middle_x + cos * dx + sin * dy,
                        middle_y - sin * dx + cos * dy,
                    ),
                    ..*lamp
                }
            })
            .collect();
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

/// A low sun ahead: bloom around it, and a veil over everything.
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

/// Gaussian blur of the light, one axis after the other; pixels beyond the edge repeat the edge.
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
