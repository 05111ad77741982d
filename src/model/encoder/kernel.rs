//! The inner loops for the instructions of this processor. Every load and store is checked before a loop is entered.
#![allow(unsafe_code)]

use super::layout::LANES;
use super::loops::{Lanes, Rivals, Row, Run, portable, products, rival};
#[cfg(target_arch = "x86_64")]
use super::x86;
use crate::model::vectors::Vectors;

impl Vectors {
    /// Adds `rounds` times [`REGISTERS`] vectors of products without access to memory, which is the peak speed of this
    /// processor.
    pub fn products_in_registers(self, rounds: u64) -> f32 {
        // SAFETY: it accesses only two arrays of its own. For the instructions, see `run`.
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

    /// Replaces each output value by the larger one of it and its input value.
    ///
    /// # Panics
    /// When the input has too few values, which is a bug of the plan, and never caused by a model or a picture.
    pub fn rival(self, row: Rivals<'_>) {
        let pixels = row.output.len() / LANES;
        let last = pixels.saturating_sub(1).saturating_mul(row.stride);
        let end = last.saturating_add(1).saturating_mul(LANES);
        assert!(
            pixels == 0 || end <= row.input.len(),
            "a pooling reads outside of its input"
        );
        // SAFETY: for output pixel `p` in `0..pixels`, the loops access its `LANES` values and those of input pixel `p
        // * stride`, at most `last`; both were compared with the slices above. For the instructions, see `run`.
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
    /// When a load or store of the row would be outside of its slices, which is a bug of the plan, and never caused by
    /// a model or a picture.
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
        // SAFETY: the kernels read `LANES` values of `bias`. For every run they read the weights `weights..weights +
        // len * LANES` and, for each pixel `p` in `0..width`, the inputs `input + p * step..input + p * step + len`, at
        // most `input + reach + len`; both were compared with the slices above. In `residual` and `output` they access
        // `width * LANES` values, which exist. Rows without pixels access only `bias`. AVX-512 and AVX2 come only from
        // `available`, which has asked the processor.
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
