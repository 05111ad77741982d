//! One moment of a drive, as a camera sees it: the ground and the objects on it become light, depth and labels.

use super::Drive;
use super::canvas::Canvas;
use super::conditions::{ConditionKind, SNOW_VERGE, Severities, graded};
use super::light::{Colour, blended, scaled};
use super::projection::{GroundRow, GroundView, Projection};
use super::road::{Pose, RoadAhead};
use super::tunnel::Tunnel;

/// Colour of snow in full light.
pub(super) const SNOW: Colour = [0.86, 0.88, 0.92];

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
                drive.layout.asphalt_m,
                pose.s_m,
                drive.seed,
            ),
            ahead,
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

    pub(super) fn sky_at(&self, x: f32, elevation: f32) -> Colour {
        let azimuth = (x - self.projection.centre_x) / self.projection.focal_px;
        let sky = self
            .drive
            .light
            .sky(azimuth + self.compass() as f32, elevation);
        blended(sky, [0.74, 0.76, 0.79], 0.8 * self.snow_on_verge())
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
            self.drive.surroundings.hill_colour(),
            SNOW,
            0.7 * self.snow_on_verge(),
        );
        let hill = scaled(hill, self.drive.light.ground[1]);
        for x in 0..canvas.width {
            let column = x as f32 + 0.5;
            let azimuth = f64::from((column - self.projection.centre_x) / self.projection.focal_px)
                + self.compass();
            let hills_px = self.drive.surroundings.hills(azimuth) * self.projection.focal_px;
            for y in 0..rows {
                let above_px = self.projection.horizon_y - (y as f32 + 0.5);
                let pixel = y * canvas.width + x;
                canvas.light[pixel] = if above_px < hills_px {
                    canvas.depth_m[pixel] = 1_500.0;
                    hill
                } else {
                    self.sky_at(column, above_px.max(0.0) / self.projection.focal_px)
                };
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
