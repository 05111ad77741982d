//! The inner loops for the instructions of this processor: every load and store is proved before a loop is entered.
#![allow(unsafe_code)]

use super::layout::LANES;
use super::loops::{Lanes, Rivals, Row, Run, portable, products, rival};
#[cfg(target_arch = "x86_64")]
use super::x86;
use crate::model::vectors::Vectors;

impl Vectors {
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
