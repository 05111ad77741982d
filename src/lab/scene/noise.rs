//! Seeded randomness: the same number for the same seed and place on every machine and thread.
//!
//! Only integer arithmetic and IEEE additions and products are used, so that results are equal bit for bit everywhere.

use std::sync::OnceLock;

/// Number of pixels of an image row whose noise is calculated at once, which fills the vectors of any processor.
pub const BLOCK: usize = 32;

/// Mixes a seed and a lattice point into 32 well mixed bits.
#[inline(always)]
pub fn hash(seed: u32, x: i32, y: i32) -> u32 {
    let mut h = seed
        ^ (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77).rotate_left(13);
    h ^= h >> 16;
    h = h.wrapping_mul(0x7FEB_352D);
    h ^= h >> 15;
    h = h.wrapping_mul(0x846C_A68B);
    h ^ (h >> 16)
}

/// Maps hashed bits to `[0, 1)`.
#[inline(always)]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A uniform number in `[0, 1)` for item `i` of kind `k`.
pub fn uniform(seed: u32, i: usize, k: i32) -> f32 {
    unit(hash(seed, i as i32, k))
}

fn lattice(x: f64) -> (i32, f32) {
    let cell = x.floor();
    (cell as i64 as i32, (x - cell) as f32)
}

/// A smooth step of a share from 0 to 1.
#[inline(always)]
pub fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

#[inline(always)]
fn mix(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// Piecewise linear noise of one coordinate, `-1..1`. As a curvature, it gives a road of clothoids.
pub fn linear_noise(seed: u32, x: f64) -> f32 {
    let (cell, t) = lattice(x);
    let at = |i: i32| 2.0 * unit(hash(seed, i, 0)) - 1.0;
    mix(at(cell), at(cell.wrapping_add(1)), t)
}

/// Smooth noise of one coordinate, `-1..1`.
pub fn wander(seed: u32, x: f64) -> f32 {
    let (cell, t) = lattice(x);
    let at = |i: i32| 2.0 * unit(hash(seed, i, 1)) - 1.0;
    mix(at(cell), at(cell.wrapping_add(1)), smooth(t))
}

/// Smooth noise of two coordinates, `0..1`.
pub fn value_noise(seed: u32, x: f64, y: f64) -> f32 {
    NoiseRow::new(seed, x).at(y)
}

/// [`value_noise`] with the first coordinate fixed.
pub struct NoiseRow {
    seed: u32,
    cell: i32,
    t: f32,
}

impl NoiseRow {
    /// Fixes the first coordinate.
    pub fn new(seed: u32, x: f64) -> Self {
        let (cell, t) = lattice(x);
        Self {
            seed,
            cell,
            t: smooth(t),
        }
    }

    /// The noise at the second coordinate, `0..1`.
    fn at(&self, y: f64) -> f32 {
        let (cell, t) = lattice(y);
        self.between(cell, smooth(t))
    }

    /// The noise of up to [`BLOCK`] pixels: `coordinate` maps a pixel to its second coordinate.
    #[inline(always)]
    pub fn block<T: Copy>(&self, pixels: &[T], coordinate: impl Fn(T) -> f64) -> [f32; BLOCK] {
        block(
            pixels,
            coordinate,
            #[inline(always)]
            |cell, t| self.between(cell, t),
        )
    }

    #[inline(always)]
    fn between(&self, cell: i32, t: f32) -> f32 {
        let corner = |i, j| unit(hash(self.seed, i, j));
        let (next_row, next) = (self.cell.wrapping_add(1), cell.wrapping_add(1));
        let near = mix(corner(self.cell, cell), corner(next_row, cell), self.t);
        let far = mix(corner(self.cell, next), corner(next_row, next), self.t);
        mix(near, far, t)
    }
}

/// [`value_noise`] with the second coordinate fixed.
pub struct NoiseColumn {
    seed: u32,
    cell: i32,
    t: f32,
}

impl NoiseColumn {
    /// Fixes the second coordinate.
    pub fn new(seed: u32, y: f64) -> Self {
        let (cell, t) = lattice(y);
        Self {
            seed,
            cell,
            t: smooth(t),
        }
    }

    /// The noise of up to [`BLOCK`] pixels: `coordinate` maps a pixel to its first coordinate.
    #[inline(always)]
    pub fn block<T: Copy>(&self, pixels: &[T], coordinate: impl Fn(T) -> f64) -> [f32; BLOCK] {
        block(
            pixels,
            coordinate,
            #[inline(always)]
            |cell, t| self.between(cell, t),
        )
    }

    #[inline(always)]
    fn between(&self, cell: i32, t: f32) -> f32 {
        let corner = |i, j| unit(hash(self.seed, i, j));
        let (next_column, next) = (self.cell.wrapping_add(1), cell.wrapping_add(1));
        let near = mix(corner(cell, self.cell), corner(next, self.cell), t);
        let far = mix(corner(cell, next_column), corner(next, next_column), t);
        mix(near, far, self.t)
    }
}

/// Number of values along each side of the table of rough noise, after which it repeats.
const ROUGH_SIDE: usize = 64;

/// Rough noise of two coordinates, neither below 0, `0..1`; the first one is fixed. It is read from a table, for surfaces
/// that cover much of the picture.
#[derive(Clone, Copy)]
pub struct RoughColumn {
    columns: [&'static [f32; ROUGH_SIDE]; 2],
    across: f32,
}

impl RoughColumn {
    /// Fixes the first coordinate.
    pub fn new(x: f32) -> Self {
        static TABLE: OnceLock<Box<[[f32; ROUGH_SIDE]; ROUGH_SIDE]>> = OnceLock::new();
        let table = TABLE.get_or_init(|| {
            let column = |x| std::array::from_fn(|y| unit(hash(0x40C4, x as i32, y as i32)));
            Box::new(std::array::from_fn(column))
        });
        let column = x as usize;
        Self {
            columns: [
                &table[column % ROUGH_SIDE],
                &table[(column + 1) % ROUGH_SIDE],
            ],
            across: x - column as f32,
        }
    }

    /// The noise at the second coordinate.
    #[inline(always)]
    pub fn at(&self, y: f32) -> f32 {
        let row = y as u32 as usize;
        let value = |row: usize| {
            let row = row % ROUGH_SIDE;
            mix(self.columns[0][row], self.columns[1][row], self.across)
        };
        mix(value(row), value(row + 1), y - row as f32)
    }

    /// The noise at the nearest value below the second coordinate.
    #[inline(always)]
    pub fn near(&self, y: f32) -> f32 {
        let row = y as u32 as usize % ROUGH_SIDE;
        mix(self.columns[0][row], self.columns[1][row], self.across)
    }
}

/// The whole part of a number from 0 to 2^22. Unlike a cast, this can be done for several numbers at once.
#[inline(always)]
pub fn whole(number: f32) -> u32 {
    // One step of the sum is 1, so the whole part is in its last bits.
    let sum = number.floor() + 1.0 / f32::EPSILON;
    sum.to_bits() & 0x003F_FFFF
}

/// Splits the coordinates of pixels into cells and smoothed places in them, and calculates the noise from these.
/// Coordinates are far below 2^51.
#[inline(always)]
fn block<T: Copy>(
    pixels: &[T],
    coordinate: impl Fn(T) -> f64,
    noise: impl Fn(i32, f32) -> f32,
) -> [f32; BLOCK] {
    let (mut cells, mut places) = ([0; BLOCK], [0.0; BLOCK]);
    for ((cell, place), &pixel) in cells.iter_mut().zip(&mut places).zip(pixels) {
        let at = coordinate(pixel);
        let below = at.floor();
        // The whole part is in the last bits of the sum. Unlike a cast, this can be done for several pixels at once.
        *cell = (below + 1.5 / f64::EPSILON).to_bits() as i32;
        *place = smooth((at - below) as f32);
    }
    let mut noises = [0.0; BLOCK];
    for ((value, cell), place) in noises.iter_mut().zip(&cells).zip(&places) {
        *value = noise(*cell, *place);
    }
    noises
}

/// Named random draws from one seed: a new draw does not change the others.
#[derive(Clone, Copy, Debug)]
pub struct Draws(pub u32);

impl Draws {
    /// A seed of its own for the thing called `name` (FNV-1a of the name, mixed with the seed).
    pub fn seed(self, name: &str) -> u32 {
        let name = name.bytes().fold(0x811C_9DC5_u32, |h, b| {
            (h ^ u32::from(b)).wrapping_mul(0x0100_0193)
        });
        hash(self.0, name as i32, 0x5EED)
    }

    /// Uniform in `low..high`.
    pub fn range(self, name: &str, low: f32, high: f32) -> f32 {
        mix(low, high, unit(self.seed(name)))
    }

    /// True with the given probability.
    pub fn chance(self, name: &str, probability: f32) -> bool {
        unit(self.seed(name)) < probability
    }

    /// One of the options, all with the same probability.
    pub fn pick<T: Copy>(self, name: &str, options: &[T]) -> T {
        options[self.seed(name) as usize % options.len()]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::float_cmp)]
    use super::*;

    #[test]
    fn noise_stays_in_range_and_is_continuous() {
        for i in 0..10_000 {
            let x = f64::from(i) * 0.013 - 50.0;
            let here = value_noise(7, x, 0.3 * x);
            assert!((0.0..=1.0).contains(&here));
            assert!((here - value_noise(7, x + 1e-6, 0.3 * x)).abs() < 1e-4);
            assert!((linear_noise(3, x) - linear_noise(3, x + 1e-6)).abs() < 1e-4);
        }
    }

    #[test]
    fn a_block_of_pixels_has_the_noise_of_each_pixel_to_the_bit() {
        for i in 0..300 {
            let (across, along) = (f64::from(i) * 0.77 - 90.0, f64::from(i - 150) * 3.1);
            let pixels: [f64; BLOCK] = std::array::from_fn(|n| along + f64::from(n as u32) * 0.13);
            let (row, column) = (NoiseRow::new(5, across), NoiseColumn::new(5, across));
            for vectors in crate::model::vectors::Vectors::available() {
                let (mut of_row, mut of_column) = ([0.0; BLOCK], [0.0; BLOCK]);
                vectors.vectorised(
                    #[inline(always)]
                    || of_row = row.block(&pixels, |at| at),
                );
                vectors.vectorised(
                    #[inline(always)]
                    || of_column = column.block(&pixels, |at| at),
                );
                assert_eq!(of_row, pixels.map(|at| value_noise(5, across, at)));
                assert_eq!(of_column, pixels.map(|at| value_noise(5, at, across)));
            }
        }
    }

    #[test]
    fn the_whole_part_is_that_of_a_cast() {
        for i in 0..1_000_000 {
            let number = 0.013 * i as f32;
            assert_eq!(whole(number), number as u32, "{number}");
        }
        assert_eq!(whole(-0.0), 0);
    }

    #[test]
    fn draws_by_name_are_independent_of_each_other() {
        let (a, b) = (Draws(1), Draws(2));
        assert_ne!(a.seed("lane width"), a.seed("lanes"));
        assert_ne!(a.seed("lane width"), b.seed("lane width"));
        let mean = (0..2_000)
            .map(|s| Draws(s).range("x", 0.0, 1.0))
            .sum::<f32>()
            / 2_000.0;
        assert!(
            (mean - 0.5).abs() < 0.02,
            "mean of 2,000 uniform draws is {mean}"
        );
    }
}
