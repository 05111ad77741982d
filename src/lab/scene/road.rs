//! The course of the road: curvature, grade, and how the car moves along it. Any time can be accessed directly, and
//! there is no end.

use super::noise::{Draws, linear_noise, wander};
use super::world::{Element, World};

/// Distance between two knots of the piecewise linear curvature, metres.
const CURVATURE_KNOT_M: f64 = 90.0;
/// Distance between two knots of the piecewise linear grade, metres.
const GRADE_KNOT_M: f64 = 160.0;

/// A road, and the motion of the car along it.
#[derive(Clone, Debug)]
pub struct Road {
    draws: Draws,
    /// Largest curvature, 1/m.
    curvature_max: f32,
    /// Largest grade, metres for each metre.
    grade_max: f32,
    /// Mean speed of the car, m/s.
    pub speed_mps: f32,
    sway_m: f32,
    /// Largest pitch of the body, radians.
    pitch_max: f32,
}

/// Position of the car, and its angle relative to the road's tangent.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Arc length along the road, metres.
    pub s_m: f64,
    /// Offset from the middle of its lane, metres, right positive.
    pub sway_m: f32,
    /// Heading relative to the tangent, radians, right positive.
    pub heading: f32,
    /// Pitch of the body, radians, nose up positive.
    pub pitch: f32,
}

impl Road {
    /// The road of a drive.
    pub fn new(draws: Draws, world: &World) -> Self {
        let curve = draws.range("curviness", 0.0, 1.0);
        Self {
            draws,
            curvature_max: world.when(Element::Curves, 0.0002 + 0.0042 * curve * curve, 0.0),
            grade_max: world.when(Element::Grades, draws.range("hilliness", 0.0, 0.035), 0.0),
            speed_mps: draws.range("speed", 31.0, 14.0 + 10.0 * (1.0 - curve)),
            sway_m: world.when(Element::Motion, draws.range("sway", 0.05, 0.30), 0.0),
            pitch_max: world.when(Element::Motion, 0.008, 0.0),
        }
    }

    /// Curvature at arc length `s_m`, 1/m, right positive.
    pub fn curvature(&self, s_m: f64) -> f32 {
        self.curvature_max * linear_noise(self.draws.seed("curvature"), s_m / CURVATURE_KNOT_M)
    }

    /// Grade at arc length `s_m`, metres for each metre.
    pub fn grade(&self, s_m: f64) -> f32 {
        self.grade_max * linear_noise(self.draws.seed("grade"), s_m / GRADE_KNOT_M)
    }

    /// The car's pose at `t_s` seconds.
    pub fn pose(&self, t_s: f64) -> Pose {
        let v = f64::from(self.speed_mps);
        // The speed varies by 8 % with a period of about 50 s. Its integral is known, so that any time can be accessed
        // directly.
        let phase = f64::from(self.draws.range("speed phase", 0.0, std::f32::consts::TAU));
        let omega = 0.125;
        let s_m = 1_000.0 + v * (t_s + 0.08 / omega * libm::sin(omega * t_s + phase));
        let sway = |t: f64| {
            self.sway_m
                * (0.7 * wander(self.draws.seed("sway slow"), t / 4.0)
                    + 0.3 * wander(self.draws.seed("sway fast"), t / 1.7))
        };
        let slope = (sway(t_s + 0.1) - sway(t_s - 0.1)) / 0.2;
        Pose {
            s_m,
            sway_m: sway(t_s),
            heading: slope / self.speed_mps,
            pitch: 0.5
                * self.pitch_max
                * (wander(self.draws.seed("pitch"), t_s / 0.8)
                    + wander(self.draws.seed("pitch slow"), t_s / 3.0)),
        }
    }

    /// The road ahead of a pose, seen from the car.
    pub fn ahead(&self, pose: &Pose) -> RoadAhead {
        let grade_here = self.grade(pose.s_m);
        let mut nodes = [Node::default(); RoadAhead::NODES];
        let (mut z, mut heading, mut lateral, mut rise) =
            (0.0_f32, -pose.heading, 0.0_f32, 0.0_f32);
        for node in &mut nodes {
            *node = Node {
                z_m: z,
                lateral_m: lateral,
                rise_m: rise,
            };
            let step = 0.5 + z * 0.03;
            let middle = pose.s_m + f64::from(z + 0.5 * step);
            let turned = heading + self.curvature(middle) * step;
            lateral += 0.5 * (heading + turned) * step;
            heading = turned;
            rise += (self.grade(middle) - grade_here) * step;
            z += step;
        }
        RoadAhead { nodes }
    }
}

/// One point of the road ahead.
#[derive(Clone, Copy, Debug, Default)]
pub struct Node {
    /// Distance ahead, metres.
    pub z_m: f32,
    /// Lateral position of the middle of the ego lane, metres, right positive.
    pub lateral_m: f32,
    /// Height above the plane on which the car stands, metres.
    pub rise_m: f32,
}

/// The road ahead as points whose spacing grows with distance, up to about 500 m.
#[derive(Clone, Debug)]
pub struct RoadAhead {
    /// Points, the nearest first.
    pub nodes: [Node; Self::NODES],
}

impl RoadAhead {
    const NODES: usize = 118;

    /// The road at distance `z_m`, interpolated between points; `None` beyond the last point.
    pub fn at(&self, z_m: f32) -> Option<Node> {
        let next = self.nodes.iter().position(|n| n.z_m > z_m)?;
        let (a, b) = (self.nodes[next.checked_sub(1)?], self.nodes[next]);
        let t = (z_m - a.z_m) / (b.z_m - a.z_m);
        Some(Node {
            z_m,
            lateral_m: a.lateral_m + t * (b.lateral_m - a.lateral_m),
            rise_m: a.rise_m + t * (b.rise_m - a.rise_m),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_car_moves_forward_without_jumps() {
        let road = Road::new(Draws(5), &World::default());
        for i in 0..1_000 {
            let t = f64::from(i) * 0.1;
            let step = road.pose(t + 0.1).s_m - road.pose(t).s_m;
            let v = f64::from(road.speed_mps);
            assert!(
                (0.09 * v..0.11 * v).contains(&step),
                "{step} m in 0.1 s at {v} m/s"
            );
        }
    }

    #[test]
    fn the_road_begins_under_the_car_and_reaches_far() {
        let road = Road::new(Draws(9), &World::default());
        let ahead = road.ahead(&road.pose(12.0));
        assert!(ahead.nodes[117].z_m > 400.0, "{}", ahead.nodes[117].z_m);
        let near = ahead.at(0.2).expect("stations begin at 0");
        assert!(near.lateral_m.abs() < 0.05 && near.rise_m.abs() < 0.05);
        assert!(ahead.at(1e6).is_none());
    }
}
