//! A tunnel over a part of the road: walls, ceiling, lamps, and the light inside.

use super::canvas::Canvas;
use super::conditions::{Condition, ConditionKind, RAMP_S, TUNNEL_LIGHT, graded};
use super::light::{Colour, blended, scaled};
use super::noise::Draws;
use super::projection::Projection;
use super::road::{Road, RoadAhead};

/// Height of the ceiling, metres: road tunnels in Europe have a clear height of 4.5 to 5.5 m.
const CEILING_M: f32 = 5.5;
/// Distance between the asphalt's edge and the wall, metres.
const CLEAR_M: f32 = 0.8;
/// Distance between two ceiling lamps and length of one, metres.
const LAMPS_M: (f64, f64) = (9.0, 1.4);
/// Distance in the tunnel at which daylight has fallen to 1/e, metres.
const DAYLIGHT_REACH_M: f32 = 14.0;
/// Height of the portal's face, metres.
const PORTAL_M: f32 = 9.0;

/// A tunnel as seen from the car.
#[derive(Clone, Copy)]
pub struct Tunnel {
    /// Distances of its two ends ahead of the car, metres; negative behind it.
    ends_m: (f32, f32),
    /// Arc length of the car.
    s_m: f64,
    /// Left and right wall, metres from the middle of the ego lane.
    walls_m: (f32, f32),
    light: f32,
    tint: Colour,
}

impl Tunnel {
    /// The darkest tunnel of `conditions` that is near the car at arc length `s_m`.
    ///
    /// The car passes the entrance when the condition begins to grow, and the exit when the condition is gone. A tunnel
    /// without a span has no ends.
    pub fn near(
        conditions: &[Condition],
        road: &Road,
        asphalt_m: (f32, f32),
        s_m: f64,
        seed: u32,
    ) -> Option<Self> {
        let draws = Draws(seed);
        conditions
            .iter()
            .filter(|c| c.kind == ConditionKind::Tunnel && c.severity > 0.0)
            .map(|condition| {
                let ends = condition
                    .span_s
                    .map_or((f64::NEG_INFINITY, f64::INFINITY), |(full_s, gone_s)| {
                        (road.pose(full_s - RAMP_S).s_m, road.pose(gone_s).s_m)
                    });
                Self {
                    ends_m: ((ends.0 - s_m) as f32, (ends.1 - s_m) as f32),
                    s_m,
                    walls_m: (asphalt_m.0 - CLEAR_M, asphalt_m.1 + CLEAR_M),
                    light: graded(TUNNEL_LIGHT, condition.severity),
                    tint: draws.pick(
                        "tunnel lamps",
                        &[[1.0, 0.80, 0.50], [1.0, 0.97, 0.90], [0.92, 0.98, 1.0]],
                    ),
                }
            })
            .filter(|tunnel| tunnel.ends_m.1 > 0.0 && tunnel.ends_m.0 < 450.0)
            .min_by(|a, b| a.light.total_cmp(&b.light))
    }

    /// Whether an object beside the road at distance `z_m` would be inside the rock.
    pub fn covers(&self, z_m: f32) -> bool {
        (self.ends_m.0..self.ends_m.1).contains(&z_m)
    }

    /// Share of daylight at distance `z_m`: 1 outside; inside, the light of the lamps and portals.
    fn light_at(&self, z_m: f32) -> Colour {
        if !self.covers(z_m) {
            return [1.0; 3];
        }
        let inside_m = (z_m - self.ends_m.0).min(self.ends_m.1 - z_m);
        let day = libm::expf(-inside_m / DAYLIGHT_REACH_M);
        self.tint.map(|tint| self.light * tint * (1.0 - day) + day)
    }

    /// Paints walls and ceiling over everything except the ground between the walls, and darkens that ground.
    ///
    /// `aside_m` is the lateral position of the camera in the ego lane.
    pub fn paint(
        &self,
        canvas: &mut Canvas,
        mask: &mut [u8],
        projection: &Projection,
        ahead: &RoadAhead,
        aside_m: f32,
    ) {
        let sections: Vec<Section> = ahead
            .nodes
            .iter()
            .filter(|node| node.z_m > 1.0 && self.covers(node.z_m))
            .map(|node| {
                let x_m = |d_m: f32| d_m + node.lateral_m - aside_m;
                Section {
                    z_m: node.z_m,
                    left: projection.column(x_m(self.walls_m.0), node.z_m),
                    right: projection.column(x_m(self.walls_m.1), node.z_m),
                    top: projection.row(node.rise_m + CEILING_M, node.z_m),
                    foot: projection.row(node.rise_m, node.z_m),
                }
            })
            .collect();
        let Some(first) = sections.first() else {
            return;
        };
        let outside = self.ends_m.0 > 1.0;
        let view = View::new(&sections, canvas.width);
        for y in 0..canvas.height {
            let row = y as f32 + 0.5;
            let below_ceilings = view.below_ceilings(row);
            let mut lit = (f32::NAN, [1.0; 3]);
            for x in 0..canvas.width {
                let at = (x as f32 + 0.5, row);
                let pixel = y * canvas.width + x;
                let beyond = view.between_walls[x].min(below_ceilings);
                if outside && beyond == 0 {
                    let face_top = first.foot - (first.foot - first.top) * PORTAL_M / CEILING_M;
                    let beside = 1.5 * (first.right - first.left);
                    if at.1 < first.foot
                        && at.1 > face_top
                        && at.0 > first.left - beside
                        && at.0 < first.right + beside
                        && canvas.depth_m[pixel] > first.z_m
                    {
                        canvas.light[pixel] = [0.42, 0.41, 0.39];
                        canvas.depth_m[pixel] = first.z_m;
                        mask[pixel] = 0;
                    }
                    continue;
                }
                // What is nearer than the wall stays visible, in the light of the tunnel.
                let depth_m = canvas.depth_m[pixel];
                match met(&sections, beyond, at) {
                    Some(section) if section.z_m < depth_m => {
                        canvas.light[pixel] = self.lining(&section, at, projection);
                        canvas.depth_m[pixel] = section.z_m;
                        mask[pixel] = 0;
                    }
                    _ => {
                        if depth_m.total_cmp(&lit.0).is_ne() {
                            lit = (depth_m, self.light_at(depth_m));
                        }
                        canvas.light[pixel] = [0, 1, 2].map(|c| canvas.light[pixel][c] * lit.1[c]);
                    }
                }
            }
        }
    }

    /// Wall or ceiling where a ray leaves the tunnel at `section`.
    fn lining(&self, section: &Section, at: (f32, f32), projection: &Projection) -> Colour {
        let light = self.light_at(section.z_m);
        let lit = |grey: f32| light.map(|l| grey * l);
        if at.1 >= section.top + 1e-3 {
            let up = (section.foot - at.1) / (section.foot - section.top);
            return lit(if up < 0.18 { 0.22 } else { 0.48 });
        }
        // On the ceiling: the ray reaches the height of the lamps at another distance than that of the section.
        let rise_px = (projection.horizon_y - at.1).max(0.5);
        let z_m = (CEILING_M - projection.height_m) * projection.focal_px / rise_px;
        let across = (at.0 - section.left) / (section.right - section.left);
        let along_m = (self.s_m + f64::from(z_m)).rem_euclid(LAMPS_M.0);
        let lamp =
            along_m < LAMPS_M.1 && ((across - 0.3).abs() < 0.03 || (across - 0.7).abs() < 0.03);
        if lamp {
            blended(lit(0.3), scaled(self.tint, 1.2), self.light.sqrt())
        } else {
            lit(0.3)
        }
    }
}

/// How far the tunnel can be seen through: the number of sections before the first one that does not hold a ray.
struct View {
    /// For each column of the picture, as far as walls are concerned.
    between_walls: Vec<usize>,
    /// The lowest ceiling up to each section, pixels.
    ceilings: Vec<f32>,
}

impl View {
    fn new(sections: &[Section], width: usize) -> Self {
        let so_far = |edge: fn(&Section) -> f32, nearest: fn(f32, f32) -> f32| -> Vec<f32> {
            let edges = sections.iter().map(edge);
            edges
                .scan(None, |last, edge| {
                    let nearest = last.map_or(edge, |last| nearest(last, edge));
                    *last = Some(nearest);
                    Some(nearest)
                })
                .collect()
        };
        let (left, right) = (so_far(|s| s.left, f32::max), so_far(|s| s.right, f32::min));
        let columns = (0..width).map(|x| x as f32 + 0.5);
        Self {
            between_walls: columns
                .map(|x| {
                    let left = left.partition_point(|&left| x >= left);
                    left.min(right.partition_point(|&right| x <= right))
                })
                .collect(),
            ceilings: so_far(|s| s.top, f32::max),
        }
    }

    /// The number for a row of the picture, as far as ceilings are concerned.
    fn below_ceilings(&self, row: f32) -> usize {
        self.ceilings.partition_point(|&top| row >= top)
    }
}

/// Where a ray through `at` leaves the tunnel, which is before the section `beyond`; `None` if it does not leave it
/// before the last section.
fn met(sections: &[Section], beyond: usize, at: (f32, f32)) -> Option<Section> {
    let far = sections.get(beyond)?;
    let Some(near) = beyond.checked_sub(1).map(|i| &sections[i]) else {
        return Some(*far);
    };
    // Outlines are straight between two sections. This finds where the first of their edges crosses the ray.
    let crossing = |edge: fn(&Section) -> f32, at: f32, outside: bool| {
        if outside {
            ((at - edge(near)) / (edge(far) - edge(near))).clamp(0.0, 1.0)
        } else {
            1.0
        }
    };
    let share = crossing(|s| s.left, at.0, at.0 < far.left)
        .min(crossing(|s| s.right, at.0, at.0 > far.right))
        .min(crossing(|s| s.top, at.1, at.1 < far.top));
    Some(near.towards(far, share))
}

/// The tunnel's outline at one distance, pixels.
#[derive(Clone, Copy)]
struct Section {
    z_m: f32,
    left: f32,
    right: f32,
    top: f32,
    foot: f32,
}

impl Section {
    /// The outline between this section and a farther one.
    fn towards(&self, far: &Self, share: f32) -> Self {
        let at = |near: f32, far: f32| near + share * (far - near);
        Self {
            // Along a line in the picture, distances are evenly spaced in 1/z.
            z_m: 1.0 / at(1.0 / self.z_m, 1.0 / far.z_m),
            left: at(self.left, far.left),
            right: at(self.right, far.right),
            top: at(self.top, far.top),
            foot: at(self.foot, far.foot),
        }
    }
}
