//! What stands beside a stretch of a road that changes: objects, and belts along the road.

use super::belts::Belt;
use super::noise::Draws;
use super::road_kind::{RoadKind, Traits};
use super::surroundings::{ObjectKind, Rail, RoadsideObject};
use super::world::{Element, Look, World};

/// The roadside of one stretch.
pub struct Roadside {
    density: f32,
    traits: Traits,
    trees: ObjectKind,
    /// On the left and on the right.
    pub belts: [Option<Belt>; 2],
    /// On the left and on the right.
    pub rails: [Option<Rail>; 2],
}

impl Roadside {
    /// The roadside of a stretch.
    pub fn new(draws: Draws, kind: RoadKind, world: &World) -> Self {
        let traits = kind.traits();
        let uphill = usize::from(draws.chance("uphill", 0.5));
        let sides = ["left", "right"].map(|name| Draws(draws.seed(name)));
        let density = draws.range("density", traits.density.0, traits.density.1);
        Self {
            density: world.when(Element::Roadside, density, 0.0),
            trees: if world.look == Look::Game {
                ObjectKind::Conifer
            } else {
                ObjectKind::Tree
            },
            belts: [0, 1].map(|side| {
                Belt::drawn(sides[side], kind, side == uphill, world)
                    .filter(|_| world.has(Element::Roadside))
            }),
            rails: sides.map(|draws| {
                let rail = Draws(draws.seed("rail"));
                (world.has(Element::Rails) && rail.chance("there", traits.rail))
                    .then(|| Rail::new(rail))
            }),
            traits,
        }
    }

    /// How much of the sky the belts hide, 0 to 1.
    pub fn encloses(&self) -> f32 {
        let belts = self.belts.iter().flatten();
        belts.map(|belt| 0.5 * belt.hides()).sum()
    }

    /// The object in a cell of the grid of objects on the side `side` (-1 left, 1 right) of the asphalt.
    pub fn object(
        &self,
        draws: Draws,
        cell: i32,
        side: f32,
        edge_m: f32,
    ) -> Option<RoadsideObject> {
        if !draws.chance("there", self.density) {
            return None;
        }
        let kind = if draws.chance("building", self.traits.buildings) {
            ObjectKind::Building
        } else if draws.chance("post", self.traits.posts) {
            ObjectKind::Post
        } else if draws.chance("high", self.traits.high_trees) {
            ObjectKind::HighTree
        } else {
            self.trees
        };
        Some(RoadsideObject::drawn(
            draws,
            kind,
            cell,
            (side, edge_m),
            self.traits.clear,
        ))
    }
}
