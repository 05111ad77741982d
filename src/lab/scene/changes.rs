//! What changes along a drive, and how each stretch looks.

use super::bridge::Bridge;
use super::light::Light;
use super::markings::Cross;
use super::noise::{Draws, smooth, wander};
use super::road_kind::RoadKind;
use super::roadside::Roadside;
use super::sequence::{Sequence, Stretch};
use super::surroundings::Surroundings;
use super::textures::Textures;
use super::world::{Element, World};

/// Time in which clouds come before the sun, seconds.
const CLOUD_S: f64 = 9.0;

/// What changes along a drive, and from what.
#[derive(Clone, Debug)]
pub struct Changes {
    pub sequence: Sequence,
    pub world: World,
    cross: Cross,
    draws: Draws,
}

impl Changes {
    /// The changes of a drive that begins with the cross-section `cross`.
    pub fn new(draws: Draws, world: &World, cross: Cross) -> Self {
        Self {
            sequence: Sequence::new(draws, world.stretch_m, cross.two_way()),
            world: world.clone(),
            cross,
            draws,
        }
    }

    /// Light of the sun at `t_s`, as a share of that without clouds.
    pub fn sun(&self, light: &Light, t_s: f64) -> f32 {
        if !self.world.has(Element::Sunlight) {
            return 1.0;
        }
        let cloud = wander(self.draws.seed("sun"), t_s / CLOUD_S)
            + 0.5 * wander(self.draws.seed("sun fast"), t_s / (0.37 * CLOUD_S));
        let often = self.draws.range("clouds before the sun", -0.6, 0.5);
        let hidden = smooth((1.8 * (cloud + often)).clamp(0.0, 1.0));
        1.0 - hidden * (0.25 + 0.5 * light.clear)
    }
}

/// How one stretch looks.
pub struct Appearance {
    pub cross: Cross,
    pub textures: Textures,
    pub roadside: Option<Roadside>,
    pub bridge: Option<Bridge>,
    pub hill_height: f32,
    pub canopy: f32,
    /// How much of the sky is hidden by what stands beside the road, 0 to 1.
    pub enclosed: f32,
    pub extinction: f32,
}

impl Appearance {
    /// How a stretch of a drive with the surroundings `base` looks.
    pub fn of(stretch: &Stretch, changes: &Changes, base: &Surroundings) -> Self {
        let world = &changes.world;
        let traits = stretch.kind.traits();
        let part = |name| Draws(stretch.draws.seed(name));
        let range = |name, (low, high): (f32, f32)| stretch.draws.range(name, low, high);
        let scenery = world.has(Element::Scenery);
        let roadside = scenery.then(|| Roadside::new(part("roadside"), stretch.kind, world));
        Self {
            cross: if world.has(Element::Markings) {
                changes.cross.changed(part("markings"), &traits, world)
            } else {
                changes.cross.clone()
            },
            textures: base.textures.changed(
                part("ground"),
                world,
                scenery.then_some(stretch.kind == RoadKind::City),
            ),
            enclosed: roadside.as_ref().map_or(0.0, Roadside::encloses),
            roadside,
            bridge: Bridge::of(stretch, &traits, world),
            hill_height: if scenery && world.has(Element::FarHills) {
                range("hills", traits.hills)
            } else {
                base.hill_height
            },
            canopy: world.when(Element::Canopy, range("canopy", traits.canopy), 0.0),
            extinction: if world.has(Element::Haze) && stretch.draws.chance("haze", 0.25) {
                range("extinction", (0.001, 0.007))
            } else {
                0.0
            },
        }
    }
}
