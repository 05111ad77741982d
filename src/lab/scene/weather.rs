//! Air and light: how weather and night change the light of a scene on its way to the lens.

use super::canvas::Canvas;
use super::conditions::{
    ConditionKind, FOG_EXTINCTION, NIGHT_DAYLIGHT, RAIN_EXTINCTION, RAIN_STREAKS, SNOW_EXTINCTION,
    SNOW_FLAKES, Severities, graded,
};
use super::light::{Colour, blended, scaled};
use super::noise::uniform;
use super::projection::Projection;
use crate::model::vectors::Vectors;

/// Applies night, haze, rain and snow in the air; `clear` is the extinction of the air on that day, 1/m. A night may be
/// `unlit`.
pub fn apply(
    canvas: &mut Canvas,
    projection: &Projection,
    severities: &Severities,
    clear: f32,
    unlit: bool,
    time_seed: u32,
) {
    let daylight = graded(NIGHT_DAYLIGHT, severities.of(ConditionKind::Night));
    let dark = 1.0 - daylight;
    let daylight = if unlit { daylight * daylight } else { daylight };
    if dark > 0.0 && unlit {
        unlit_night(canvas, projection, daylight, dark);
    } else if dark > 0.0 {
        night(canvas, projection, daylight);
    }
    if dark > 0.0 {
        lamps(canvas, dark);
    }
    let rain = severities.of(ConditionKind::Rain);
    let snow = severities.of(ConditionKind::Snow);
    let extinction = clear
        + graded(FOG_EXTINCTION, severities.of(ConditionKind::Fog))
        + graded(RAIN_EXTINCTION, rain)
        + graded(SNOW_EXTINCTION, snow);
    if extinction > 0.0 {
        haze(
            canvas,
            projection,
            extinction,
            scaled(
                [0.74, 0.76, 0.79],
                daylight.max(if unlit { 0.0 } else { 0.03 }),
            ),
        );
    }
    if rain > 0.0 {
        streaks(
            canvas,
            graded(RAIN_STREAKS, rain),
            daylight.max(0.08),
            time_seed,
        );
    }
    if snow > 0.0 {
        flakes(
            canvas,
            graded(SNOW_FLAKES, snow),
            daylight.max(0.08),
            time_seed,
        );
    }
}

/// Reach of low beams, metres, and the elevation at which they end, radians.
const LOW_BEAM_M: f32 = 62.0;
const LOW_BEAM_CUT_OFF: f32 = 0.035;

fn night(canvas: &mut Canvas, projection: &Projection, daylight: f32) {
    let dark = 1.0 - daylight;
    let tint: Colour = [1.0 - 0.25 * dark, 1.0 - 0.12 * dark, 1.0];
    let lights = canvas.light.chunks_exact_mut(canvas.width);
    Vectors::fastest().vectorised(
        #[inline(always)]
        || {
            for (light, depth_m) in lights.zip(canvas.depth_m.chunks_exact(canvas.width)) {
                for (x, (light, &z_m)) in light.iter_mut().zip(depth_m).enumerate() {
                    let x_m = (x as f32 - projection.centre_x) * z_m / projection.focal_px;
                    let aside = (x_m / (2.2 + 0.16 * z_m)).abs().min(1.0);
                    let far = 1.0 - z_m / 60.0;
                    let beam = 0.55 * dark * far * far * (1.0 - aside * aside);
                    let beam = if z_m < 60.0 { beam } else { 0.0 };
                    *light = [0, 1, 2]
                        .map(|c| light[c] * (daylight * tint[c] + beam * [1.0, 0.95, 0.82][c]));
                }
            }
        },
    );
}

/// A night in which nothing but lamps gives light: low beams, which light what is near and low.
fn unlit_night(canvas: &mut Canvas, projection: &Projection, daylight: f32, dark: f32) {
    let rows = canvas.light.chunks_exact_mut(canvas.width);
    let rows = rows.zip(canvas.depth_m.chunks_exact(canvas.width));
    for (y, (light, depth_m)) in rows.enumerate() {
        let up = (projection.horizon_y - (y as f32 + 0.5)) / projection.focal_px;
        let below_cut_off = (1.0 - up / LOW_BEAM_CUT_OFF).clamp(0.04, 1.0);
        for (x, (light, &z_m)) in light.iter_mut().zip(depth_m).enumerate() {
            let near_m = z_m.min(1_000.0);
            let x_m = (x as f32 - projection.centre_x) * near_m / projection.focal_px;
            let aside = (x_m / (2.5 + 0.25 * near_m)).abs().min(1.0);
            let along =
                ((near_m - 1.6) / 2.0).clamp(0.02, 1.0) * (1.0 - near_m / LOW_BEAM_M).max(0.0);
            let beam = 0.9 * dark * along * (1.0 - aside * aside)
                / (1.0 + (near_m / 18.0) * (near_m / 18.0));
            let beam = beam * below_cut_off;
            *light = [0, 1, 2].map(|c| light[c] * (daylight + beam * [1.0, 0.95, 0.82][c]));
        }
    }
}

/// Lamps of vehicles, and what sends the light of the own lamps back.
fn lamps(canvas: &mut Canvas, dark: f32) {
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

/// Pixels within `reach` of `middle`, inside `limit`.
pub(super) fn span(middle: f32, reach: f32, limit: usize) -> std::ops::Range<usize> {
    let inside = |v: f32| v.clamp(0.0, limit as f32) as usize;
    inside(middle - reach)..inside(middle + reach + 1.0)
}

/// Scatters towards `air` with distance (Koschmieder); the sky is seen through a layer 70 m high.
fn haze(canvas: &mut Canvas, projection: &Projection, extinction: f32, air: Colour) {
    let mut kept = vec![0.0; canvas.width];
    let depths_m = canvas.depth_m.chunks_exact(canvas.width);
    let lights = canvas.light.chunks_exact_mut(canvas.width);
    for (y, (light, depth_m)) in lights.zip(depths_m).enumerate() {
        let elevation = ((projection.horizon_y - y as f32) / projection.focal_px).max(0.03);
        let sky_depth_m = (70.0 / elevation).max(300.0);
        let (mut last_depth, mut last_kept) = (f32::NAN, 1.0);
        for (kept, depth_m) in kept.iter_mut().zip(depth_m) {
            let depth = depth_m.min(sky_depth_m);
            if depth.total_cmp(&last_depth).is_ne() {
                (last_depth, last_kept) = (depth, libm::expf(-extinction * depth));
            }
            *kept = last_kept;
        }
        Vectors::fastest().vectorised(
            #[inline(always)]
            || {
                for (light, kept) in light.iter_mut().zip(&kept) {
                    *light = blended(air, *light, *kept);
                }
            },
        );
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

/// Flakes: small soft discs, which are larger when they are nearer, and blurred by their fall.
fn flakes(canvas: &mut Canvas, count_320: f32, brightness: f32, time_seed: u32) {
    let scale = canvas.width as f32 / 320.0;
    for i in 0..count_320 as usize {
        let (cx, cy) = (
            uniform(time_seed, i, 6) * canvas.width as f32,
            uniform(time_seed, i, 7) * canvas.height as f32,
        );
        let near = uniform(time_seed, i, 8);
        let radius = (0.5 + 1.8 * near * near) * scale;
        for y in span(cy, 1.6 * radius, canvas.height) {
            for x in span(cx, radius, canvas.width) {
                let (dx, dy) = (
                    (x as f32 + 0.5 - cx) / radius,
                    (y as f32 + 0.5 - cy) / (1.6 * radius),
                );
                let inside = 1.0 - (dx * dx + dy * dy);
                if inside > 0.0 {
                    let light = &mut canvas.light[y * canvas.width + x];
                    *light = blended(
                        *light,
                        scaled([0.92, 0.93, 0.95], brightness),
                        0.75 * inside,
                    );
                }
            }
        }
    }
}
