//! One moment of a drive, as a camera sees it: the ground and the objects on it become light, depth and labels.

use std::borrow::Cow;

use super::Drive;
use super::canvas::Canvas;
use super::conditions::{ConditionKind, NIGHT_DAYLIGHT, SNOW_VERGE, Severities, graded};
use super::light::{Colour, Light, blended, scaled};
use super::projection::{GroundRow, GroundView, Projection};
use super::road::{Pose, RoadAhead};
use super::surroundings::Surroundings;
use super::textures::SNOW;
use super::tunnel::Tunnel;
use super::way::Way;
use crate::model::vectors::Vectors;

/// One moment of a drive and the camera that looks at it.
pub(super) struct Moment<'a> {
    pub drive: &'a Drive,
    pub t_s: f64,
    pub pose: Pose,
    pub ahead: RoadAhead,
    pub severities: Severities,
    pub projection: Projection,
    pub view: GroundView,
    pub tunnel: Option<Tunnel>,
    pub way: Way<'a>,
    pub light: Cow<'a, Light>,
    pub surroundings: Cow<'a, Surroundings>,
}

impl<'a> Moment<'a> {
    /// The moment `t_s` of a drive, in a picture with a height of `height` pixels.
    pub fn new(
        drive: &'a Drive,
        t_s: f64,
        severities: Severities,
        pose: Pose,
        projection: Projection,
        height: usize,
    ) -> Self {
        let ahead = drive.road.ahead(&pose);
        let way = Way::new(drive, pose.s_m);
        Self {
            drive,
            t_s,
            pose,
            severities,
            projection,
            view: GroundView::new(&projection, &ahead, height),
            tunnel: Tunnel::near(
                &drive.conditions,
                &drive.road,
                way.layout(pose.s_m).asphalt_m,
                pose.s_m,
                drive.seed,
            ),
            ahead,
            light: way.light(t_s),
            surroundings: way.surroundings(),
            way,
        }
    }

    /// Paints light, depth and labels of everything; `label_half_px` is half the width of a lane label.
    pub fn paint(&self, label_half_px: f32, canvas: &mut Canvas, mask: &mut [u8]) {
        canvas.lamps.clear();
        canvas.depth_m.fill(f32::INFINITY);
        mask.fill(0);
        self.paint_sky(canvas);
        self.paint_ground(label_half_px, canvas, mask);
        self.paint_standing(canvas, mask);
        if let Some(tunnel) = &self.tunnel {
            let aside_m = self.pose.sway_m + self.drive.camera.aside_m;
            tunnel.paint(canvas, mask, &self.projection, &self.ahead, aside_m);
        }
        if let Some(bonnet) = self.drive.bonnet {
            paint_bonnet(bonnet, canvas, mask);
        }
    }

    /// Compass direction of the road under the car. It turns with the road, so that hills and clouds move sideways in
    /// curves.
    fn compass(&self) -> f64 {
        // The integral of the curvature has no closed form here; slow random motion with the same period looks the
        // same.
        f64::from(self.drive.road.curvature(self.pose.s_m)) * 60.0
    }

    /// Compass directions, radians, that the columns of a picture show: the first one at `first`, in pixels.
    pub(super) fn azimuths(&self, first: f32, width: usize) -> Vec<f32> {
        let compass = self.compass() as f32;
        (0..width)
            .map(|x| {
                (x as f32 + first - self.projection.centre_x) / self.projection.focal_px + compass
            })
            .collect()
    }

    /// The sky in the compass directions `azimuths` at one elevation, radians.
    #[inline(always)]
    pub(super) fn sky(&self, azimuths: &[f32], elevation: f32, colours: &mut [Colour]) {
        self.light.sky(azimuths, elevation, colours);
        let snow = self.snow_on_verge();
        if snow > 0.0 {
            for colour in colours {
                *colour = blended(*colour, [0.74, 0.76, 0.79], 0.8 * snow);
            }
        }
    }

    /// How dark the night is, 0 to 1, if nothing but lamps gives light; else 0.
    pub(super) fn unlit_dark(&self) -> f32 {
        if self.drive.unlit {
            1.0 - graded(NIGHT_DAYLIGHT, self.severities.of(ConditionKind::Night))
        } else {
            0.0
        }
    }

    /// Share of the verge under snow.
    pub(super) fn snow_on_verge(&self) -> f32 {
        graded(SNOW_VERGE, self.severities.of(ConditionKind::Snow))
    }

    fn paint_sky(&self, canvas: &mut Canvas) {
        let rows = self
            .view
            .rows
            .iter()
            .position(Option::is_some)
            .unwrap_or(canvas.height);
        let hill = blended(
            self.surroundings.hill_colour(),
            SNOW,
            0.7 * self.snow_on_verge(),
        );
        let hill = scaled(hill, self.light.ground[1]);
        let azimuths = self.azimuths(0.5, canvas.width);
        let compass = self.compass();
        let hills_px: Vec<f32> = (0..canvas.width)
            .map(|x| {
                let ahead = (x as f32 + 0.5 - self.projection.centre_x) / self.projection.focal_px;
                let hills = self.surroundings.hills(f64::from(ahead) + compass);
                hills * self.projection.focal_px
            })
            .collect();
        let highest_px = hills_px.iter().copied().fold(0.0, f32::max);
        let lights = canvas.light.chunks_exact_mut(canvas.width);
        let depths_m = canvas.depth_m.chunks_exact_mut(canvas.width);
        for (y, (light, depth_m)) in lights.zip(depths_m).take(rows).enumerate() {
            let above_px = self.projection.horizon_y - (y as f32 + 0.5);
            let elevation = above_px.max(0.0) / self.projection.focal_px;
            Vectors::fastest().vectorised(
                #[inline(always)]
                || self.sky(&azimuths, elevation, light),
            );
            if above_px < highest_px {
                for ((light, depth_m), &hills_px) in light.iter_mut().zip(depth_m).zip(&hills_px) {
                    if above_px < hills_px {
                        (*light, *depth_m) = (hill, 1_500.0);
                    }
                }
            }
        }
    }

    /// Offset from the middle of the ego lane that column `x` of a ground row shows, metres.
    pub(super) fn lateral(&self, row: &GroundRow, x: f32) -> f32 {
        let from_axis_m = (x - self.projection.centre_x) * row.z_m / self.projection.focal_px;
        from_axis_m - row.lateral_m + self.pose.sway_m + self.drive.camera.aside_m
    }
}

/// Paints the own car's bonnet over the foot of the picture.
fn paint_bonnet(colour: Colour, canvas: &mut Canvas, mask: &mut [u8]) {
    let (width, height) = (canvas.width as f32, canvas.height as f32);
    for x in 0..canvas.width {
        let across = (2.0 * (x as f32 + 0.5) / width - 1.0) / 0.92;
        let arch = (1.0 - across * across).max(0.0).sqrt();
        let top = height - 0.11 * height * arch;
        for y in (top.max(0.0) as usize)..canvas.height {
            let down = (y as f32 + 0.5 - top) / (0.11 * height);
            let pixel = y * canvas.width + x;
            canvas.light[pixel] = scaled(colour, 1.6 - down.clamp(0.0, 1.0));
            canvas.depth_m[pixel] = 1.5;
            mask[pixel] = 0;
        }
    }
}
