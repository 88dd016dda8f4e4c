//! Morton (Z-order) keys of up to 21 bits per axis: sorting by key keeps spatial neighbours close together in memory.

/// Bits per axis that a key can hold.
pub const AXIS_BITS: u32 = 21;

/// The bits of a key that come from its first coordinate; shifted left by one and two, those of the second and third.
pub const AXIS_MASK: u64 = 0x1249_2492_4924_9249;

/// Spreads the low 21 bits of `v` so that two zero bits follow each.
#[inline(always)]
const fn spread(v: u32) -> u64 {
    let mut x = v as u64 & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & AXIS_MASK
}

/// Inverse of [`spread`].
#[inline(always)]
const fn compact(v: u64) -> u32 {
    let mut x = v & AXIS_MASK;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    (x | x >> 32) as u32 & 0x1f_ffff
}

/// Interleaves the low 21 bits of three coordinates: bit 0 of the key is bit 0 of x, bit 1 is bit 0 of y, bit 2 is bit 0 of z.
#[inline(always)]
pub const fn encode(c: [u32; 3]) -> u64 {
    spread(c[0]) | spread(c[1]) << 1 | spread(c[2]) << 2
}

/// Inverse of [`encode`].
#[inline(always)]
pub const fn decode(key: u64) -> [u32; 3] {
    [compact(key), compact(key >> 1), compact(key >> 2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn decode_inverts_encode(x in 0u32..1 << 21, y in 0u32..1 << 21, z in 0u32..1 << 21) {
            prop_assert_eq!(decode(encode([x, y, z])), [x, y, z]);
        }

        #[test]
        fn encode_interleaves_bit_by_bit(x in 0u32..1 << 21, y in 0u32..1 << 21, z in 0u32..1 << 21) {
            let slow = (0..21).fold(0u64, |k, b| {
                k | (u64::from(x >> b & 1) << (3 * b)) | (u64::from(y >> b & 1) << (3 * b + 1)) | (u64::from(z >> b & 1) << (3 * b + 2))
            });
            prop_assert_eq!(encode([x, y, z]), slow);
        }
    }
}
