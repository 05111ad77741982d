//! What lies and stands around the paint: asphalt, verge, far hills, and boxes along the roadside.

use super::light::{Colour, blended, scaled};
use super::noise::{Draws, NoiseRow, hash, unit, wander};

/// Ground and roadside of a drive.
#[derive(Clone, Debug)]
pub struct Surroundings {
    asphalt: Colour,
    roughness: f32,
    asphalt_seed: u32,
    tracks: f32,
    patches: f32,
    /// Base colour of the verge.
    pub verge: Colour,
    verge_seed: u32,
    hill_seed: u32,
    hill_height: f32,
    object_seed: u32,
    object_density: f32,
    buildings: f32,
}

/// A thing beside the road, drawn as an upright board.
#[derive(Clone, Copy, Debug)]
pub struct RoadsideObject {
    /// Arc length, metres.
    pub s_m: f64,
    /// Offset from the middle of the ego lane, metres.
    pub d_m: f32,
    /// Width and height, metres.
    pub size_m: (f32, f32),
    /// What it is.
    pub kind: ObjectKind,
    /// Its colour in full light.
    pub colour: Colour,
    /// Seed of its surface.
    pub seed: u32,
}

/// Kinds of roadside object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKind {
    /// A crown with ragged edge over a trunk.
    Tree,
    /// A box with rows of windows.
    Building,
    /// A slim post, some with a plate.
    Post,
}

/// Spacing of the roadside grid that may hold one object a side, metres.
const OBJECT_CELL_M: f64 = 9.0;

impl Surroundings {
    /// The surroundings of a drive.
    pub fn new(draws: Draws) -> Self {
        let grey = draws.range("asphalt", 0.07, 0.30);
        let tint = draws.range("asphalt tint", -0.06, 0.06);
        let green = draws.range("green", 0.0, 1.0);
        Self {
            asphalt: [grey * (1.0 + tint), grey, grey * (1.0 - tint)],
            roughness: draws.range("roughness", 0.06, 0.30),
            asphalt_seed: draws.seed("asphalt grain"),
            tracks: draws.range("wheel tracks", -0.22, 0.10),
            patches: draws.range("patches", 0.0, 0.45),
            verge: blended([0.30, 0.24, 0.15], [0.10, 0.22, 0.06], green),
            verge_seed: draws.seed("verge grain"),
            hill_seed: draws.seed("hills"),
            hill_height: draws.range("hill height", 0.0, 0.10),
            object_seed: draws.seed("objects"),
            object_density: draws.range("object density", 0.05, 0.75),
            buildings: draws.range("buildings", 0.0, 0.6),
        }
    }

    /// Ground textures along one image row at arc length `s_m`; `length_m` is the row's stretch of road.
    pub fn ground_row(&self, s_m: f64, length_m: f32) -> GroundRow<'_> {
        GroundRow {
            of: self,
            fine: NoiseRow::new(self.asphalt_seed, s_m / 0.25),
            coarse: NoiseRow::new(self.asphalt_seed ^ 1, s_m / 6.0),
            patch: NoiseRow::new(self.asphalt_seed ^ 2, s_m / 14.0),
            verge: NoiseRow::new(self.verge_seed, s_m / 0.7),
            field: NoiseRow::new(self.verge_seed ^ 1, s_m / 12.0),
            fine_share: (0.5 / length_m.max(1e-3)).min(1.0),
        }
    }

    /// Height of the far hills in direction `azimuth` of the compass, radians above the horizon.
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

    /// Objects between two arc lengths, farthest first; `edges_m` are the edges of the asphalt.
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
        } else {
            ObjectKind::Tree
        };
        let (clear_m, size_m, colour) = match kind {
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
    fine: NoiseRow,
    coarse: NoiseRow,
    patch: NoiseRow,
    verge: NoiseRow,
    field: NoiseRow,
    fine_share: f32,
}

impl GroundRow<'_> {
    /// Asphalt at offset `d_m`; `lane_phase` is the distance to the nearest lane's middle, metres.
    pub fn asphalt(&self, d_m: f32, lane_phase: f32) -> Colour {
        let d = f64::from(d_m);
        let fine = (self.fine.at(d / 0.25) - 0.5) * self.fine_share;
        let coarse = self.coarse.at(d / 1.2) - 0.5;
        let track = 1.0 - ((lane_phase.abs() - 0.85).abs() / 0.45).min(1.0);
        let patch = if self.patch.at(d / 5.0) > 0.66 {
            self.of.patches
        } else {
            0.0
        };
        let tone = (1.0 + self.of.roughness * (1.6 * fine + coarse))
            * (1.0 + self.of.tracks * track)
            * (1.0 - 0.4 * patch);
        scaled(self.of.asphalt, tone)
    }

    /// Verge at offset `d_m`.
    pub fn verge(&self, d_m: f32) -> Colour {
        let d = f64::from(d_m);
        let tuft = (self.verge.at(d / 0.7) - 0.5) * self.fine_share;
        let field = self.field.at(d / 9.0);
        let dry = blended(self.of.verge, [0.36, 0.31, 0.18], 0.5 * field);
        scaled(dry, 1.0 + 0.9 * tuft + 0.35 * (field - 0.5))
    }
}
