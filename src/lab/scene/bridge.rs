//! Bridges over a road that changes.

use super::light::Colour;
use super::noise::smooth;
use super::road_kind::Traits;
use super::sequence::Stretch;
use super::world::{Element, World};

/// A bridge.
#[derive(Clone, Copy, Debug)]
pub struct Bridge {
    /// Arc lengths of its two sides, metres.
    pub ends_m: (f64, f64),
    /// Height of its underside and thickness of its deck, metres.
    pub under_m: f32,
    pub thick_m: f32,
    /// Its colour in full light.
    pub colour: Colour,
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
