//! Textures of the ground: asphalt with grain, wheel tracks, patches, oil and joints, the verge, and where snow lies.

use super::light::{Colour, blended, scaled};
use super::noise::{BLOCK, Draws, NoiseRow};
use super::world::{Element, Look, World};

/// Colour of snow in full light.
pub const SNOW: Colour = [0.86, 0.88, 0.92];

/// The textures of a drive.
#[derive(Clone, Debug)]
pub struct Textures {
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
}

impl Textures {
    /// The textures of a drive.
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
        }
    }

    /// The textures of a stretch of a road that changes; `paved` is whether the verge is a pavement, or `None` if the
    /// verge stays.
    pub fn changed(&self, draws: Draws, world: &World, paved: Option<bool>) -> Self {
        let drawn = Self::new(draws, world);
        let mut ground = self.clone();
        if world.has(Element::Surface) {
            ground = drawn.clone();
            if world.look != Look::Game {
                ground.asphalt = scaled(ground.asphalt, draws.range("old or new", 0.45, 1.35));
            }
        }
        let (verge, verge_texture) = match paved {
            None => (self.verge, self.verge_texture),
            Some(false) => (drawn.verge, drawn.verge_texture),
            Some(true) => {
                let grey = draws.range("pavement", 0.16, 0.34);
                (scaled([1.0, 0.98, 0.94], grey), 0.35 * drawn.verge_texture)
            }
        };
        Self {
            verge,
            verge_texture,
            verge_seed: self.verge_seed,
            ..ground
        }
    }

    /// These textures with the verge on the way to that of `other`.
    pub fn with_verge_towards(&self, other: &Self, share: f32) -> Self {
        Self {
            verge: blended(self.verge, other.verge, share),
            verge_texture: self.verge_texture + share * (other.verge_texture - self.verge_texture),
            ..self.clone()
        }
    }

    /// The textures along one image row at arc length `s_m`; `length_m` is the length of road that the row shows.
    pub fn row(&self, s_m: f64, length_m: f32) -> TextureRow<'_> {
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
        TextureRow {
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
}

/// The textures of one image row. Pixels are given by their offsets from the middle of the ego lane, metres.
pub struct TextureRow<'a> {
    of: &'a Textures,
    /// Share of the row that is a joint across the road.
    joint: f32,
    fine: NoiseRow,
    coarse: NoiseRow,
    patch: NoiseRow,
    verge: NoiseRow,
    field: NoiseRow,
    fine_share: f32,
}

impl TextureRow<'_> {
    /// Asphalt at the offsets `d_m`; lanes are `lane_m` wide, and a pixel covers `width_m`.
    #[inline(always)]
    pub fn asphalt(&self, d_m: &[f32], lane_m: f32, width_m: f32, colours: &mut [Colour]) {
        // Without joints, the joint along the road is infinitely far away.
        let joint_m = self.of.joints.map_or(f32::INFINITY, |(at_m, _)| at_m);
        let joint_share = (0.08 / width_m).min(1.0);
        for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let fine = self.fine.block(d_m, |d| f64::from(d) / 0.25);
            let coarse = self.coarse.block(d_m, |d| f64::from(d) / 1.2);
            let patch = if self.of.patches > 0.0 {
                self.patch.block(d_m, |d| f64::from(d) / 5.0)
            } else {
                [0.0; BLOCK]
            };
            let grains = fine.iter().zip(&coarse).zip(&patch);
            for ((colour, &d_m), ((fine, coarse), patch)) in colours.iter_mut().zip(d_m).zip(grains)
            {
                let fine = (fine - 0.5) * self.fine_share;
                let coarse = coarse - 0.5;
                let lane_phase_m = lane_phase(d_m, lane_m);
                let patch = if *patch > 0.66 { self.of.patches } else { 0.0 };
                let along = ((0.04 + 0.5 * width_m - (lane_phase_m - joint_m).abs()) / width_m)
                    .max(0.0)
                    .min(joint_share);
                let oil = self.of.oil * (1.0 - (lane_phase_m.abs() / 0.5).min(1.0));
                let tone = (1.0 + self.of.roughness * (1.6 * fine + coarse))
                    * (1.0 + self.of.tracks * track(lane_phase_m))
                    * (1.0 - 0.4 * patch)
                    * (1.0 - oil)
                    * (1.0 - self.of.joint_tone * along.max(self.joint));
                *colour = scaled(self.of.asphalt, tone);
            }
        }
    }

    /// Verge at the offsets `d_m`.
    #[inline(always)]
    pub fn verge(&self, d_m: &[f32], colours: &mut [Colour]) {
        let texture = self.of.verge_texture;
        for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let tufts = self.verge.block(d_m, |d| f64::from(d) / 0.7);
            let fields = self.field.block(d_m, |d| f64::from(d) / 9.0);
            for ((colour, tuft), field) in colours.iter_mut().zip(&tufts).zip(&fields) {
                let tuft = (tuft - 0.5) * self.fine_share;
                let field = texture * field;
                let dry = blended(self.of.verge, [0.36, 0.31, 0.18], 0.5 * field);
                *colour = scaled(dry, 1.0 + texture * (0.9 * tuft + 0.35 * (field - 0.5)));
            }
        }
    }

    /// Lays snow on the ground at the offsets `d_m`; `cover` is the share of the ground under snow at an offset.
    #[inline(always)]
    pub fn snow(&self, d_m: &[f32], cover: impl Fn(f32) -> f32, colours: &mut [Colour]) {
        for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let coarse = self.coarse.block(d_m, |d| f64::from(d) / 1.2);
            let tufts = self.verge.block(d_m, |d| f64::from(d) / 0.7);
            let depths = coarse.iter().zip(&tufts);
            for ((colour, &d_m), (coarse, tuft)) in colours.iter_mut().zip(d_m).zip(depths) {
                let depth = 0.6 * coarse + 0.4 * tuft;
                let cover = cover(d_m);
                // The noise is between 0.1 and 0.9 almost everywhere.
                let lies = ((0.1 + 0.8 * cover - depth) * 8.0 + 0.5).clamp(0.0, 1.0)
                    * if cover > 0.0 { 0.95 } else { 0.0 };
                *colour = blended(*colour, SNOW, lies);
            }
        }
    }
}

/// Distance to the middle of the nearest lane at the offset `d_m`, metres; lanes are `lane_m` wide.
#[inline(always)]
fn lane_phase(d_m: f32, lane_m: f32) -> f32 {
    d_m - lane_m * (d_m / lane_m).round()
}

/// How much a place is in a wheel track, 0 to 1, by its distance to the middle of the lane.
#[inline(always)]
fn track(lane_phase_m: f32) -> f32 {
    1.0 - ((lane_phase_m.abs() - 0.85).abs() / 0.45).min(1.0)
}

/// How much the offset `d_m` is in a wheel track, 0 to 1; lanes are `lane_m` wide.
#[inline(always)]
pub fn wheel_track(d_m: f32, lane_m: f32) -> f32 {
    track(lane_phase(d_m, lane_m))
}
