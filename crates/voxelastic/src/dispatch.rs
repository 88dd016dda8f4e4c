//! Runs a kernel with the widest vector instructions that the machine has.
//!
//! A kernel is plain, branch-free code that the compiler vectorises. It is compiled three times: for the target's baseline
//! (SSE2, NEON) and, on x86-64, for AVX2 and for AVX-512; which one runs is decided where the program runs. All give the same
//! bits: the compiler never contracts a product and a sum into one rounding, and no kernel asks for it.
#![allow(unsafe_code)]

/// A piece of work worth vectorising. Write `run` with `#[inline(always)]`, and everything it calls too.
pub(crate) trait Kernel {
    /// Does the work.
    fn run(self);
}

/// Runs `kernel` with AVX-512 or AVX2 where the machine has it.
#[inline]
pub(crate) fn dispatch(kernel: impl Kernel) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        if has_avx2() {
            if has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw") {
                // SAFETY: the machine has the features that the function is compiled for, as just tested.
                return unsafe { with_avx512(kernel) };
            }
            // SAFETY: as above.
            return unsafe { with_avx2(kernel) };
        }
    }
    kernel.run();
}

/// Writes the items of `from` at each `index`: one test for all of them, where indexing has a test for each and so no vector instruction.
///
/// # Panics
/// If an index lies beyond the end.
#[inline(always)]
pub(crate) fn gather<T: Copy>(from: &[T], index: &[u32], to: &mut [T]) {
    let mut last = 0;
    for &i in index {
        last = if i > last { i } else { last };
    }
    assert!((last as usize) < from.len());
    for (to, &i) in to.iter_mut().zip(index) {
        // SAFETY: no index is larger than the last one, which lies within.
        *to = unsafe { *from.get_unchecked(i as usize) };
    }
}

/// Whether the machine has AVX2 and the instructions for single bits that came with it.
#[cfg(target_arch = "x86_64")]
#[inline]
fn has_avx2() -> bool {
    use std::arch::is_x86_feature_detected as has;
    has!("avx2") && has!("bmi1") && has!("bmi2") && has!("lzcnt") && has!("popcnt")
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
    use crate::sensor::atan2;
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
                // SAFETY: the machine has the features, as just tested.
                prop_assert_eq!(&angles(&|kernel| unsafe { with_avx2(kernel) }), &narrow);
            }
        }

        #[test]
        fn gathering_is_indexing(items in prop::collection::vec(0u32..1000, 1..50), places in prop::collection::vec(any::<prop::sample::Index>(), 0..40)) {
            let places: Vec<u32> = places.iter().map(|place| place.index(items.len()) as u32).collect();
            let mut gathered = vec![0; places.len()];
            gather(&items, &places, &mut gathered);
            prop_assert_eq!(gathered, places.iter().map(|&i| items[i as usize]).collect::<Vec<u32>>());
        }
    }

    #[test]
    #[should_panic(expected = "last as usize")]
    fn gathering_stays_within() {
        gather(&[1, 2, 3], &[0, 3, 1], &mut [0; 3]);
    }
}
