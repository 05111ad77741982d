//! What is around the paint: the ground, far hills, and objects along the roadside.

use super::light::{Colour, blended, scaled};
use super::noise::{Draws, hash, unit, wander};
use super::textures::Textures;
use super::world::{Element, Look, World};

/// Ground and roadside of a drive.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Textures of the ground.
    pub textures: Textures,
    hill_seed: u32,
    /// Height of the far hills, radians.
    pub hill_height: f32,
    object_seed: u32,
    object_density: f32,
    buildings: f32,
    conifers: bool,
    /// Rails on the left and on the right.
    pub rails: [Option<Rail>; 2],
}

/// A guard rail or barrier that follows the edge of the asphalt.
#[derive(Clone, Copy, Debug)]
pub struct Rail {
    /// Distance from the edge of the asphalt, metres.
    pub clear_m: f32,
    /// Lower and upper edge above the road, metres.
    pub height_m: (f32, f32),
    /// Its colour in full light.
    pub colour: Colour,
}

/// An object beside the road, drawn as an upright board.
#[derive(Clone, Copy, Debug)]
pub struct RoadsideObject {
    /// Arc length, metres.
    pub s_m: f64,
    /// Offset from the middle of the ego lane, metres.
    pub d_m: f32,
    /// Width and height, metres.
    pub size_m: (f32, f32),
    /// Kind of the object.
    pub kind: ObjectKind,
    /// Its colour in full light.
    pub colour: Colour,
    /// Seed of its surface.
    pub seed: u32,
}

/// Kinds of roadside object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKind {
    /// A crown with a ragged edge over a trunk.
    Tree,
    /// A cone on a short trunk.
    Conifer,
    /// A crown high above a trunk.
    HighTree,
    /// A box with rows of windows.
    Building,
    /// A thin post; some posts have a plate.
    Post,
}

/// Spacing of the roadside grid, whose cells may hold one object on each side, metres.
pub const OBJECT_CELL_M: f64 = 9.0;

impl Surroundings {
    /// The surroundings of a drive.
    pub fn new(draws: Draws, world: &World) -> Self {
        Self {
            textures: Textures::new(draws, world),
            hill_seed: draws.seed("hills"),
            hill_height: world.when(
                Element::FarHills,
                draws.range("hill height", 0.0, 0.10),
                0.0,
            ),
            object_seed: draws.seed("objects"),
            object_density: world.when(
                Element::Roadside,
                draws.range("object density", 0.05, 0.75),
                0.0,
            ),
            buildings: draws.range("buildings", 0.0, 0.6),
            conifers: world.look == Look::Game,
            rails: ["left rail", "right rail"].map(|name| {
                let rail = Draws(draws.seed(name));
                (world.has(Element::Rails) && rail.chance("there", 0.35)).then(|| Rail::new(rail))
            }),
        }
    }

    /// These surroundings with hills of another height, radians.
    pub fn with_hills(&self, hill_height: f32) -> Self {
        Self {
            hill_height,
            ..self.clone()
        }
    }

    /// Height of the far hills in the compass direction `azimuth`, radians above the horizon.
    pub fn hills(&self, azimuth: f64) -> f32 {
        self.hill_height
            * (0.55
                + 0.3 * wander(self.hill_seed, azimuth * 3.0)
                + 0.15 * wander(self.hill_seed ^ 1, azimuth * 11.0))
    }

    /// Colour of the far hills.
    pub fn hill_colour(&self) -> Colour {
        blended(scaled(self.textures.verge, 1.1), [0.45, 0.52, 0.60], 0.55)
    }

    /// Objects between two arc lengths, the farthest first; `edges_m` are the edges of the asphalt.
    pub fn objects(
        &self,
        from_m: f64,
        to_m: f64,
        edges_m: (f32, f32),
    ) -> impl Iterator<Item = RoadsideObject> + '_ {
        let cells = (from_m / OBJECT_CELL_M).floor() as i32..(to_m / OBJECT_CELL_M).floor() as i32;
        cells.rev().flat_map(move |cell| {
            [(-1.0_f32, edges_m.0), (1.0, edges_m.1)]
                .into_iter()
                .filter_map(move |(side, edge)| self.object(cell, side, edge))
        })
    }

    fn object(&self, cell: i32, side: f32, edge_m: f32) -> Option<RoadsideObject> {
        let draws = Draws(hash(self.object_seed, cell, side as i32));
        if !draws.chance("there", self.object_density) {
            return None;
        }
        let kind = if draws.chance("building", self.buildings) {
            ObjectKind::Building
        } else if draws.chance("post", 0.3) {
            ObjectKind::Post
        } else if self.conifers {
            ObjectKind::Conifer
        } else {
            ObjectKind::Tree
        };
        Some(RoadsideObject::drawn(
            draws,
            kind,
            cell,
            (side, edge_m),
            1.0,
        ))
    }
}

impl RoadsideObject {
    /// The object in a cell of the grid on the side `side` (-1 left, 1 right) of the asphalt, which ends at `edge_m`;
    /// its distance from there is `clear` times that on roads that do not change.
    pub fn drawn(
        draws: Draws,
        kind: ObjectKind,
        cell: i32,
        (side, edge_m): (f32, f32),
        clear: f32,
    ) -> Self {
        let (clear_m, size_m, colour) = match kind {
            ObjectKind::Conifer => (
                draws.range("clear", 2.0, 14.0),
                (draws.range("w", 2.0, 4.0), draws.range("h", 5.0, 14.0)),
                blended(
                    [0.02, 0.22, 0.05],
                    [0.05, 0.30, 0.16],
                    draws.range("hue", 0.0, 1.0),
                ),
            ),
            ObjectKind::Tree => (
                draws.range("clear", 2.0, 14.0),
                (draws.range("w", 2.0, 6.0), draws.range("h", 3.0, 10.0)),
                blended(
                    [0.05, 0.13, 0.03],
                    [0.16, 0.17, 0.06],
                    draws.range("hue", 0.0, 1.0),
                ),
            ),
            ObjectKind::HighTree => (
                draws.range("clear", 2.0, 12.0),
                (draws.range("w", 4.0, 9.0), draws.range("h", 9.0, 22.0)),
                blended(
                    [0.03, 0.08, 0.02],
                    [0.13, 0.14, 0.05],
                    draws.range("hue", 0.0, 1.0),
                ),
            ),
            ObjectKind::Building => (
                draws.range("clear", 8.0, 22.0),
                (draws.range("w", 7.0, 16.0), draws.range("h", 4.0, 15.0)),
                draws.pick(
                    "paint",
                    &[
                        [0.5, 0.45, 0.38],
                        [0.35, 0.18, 0.13],
                        [0.6, 0.6, 0.58],
                        [0.3, 0.32, 0.36],
                    ],
                ),
            ),
            ObjectKind::Post => (
                draws.range("clear", 0.8, 2.5),
                (draws.range("w", 0.12, 0.25), draws.range("h", 1.0, 6.0)),
                draws.pick(
                    "paint",
                    &[[0.4, 0.4, 0.42], [0.55, 0.55, 0.55], [0.25, 0.18, 0.12]],
                ),
            ),
        };
        Self {
            s_m: (f64::from(cell) + f64::from(unit(draws.seed("place")))) * OBJECT_CELL_M,
            d_m: edge_m + side * (clear_m * clear + 0.5 * size_m.0),
            size_m,
            kind,
            colour,
            seed: draws.0,
        }
    }
}

impl Rail {
    /// A rail with draws of its own.
    pub fn new(draws: Draws) -> Self {
        let concrete = draws.chance("concrete", 0.4);
        let grey = draws.range("grey", 0.25, 0.55);
        Self {
            clear_m: draws.range("clear", 0.1, 0.9),
            height_m: if concrete { (0.0, 0.9) } else { (0.42, 0.75) },
            colour: if concrete {
                [grey, 0.97 * grey, 0.92 * grey]
            } else {
                [0.9 * grey, 0.95 * grey, grey]
            },
        }
    }
}
