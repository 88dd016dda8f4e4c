//! Bit sets in a word.

/// Collects the lowest bit of each of eight bytes: bit k of the result is that of byte k.
#[inline(always)]
pub(crate) fn lowest_bits(bytes: u64) -> u64 {
    // The product adds byte k, shifted to bit k, into the topmost byte; nothing else reaches it.
    (bytes & 0x0101_0101_0101_0101).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// Number of set bits of `bits` below position `bit`.
#[inline(always)]
pub(crate) fn rank(bits: u64, bit: usize) -> usize {
    (bits & ((1 << bit) - 1)).count_ones() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equal_a_loop_over_bits(bits in any::<u64>()) {
            let slow = (0..8).fold(0, |all, k| all | (bits >> (8 * k) & 1) << k);
            prop_assert_eq!(lowest_bits(bits), slow);
            let mut before = 0;
            for bit in 0..64 {
                prop_assert_eq!(rank(bits, bit), before);
                before += (bits >> bit & 1) as usize;
            }
        }
    }
}
