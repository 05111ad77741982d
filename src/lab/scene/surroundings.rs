//! What is around the paint: asphalt, verge, far hills, and objects along the roadside.

use super::light::{Colour, blended, scaled};
use super::noise::{Draws, NoiseRow, hash, unit, wander};
use super::world::{Element, Look, World};

/// Ground and roadside of a drive.
#[derive(Clone, Debug)]
pub struct Surroundings {
    asphalt: Colour,
    roughness: f32,
    asphalt_seed: u32,
    tracks: f32,
    patches: f32,
    /// Offset of the joint along the road from the middle of each lane, metres, and distance between joints across the
    /// road.
    joints: Option<(f32, f64)>,
    joint_tone: f32,
    /// Darkness of the oil in the middle of lanes.
    oil: f32,
    /// Length after which textures repeat, metres; infinite in a world without repetition.
    tile_m: f64,
    /// Base colour of the verge.
    pub verge: Colour,
    verge_texture: f32,
    verge_seed: u32,
    hill_seed: u32,
    hill_height: f32,
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
    /// A box with rows of windows.
    Building,
    /// A thin post; some posts have a plate.
    Post,
}

/// Spacing of the roadside grid, whose cells may hold one object on each side, metres.
const OBJECT_CELL_M: f64 = 9.0;

impl Surroundings {
    /// The surroundings of a drive.
    pub fn new(draws: Draws, world: &World) -> Self {
        let grey = match world.look {
            Look::Sim | Look::Realistic => draws.range("asphalt", 0.07, 0.30),
            Look::Game => draws.range("asphalt", 0.05, 0.12),
        };
        let tint = match world.look {
            Look::Sim | Look::Realistic => draws.range("asphalt tint", -0.06, 0.06),
            Look::Game => -0.22,
        };
        let green = draws.range("green", 0.0, 1.0);
        let rough = match world.look {
            Look::Sim | Look::Game => draws.range("roughness", 0.06, 0.30),
            Look::Realistic => draws.range("roughness", 0.20, 0.50),
        };
        let joint = draws.chance(
            "joints",
            match world.look {
                Look::Sim | Look::Game => 0.4,
                Look::Realistic => 0.8,
            },
        );
        Self {
            asphalt: [grey * (1.0 + tint), grey, grey * (1.0 - tint)],
            roughness: world.when(Element::Texture, rough, 0.0),
            asphalt_seed: draws.seed("asphalt grain"),
            tracks: world.when(
                Element::Patches,
                draws.range("wheel tracks", -0.22, 0.10),
                0.0,
            ),
            patches: world.when(Element::Patches, draws.range("patches", 0.0, 0.45), 0.0),
            joints: (world.has(Element::Joints) && joint).then(|| {
                (
                    draws.range("joint offset", 1.2, 1.9),
                    f64::from(draws.range("joint spacing", 4.5, 30.0)),
                )
            }),
            joint_tone: draws.range("joint tone", 0.35, 0.75),
            oil: match world.look {
                Look::Sim | Look::Game => 0.0,
                Look::Realistic => draws.range("oil", 0.05, 0.30),
            },
            tile_m: match world.look {
                Look::Sim | Look::Realistic => f64::INFINITY,
                Look::Game => 8.0,
            },
            verge: match world.look {
                Look::Sim | Look::Realistic => {
                    blended([0.30, 0.24, 0.15], [0.10, 0.22, 0.06], green)
                }
                Look::Game => blended([0.42, 0.36, 0.10], [0.06, 0.34, 0.05], green),
            },
            verge_texture: world.when(Element::Texture, 1.0, 0.0),
            verge_seed: draws.seed("verge grain"),
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

    /// Ground textures along one image row at arc length `s_m`; `length_m` is the length of road that the row shows.
    pub fn ground_row(&self, s_m: f64, length_m: f32) -> GroundRow<'_> {
        let across = self.joints.is_some_and(|(_, spacing_m)| {
            let half_m = 0.5 * f64::from(length_m).max(0.06);
            length_m < 2.0 && (s_m + half_m).rem_euclid(spacing_m) < 2.0 * half_m
        });
        let joint = if across {
            (0.06 / length_m.max(0.06)).min(1.0)
        } else {
            0.0
        };
        let s_m = if self.tile_m.is_finite() {
            s_m.rem_euclid(self.tile_m)
        } else {
            s_m
        };
        GroundRow {
            of: self,
            joint,
            fine: NoiseRow::new(self.asphalt_seed, s_m / 0.25),
            coarse: NoiseRow::new(self.asphalt_seed ^ 1, s_m / 6.0),
            patch: NoiseRow::new(self.asphalt_seed ^ 2, s_m / 14.0),
            verge: NoiseRow::new(self.verge_seed, s_m / 0.7),
            field: NoiseRow::new(self.verge_seed ^ 1, s_m / 12.0),
            fine_share: (0.5 / length_m.max(1e-3)).min(1.0),
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
        blended(scaled(self.verge, 1.1), [0.45, 0.52, 0.60], 0.55)
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
        Some(RoadsideObject {
            s_m: (f64::from(cell) + f64::from(unit(draws.seed("place")))) * OBJECT_CELL_M,
            d_m: edge_m + side * (clear_m + 0.5 * size_m.0),
            size_m,
            kind,
            colour,
            seed: draws.0,
        })
    }
}

/// Ground textures of one image row.
pub struct GroundRow<'a> {
    of: &'a Surroundings,
    /// Share of the row that is a joint across the road.
    joint: f32,
    fine: NoiseRow,
    coarse: NoiseRow,
    patch: NoiseRow,
    verge: NoiseRow,
    field: NoiseRow,
    fine_share: f32,
}

impl GroundRow<'_> {
    /// Asphalt at offset `d_m`; `lane_phase_m` is the distance to the middle of the nearest lane, and `width_m` is the
    /// width that the pixel covers.
    pub fn asphalt(&self, d_m: f32, lane_phase_m: f32, width_m: f32) -> Colour {
        let d = f64::from(d_m);
        let fine = (self.fine.at(d / 0.25) - 0.5) * self.fine_share;
        let coarse = self.coarse.at(d / 1.2) - 0.5;
        let track = 1.0 - ((lane_phase_m.abs() - 0.85).abs() / 0.45).min(1.0);
        let patch = if self.of.patches > 0.0 && self.patch.at(d / 5.0) > 0.66 {
            self.of.patches
        } else {
            0.0
        };
        let along = self.of.joints.map_or(0.0, |(at_m, _)| {
            ((0.04 + 0.5 * width_m - (lane_phase_m - at_m).abs()) / width_m)
                .clamp(0.0, (0.08 / width_m).min(1.0))
        });
        let oil = self.of.oil * (1.0 - (lane_phase_m.abs() / 0.5).min(1.0));
        let tone = (1.0 + self.of.roughness * (1.6 * fine + coarse))
            * (1.0 + self.of.tracks * track)
            * (1.0 - 0.4 * patch)
            * (1.0 - oil)
            * (1.0 - self.of.joint_tone * along.max(self.joint));
        scaled(self.of.asphalt, tone)
    }

    /// Verge at offset `d_m`.
    pub fn verge(&self, d_m: f32) -> Colour {
        let d = f64::from(d_m);
        let tuft = (self.verge.at(d / 0.7) - 0.5) * self.fine_share;
        let field = self.of.verge_texture * self.field.at(d / 9.0);
        let dry = blended(self.of.verge, [0.36, 0.31, 0.18], 0.5 * field);
        scaled(
            dry,
            1.0 + self.of.verge_texture * (0.9 * tuft + 0.35 * (field - 0.5)),
        )
    }

    /// Share of snow at offset `d_m` if the share `cover` of the ground is under snow.
    pub fn snow(&self, d_m: f32, cover: f32) -> f32 {
        let d = f64::from(d_m);
        let depth = 0.6 * self.coarse.at(d / 1.2) + 0.4 * self.verge.at(d / 0.7);
        // The noise is between 0.1 and 0.9 almost everywhere.
        ((0.1 + 0.8 * cover - depth) * 8.0 + 0.5).clamp(0.0, 1.0)
            * if cover > 0.0 { 0.95 } else { 0.0 }
    }
}

impl Rail {
    fn new(draws: Draws) -> Self {
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
