//! The camera: a pinhole behind the windscreen, and which part of the road each image row shows.

use super::noise::Draws;
use super::road::{Pose, RoadAhead};
use super::world::{Look, World};

/// How the camera is mounted in the car.
#[derive(Clone, Copy, Debug)]
pub struct CameraMount {
    /// Focal length, as a share of the picture's width.
    focal: f32,
    height_m: f32,
    pitch: f32,
    yaw: f32,
    /// Offset from the car's middle, metres, right positive.
    pub aside_m: f32,
}

impl CameraMount {
    /// The camera of a drive: 52 to 74 degrees of horizontal view, 1.2 to 1.7 m above the road; that of the look `game`
    /// is wider and higher.
    pub fn new(draws: Draws, world: &World) -> Self {
        let (half_view, height_m) = match world.look {
            Look::Sim | Look::Realistic => (
                draws.range("half view", 26.0, 37.0),
                draws.range("height", 1.2, 1.7),
            ),
            Look::Game => (
                draws.range("half view", 38.0, 46.0),
                draws.range("height", 1.8, 2.4),
            ),
        };
        Self {
            focal: 0.5 / libm::tanf(half_view.to_radians()),
            height_m,
            pitch: draws.range("pitch", -0.05, 0.03),
            yaw: draws.range("yaw", -0.02, 0.02),
            aside_m: draws.range("aside", -0.2, 0.2),
        }
    }

    /// The projection for a picture of the given size in pixels while the car is at `pose`; `turned` and `tipped` are
    /// additional yaw and pitch of the camera, radians.
    pub fn projection(
        &self,
        (width, height): (usize, usize),
        pose: &Pose,
        (turned, tipped): (f32, f32),
    ) -> Projection {
        let focal_px = self.focal * width as f32;
        Projection {
            focal_px,
            centre_x: 0.5 * width as f32 - focal_px * (self.yaw + turned),
            horizon_y: 0.45 * height as f32 + focal_px * (self.pitch + pose.pitch + tipped),
            height_m: self.height_m,
        }
    }
}

/// From metres around the car to pixels.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Focal length, pixels.
    pub focal_px: f32,
    /// Column straight ahead.
    pub centre_x: f32,
    /// Row of the flat horizon.
    pub horizon_y: f32,
    /// Height of the camera above the road, metres.
    pub height_m: f32,
}

impl Projection {
    /// The same projection into a picture with `margin_px` more pixels on every side.
    pub fn with_margin(self, margin_px: usize) -> Self {
        Self {
            centre_x: self.centre_x + margin_px as f32,
            horizon_y: self.horizon_y + margin_px as f32,
            ..self
        }
    }

    /// Column of a point `x_m` to the right at distance `z_m`.
    pub fn column(&self, x_m: f32, z_m: f32) -> f32 {
        self.centre_x + self.focal_px * x_m / z_m
    }

    /// Row of a point at distance `z_m` that is `rise_m` above the plane on which the car stands.
    pub fn row(&self, rise_m: f32, z_m: f32) -> f32 {
        self.horizon_y + self.focal_px * (self.height_m - rise_m) / z_m
    }
}

/// The part of the road that one image row shows.
#[derive(Clone, Copy, Debug)]
pub struct GroundRow {
    /// Distance, metres.
    pub z_m: f32,
    /// Lateral position of the middle of the ego lane there, metres.
    pub lateral_m: f32,
    /// Length of road that the row covers, metres.
    pub length_m: f32,
}

/// What each image row shows of the ground (`None` above the horizon), and where hills hide what is behind them.
pub struct GroundView {
    /// One entry for each image row, the top row first.
    pub rows: Vec<Option<GroundRow>>,
    /// Distance, and the highest row that nearer ground reaches; the nearest entry first.
    crests: Vec<(f32, f32)>,
}

impl GroundView {
    /// Follows the road away from the car; ground that is hidden by a nearer crest is skipped.
    pub fn new(projection: &Projection, ahead: &RoadAhead, height: usize) -> Self {
        let mut rows = vec![None; height];
        let mut crests = Vec::with_capacity(ahead.nodes.len());
        let mut unseen = height as i32 - 1;
        let mut top = f32::INFINITY;
        for pair in ahead.nodes.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            if a.z_m < 1.0 {
                continue;
            }
            let (row_a, row_b) = (
                projection.row(a.rise_m, a.z_m),
                projection.row(b.rise_m, b.z_m),
            );
            while unseen >= 0 && unseen as f32 + 0.5 >= row_b {
                let centre = unseen as f32 + 0.5;
                let t = ((row_a - centre) / (row_a - row_b).max(1e-6)).clamp(0.0, 1.0);
                // Inside a step, rows are evenly spaced in 1/z, and not in z.
                let z_m = 1.0 / (1.0 / a.z_m + t * (1.0 / b.z_m - 1.0 / a.z_m));
                let share = (z_m - a.z_m) / (b.z_m - a.z_m);
                rows[unseen as usize] = Some(GroundRow {
                    z_m,
                    lateral_m: a.lateral_m + share * (b.lateral_m - a.lateral_m),
                    length_m: (b.z_m - a.z_m) / (row_a - row_b).max(0.05),
                });
                unseen -= 1;
            }
            top = top.min(row_b);
            crests.push((b.z_m, top));
        }
        Self { rows, crests }
    }

    /// The row above which something at distance `z_m` can be seen over the ground before it.
    pub fn crest(&self, z_m: f32) -> f32 {
        let nearer = self.crests.partition_point(|&(z, _)| z < z_m);
        nearer
            .checked_sub(1)
            .map_or(f32::INFINITY, |i| self.crests[i].1)
    }
}
