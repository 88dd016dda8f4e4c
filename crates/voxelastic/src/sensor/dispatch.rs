//! Runs a kernel with the widest vector instructions that the machine has.
//!
//! A kernel is plain, branch-free code that the compiler vectorises. It is compiled twice: for the target's baseline (SSE2,
//! NEON) and, on x86-64, for AVX2; which one runs is decided where the program runs. Both give the same bits: the compiler
//! never contracts a product and a sum into one rounding, and no kernel asks for it.
#![allow(unsafe_code)]

/// A piece of work worth vectorising. Write `run` with `#[inline(always)]`, and everything it calls too.
pub(crate) trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs `kernel` with AVX2 where the machine has it.
#[inline]
pub(crate) fn dispatch(kernel: impl Kernel) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        // SAFETY: the machine has the features that the function is compiled for, as just tested.
        return unsafe { with_avx2(kernel) };
    }
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn with_avx2(kernel: impl Kernel) {
    kernel.run();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::trig::atan2;
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
            let (mut wide, mut narrow) = (vec![0f32; points.len()], vec![0f32; points.len()]);
            dispatch(Angles { points: &points, angles: &mut wide });
            Angles { points: &points, angles: &mut narrow }.run();
            prop_assert!(wide.iter().zip(&narrow).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
    }
}
