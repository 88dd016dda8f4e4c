//! Stable radix sort of packed records by their upper bits.

/// Bits sorted per pass: 2048 counters stay in the first-level cache.
const DIGIT: u32 = 11;

/// Sorts `records` by the bits from `low` up to (not including) `high`, stably; `spare` is scratch space that is reused.
pub fn sort_by_bits(records: &mut Vec<u64>, spare: &mut Vec<u64>, low: u32, high: u32) {
    spare.clear();
    spare.resize(records.len(), 0);
    let mut shift = low;
    while shift < high {
        let bits = DIGIT.min(high - shift);
        let mask = (1usize << bits) - 1;
        let mut starts = [0u32; 1 << DIGIT];
        for &record in records.iter() {
            starts[(record >> shift) as usize & mask] += 1;
        }
        let mut sum = 0;
        for start in &mut starts[..=mask] {
            sum += std::mem::replace(start, sum);
        }
        for &record in records.iter() {
            let start = &mut starts[(record >> shift) as usize & mask];
            spare[*start as usize] = record;
            *start += 1;
        }
        std::mem::swap(records, spare);
        shift += bits;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_a_stable_sort(mut records in prop::collection::vec(any::<u64>(), 0..3000), low in 0u32..40, width in 1u32..24) {
            let mask = (1u64 << width) - 1;
            let mut slow = records.clone();
            slow.sort_by_key(|r| r >> low & mask);
            sort_by_bits(&mut records, &mut Vec::new(), low, low + width);
            prop_assert_eq!(records, slow);
        }
    }
}
