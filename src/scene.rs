//! The road simulator: labelled frames of drives, for training the lane model and for shifts with a known truth.
//!
//! A [`Drive`] is a road, its paint, its surroundings, traffic, light and a camera, all drawn from one seed. Any moment
//! of it can be rendered at once; the same seed, time and size give the same bytes on every machine and thread. It models
//! what the lane task needs and nothing else: a road surface of clothoids and hills, boards standing on it, light, lens.
//!
//! Data flow: `Road`, `Layout`, `Surroundings`, `Traffic`, `Light` → [`Renderer`] (linear light and depth) → weather →
//! lens → sensor → 8-bit frame and lane mask. A [`World`] says in which look, and with which elements.
//!
//! Pixel arithmetic converts between integers and floats on every line, inside ranges that the code fixes.
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod canvas;
mod conditions;
mod lens;
mod light;
mod markings;
mod noise;
mod projection;
mod render;
mod road;
mod sensor;
mod spec;
mod surroundings;
mod traffic;
mod tunnel;
mod weather;
mod world;

pub use conditions::{Condition, ConditionError, ConditionKind, Severities, severities_at};
pub use render::{Labelled, Renderer};
pub use spec::{DriveSpec, SpecError};
pub use world::{Element, Look, World, WorldError};

use light::{Colour, Light};
use markings::Layout;
use noise::{Draws, hash};
use projection::CameraMount;
use road::Road;
use sensor::Sensor;
use surroundings::Surroundings;
use traffic::Traffic;

/// Seed of the drive and time in it, seconds, of scene `index` of the scene set `set`: one moment of a drive of its own.
///
/// Seeds of scene sets lie above 32 bits: no scene is a moment of a drive that a user can name by a small seed.
pub fn scene_moment(set: u32, index: u32) -> (u64, f64) {
    let seed = (u64::from(set) + 1) << 32 | u64::from(index);
    (seed, f64::from(index % 600))
}

/// A drive that can be rendered at any time.
#[derive(Clone, Debug)]
pub struct Drive {
    seed: u32,
    road: Road,
    layout: Layout,
    surroundings: Surroundings,
    traffic: Traffic,
    light: Light,
    camera: CameraMount,
    sensor: Sensor,
    /// Colour of the own bonnet, where it is in view.
    bonnet: Option<Colour>,
    conditions: Vec<Condition>,
}

impl Drive {
    /// The drive of a seed in a world under a list of conditions.
    pub fn new(world: &World, seed: u64, conditions: &[Condition]) -> Self {
        let seed = hash((seed >> 32) as u32, seed as u32 as i32, 0);
        let part = |name| Draws(Draws(seed).seed(name));
        Self {
            seed,
            road: Road::new(part("road"), world),
            layout: Layout::new(part("layout"), world),
            surroundings: Surroundings::new(part("surroundings"), world),
            traffic: Traffic::new(part("traffic"), world),
            light: Light::new(part("light"), world),
            camera: CameraMount::new(part("camera"), world),
            sensor: Sensor::new(part("sensor"), world),
            bonnet: (world.look == Look::Game).then(|| {
                part("bonnet").pick("paint", &[[0.04, 0.04, 0.05], [0.30, 0.02, 0.02], [0.5; 3]])
            }),
            conditions: conditions.to_vec(),
        }
    }
}
