//! Light and air of a nominal drive: sun, sky, haze and the exposure that follows them.

use super::noise::{BLOCK, Draws, NoiseColumn, NoiseRow};
use super::shade::Shade;
use super::world::{Element, Look, World};

/// A colour in linear light: red, green and blue; 1 is a white sheet in full light.
pub type Colour = [f32; 3];

/// Scales a colour.
#[inline(always)]
pub fn scaled(colour: Colour, by: f32) -> Colour {
    colour.map(|c| c * by)
}

/// Interpolates from `a` to `b` as `t` goes from 0 to 1.
#[inline(always)]
pub fn blended(a: Colour, b: Colour, t: f32) -> Colour {
    [
        a[0] + (b[0] - a[0]) * t,
        a[1] + (b[1] - a[1]) * t,
        a[2] + (b[2] - a[2]) * t,
    ]
}

/// The light of a drive.
#[derive(Clone, Debug)]
pub struct Light {
    /// Light that falls on the ground.
    pub ground: Colour,
    zenith: Colour,
    horizon: Colour,
    cloud_cover: f32,
    cloud_seed: u32,
    shadow_depth: f32,
    shadow_side: f64,
    shadow_seed: u32,
    shadow_density: f32,
    /// How clear the sky is, 0 to 1.
    pub clear: f32,
    /// Extinction of the air on a clear day, 1/m.
    pub extinction: f32,
    /// Brightness after exposure: about the pixel value of a mid-grey road.
    pub exposure: f32,
}

impl Light {
    /// The light of a drive: a day, from overcast to clear.
    pub fn new(draws: Draws, world: &World) -> Self {
        let clear = match world.look {
            Look::Sim | Look::Realistic => draws.range("clear sky", 0.0, 1.0),
            Look::Game => draws.range("clear sky", 0.7, 1.0),
        };
        let warm = draws.range("warmth", 0.0, 1.0);
        let ground = blended([0.92, 0.97, 1.05], [1.08, 0.99, 0.86], warm * clear);
        let grey = [0.78, 0.80, 0.83];
        let low = blended([0.66, 0.78, 0.95], [0.95, 0.86, 0.72], warm * 0.7);
        let (high, low) = match world.look {
            Look::Sim => ([0.18, 0.36, 0.74], low),
            // A real sensor, exposed for the road, clips the sky near the horizon.
            Look::Realistic => ([0.30, 0.46, 0.78], scaled(low, 1.35)),
            Look::Game => ([0.08, 0.28, 0.80], [0.62, 0.82, 1.0]),
        };
        let shadow_depth = match world.look {
            Look::Sim => (0.62 * clear - 0.1).max(0.0),
            Look::Realistic => (0.75 * clear - 0.1).max(0.0),
            Look::Game => 0.7,
        };
        Self {
            ground: match world.look {
                Look::Sim | Look::Realistic => ground,
                Look::Game => [1.25, 1.16, 0.98],
            },
            zenith: blended(scaled(grey, 0.85), high, clear),
            horizon: blended(grey, low, clear),
            cloud_cover: world.when(
                Element::Clouds,
                draws.range("cloud cover", 0.25, 0.75),
                -1.0,
            ),
            cloud_seed: draws.seed("clouds"),
            shadow_depth: world.when(Element::Shadows, shadow_depth, 0.0),
            shadow_side: if draws.chance("shadow side", 0.5) {
                1.0
            } else {
                -1.0
            },
            shadow_seed: draws.seed("shadows"),
            clear,
            shadow_density: draws.range("shadow density", 0.35, 0.72),
            extinction: match world.look {
                Look::Sim | Look::Game => 0.0,
                Look::Realistic => draws.range("air", 0.0003, 0.0020),
            },
            exposure: world.when(Element::Exposure, draws.range("exposure", 0.75, 1.30), 1.0),
        }
    }

    /// This light when a share `sun` of it passes the clouds, in air with an additional extinction of `haze`.
    pub fn changed(&self, sun: f32, haze: f32) -> Self {
        Self {
            ground: scaled(self.ground, sun),
            shadow_depth: self.shadow_depth * sun,
            extinction: self.extinction + haze,
            ..self.clone()
        }
    }

    /// Light on what stands along a side of the road (0 left, 1 right) and faces it: the sun shines on one of them.
    pub fn on_side(&self, side: usize) -> f32 {
        let sunny = (self.shadow_side > 0.0) == (side == 0);
        if sunny {
            1.0
        } else {
            1.0 - 0.9 * self.shadow_depth
        }
    }

    /// The sky in the directions `azimuths` (radians, right positive) at one elevation (radians, above 0).
    #[inline(always)]
    pub fn sky(&self, azimuths: &[f32], elevation: f32, colours: &mut [Colour]) {
        let up = (elevation / 0.5).clamp(0.0, 1.0);
        let clear = blended(self.horizon, self.zenith, up);
        if up <= 0.0 || self.cloud_cover < 0.0 {
            colours.fill(clear);
            return;
        }
        let sheet = 0.25 / f64::from(elevation.max(0.02));
        let large = NoiseColumn::new(self.cloud_seed, sheet);
        let small = NoiseColumn::new(self.cloud_seed ^ 1, 2.3 * sheet);
        for (azimuths, colours) in azimuths.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let large = large.block(azimuths, |azimuth| f64::from(azimuth) * sheet * 1.5);
            let small = small.block(azimuths, |azimuth| 2.3 * (f64::from(azimuth) * sheet * 1.5));
            for ((colour, large), small) in colours.iter_mut().zip(&large).zip(&small) {
                let puff = 0.65 * large + 0.35 * small;
                let cover = ((puff - 1.0 + self.cloud_cover) * 4.0).clamp(0.0, 1.0) * up;
                *colour = blended(clear, [0.93, 0.94, 0.96], 0.8 * cover);
            }
        }
    }

    /// Lights the road at arc length `s_m` and offsets `d_m`; roadside shadows fall across it. The row shows a length of
    /// `length_m` of it, which is in `shade`.
    #[inline(always)]
    pub fn fall_on(
        &self,
        s_m: f64,
        length_m: f32,
        d_m: &[f32],
        shade: Shade,
        colours: &mut [Colour],
    ) {
        self.fall_in_the_open(s_m, d_m, colours);
        if shade.canopy > 0.01 {
            self.fall_through_trees(s_m, length_m, d_m, shade.canopy, colours);
        }
        if shade.roof > 0.01 {
            for colour in colours {
                *colour = scaled(*colour, 1.0 - 0.82 * shade.roof);
            }
        }
    }

    /// Shades the road under trees, where the sun shines through gaps.
    #[inline(always)]
    fn fall_through_trees(
        &self,
        s_m: f64,
        length_m: f32,
        d_m: &[f32],
        canopy: f32,
        colours: &mut [Colour],
    ) {
        let leaves = NoiseRow::new(self.shadow_seed ^ 2, s_m / 1.4);
        let crowns = NoiseRow::new(self.shadow_seed ^ 3, s_m / 7.0);
        let fine = (0.9 / length_m).min(1.0);
        let dark = canopy * (0.5 + 0.42 * self.clear);
        for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let leaves = leaves.block(d_m, |d| f64::from(d) / 1.1);
            let crowns = crowns.block(d_m, |d| f64::from(d) / 5.0);
            for ((colour, leaf), crown) in colours.iter_mut().zip(&leaves).zip(&crowns) {
                let gap = 0.55 * crown + 0.45 * (0.5 + fine * (leaf - 0.5));
                let gap = ((gap - 0.40 - 0.22 * canopy) * 7.0).clamp(0.0, 1.0);
                let kept = 1.0 - dark * (1.0 - gap);
                // What comes through leaves is the light of the sky.
                let blue = 0.12 * self.clear * (1.0 - kept);
                *colour = [
                    colour[0] * kept * (1.0 - blue),
                    colour[1] * kept,
                    colour[2] * kept * (1.0 + 2.0 * blue),
                ];
            }
        }
    }

    #[inline(always)]
    fn fall_in_the_open(&self, s_m: f64, d_m: &[f32], colours: &mut [Colour]) {
        let lit = |colour: Colour| [0, 1, 2].map(|i| colour[i] * self.ground[i]);
        if self.shadow_depth <= 0.02 {
            for colour in colours {
                *colour = lit(*colour);
            }
            return;
        }
        let shadows = NoiseRow::new(self.shadow_seed, s_m / 7.0);
        for (d_m, colours) in d_m.chunks(BLOCK).zip(colours.chunks_mut(BLOCK)) {
            let reaches = shadows.block(d_m, |d| f64::from(d) / 9.0);
            for ((colour, &d_m), reach) in colours.iter_mut().zip(d_m).zip(&reaches) {
                let side = (f64::from(d_m) * self.shadow_side + 6.0).clamp(0.0, 12.0) as f32 / 12.0;
                let dark =
                    ((reach - self.shadow_density + 0.25 * (side - 0.5)) * 6.0).clamp(0.0, 1.0);
                *colour = scaled(lit(*colour), 1.0 - self.shadow_depth * dark);
            }
        }
    }
}
