//! One row of one block of a convolution: the inner loops, for the instruction sets of this processor.
//!
//! The only file with unsafe code: instructions that not every processor has, and loads without bounds checks.
//! [`Kernel::run`] proves every load and store of the loops before it enters them.
//!
//! A tile of a few neighbouring pixels by [`LANES`] output channels stays in registers while all products are added to it;
//! each product is one weight vector times one input value. Every output is summed in the same order whatever the tile, and
//! products are fused with their sums on AVX-512, AVX2 and 64-bit ARM, so these agree to the bit.
#![allow(unsafe_code)]

use super::graph::Activation;
use super::layout::LANES;

/// Vectors of products in a round of [`Kernel::products_in_registers`].
pub const REGISTERS: usize = 12;

/// A run of neighbouring input values of every pixel, and the weight vectors that they are multiplied with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Where it starts in the input, for pixel 0.
    pub input: usize,
    /// Where its weights start.
    pub weights: usize,
    /// Values in it, each with [`LANES`] weights.
    pub len: usize,
    /// First pixel for which it reads the picture and not zeros beside it.
    pub from: usize,
    /// The pixel after the last such. Tiles wholly outside leave the run out.
    pub to: usize,
}

/// One row of outputs of one block of channels.
pub struct Row<'a> {
    /// What the runs are read from.
    pub input: &'a [f32],
    /// What is summed.
    pub runs: &'a [Run],
    /// `[products, LANES]` of this block.
    pub weights: &'a [f32],
    /// What every sum starts with.
    pub bias: &'a [f32; LANES],
    /// `[width, LANES]`, added to the sums before the activation.
    pub residual: Option<&'a [f32]>,
    /// `[width, LANES]`.
    pub output: &'a mut [f32],
    /// Input values from one pixel to the next.
    pub step: usize,
    /// What follows the sum.
    pub activation: Activation,
}

/// Pixels that compete with those of an output.
pub struct Rivals<'a> {
    /// `[pixels, LANES]`.
    pub input: &'a [f32],
    /// Pixels of the input from one output to the next.
    pub stride: usize,
    /// `[pixels, LANES]`; becomes the larger of the two, and NaN when one is.
    pub output: &'a mut [f32],
}

/// Inner loops for one set of instructions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// 512-bit vectors with fused products.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 256-bit vectors with fused products.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// What every processor of this architecture has; the compiler chooses the instructions.
    Portable,
}

impl Kernel {
    /// All that this processor can run, fastest first.
    pub fn available() -> Vec<Self> {
        let all = [
            #[cfg(target_arch = "x86_64")]
            Self::Avx512,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2,
            Self::Portable,
        ];
        all.into_iter()
            .filter(|kernel| kernel.runs_here())
            .collect()
    }

    /// The fastest that this processor can run. Allocates nothing.
    pub fn fastest() -> Self {
        #[cfg(target_arch = "x86_64")]
        for kernel in [Self::Avx512, Self::Avx2] {
            if kernel.runs_here() {
                return kernel;
            }
        }
        Self::Portable
    }

    fn runs_here(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512dq")
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
            Self::Portable => true,
        }
    }

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "AVX-512",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "AVX2",
            Self::Portable => std::env::consts::ARCH,
        }
    }

    /// Does some work with the vectors of these instructions, as far as the compiler finds them in it: what is inlined into the
    /// work is compiled for them.
    #[inline]
    pub fn vectorised(self, work: impl FnOnce()) {
        match self {
            // SAFETY: AVX-512 and AVX2 come from `available` and `fastest` alone, which have asked the processor.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => unsafe { x86::with_avx512(work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { x86::with_avx2(work) },
            Self::Portable => work(),
        }
    }

    /// Adds `rounds` times [`REGISTERS`] vectors of products without touching memory: what this processor can do at most.
    pub fn products_in_registers(self, rounds: u64) -> f32 {
        // SAFETY: touches nothing but two arrays of its own. The instructions are those of `run`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => x86::products_avx512(rounds),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => x86::products_avx2(rounds),
                Self::Portable => products::<Lanes, 2>(rounds),
            }
        }
    }

    /// Lets pixels compete.
    ///
    /// # Panics
    /// When the input has too few: a bug of the plan, never of a model or a picture.
    pub fn rival(self, row: Rivals<'_>) {
        let pixels = row.output.len() / LANES;
        let last = pixels.saturating_sub(1).saturating_mul(row.stride);
        let end = last.saturating_add(1).saturating_mul(LANES);
        assert!(
            pixels == 0 || end <= row.input.len(),
            "a pooling reads outside of its input"
        );
        // SAFETY: of output pixel `p` of `0..pixels` the loops touch its `LANES` values and those of input pixel
        // `p * stride`, at most `last`; both were compared with the slices above. The instructions are those of `run`.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => x86::rival_avx512(row),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => x86::rival_avx2(row),
                Self::Portable => rival::<Lanes>(row),
            }
        }
    }

    /// Computes a row.
    ///
    /// # Panics
    /// When a load or store of the row would lie outside of its slices: a bug of the plan, never of a model or a picture.
    pub fn run(self, row: Row<'_>) {
        let width = row.output.len() / LANES;
        let reach = width.saturating_sub(1).saturating_mul(row.step);
        let inside = |run: &Run| {
            let input = run.input.saturating_add(reach).saturating_add(run.len);
            let weights = run.len.saturating_mul(LANES).saturating_add(run.weights);
            input <= row.input.len() && weights <= row.weights.len()
        };
        assert!(
            row.runs.iter().all(inside),
            "a convolution reads outside of its input"
        );
        assert!(
            row.residual.is_none_or(|r| r.len() >= width * LANES),
            "a convolution adds too short a row"
        );
        // SAFETY: the kernels read `LANES` values of `bias`, and of every run the weights `weights..weights + len * LANES`
        // and, for each pixel `p` of `0..width`, the inputs `input + p * step..input + p * step + len`: at most
        // `input + reach + len`; both were compared with the slices above. Of `residual` and `output` they touch
        // `width * LANES` values, which they have. Rows of no pixel touch nothing but `bias`. AVX-512 and AVX2 come from
        // `available` alone, which has asked the processor.
        unsafe {
            match self {
                #[cfg(target_arch = "x86_64")]
                Self::Avx512 => x86::avx512(row),
                #[cfg(target_arch = "x86_64")]
                Self::Avx2 => x86::avx2(row),
                Self::Portable => portable(row),
            }
        }
    }
}

/// Rows and columns exchanged.
#[inline(always)]
pub fn turned(square: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    #[cfg(target_arch = "x86_64")]
    {
        x86::turned(square)
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        std::array::from_fn(|i| std::array::from_fn(|j| square[j][i]))
    }
}

/// The larger of two; NaN when one is.
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if b > a || b.is_nan() { b } else { a }
}

/// # Safety
/// See [`Kernel::rival`].
#[inline(always)]
unsafe fn rival<V: Vector>(row: Rivals<'_>) {
    let mut input = row.input.as_ptr();
    let mut output = row.output.as_mut_ptr();
    for _ in 0..row.output.len() / LANES {
        // SAFETY: as the caller's.
        unsafe { V::load(output).larger(V::load(input)).store(output) };
        // Past the end only after the last.
        input = input.wrapping_add(row.stride * LANES);
        output = output.wrapping_add(LANES);
    }
}

/// Adds products in `N` independent vectors, [`REGISTERS`] a round.
///
/// # Safety
/// The processor has the instructions.
#[inline(always)]
unsafe fn products<V: Vector, const N: usize>(rounds: u64) -> f32 {
    let mut values = [0.0; LANES];
    // SAFETY: as the caller's; `values` has the values that are stored.
    unsafe {
        let factor = V::splat(std::hint::black_box(0.999));
        // Sums that the compiler cannot know to be equal.
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
/// All functions: the processor has the instructions; pointers are good for [`LANES`] values.
trait Vector: Copy {
    unsafe fn load(from: *const f32) -> Self;
    unsafe fn store(self, to: *mut f32);
    unsafe fn splat(value: f32) -> Self;
    /// `self + a * b`.
    unsafe fn plus_product(self, a: Self, b: Self) -> Self;
    unsafe fn plus(self, other: Self) -> Self;
    /// The larger of two; NaN when one is.
    unsafe fn larger(self, other: Self) -> Self;
    /// 0 for negative values, NaN for NaN.
    unsafe fn relu(self) -> Self;
    /// Negative values times `slope`.
    unsafe fn leaky(self, slope: Self) -> Self;
}

/// The row in tiles of `P` pixels, what is left in tiles of `Q`, what is then left pixel by pixel.
///
/// # Safety
/// See [`Kernel::run`].
#[inline(always)]
unsafe fn row_of_tiles<V: Vector, const P: usize, const Q: usize>(row: Row<'_>) {
    // SAFETY: as the caller's.
    unsafe {
        // Steps known when compiled become displacements in the addresses: stride 1 and 2 in blocks, and in a plane.
        match row.step {
            16 => tiles::<V, P, Q, 16>(row),
            32 => tiles::<V, P, Q, 32>(row),
            2 => tiles::<V, P, Q, 2>(row),
            _ => tiles::<V, P, Q, 0>(row),
        }
    }
}

/// # Safety
/// See [`Kernel::run`].
#[inline(always)]
unsafe fn tiles<V: Vector, const P: usize, const Q: usize, const STEP: usize>(row: Row<'_>) {
    let width = row.output.len() / LANES;
    let output = row.output.as_mut_ptr();
    let mut pixel = 0;
    // SAFETY: as the caller's; `pixel + P`, `pixel + Q` and `pixel + 1` are at most `width`.
    unsafe {
        while pixel + P <= width {
            tile::<V, P, STEP>(&row, output, pixel);
            pixel += P;
        }
        // The last tile may begin before the one before it has ended: it writes the same values once more.
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
/// See [`Kernel::run`]; `first + P` is at most the width of the row, and `output` its first output.
#[inline(always)]
unsafe fn tile<V: Vector, const P: usize, const STEP: usize>(
    row: &Row<'_>,
    output: *mut f32,
    first: usize,
) {
    let step = if STEP == 0 { row.step } else { STEP };
    // SAFETY: as the caller's: `first + p` is a pixel of the row.
    unsafe {
        let mut sums = [V::load(row.bias.as_ptr()); P];
        // A row without runs may lie outside: its place is named, never read.
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
type Lanes = [f32; LANES];

impl Vector for Lanes {
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: as the caller's; an array of `f32` needs the alignment of `f32`.
        unsafe { *from.cast::<Self>() }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as the caller's; an array of `f32` needs the alignment of `f32`.
        unsafe { *to.cast::<Self>() = self }
    }

    #[inline(always)]
    unsafe fn splat(value: f32) -> Self {
        [value; LANES]
    }

    #[inline(always)]
    unsafe fn plus_product(self, a: Self, b: Self) -> Self {
        // Every 64-bit ARM fuses; on others a fused product without its instruction is a slow call.
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
/// See [`Kernel::run`].
unsafe fn portable(row: Row<'_>) {
    // SAFETY: as the caller's. Sixteen registers of four lanes hold two pixels and a weight; ARM has 32.
    unsafe {
        if cfg!(target_arch = "aarch64") {
            row_of_tiles::<Lanes, 5, 2>(row);
        } else {
            row_of_tiles::<Lanes, 2, 1>(row);
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, __m512, _CMP_LT_OQ, _CMP_UNORD_Q, _mm_loadu_ps, _mm_movehl_ps, _mm_movelh_ps,
        _mm_storeu_ps, _mm_unpackhi_ps, _mm_unpacklo_ps, _mm256_add_ps, _mm256_blendv_ps,
        _mm256_cmp_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_mul_ps,
        _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps, _mm512_add_ps, _mm512_cmp_ps_mask,
        _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_mask_mov_ps, _mm512_mask_mul_ps, _mm512_max_ps,
        _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps,
    };

    use super::{Rivals, Row, Vector, products, rival, row_of_tiles};

    #[inline(always)]
    pub(super) fn turned(square: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
        let mut turned = [[0.0; 4]; 4];
        // SAFETY: every load and store is of a whole array of four; SSE is part of this architecture.
        unsafe {
            let [a, b, c, d] = square.each_ref().map(|row| _mm_loadu_ps(row.as_ptr()));
            let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
            let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
            let rows = [
                _mm_movelh_ps(ab, cd),
                _mm_movehl_ps(cd, ab),
                _mm_movelh_ps(ab_high, cd_high),
                _mm_movehl_ps(cd_high, ab_high),
            ];
            for (to, from) in turned.iter_mut().zip(rows) {
                _mm_storeu_ps(to.as_mut_ptr(), from);
            }
        }
        turned
    }

    /// # Safety
    /// See [`super::products`].
    #[target_feature(enable = "avx512f")]
    pub(super) unsafe fn products_avx512(rounds: u64) -> f32 {
        // SAFETY: as the caller's.
        unsafe { products::<Avx512, 12>(rounds) }
    }

    /// # Safety
    /// See [`super::products`].
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn products_avx2(rounds: u64) -> f32 {
        // SAFETY: as the caller's.
        unsafe { products::<Avx2, 6>(rounds) }
    }

    /// # Safety
    /// See [`super::Kernel::rival`].
    #[target_feature(enable = "avx512f")]
    pub(super) unsafe fn rival_avx512(row: Rivals<'_>) {
        // SAFETY: as the caller's.
        unsafe { rival::<Avx512>(row) }
    }

    /// # Safety
    /// See [`super::Kernel::rival`].
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn rival_avx2(row: Rivals<'_>) {
        // SAFETY: as the caller's.
        unsafe { rival::<Avx2>(row) }
    }

    /// # Safety
    /// See [`super::Kernel::vectorised`].
    #[target_feature(enable = "avx512f,avx512vl,avx512dq")]
    pub(super) unsafe fn with_avx512(work: impl FnOnce()) {
        work();
    }

    /// # Safety
    /// See [`super::Kernel::vectorised`].
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn with_avx2(work: impl FnOnce()) {
        work();
    }

    /// # Safety
    /// See [`super::Kernel::run`].
    #[target_feature(enable = "avx512f")]
    pub(super) unsafe fn avx512(row: Row<'_>) {
        // SAFETY: as the caller's.
        unsafe { row_of_tiles::<Avx512, 10, 5>(row) }
    }

    /// # Safety
    /// See [`super::Kernel::run`].
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn avx2(row: Row<'_>) {
        // SAFETY: as the caller's.
        unsafe { row_of_tiles::<Avx2, 5, 2>(row) }
    }

    #[derive(Clone, Copy)]
    struct Avx512(__m512);

    #[derive(Clone, Copy)]
    struct Avx2(__m256, __m256);

    // Of `max` the second is the answer when one of the two is NaN.

    impl Vector for Avx512 {
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: as the caller's, here and below.
            unsafe { Self(_mm512_loadu_ps(from)) }
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: see `load`.
            unsafe { _mm512_storeu_ps(to, self.0) }
        }

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: see `load`.
            unsafe { Self(_mm512_set1_ps(value)) }
        }

        #[inline(always)]
        unsafe fn plus_product(self, a: Self, b: Self) -> Self {
            // SAFETY: see `load`.
            unsafe { Self(_mm512_fmadd_ps(a.0, b.0, self.0)) }
        }

        #[inline(always)]
        unsafe fn plus(self, other: Self) -> Self {
            // SAFETY: see `load`.
            unsafe { Self(_mm512_add_ps(self.0, other.0)) }
        }

        #[inline(always)]
        unsafe fn larger(self, other: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                let undefined = _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(other.0, other.0);
                let larger = _mm512_max_ps(other.0, self.0);
                Self(_mm512_mask_mov_ps(larger, undefined, other.0))
            }
        }

        #[inline(always)]
        unsafe fn relu(self) -> Self {
            // SAFETY: see `load`.
            unsafe { Self(_mm512_max_ps(_mm512_setzero_ps(), self.0)) }
        }

        #[inline(always)]
        unsafe fn leaky(self, slope: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                let negative = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(self.0, _mm512_setzero_ps());
                Self(_mm512_mask_mul_ps(self.0, negative, self.0, slope.0))
            }
        }
    }

    impl Vector for Avx2 {
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            // SAFETY: as the caller's, here and below.
            unsafe { Self(_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))) }
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            // SAFETY: see `load`.
            unsafe {
                _mm256_storeu_ps(to, self.0);
                _mm256_storeu_ps(to.add(8), self.1);
            }
        }

        #[inline(always)]
        unsafe fn splat(value: f32) -> Self {
            // SAFETY: see `load`.
            unsafe { Self(_mm256_set1_ps(value), _mm256_set1_ps(value)) }
        }

        #[inline(always)]
        unsafe fn plus_product(self, a: Self, b: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                Self(
                    _mm256_fmadd_ps(a.0, b.0, self.0),
                    _mm256_fmadd_ps(a.1, b.1, self.1),
                )
            }
        }

        #[inline(always)]
        unsafe fn plus(self, other: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                Self(
                    _mm256_add_ps(self.0, other.0),
                    _mm256_add_ps(self.1, other.1),
                )
            }
        }

        #[inline(always)]
        unsafe fn larger(self, other: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                let undefined = Self(
                    _mm256_cmp_ps::<_CMP_UNORD_Q>(other.0, other.0),
                    _mm256_cmp_ps::<_CMP_UNORD_Q>(other.1, other.1),
                );
                Self(
                    _mm256_blendv_ps(_mm256_max_ps(other.0, self.0), other.0, undefined.0),
                    _mm256_blendv_ps(_mm256_max_ps(other.1, self.1), other.1, undefined.1),
                )
            }
        }

        #[inline(always)]
        unsafe fn relu(self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                let zero = _mm256_setzero_ps();
                Self(_mm256_max_ps(zero, self.0), _mm256_max_ps(zero, self.1))
            }
        }

        #[inline(always)]
        unsafe fn leaky(self, slope: Self) -> Self {
            // SAFETY: see `load`.
            unsafe {
                let zero = _mm256_setzero_ps();
                let negative = Self(
                    _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, zero),
                    _mm256_cmp_ps::<_CMP_LT_OQ>(self.1, zero),
                );
                Self(
                    _mm256_blendv_ps(self.0, _mm256_mul_ps(self.0, slope.0), negative.0),
                    _mm256_blendv_ps(self.1, _mm256_mul_ps(self.1, slope.1), negative.1),
                )
            }
        }
    }
}
