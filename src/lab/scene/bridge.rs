//! Bridges over a road that changes.

use super::canvas::Canvas;
use super::light::{Colour, blended, scaled};
use super::moment::Moment;
use super::noise::{RoughColumn, smooth};
use super::road_kind::Traits;
use super::sequence::Stretch;
use super::world::{Element, World};

/// Distance of the supports from the asphalt, metres.
const CLEAR_M: f32 = 2.2;
/// How far the embankments at its ends reach to the sides, metres.
const SIDE_M: f32 = 60.0;
/// A bridge is seen up to this distance, metres.
const REACH_M: f32 = 380.0;

/// A bridge.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    /// Arc lengths of its two sides, metres.
    ends_m: (f64, f64),
    /// Height of its underside and thickness of its deck, metres.
    under_m: f32,
    thick_m: f32,
    colour: Colour,
    /// How far the sun moves its shadow along the road, metres.
    shadow_m: f64,
}

impl Bridge {
    /// The bridge over a stretch, if it has one.
    pub fn of(stretch: &Stretch, traits: &Traits, world: &World) -> Option<Self> {
        let draws = stretch.draws;
        if !world.has(Element::Bridges) || !draws.chance("bridge", traits.bridge) {
            return None;
        }
        let share = f64::from(draws.range("bridge place", 0.3, 0.7));
        let at_m = stretch.ends_m.0 + share * (stretch.ends_m.1 - stretch.ends_m.0);
        let grey = draws.range("bridge grey", 0.18, 0.48);
        Some(Self {
            ends_m: (
                at_m,
                at_m + f64::from(draws.range("bridge width", 6.0, 18.0)),
            ),
            under_m: draws.range("bridge height", 4.8, 6.2),
            thick_m: draws.range("bridge thickness", 0.9, 1.9),
            colour: [grey, 0.97 * grey, 0.92 * grey],
            shadow_m: f64::from(draws.range("bridge shadow", -5.0, 5.0)),
        })
    }

    /// Share of the light that it takes from a place of the road.
    pub fn shade(&self, s_m: f64) -> f32 {
        let edge = |inside_m: f64| smooth((0.7 * inside_m as f32 + 0.5).clamp(0.0, 1.0));
        let s_m = s_m - self.shadow_m;
        edge(s_m - self.ends_m.0).min(edge(self.ends_m.1 - s_m))
    }
}

impl Moment<'_> {
    /// The bridges in view, with their distances.
    pub(super) fn bridges_ahead(&self) -> impl Iterator<Item = (f32, &Bridge)> {
        self.way.bridges().filter_map(|bridge| {
            let near_m = (bridge.ends_m.0 - self.pose.s_m) as f32;
            let far_m = (bridge.ends_m.1 - self.pose.s_m) as f32;
            (far_m > 1.5 && near_m < REACH_M).then_some((near_m, bridge))
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
        let supports_m = [edges_m.0 - CLEAR_M, edges_m.1 + CLEAR_M];
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
            let beyond_m = d_m + outwards * SIDE_M;
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
        let rows = super::standing::pixels(top - 0.5, foot + 0.5, canvas.height);
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
}
