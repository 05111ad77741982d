//! Paints what stands beside a road that changes and over it: belts, bridges and objects.

use super::belts::Belt;
use super::bridge::Bridge;
use super::canvas::Canvas;
use super::light::{Colour, blended, scaled};
use super::moment::Moment;
use super::noise::{Draws, RoughColumn, hash};
use super::panels::pixels;
use super::surroundings::{OBJECT_CELL_M, RoadsideObject};
use super::textures::SNOW;

/// Belts are seen up to this distance, metres.
const BELT_REACH_M: f32 = 380.0;
/// Makes the outer one of two belts at the same distance the farther one; this is a share of its distance from the road.
const OUTER_FIRST: f32 = 1e-3;
/// The texture of a belt repeats after this length of road, metres.
const REPEAT_M: f64 = 4_096.0;
/// Distance of the supports from the asphalt, metres.
const SUPPORT_M: f32 = 2.2;
/// How far the embankments at its ends reach to the sides, metres.
const EMBANKMENT_M: f32 = 60.0;
/// A bridge is seen up to this distance, metres.
const BRIDGE_REACH_M: f32 = 380.0;

/// Distances at which objects begin to rise into view, and at which they have their size, metres.
const RISE_M: (f32, f32) = (260.0, 200.0);

/// A piece of a belt between two points of the road ahead.
#[derive(Clone, Copy)]
pub struct BeltPiece<'a> {
    belt: &'a Belt,
    /// 0 left, 1 right.
    side: usize,
    /// The stretch of the belt.
    stretch: usize,
    /// The farther point.
    node: usize,
}

impl Moment<'_> {
    /// The pieces of all belts, with their distances.
    pub(super) fn belt_pieces(&self) -> impl Iterator<Item = (f32, BeltPiece<'_>)> {
        let nodes = &self.ahead.nodes;
        (0..2).flat_map(move |side| {
            self.way.belts(side).flat_map(move |(stretch, belt)| {
                let (from_m, to_m) = if belt.ends_abruptly() {
                    self.way.ends_m(stretch, 0.0)
                } else {
                    self.way.ends_m(stretch, 0.5)
                };
                let ahead_m = |s_m: f64| (s_m - self.pose.s_m) as f32;
                let (from_m, to_m) = (ahead_m(from_m), ahead_m(to_m));
                (1..nodes.len()).filter_map(move |node| {
                    let (near_m, far_m) = (nodes[node - 1].z_m, nodes[node].z_m);
                    let there = far_m > from_m && near_m < to_m;
                    (there && near_m >= 1.0 && far_m < BELT_REACH_M).then_some((
                        far_m + OUTER_FIRST * belt.clear_m,
                        BeltPiece {
                            belt,
                            side,
                            stretch,
                            node,
                        },
                    ))
                })
            })
        })
    }

    /// Paints one piece of a belt.
    pub(super) fn paint_belt(
        &self,
        BeltPiece {
            belt,
            side,
            stretch,
            node,
        }: BeltPiece<'_>,
        canvas: &mut Canvas,
        mask: &mut [u8],
    ) {
        let corner = |node: usize| {
            let node = self.ahead.nodes[node];
            let s_m = self.pose.s_m + f64::from(node.z_m);
            let edges_m = self.way.edges_m(s_m);
            let d_m = if side == 0 {
                edges_m.0 - belt.clear_m
            } else {
                edges_m.1 + belt.clear_m
            };
            let height_m = if belt.ends_abruptly() {
                belt.height_m
            } else {
                belt.height_m * self.way.grown(stretch, s_m)
            };
            self.corner(&node, d_m, (0.0, height_m))
        };
        let ends = [corner(node - 1), corner(node)];
        let start_m = self.pose.s_m.rem_euclid(REPEAT_M) as f32;
        let middle_m = 0.5 * (ends[0].z_m + ends[1].z_m);
        let shade = self.way.shade(self.pose.s_m + f64::from(middle_m)).left();
        let sun = scaled(self.light.ground, shade * self.light.on_side(side));
        let snow = 0.4 * self.snow_on_verge();
        self.paint_panel(
            &ends,
            canvas,
            mask,
            |z_m| belt.column(start_m + z_m, z_m),
            |column, up| {
                let tone = belt.tone(column, up, up * belt.height_m)?;
                let colour = [0, 1, 2].map(|c| column.colour[c] * sun[c] * tone);
                Some(if snow > 0.0 {
                    blended(colour, SNOW, snow * up)
                } else {
                    colour
                })
            },
        );
    }

    /// The bridges in view, with their distances.
    pub(super) fn bridges_ahead(&self) -> impl Iterator<Item = (f32, &Bridge)> {
        self.way.bridges().filter_map(|bridge| {
            let near_m = (bridge.ends_m.0 - self.pose.s_m) as f32;
            let far_m = (bridge.ends_m.1 - self.pose.s_m) as f32;
            (far_m > 1.5 && near_m < BRIDGE_REACH_M).then_some((near_m, bridge))
        })
    }

    /// Paints a bridge: the underside, the supports, the deck, and the embankments beside it.
    pub(super) fn paint_bridge(&self, bridge: &Bridge, canvas: &mut Canvas, mask: &mut [u8]) {
        let near_m = ((bridge.ends_m.0 - self.pose.s_m) as f32).max(1.1);
        let far_m = (bridge.ends_m.1 - self.pose.s_m) as f32;
        let (Some(near), Some(far)) = (self.ahead.at(near_m), self.ahead.at(far_m)) else {
            return;
        };
        let sun = self.light.ground;
        let lit = |tone: f32| [0, 1, 2].map(|c| bridge.colour[c] * sun[c] * tone);
        let edges_m = self.way.edges_m(bridge.ends_m.0);
        let supports_m = [edges_m.0 - SUPPORT_M, edges_m.1 + SUPPORT_M];
        let bottom = |node| self.corner(node, 0.0, (0.0, bridge.under_m)).top;
        let (under_near, under_far) = (bottom(&near), bottom(&far));
        self.fill_rows((under_near, under_far), far.z_m, lit(0.16), canvas, mask);
        for d_m in supports_m {
            let ends = [&near, &far].map(|node| self.corner(node, d_m, (0.0, bridge.under_m)));
            let tone = |_: f32| ();
            self.paint_panel(&ends, canvas, mask, tone, |(), up| {
                Some(lit(0.3 + 0.1 * up))
            });
        }
        if bridge.ends_m.0 - self.pose.s_m < 1.1 {
            return;
        }
        let deck_m = bridge.under_m + bridge.thick_m;
        let verge = scaled(self.way.textures(bridge.ends_m.0).verge, 0.8);
        for (d_m, outwards) in supports_m.iter().zip([-1.0, 1.0]) {
            let beyond_m = d_m + outwards * EMBANKMENT_M;
            let ends = [*d_m, beyond_m].map(|d_m| self.corner(&near, d_m, (0.0, bridge.under_m)));
            let tufts = |_: f32| RoughColumn::new(3.0);
            self.paint_panel(&ends, canvas, mask, tufts, |tufts, up| {
                let tone = 0.7 + 0.5 * tufts.at(40.0 * up);
                Some([0, 1, 2].map(|c| verge[c] * sun[c] * tone))
            });
        }
        let deck = (self.corner(&near, 0.0, (0.0, deck_m)).top, under_near);
        self.fill_rows(deck, near.z_m, lit(0.8), canvas, mask);
    }

    /// Fills rows of the whole picture at a distance.
    fn fill_rows(
        &self,
        (top, foot): (f32, f32),
        z_m: f32,
        colour: Colour,
        canvas: &mut Canvas,
        mask: &mut [u8],
    ) {
        let crest = self.view.crest(z_m);
        let foot = foot.min(crest);
        let rows = pixels(top - 0.5, foot + 0.5, canvas.height);
        for y in rows {
            let cover = (foot.min(y as f32 + 1.0) - top.max(y as f32)).clamp(0.0, 1.0);
            let row = y * canvas.width..(y + 1) * canvas.width;
            for light in &mut canvas.light[row.clone()] {
                *light = blended(*light, colour, cover);
            }
            if cover > 0.5 {
                canvas.depth_m[row.clone()].fill(z_m);
                mask[row].fill(0);
            }
        }
    }

    /// Objects beside a road that changes.
    pub(super) fn changing_objects(&self) -> Vec<RoadsideObject> {
        let (from_m, to_m) = (self.pose.s_m + 5.0, self.pose.s_m + f64::from(RISE_M.0));
        let cells = (from_m / OBJECT_CELL_M).floor() as i32..(to_m / OBJECT_CELL_M).floor() as i32;
        let mut objects = Vec::new();
        for (cell, side) in cells.flat_map(|cell| [(cell, 0), (cell, 1)]) {
            let draws = Draws(hash(self.drive.seed, cell, 0x0B1 + side));
            let s_m = f64::from(cell) * OBJECT_CELL_M;
            let Some(roadside) = self.way.roadside(s_m, draws) else {
                continue;
            };
            let edges_m = self.way.edges_m(s_m);
            let side_edge = if side == 0 {
                (-1.0, edges_m.0)
            } else {
                (1.0, edges_m.1)
            };
            if let Some(mut object) = roadside.object(draws, cell, side_edge.0, side_edge.1) {
                let z_m = (object.s_m - self.pose.s_m) as f32;
                let risen = ((RISE_M.0 - z_m) / (RISE_M.0 - RISE_M.1)).clamp(0.05, 1.0);
                object.size_m.1 *= risen;
                objects.push(object);
            }
        }
        objects
    }
}
