//! One row of one block of a convolution: the inner loops, for the instruction sets of this processor.
//!
//! Unsafe code: instructions that not every processor has, and loads without bounds checks. [`Vectors::run`] checks
//! every load and store of the loops before it enters them.
//!
//! A tile of a few neighbouring pixels by [`LANES`] output channels stays in registers while all products are added to
//! it; each product is one weight vector times one input value. Every output is summed in the same order, whatever the
//! tile is, and products are fused with their sums on AVX-512, AVX2 and 64-bit ARM, so the results on these are equal
//! bit for bit.
#![allow(unsafe_code)]

use super::graph::Activation;
use super::layout::LANES;

/// Number of vectors of products in a round of [`Vectors::products_in_registers`].
pub const REGISTERS: usize = 12;

/// A run of neighbouring input values of every pixel, and the weight vectors with which they are multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Where it starts in the input, for pixel 0.
    pub input: usize,
    /// Where its weights start.
    pub weights: usize,
    /// Number of values in it, each with [`LANES`] weights.
    pub len: usize,
    /// First pixel for which it reads the picture and not zeros beside it.
    pub from: usize,
    /// The pixel after the last one for which it does. Tiles that are completely outside leave the run out.
    pub to: usize,
}

/// One row of outputs of one block of channels.
pub struct Row<'a> {
    /// Values from which the runs are read.
    pub input: &'a [f32],
    /// Runs that are summed.
    pub runs: &'a [Run],
    /// `[products, LANES]` of this block.
    pub weights: &'a [f32],
    /// Start value of every sum.
    pub bias: &'a [f32; LANES],
    /// `[width, LANES]`, added to the sums before the activation.
    pub residual: Option<&'a [f32]>,
    /// `[width, LANES]`.
    pub output: &'a mut [f32],
    /// Input values from one pixel to the next.
    pub step: usize,
    /// Function that is applied to the sum.
    pub activation: Activation,
}

/// Pixels that are compared with those of an output, for the larger value.
pub struct Rivals<'a> {
    /// `[pixels, LANES]`.
    pub input: &'a [f32],
    /// Pixels of the input from one output to the next.
    pub stride: usize,
    /// `[pixels, LANES]`; becomes the larger of both, and NaN if one of them is NaN.
    pub output: &'a mut [f32],
}

/// The larger of two; NaN if one of them is NaN.
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

/// # Safety
/// See [`Vectors::rival`].
#[inline(always)]
pub unsafe fn rival<V: Vector>(row: Rivals<'_>) {
    let mut input = row.input.as_ptr();
    let mut output = row.output.as_mut_ptr();
    for _ in 0..row.output.len() / LANES {
        // SAFETY: as for the caller.
        unsafe { V::load(output).larger(V::load(input)).store(output) };
        // It is past the end only after the last pixel.
        input = input.wrapping_add(row.stride * LANES);
        output = output.wrapping_add(LANES);
    }
}

/// Adds products in `N` independent vectors, [`REGISTERS`] in each round.
///
/// # Safety
/// The processor has the instructions.
#[inline(always)]
pub unsafe fn products<V: Vector, const N: usize>(rounds: u64) -> f32 {
    let mut values = [0.0; LANES];
    // SAFETY: as for the caller; `values` has room for the values that are stored.
    unsafe {
        let factor = V::splat(std::hint::black_box(0.999));
        // The compiler cannot know that these sums are equal.
        let mut sums = [factor; N];
        for sum in &mut sums {
            *sum = V::load(std::hint::black_box(&values).as_ptr());
        }
        for _ in 0..rounds * (REGISTERS / N) as u64 {
            for sum in &mut sums {
                *sum = factor.plus_product(*sum, factor);
            }
        }
        let sum = sums.into_iter().fold(factor, |a, b| a.plus(b));
        sum.store(values.as_mut_ptr());
    }
    values.iter().sum()
}

/// A vector of [`LANES`] values.
///
/// # Safety
/// For all functions: the processor has the instructions, and pointers are valid for [`LANES`] values.
pub trait Vector: Copy {
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    unsafe fn splat(value: f32) -> Self;
    /// `self + a * b`.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;
    unsafe fn plus(self, other: Self) -> Self;
    /// The larger of two; NaN if one of them is NaN.
    unsafe fn larger(self, other: Self) -> Self;
    /// 0 for negative values, NaN for NaN.
    unsafe fn relu(self) -> Self;
    /// Negative values times `slope`.
    unsafe fn leaky(self, slope: Self) -> Self;
}

/// Computes the row in tiles of `P` pixels, then the rest in tiles of `Q` pixels, and then the rest pixel by pixel.
///
/// # Safety
/// See [`Vectors::run`].
#[inline(always)]
pub unsafe fn row_of_tiles<V: Vector, const P: usize, const Q: usize>(row: Row<'_>) {
    // SAFETY: as for the caller.
    unsafe {
        // Steps that are known at compile time become displacements in the addresses: stride 1 and 2 in blocks, and in
        // a plane.
        match row.step {
            16 => tiles::<V, P, Q, 16>(row),
            32 => tiles::<V, P, Q, 32>(row),
            2 => tiles::<V, P, Q, 2>(row),
            _ => tiles::<V, P, Q, 0>(row),
        }
    }
}

/// # Safety
/// See [`Vectors::run`].
#[inline(always)]
pub unsafe fn tiles<V: Vector, const P: usize, const Q: usize, const STEP: usize>(row: Row<'_>) {
    let width = row.output.len() / LANES;
    let output = row.output.as_mut_ptr();
    let mut pixel = 0;
    // SAFETY: as for the caller; `pixel + P`, `pixel + Q` and `pixel + 1` are at most `width`.
    unsafe {
        while pixel + P <= width {
            tile::<V, P, STEP>(&row, output, pixel);
            pixel += P;
        }
        // The last tile may overlap the tile before: it writes the same values once more.
        if pixel < width && width >= P && width - pixel > Q {
            tile::<V, P, STEP>(&row, output, width - P);
        } else if pixel < width && width >= Q {
            while pixel + Q <= width {
                tile::<V, Q, STEP>(&row, output, pixel);
                pixel += Q;
            }
            if pixel < width {
                tile::<V, Q, STEP>(&row, output, width - Q);
            }
        } else {
            while pixel < width {
                tile::<V, 1, STEP>(&row, output, pixel);
                pixel += 1;
            }
        }
    }
}

/// # Safety
/// See [`Vectors::run`]; `first + P` is at most the width of the row, and `output` its first output.
#[inline(always)]
pub unsafe fn tile<V: Vector, const P: usize, const STEP: usize>(
    row: &Row<'_>,
    output: *mut f32,
    first: usize,
) {
    let step = if STEP == 0 { row.step } else { STEP };
    // SAFETY: as for the caller: `first + p` is a pixel of the row.
    unsafe {
        let mut sums = [V::load(row.bias.as_ptr()); P];
        // A row without runs may be outside: its address is calculated, but never read.
        let origin = row.input.as_ptr().wrapping_add(first * step);
        for run in row.runs {
            if first >= run.to || first + P <= run.from {
                continue;
            }
            let mut input = origin.wrapping_add(run.input);
            let mut weights = row.weights.as_ptr().add(run.weights);
            for _ in 0..run.len {
                let weight = V::load(weights);
                for (pixel, sum) in sums.iter_mut().enumerate() {
                    *sum = sum.plus_product(V::splat(*input.add(pixel * step)), weight);
                }
                input = input.add(1);
                weights = weights.add(LANES);
            }
        }
        if let Some(residual) = row.residual {
            let residual = residual.as_ptr().add(first * LANES);
            for (pixel, sum) in sums.iter_mut().enumerate() {
                *sum = sum.plus(V::load(residual.add(pixel * LANES)));
            }
        }
        match row.activation {
            Activation::None => {}
            Activation::Relu => {
                for sum in &mut sums {
                    *sum = sum.relu();
                }
            }
            Activation::Leaky(slope) => {
                for sum in &mut sums {
                    *sum = sum.leaky(V::splat(slope));
                }
            }
        }
        let output = output.add(first * LANES);
        for (pixel, sum) in sums.into_iter().enumerate() {
            sum.store(output.add(pixel * LANES));
        }
    }
}

/// A plain array: the compiler finds the vectors.
pub type Lanes = [f32; LANES];

impl Vector for Lanes {
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: as for the caller; an array of `f32` needs the alignment of `f32`.
        unsafe { *from.cast::<Self>() }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as for the caller; an array of `f32` needs the alignment of `f32`.
        unsafe { *to.cast::<Self>() = self }
    }

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        [value; LANES]
    }

    #[inline(always)]
    unsafe fn plus_product(self, a: Self, b: Self) -> Self {
        // Every 64-bit ARM processor has fused products; on others, a fused product without its instruction is a slow
        // call.
        let sum = |i: usize| match cfg!(target_arch = "aarch64") {
            true => a[i].mul_add(b[i], self[i]),
            false => a[i] * b[i] + self[i],
        };
        std::array::from_fn(sum)
    }

    #[inline(always)]
    unsafe fn plus(self, other: Self) -> Self {
        std::array::from_fn(|i| self[i] + other[i])
    }

    #[inline(always)]
    unsafe fn larger(self, other: Self) -> Self {
        std::array::from_fn(|i| larger(self[i], other[i]))
    }

    #[inline(always)]
    unsafe fn relu(self) -> Self {
        self.map(|value| Activation::Relu.of(value))
    }

    #[inline(always)]
    unsafe fn leaky(self, slope: Self) -> Self {
        self.map(|value| Activation::Leaky(slope[0]).of(value))
    }
}

/// # Safety
/// See [`Vectors::run`].
pub unsafe fn portable(row: Row<'_>) {
    // SAFETY: as for the caller. Sixteen registers of four lanes hold two pixels and a weight; ARM has 32.
    unsafe {
        if cfg!(target_arch = "aarch64") {
            row_of_tiles::<Lanes, 5, 2>(row);
        } else {
            row_of_tiles::<Lanes, 2, 1>(row);
        }
    }
}
