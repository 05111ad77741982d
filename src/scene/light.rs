//! Light and air of a nominal drive: sun, sky, haze and the exposure that follows them.

use super::noise::{Draws, value_noise};

/// A linear-light colour, red, green, blue; 1 is a white sheet in full light.
pub type Colour = [f32; 3];

/// Scales a colour.
pub fn scaled(colour: Colour, by: f32) -> Colour {
    colour.map(|c| c * by)
}

/// Goes from `a` to `b` as `t` goes from 0 to 1.
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
    /// Brightness after exposure: pixel value of a mid-grey road, about.
    pub exposure: f32,
}

impl Light {
    /// The light of a drive: day, from overcast to clear.
    pub fn new(draws: Draws) -> Self {
        let clear = draws.range("clear sky", 0.0, 1.0);
        let warm = draws.range("warmth", 0.0, 1.0);
        let ground = blended([0.92, 0.97, 1.05], [1.08, 0.99, 0.86], warm * clear);
        let grey = [0.78, 0.80, 0.83];
        Self {
            ground,
            zenith: blended(scaled(grey, 0.85), [0.18, 0.36, 0.74], clear),
            horizon: blended(
                grey,
                blended([0.66, 0.78, 0.95], [0.95, 0.86, 0.72], warm * 0.7),
                clear,
            ),
            cloud_cover: draws.range("cloud cover", 0.25, 0.75),
            cloud_seed: draws.seed("clouds"),
            shadow_depth: (0.62 * clear - 0.1).max(0.0),
            shadow_side: if draws.chance("shadow side", 0.5) {
                1.0
            } else {
                -1.0
            },
            shadow_seed: draws.seed("shadows"),
            shadow_density: draws.range("shadow density", 0.35, 0.72),
            exposure: draws.range("exposure", 0.75, 1.30),
        }
    }

    /// The sky in direction `azimuth` (radians, right positive) and `elevation` (radians, above 0).
    pub fn sky(&self, azimuth: f32, elevation: f32) -> Colour {
        let up = (elevation / 0.5).clamp(0.0, 1.0);
        let clear = blended(self.horizon, self.zenith, up);
        let sheet = 0.25 / f64::from(elevation.max(0.02));
        let (x, y) = (f64::from(azimuth) * sheet * 1.5, sheet);
        let puff = 0.65 * value_noise(self.cloud_seed, x, y)
            + 0.35 * value_noise(self.cloud_seed ^ 1, 2.3 * x, 2.3 * y);
        let cover = ((puff - 1.0 + self.cloud_cover) * 4.0).clamp(0.0, 1.0) * up.min(1.0);
        blended(clear, [0.93, 0.94, 0.96], 0.8 * cover)
    }

    /// Share of light left on the road at arc length `s_m`, offset `d_m`: roadside shadows fall across it.
    pub fn shade(&self, s_m: f64, d_m: f32) -> f32 {
        if self.shadow_depth <= 0.02 {
            return 1.0;
        }
        let reach = value_noise(self.shadow_seed, s_m / 7.0, f64::from(d_m) / 9.0);
        let side = (f64::from(d_m) * self.shadow_side + 6.0).clamp(0.0, 12.0) as f32 / 12.0;
        let dark = ((reach - self.shadow_density + 0.25 * (side - 0.5)) * 6.0).clamp(0.0, 1.0);
        1.0 - self.shadow_depth * dark
    }
}
