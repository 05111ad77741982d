//! Paints the ground of a moment, row by row: asphalt, paint, joints, verge, snow and water, and the lane labels.

use super::canvas::Canvas;
use super::conditions::{ConditionKind, RAIN_MIRROR, SNOW_ROAD, graded};
use super::light::{Colour, blended, scaled};
use super::markings::{Layout, PaintRow};
use super::moment::Moment;
use super::projection::GroundRow;
use super::textures::wheel_track;
use crate::model::vectors::Vectors;

/// Lane lines are labelled up to this distance, metres.
const LABEL_REACH_M: f32 = 60.0;
/// How much more light paint sends back to the car than a white sheet does.
const RETRO: f32 = 2.0;
/// Colour of the walkway along a tunnel's wall.
const KERB: Colour = [0.34, 0.34, 0.33];

impl Moment<'_> {
    pub(super) fn paint_ground(&self, label_half_px: f32, canvas: &mut Canvas, mask: &mut [u8]) {
        let width = canvas.width;
        let mut strip = Strip {
            azimuths: self.azimuths(0.0, width),
            sky: vec![[0.0; 3]; width],
            d_m: vec![0.0; width],
        };
        for (y, row) in self.view.rows.iter().enumerate() {
            let Some(row) = row else { continue };
            let span = y * width..(y + 1) * width;
            canvas.depth_m[span.clone()].fill(row.z_m);
            let (light, mask) = (&mut canvas.light[span.clone()], &mut mask[span]);
            Vectors::fastest().vectorised(
                #[inline(always)]
                || {
                    self.place(row, &mut strip.d_m);
                    let layout = self.way.layout(self.pose.s_m + f64::from(row.z_m));
                    self.paint_ground_row((y, row), &layout, &mut strip, light);
                    self.label(row, &layout, label_half_px, &strip.d_m, mask);
                },
            );
        }
    }

    /// Offsets of the pixels of a row from the middle of the ego lane, metres. The camera is beside it because of sway
    /// and mount.
    #[inline(always)]
    fn place(&self, row: &GroundRow, d_m: &mut [f32]) {
        let left_m = self.lateral(row, 0.5);
        let metres_a_pixel = row.z_m / self.projection.focal_px;
        for (x, d_m) in d_m.iter_mut().enumerate() {
            *d_m = left_m + x as f32 * metres_a_pixel;
        }
    }

    #[inline(always)]
    fn paint_ground_row(
        &self,
        (y, row): (usize, &GroundRow),
        layout: &Layout,
        strip: &mut Strip,
        light: &mut [Colour],
    ) {
        let s_m = self.pose.s_m + f64::from(row.z_m);
        let ground = self.way.textures(s_m);
        let metres_a_pixel = row.z_m / self.projection.focal_px;
        let textures = ground.row(s_m, row.length_m.max(metres_a_pixel));
        let wet = graded(RAIN_MIRROR, self.severities.of(ConditionKind::Rain));
        let mirror = wet * row.z_m / (row.z_m + 12.0);
        let in_tunnel = self.tunnel.as_ref().is_some_and(|t| t.covers(row.z_m));
        let (snow_on_verge, snow_on_road) = if in_tunnel {
            (0.0, 0.0)
        } else {
            (
                self.snow_on_verge(),
                graded(SNOW_ROAD, self.severities.of(ConditionKind::Snow)),
            )
        };
        let below_horizon =
            ((y as f32 + 0.5) - self.projection.horizon_y).max(0.0) / self.projection.focal_px;
        let left_of = |edge_m: f32| strip.d_m.iter().filter(|&&d_m| d_m < edge_m).count();
        let asphalt = left_of(layout.asphalt_m.0)..left_of(layout.asphalt_m.1);
        for verge in [0..asphalt.start, asphalt.end..light.len()] {
            let (d_m, light) = (&strip.d_m[verge.clone()], &mut light[verge]);
            if in_tunnel {
                light.fill(KERB);
                continue;
            }
            textures.verge(d_m, light);
            if snow_on_verge > 0.0 {
                textures.snow(d_m, |_| snow_on_verge, light);
            }
        }
        {
            let d_m = &strip.d_m[asphalt.clone()];
            let light = &mut light[asphalt.clone()];
            textures.asphalt(d_m, layout.lane_width_m, metres_a_pixel, light);
            PaintRow::new(layout, s_m, row.length_m)
                .reflecting(1.0 + RETRO * self.unlit_dark())
                .paint(d_m, metres_a_pixel, light);
            if snow_on_road > 0.0 {
                // Wheels clear their tracks as long as any road can be seen.
                let cover = |d_m: f32| {
                    let track = wheel_track(d_m, layout.lane_width_m);
                    snow_on_road * (1.0 - 0.6 * track * (1.0 - snow_on_road))
                };
                textures.snow(d_m, cover, light);
            }
            if mirror > 0.0 {
                let sky = &mut strip.sky[asphalt.clone()];
                self.sky(&strip.azimuths[asphalt], below_horizon, sky);
                for (light, sky) in light.iter_mut().zip(sky) {
                    *light = blended(scaled(*light, 1.0 - 0.4 * wet), *sky, mirror);
                }
            }
        }
        let shade = self.way.shade(s_m);
        self.light.fall_on(
            s_m,
            row.length_m.max(metres_a_pixel),
            &strip.d_m,
            shade,
            light,
        );
    }

    /// Labels the lane lines in a row at the offsets `d_m`.
    #[inline(always)]
    fn label(
        &self,
        row: &GroundRow,
        layout: &Layout,
        label_half_px: f32,
        d_m: &[f32],
        mask: &mut [u8],
    ) {
        if row.z_m > LABEL_REACH_M {
            return;
        }
        let label_half_m = label_half_px * (row.z_m / self.projection.focal_px);
        // A line that is `d` metres to the side has the slope d / height in the picture. Its label has the same width
        // across the line as along a row.
        let camera_d_m = self.lateral(row, self.projection.centre_x);
        for line in &layout.lines {
            let slope = (line.offset_m - camera_d_m) / self.projection.height_m;
            let half_m = (0.5 * line.width_m).max(label_half_m * (1.0 + slope * slope).sqrt());
            for (mask, d_m) in mask.iter_mut().zip(d_m) {
                *mask |= if (d_m - line.offset_m).abs() <= half_m {
                    255
                } else {
                    0
                };
            }
        }
    }
}

/// Values along one row of the picture, which are kept from row to row.
struct Strip {
    /// Compass directions, radians.
    azimuths: Vec<f32>,
    /// The sky that a wet road mirrors.
    sky: Vec<Colour>,
    /// Offsets from the middle of the ego lane, metres.
    d_m: Vec<f32>,
}
