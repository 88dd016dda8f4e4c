//! Masks: a bit per value, least bit first, set where the value is not zero.

use super::bytes::Bytes;

/// Appends a bit per value: whether it is anything but zero. Moves those that are to the beginning, in order, and returns their number.
pub(crate) fn push_mask<T: Copy + Default + PartialEq>(out: &mut Vec<u8>, values: &mut [T]) -> usize {
    out.reserve(values.len().div_ceil(8));
    let mut kept = 0;
    for first in (0..values.len()).step_by(8) {
        let remaining = &values[first..];
        let eight: [T; 8] =
            remaining.first_chunk().copied().unwrap_or_else(|| std::array::from_fn(|i| remaining.get(i).copied().unwrap_or_default()));
        let mut is_set = [0; 8];
        for (bit, value) in is_set.iter_mut().zip(&eight) {
            *bit = u8::from(*value != T::default());
        }
        let mask = bits(is_set);
        out.push(mask);
        match mask {
            0 => {}
            u8::MAX => {
                values[kept..][..8].copy_from_slice(&eight);
                kept += 8;
            }
            // A branch for each value would be unpredictable.
            _ => {
                for (i, value) in eight.into_iter().enumerate().take(values.len() - first) {
                    values[kept] = value;
                    kept += usize::from(mask >> i & 1);
                }
            }
        }
    }
    kept
}

/// Bit i is byte i, which is 0 or 1: each factor's bit moves one of the bytes to its place in the highest byte, and no two meet on the way.
fn bits(bytes: [u8; 8]) -> u8 {
    (u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

/// Takes the mask of `count` values and says how many of them are set.
pub(crate) fn mask<'a>(bytes: &mut Bytes<'a>, count: usize) -> Result<(&'a [u8], usize), String> {
    let mask = bytes.take(count.div_ceil(8))?;
    let set = mask.iter().map(|b| b.count_ones() as usize).sum();
    let tail = mask.last().filter(|_| !count.is_multiple_of(8)).is_some_and(|b| b >> (count % 8) != 0);
    if tail { Err("a mask is longer than its values".to_owned()) } else { Ok((mask, set)) }
}

/// Calls `set` with the index of every bit that is set.
#[inline(always)]
pub(crate) fn for_each_set(mask: &[u8], mut set: impl FnMut(usize)) {
    for (i, &byte) in mask.iter().enumerate() {
        let mut left = byte;
        while left != 0 {
            set(8 * i + left.trailing_zeros() as usize);
            left &= left - 1;
        }
    }
}
