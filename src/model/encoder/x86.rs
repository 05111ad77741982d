//! The loops with vectors of AVX-512 and AVX2.
#![allow(unsafe_code)]

use std::arch::x86_64::{
    __m256, __m512, _CMP_LT_OQ, _CMP_UNORD_Q, _mm256_add_ps, _mm256_blendv_ps, _mm256_cmp_ps,
    _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_mul_ps, _mm256_set1_ps,
    _mm256_setzero_ps, _mm256_storeu_ps, _mm512_add_ps, _mm512_cmp_ps_mask, _mm512_fmadd_ps,
    _mm512_loadu_ps, _mm512_mask_mov_ps, _mm512_mask_mul_ps, _mm512_max_ps, _mm512_set1_ps,
    _mm512_setzero_ps, _mm512_storeu_ps,
};

use super::loops::{Rivals, Row, Vector, products, rival, row_of_tiles};

/// # Safety
/// See [`super::loops::products`].
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn products_avx512(rounds: u64) -> f32 {
    // SAFETY: as for the caller.
    unsafe { products::<Avx512, 12>(rounds) }
}

/// # Safety
/// See [`super::loops::products`].
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn products_avx2(rounds: u64) -> f32 {
    // SAFETY: as for the caller.
    unsafe { products::<Avx2, 6>(rounds) }
}

/// # Safety
/// See [`crate::model::vectors::Vectors::rival`].
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn rival_avx512(row: Rivals<'_>) {
    // SAFETY: as for the caller.
    unsafe { rival::<Avx512>(row) }
}

/// # Safety
/// See [`crate::model::vectors::Vectors::rival`].
#[target_feature(enable = "avx2")]
pub(super) unsafe fn rival_avx2(row: Rivals<'_>) {
    // SAFETY: as for the caller.
    unsafe { rival::<Avx2>(row) }
}

/// # Safety
/// See [`crate::model::vectors::Vectors::run`].
#[target_feature(enable = "avx512f")]
pub(super) unsafe fn avx512(row: Row<'_>) {
    // SAFETY: as for the caller.
    unsafe { row_of_tiles::<Avx512, 10, 5>(row) }
}

/// # Safety
/// See [`crate::model::vectors::Vectors::run`].
#[target_feature(enable = "avx2,fma")]
pub(super) unsafe fn avx2(row: Row<'_>) {
    // SAFETY: as for the caller.
    unsafe { row_of_tiles::<Avx2, 5, 2>(row) }
}

#[derive(Clone, Copy)]
struct Avx512(__m512);

#[derive(Clone, Copy)]
struct Avx2(__m256, __m256);

// `max` returns its second argument if one of both is NaN.

impl Vector for Avx512 {
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: as for the caller, here and below.
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
        // SAFETY: as for the caller, here and below.
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
