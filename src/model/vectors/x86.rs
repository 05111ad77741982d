//! Code that the compiler generates for AVX-512 and AVX2.

use std::arch::x86_64::{
    _mm_loadu_ps, _mm_movehl_ps, _mm_movelh_ps, _mm_storeu_ps, _mm_unpackhi_ps, _mm_unpacklo_ps,
};

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
/// See [`super::Vectors::vectorised`].
#[target_feature(enable = "avx512f,avx512vl,avx512dq")]
pub(super) unsafe fn with_avx512(work: impl FnOnce()) {
    work();
}

/// # Safety
/// See [`super::Vectors::vectorised`].
#[target_feature(enable = "avx2")]
pub(super) unsafe fn with_avx2(work: impl FnOnce()) {
    work();
}
