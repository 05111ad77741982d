//! The lens: what is on it, what shines into it, how it is held, and how sharp it is.

use super::canvas::{Canvas, Lamp};
use super::conditions::{
    ASKEW_ROLL_DEG, BLUR_SIGMA, ConditionKind, DIRT_COVER, GLARE_VEIL, NIGHT_DAYLIGHT, RAIN_DROPS,
    Severities, graded,
};
use super::light::{Colour, blended, scaled};
use super::noise::{BLOCK, Draws, NoiseColumn, uniform, whole};
use super::projection::Projection;
use super::weather::span;
use crate::model::vectors::Vectors;

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
        let mut places = vec![Place::default(); to.width];
        for y in 0..to.height {
            let dy = y as f32 + 0.5 - middle_y;
            Vectors::fastest().vectorised(
                #[inline(always)]
                || {
                    for (x, place) in places.iter_mut().enumerate() {
                        let dx = x as f32 + 0.5 - middle_x;
                        *place = Place::of(
                            middle_x + margin + cos * dx - sin * dy - 0.5,
                            middle_y + margin + sin * dx + cos * dy - 0.5,
                            from,
                        );
                    }
                },
            );
            let row = y * to.width..(y + 1) * to.width;
            let (lights, depths_m) = (&mut to.light[row.clone()], &mut to.depth_m[row.clone()]);
            let pixels = lights.iter_mut().zip(depths_m).zip(&mut to_mask[row]);
            for (((light, depth_m), mask), place) in pixels.zip(&places) {
                let first = place.first as usize;
                let [above, below] = [first, first + from.width].map(|first| {
                    let pair = &from.light[first..first + 2];
                    blended(pair[0], pair[1], place.across)
                });
                *light = blended(above, below, place.down);
                let nearest = first
                    + usize::from(place.down > 0.5) * from.width
                    + usize::from(place.across > 0.5);
                (*depth_m, *mask) = (from.depth_m[nearest], from_mask[nearest]);
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

/// A place between four pixels of a picture.
#[derive(Clone, Copy, Default)]
struct Place {
    /// Number of the pixel to the left and above.
    first: u32,
    /// How far the place is from that pixel to the next one in its row, and to the next row, 0 to 1.
    across: f32,
    down: f32,
}

impl Place {
    /// The place at a column and row of a picture, both from the middle of the first pixel on.
    #[inline(always)]
    fn of(column: f32, row: f32, picture: &Canvas) -> Self {
        let (x, y) = (
            whole(column.max(0.0)).min(picture.width as u32 - 2),
            whole(row.max(0.0)).min(picture.height as u32 - 2),
        );
        Self {
            first: y * picture.width as u32 + x,
            across: (column - x as f32).clamp(0.0, 1.0),
            down: (row - y as f32).clamp(0.0, 1.0),
        }
    }
}

/// Drops on the lens: each shows the scene small and upside down.
fn drops(canvas: &mut Canvas, count: f32, seed: u32) {
    canvas.spare.copy_from_slice(&canvas.light);
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
                        scaled(canvas.spare[from_y * canvas.width + from_x], 1.1),
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
    Vectors::fastest().vectorised(
        #[inline(always)]
        || {
            for (y, light) in canvas.light.chunks_exact_mut(canvas.width).enumerate() {
                let dy = (y as f32 - sun_y) / width;
                for (x, light) in light.iter_mut().enumerate() {
                    let dx = (x as f32 - sun_x) / width;
                    let r2 = dx * dx + dy * dy;
                    let glow = veil * (0.45 + 1.3 * 0.02 / (0.02 + r2))
                        + veil * 6.0 * 0.0006 / (0.0006 + r2);
                    *light = [0, 1, 2].map(|c| light[c] + glow * [1.0, 0.93, 0.78][c]);
                }
            }
        },
    );
}

/// Smears that cover the wanted share of the lens, brown and nearly opaque.
fn dirt(canvas: &mut Canvas, cover: f32, daylight: f32, seed: u32) {
    let field = smears(canvas.width, canvas.height, seed);
    let mut sample: Vec<f32> = field
        .chunks_exact(canvas.width)
        .step_by((canvas.height / 20).max(1))
        .flat_map(|row| row.iter().step_by((canvas.width / 40).max(1)))
        .copied()
        .collect();
    sample.sort_by(f32::total_cmp);
    let edge = sample[((1.0 - cover) * (sample.len() - 1) as f32) as usize];
    let soil = scaled([0.11, 0.085, 0.06], daylight);
    Vectors::fastest().vectorised(
        #[inline(always)]
        || {
            for (light, depth) in canvas.light.iter_mut().zip(&field) {
                let opacity = ((depth - edge) / 0.04 + 0.5).clamp(0.0, 1.0) * 0.88;
                *light = blended(*light, soil, opacity);
            }
        },
    );
}

/// How much dirt could be on each place of the lens, `[H, W]`, 0..1.
fn smears(width: usize, height: usize, seed: u32) -> Vec<f32> {
    let place = |pixel: usize| pixel as f64 / width as f64;
    let across: Vec<f64> = (0..width).map(place).collect();
    let mut field = vec![0.0; width * height];
    for (y, field) in field.chunks_exact_mut(width).enumerate() {
        let large = NoiseColumn::new(seed ^ 31, place(y) * 9.0);
        let small = NoiseColumn::new(seed ^ 32, place(y) * 27.0);
        Vectors::fastest().vectorised(
            #[inline(always)]
            || {
                for (across, field) in across.chunks(BLOCK).zip(field.chunks_mut(BLOCK)) {
                    let large = large.block(across, |u| u * 9.0);
                    let small = small.block(across, |u| u * 27.0);
                    for ((field, large), small) in field.iter_mut().zip(&large).zip(&small) {
                        *field = 0.6 * large + 0.4 * small;
                    }
                }
            },
        );
    }
    field
}

/// Gaussian blur of the light, one axis after the other; pixels beyond the edge repeat the edge.
fn blur(canvas: &mut Canvas, sigma_px: f32) {
    let reach = (3.0 * sigma_px).ceil() as usize;
    let mut kernel: Vec<f32> = (0..=2 * reach)
        .map(|i| i as f32 - reach as f32)
        .map(|i| libm::expf(-0.5 * (i / sigma_px) * (i / sigma_px)))
        .collect();
    let total: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= total);
    let (width, height) = (canvas.width, canvas.height);
    let mut padded = vec![[0.0; 3]; width + 2 * reach];
    let rows = canvas.light.chunks_exact(width);
    for (row, out) in rows.zip(canvas.spare.chunks_exact_mut(width)) {
        padded[..reach].fill(row[0]);
        padded[reach..reach + width].copy_from_slice(row);
        padded[reach + width..].fill(row[width - 1]);
        weighted_sum(&kernel, |tap| &padded[tap..tap + width], out);
    }
    let above = |tap: usize, y: usize| (y + tap).saturating_sub(reach).min(height - 1) * width;
    for (y, out) in canvas.light.chunks_exact_mut(width).enumerate() {
        let row = |tap| &canvas.spare[above(tap, y)..][..width];
        weighted_sum(&kernel, row, out);
    }
}

/// The sum of rows, which `row` gives by number, with these weights.
fn weighted_sum<'a>(weights: &[f32], row: impl Fn(usize) -> &'a [Colour], out: &mut [Colour]) {
    /// Sums that stay in the processor's registers.
    const SUMS: usize = 64;
    Vectors::fastest().vectorised(
        #[inline(always)]
        || {
            let (blocks, rest) = out.as_flattened_mut().as_chunks_mut::<SUMS>();
            let first_of_rest = SUMS * blocks.len();
            for (first, sums) in (0..).step_by(SUMS).zip(blocks) {
                let mut block = [0.0; SUMS];
                for (tap, weight) in weights.iter().enumerate() {
                    // Rows are as long as the sums, so none is too short.
                    let lights = row(tap).as_flattened()[first..].first_chunk::<SUMS>();
                    for (sum, light) in block.iter_mut().zip(lights.unwrap_or(&[0.0; SUMS])) {
                        *sum += weight * light;
                    }
                }
                *sums = block;
            }
            rest.fill(0.0);
            for (tap, weight) in weights.iter().enumerate() {
                let lights = &row(tap).as_flattened()[first_of_rest..];
                for (sum, light) in rest.iter_mut().zip(lights) {
                    *sum += weight * light;
                }
            }
        },
    );
}
