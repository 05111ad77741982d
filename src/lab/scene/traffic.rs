//! Other vehicles. The traffic of each lane is at rest in a frame of reference that moves with the speed of the lane,
//! so that any moment can be calculated directly, and a drive needs no end.

use std::borrow::Cow;

use super::light::Colour;
use super::markings::Layout;
use super::noise::{Draws, hash, wander};
use super::road::{Pose, Road};
use super::world::{Element, World};

/// Spacing of the grid, whose cells may hold one vehicle, metres.
const CELL_M: f64 = 34.0;

/// A vehicle ahead of the car.
#[derive(Clone, Copy, Debug)]
pub struct Vehicle {
    /// Distance ahead, metres.
    pub z_m: f32,
    /// Offset from the middle of the ego lane, metres.
    pub d_m: f32,
    /// Width and height, metres.
    pub size_m: (f32, f32),
    /// Colour of its paint.
    pub colour: Colour,
    /// Whether its front is seen instead of its back.
    pub oncoming: bool,
}

/// The traffic of a drive.
#[derive(Clone, Debug)]
pub struct Traffic {
    draws: Draws,
    density: f32,
}

impl Traffic {
    /// The traffic of a drive.
    pub fn new(draws: Draws, world: &World) -> Self {
        Self {
            draws,
            density: world.when(
                Element::Traffic,
                draws.range("traffic density", 0.0, 0.55),
                0.0,
            ),
        }
    }

    /// Vehicles between 7 and 160 m ahead, the farthest first; `layout_at` gives the cross-section at an arc length.
    pub fn ahead<'a>(
        &self,
        t_s: f64,
        pose: &Pose,
        road: &Road,
        layout_at: impl Fn(f64) -> Cow<'a, Layout>,
    ) -> Vec<Vehicle> {
        let mut seen = Vec::new();
        let layout = layout_at(pose.s_m);
        if self.draws.chance("lead vehicle", 1.2 * self.density) {
            let z_m = self.draws.range("lead distance", 18.0, 70.0)
                * (1.0 + 0.3 * wander(self.draws.seed("lead breathing"), t_s / 11.0));
            seen.push(vehicle(Draws(self.draws.seed("lead")), z_m, 0.0, false));
        }
        for (lane, &middle_m) in layout
            .lanes_m
            .iter()
            .enumerate()
            .filter(|(_, m)| m.abs() > 0.1)
        {
            // Left lanes overtake and right lanes are slower: each lane farther to the left is 3 m/s faster.
            let speed_mps = road.speed_mps - 3.0 * middle_m / layout.lane_width_m;
            self.lane_ahead(
                lane as i32,
                t_s * f64::from(speed_mps),
                pose.s_m,
                |s_m| layout_at(s_m).lanes_m.get(lane).copied(),
                &mut seen,
            );
        }
        if layout.oncoming_m.is_some() {
            self.lane_ahead(
                ONCOMING,
                -t_s * f64::from(road.speed_mps),
                pose.s_m,
                |s_m| layout_at(s_m).oncoming_m,
                &mut seen,
            );
        }
        seen.sort_by(|a, b| b.z_m.total_cmp(&a.z_m));
        seen
    }

    /// Adds the vehicles of one lane, whose traffic has moved by `moved_m` since the drive began.
    fn lane_ahead(
        &self,
        lane: i32,
        moved_m: f64,
        ego_s_m: f64,
        middle_m: impl Fn(f64) -> Option<f32>,
        seen: &mut Vec<Vehicle>,
    ) {
        let cell = |z_m: f64| ((ego_s_m + z_m - moved_m) / CELL_M).floor() as i32;
        for k in cell(7.0)..=cell(160.0) {
            let draws = Draws(hash(self.draws.seed("lane traffic"), k, lane));
            let place_m = (f64::from(k) + f64::from(draws.range("place", 0.2, 0.8))) * CELL_M;
            let z_m = (place_m + moved_m - ego_s_m) as f32;
            if draws.chance("there", self.density) && (7.0..160.0).contains(&z_m) {
                let middle_m = middle_m(ego_s_m + f64::from(z_m)).unwrap_or_default();
                seen.push(vehicle(draws, z_m, middle_m, lane == ONCOMING));
            }
        }
    }
}

/// The lane number of oncoming traffic.
const ONCOMING: i32 = -1;

fn vehicle(draws: Draws, z_m: f32, middle_m: f32, oncoming: bool) -> Vehicle {
    let lorry = draws.chance("lorry", 0.18);
    Vehicle {
        z_m,
        d_m: middle_m + draws.range("aside", -0.25, 0.25),
        size_m: if lorry {
            (2.5, draws.range("height", 2.8, 3.8))
        } else {
            (
                draws.range("width", 1.65, 1.95),
                draws.range("height", 1.35, 1.85),
            )
        },
        colour: draws.pick(
            "paint",
            &[
                [0.6, 0.6, 0.6],
                [0.75, 0.75, 0.73],
                [0.03, 0.03, 0.035],
                [0.12, 0.13, 0.15],
                [0.35, 0.03, 0.03],
                [0.03, 0.08, 0.3],
            ],
        ),
        oncoming,
    }
}
