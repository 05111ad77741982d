//! Paints the ground of a moment, row by row: asphalt, paint, joints, verge, snow and water, and the lane labels.

use super::canvas::Canvas;
use super::conditions::{ConditionKind, RAIN_MIRROR, SNOW_ROAD, graded};
use super::light::{Colour, blended, scaled};
use super::markings::{Line, PaintRow};
use super::moment::{Moment, SNOW};
use super::projection::GroundRow;

/// Lane lines are labelled up to this distance, metres.
const LABEL_REACH_M: f32 = 60.0;
/// Colour of the walkway along a tunnel's wall.
const KERB: Colour = [0.34, 0.34, 0.33];

impl Moment<'_> {
    pub(super) fn paint_ground(&self, label_half_px: f32, canvas: &mut Canvas, mask: &mut [u8]) {
        let width = canvas.width;
        for (y, row) in self.view.rows.iter().enumerate() {
            let Some(row) = row else { continue };
            let span = y * width..(y + 1) * width;
            canvas.depth_m[span.clone()].fill(row.z_m);
            self.paint_ground_row(
                (y, row),
                label_half_px,
                &mut canvas.light[span.clone()],
                &mut mask[span],
            );
        }
    }

    fn paint_ground_row(
        &self,
        (y, row): (usize, &GroundRow),
        label_half_px: f32,
        light: &mut [Colour],
        mask: &mut [u8],
    ) {
        let drive = self.drive;
        let layout = &drive.layout;
        let s_m = self.pose.s_m + f64::from(row.z_m);
        let metres_a_pixel = row.z_m / self.projection.focal_px;
        let textures = drive
            .surroundings
            .ground_row(s_m, row.length_m.max(metres_a_pixel));
        let paint = PaintRow::new(layout, s_m, row.length_m);
        let label_half_m = label_half_px * metres_a_pixel;
        // A line that is `d` metres to the side has the slope d / height in the picture. Its label has the same width
        // across the line as along a row.
        let camera_d_m = self.lateral(row, self.projection.centre_x);
        let slant = |d_m: f32| {
            let slope = (d_m - camera_d_m) / self.projection.height_m;
            (1.0 + slope * slope).sqrt()
        };
        let labelled = row.z_m <= LABEL_REACH_M;
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
        // Positions on the ground are measured from the middle of the ego lane; the camera is beside it because of sway
        // and mount.
        let left_m = self.lateral(row, 0.5);
        for (x, (light, mask)) in light.iter_mut().zip(mask).enumerate() {
            let d_m = left_m + x as f32 * metres_a_pixel;
            let (from_m, to_m) = layout.asphalt_m;
            let ground = if (from_m..to_m).contains(&d_m) {
                let phase = d_m - layout.lane_width_m * (d_m / layout.lane_width_m).round();
                let base = textures.asphalt(d_m, phase, metres_a_pixel);
                let painted = match paint.at(d_m, metres_a_pixel) {
                    Some((share, colour)) => blended(base, colour, share),
                    None => base,
                };
                let painted = if snow_on_road > 0.0 {
                    // Wheels clear their tracks as long as any road can be seen.
                    let track = 1.0 - ((phase.abs() - 0.85).abs() / 0.45).min(1.0);
                    let cover = snow_on_road * (1.0 - 0.6 * track * (1.0 - snow_on_road));
                    blended(painted, SNOW, textures.snow(d_m, cover))
                } else {
                    painted
                };
                if mirror > 0.0 {
                    let sky = self.sky_at(x as f32, below_horizon);
                    blended(scaled(painted, 1.0 - 0.4 * wet), sky, mirror)
                } else {
                    painted
                }
            } else if in_tunnel {
                KERB
            } else if snow_on_verge > 0.0 {
                blended(textures.verge(d_m), SNOW, textures.snow(d_m, snow_on_verge))
            } else {
                textures.verge(d_m)
            };
            let shade = drive.light.shade(s_m, d_m);
            *light = [0, 1, 2].map(|i| ground[i] * drive.light.ground[i] * shade);
            if labelled {
                let on_line = |l: &Line| {
                    (d_m - l.offset_m).abs()
                        <= (0.5 * l.width_m).max(label_half_m * slant(l.offset_m))
                };
                *mask = if layout.lines.iter().any(on_line) {
                    255
                } else {
                    0
                };
            }
        }
    }
}
