//! What stands beside a stretch of a road that changes: objects, and belts along the road.

use super::belts::Belt;
use super::moment::Moment;
use super::noise::{Draws, hash};
use super::road_kind::{RoadKind, Traits};
use super::surroundings::{OBJECT_CELL_M, ObjectKind, Rail, RoadsideObject};
use super::world::{Element, Look, World};

/// Distances at which objects begin to rise into view, and at which they have their size, metres.
const RISE_M: (f32, f32) = (260.0, 200.0);

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

    fn object(&self, draws: Draws, cell: i32, side: f32, edge_m: f32) -> Option<RoadsideObject> {
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

impl Moment<'_> {
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
