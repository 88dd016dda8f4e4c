//! Whole parts by arithmetic.

/// The whole part of `x` in 0..2^22; any number for others. A cast cares for all of them and for NaN, and is done one by one for it; this
/// becomes vector instructions.
#[inline(always)]
pub(crate) fn whole(x: f32) -> i32 {
    /// Here neighbouring floats are one apart.
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
                prop_assert_eq!(whole(x), x as i32);
            }
        }
    }
}
