//! Conversion to integers without casts.

/// The integer part of `x` for `x` in 0..2^22, an arbitrary number otherwise. Unlike a cast, which has to saturate and to handle NaN, it
/// vectorises.
#[inline(always)]
pub(crate) fn floor_positive(x: f32) -> i32 {
    /// 2^23: from here on, adjacent floats differ by one.
    const ONES: f32 = 8_388_608.0;
    let near = x + ONES;
    let is_above = near - ONES > x;
    (near.to_bits() & 0x007f_ffff) as i32 - i32::from(is_above)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_the_cast(x in prop_oneof![0f32..4_194_303.0, 0f32..3.0, (0u32..4_194_304).prop_map(|n| n as f32)]) {
            for x in [x, x.next_down().max(0.0), x.next_up()] {
                prop_assert_eq!(floor_positive(x), x as i32);
            }
        }
    }
}
