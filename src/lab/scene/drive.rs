//! A drive: everything that is drawn from its seed.

use super::changes::Changes;
use super::conditions::Condition;
use super::light::{Colour, Light};
use super::markings::{Cross, Layout};
use super::noise::{Draws, hash};
use super::projection::CameraMount;
use super::road::Road;
use super::sensor::Sensor;
use super::surroundings::Surroundings;
use super::traffic::Traffic;
use super::world::{Look, World};

/// A drive that can be rendered at any time.
#[derive(Clone, Debug)]
pub struct Drive {
    pub(super) seed: u32,
    pub(super) road: Road,
    pub(super) layout: Layout,
    pub(super) changes: Option<Changes>,
    pub(super) surroundings: Surroundings,
    pub(super) traffic: Traffic,
    pub(super) light: Light,
    pub(super) camera: CameraMount,
    pub(super) sensor: Sensor,
    /// Colour of the own bonnet, if it is in view.
    pub(super) bonnet: Option<Colour>,
    pub(super) conditions: Vec<Condition>,
    pub(super) unlit: bool,
}

impl Drive {
    /// The drive with a seed, in a world and under a list of conditions.
    pub fn new(world: &World, seed: u64, conditions: &[Condition]) -> Self {
        let seed = hash((seed >> 32) as u32, seed as u32 as i32, 0);
        let part = |name| Draws(Draws(seed).seed(name));
        let cross = Cross::new(part("layout"), world);
        let layout = cross.layout();
        let changes = (world.stretch_m > 0).then(|| Changes::new(part("stretches"), world, cross));
        Self {
            seed,
            road: Road::new(part("road"), world),
            layout,
            changes,
            surroundings: Surroundings::new(part("surroundings"), world),
            traffic: Traffic::new(part("traffic"), world),
            light: Light::new(part("light"), world),
            camera: CameraMount::new(part("camera"), world),
            sensor: Sensor::new(part("sensor"), world),
            bonnet: (world.look == Look::Game).then(|| {
                part("bonnet").pick("paint", &[[0.04, 0.04, 0.05], [0.30, 0.02, 0.02], [0.5; 3]])
            }),
            conditions: conditions.to_vec(),
            unlit: world.unlit,
        }
    }
}
