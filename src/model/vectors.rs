//! The vector instructions of this processor, and how to use them.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod x86;

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Vectors {
    /// 512-bit vectors with fused products.
    #[cfg(target_arch = "x86_64")]
    Avx512,
    /// 256-bit vectors with fused products.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// Instructions of every processor of this architecture; the compiler chooses them.
    Portable,
}

impl Vectors {
    /// All sets that this processor has, the fastest first.
    pub fn available() -> Vec<Self> {
        let all = [
            #[cfg(target_arch = "x86_64")]
            Self::Avx512,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2,
            Self::Portable,
        ];
        all.into_iter()
            .filter(|vectors| vectors.runs_here())
            .collect()
    }

    /// The fastest set that this processor has. Allocates nothing.
    pub fn fastest() -> Self {
        #[cfg(target_arch = "x86_64")]
        for vectors in [Self::Avx512, Self::Avx2] {
            if vectors.runs_here() {
                return vectors;
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

    /// Name for people.
    pub fn name(self) -> &'static str {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => "AVX-512",
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => "AVX2",
            Self::Portable => std::env::consts::ARCH,
        }
    }

    /// Does some work with these vector instructions, as far as the compiler can use them: everything that is inlined
    /// into the work is compiled for them.
    #[inline]
    pub fn vectorised(self, work: impl FnOnce()) {
        match self {
            // SAFETY: AVX-512 and AVX2 come only from `available` and `fastest`, which have asked the processor.
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => unsafe { x86::with_avx512(work) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => unsafe { x86::with_avx2(work) },
            Self::Portable => work(),
        }
    }
}

/// The transposed square.
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
