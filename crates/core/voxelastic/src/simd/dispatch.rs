//! Runs a kernel with the widest vector instructions that the CPU supports.
//!
//! A kernel is plain, branch-free code that the compiler vectorises. It is compiled three times: for the target's baseline
//! (SSE2, NEON) and, on x86-64, for AVX2 and for AVX-512; which one runs is decided at run time. All give the same
//! bits: the compiler never fuses a product and a sum into one rounding, and no kernel does so explicitly.
#![allow(unsafe_code)]

/// Work to be vectorised. `run` and everything that it calls must be `#[inline(always)]`, so that it is compiled for each instruction set.
pub(crate) trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs `kernel` with AVX-512 or AVX2 where the CPU has it.
#[inline]
pub(crate) fn dispatch(kernel: impl Kernel) {
    #[cfg(target_arch = "x86_64")]
    {
        if has_avx2() {
            if has_avx512() {
                // SAFETY: the CPU has the features that the function is compiled for, as just tested.
                return unsafe { with_avx512(kernel) };
            }
            // SAFETY: as above.
            return unsafe { with_avx2(kernel) };
        }
    }
    kernel.run();
}

/// Whether the CPU has AVX2 and the bit manipulation instructions that came with it.
#[cfg(target_arch = "x86_64")]
#[inline]
fn has_avx2() -> bool {
    use std::arch::is_x86_feature_detected as has;
    has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt")
}

/// Whether it has, beyond AVX2, what kernels use of AVX-512.
#[cfg(target_arch = "x86_64")]
#[inline]
fn has_avx512() -> bool {
    use std::arch::is_x86_feature_detected as has;
    has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw")
}

/// The vector instructions that the mapper runs with on this CPU, by the name that its maker gives them. Maps do not depend on them.
pub fn vector_instructions() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if has_avx2() {
        return if has_avx512() { "AVX-512" } else { "AVX2" };
    }
    if cfg!(target_arch = "x86_64") {
        "SSE2"
    } else if cfg!(target_arch = "aarch64") {
        "NEON"
    } else {
        "none"
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512vl,avx512dq,avx512bw")]
fn with_avx512(kernel: impl Kernel) {
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn with_avx2(kernel: impl Kernel) {
    kernel.run();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::atan2;
    use proptest::prelude::*;

    struct Angles<'a> {
        points: &'a [[f32; 2]],
        angles: &'a mut [f32],
    }

    impl Kernel for Angles<'_> {
        #[inline(always)]
        fn run(self) {
            self.angles.iter_mut().zip(self.points).for_each(|(a, p)| *a = atan2(p[1], p[0]) * 3.0 + p[0]);
        }
    }

    proptest! {
        #[test]
        fn wide_and_narrow_give_the_same_bits(points in prop::collection::vec(prop::array::uniform2(-100f32..100.0), 0..200)) {
            let angles = |run: &dyn Fn(Angles<'_>)| {
                let mut angles = vec![0f32; points.len()];
                run(Angles { points: &points, angles: &mut angles });
                angles.iter().map(|a| a.to_bits()).collect::<Vec<u32>>()
            };
            let narrow = angles(&|kernel| kernel.run());
            prop_assert_eq!(&angles(&|kernel| dispatch(kernel)), &narrow);
            #[cfg(target_arch = "x86_64")]
            if has_avx2() {
                // SAFETY: the CPU has the features, as just tested.
                prop_assert_eq!(&angles(&|kernel| unsafe { with_avx2(kernel) }), &narrow);
            }
        }
    }
}
