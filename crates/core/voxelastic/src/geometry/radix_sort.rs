//! Stable radix sort of packed records by their upper bits.

/// Most bits sorted per pass: 4096 counters stay in the first-level cache.
const DIGIT: u32 = 12;

/// Fewer records than this are sorted by one thread.
const LEAST_SHARED: usize = 1 << 14;

/// Sorts `records` stably by the bits from `low` up to, not including, `high`. `spare` is scratch memory.
///
/// With several threads, two halves are sorted in parallel and merged from both ends; the result is the same.
pub(crate) fn sort_by_bits(records: &mut Vec<u64>, spare: &mut Vec<u64>, low: u32, high: u32) {
    spare.clear();
    spare.resize(records.len(), 0);
    if records.len() < LEAST_SHARED || rayon::current_num_threads() < 2 {
        if sort(records, spare, low, high) {
            std::mem::swap(records, spare);
        }
        return;
    }
    let half = records.len() / 2;
    let ((a, b), (c, d)) = (records.split_at_mut(half), spare.split_at_mut(half));
    let (is_moved, _) = rayon::join(|| sort(a, c, low, high), || sort(b, d, low, high));
    if is_moved {
        std::mem::swap(records, spare);
    }
    let key = |record: u64| record << (u64::BITS - high) >> (u64::BITS - high + low);
    let (a, b) = records.split_at(half);
    let (front, back) = spare.split_at_mut(half);
    rayon::join(|| merge_front(a, b, front, key), || merge_back(a, b, back, key));
    std::mem::swap(records, spare);
}

/// The first `to.len()` records of `a` and `b` merged.
fn merge_front(a: &[u64], b: &[u64], to: &mut [u64], key: impl Fn(u64) -> u64) {
    let (mut i, mut j) = (0, 0);
    for slot in to {
        let from_a = j == b.len() || (i < a.len() && key(a[i]) <= key(b[j]));
        *slot = if from_a { a[i] } else { b[j] };
        i += usize::from(from_a);
        j += usize::from(!from_a);
    }
}

/// The last `to.len()` records of `a` and `b` merged.
fn merge_back(a: &[u64], b: &[u64], to: &mut [u64], key: impl Fn(u64) -> u64) {
    let (mut i, mut j) = (a.len(), b.len());
    for slot in to.iter_mut().rev() {
        let from_b = i == 0 || (j > 0 && key(a[i - 1]) <= key(b[j - 1]));
        *slot = if from_b { b[j - 1] } else { a[i - 1] };
        i -= usize::from(!from_b);
        j -= usize::from(from_b);
    }
}

/// Sorts `records`; returns whether the result is in `spare`.
fn sort<'a>(mut records: &'a mut [u64], mut spare: &'a mut [u64], low: u32, high: u32) -> bool {
    let mut is_swapped = false;
    let mut shift = low;
    let digit = (high - low).div_ceil((high - low).div_ceil(DIGIT));
    while shift < high {
        let bits = digit.min(high - shift);
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
        std::mem::swap(&mut records, &mut spare);
        is_swapped = !is_swapped;
        shift += bits;
    }
    is_swapped
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

        #[test]
        fn halves_sorted_by_two_threads_equal_a_stable_sort(seed in any::<u64>(), more in 0usize..3, low in 1u32..30, width in 1u32..34) {
            let mut hash = seed;
            let mut next = || { hash = hash.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29) ^ seed; hash };
            let mut records: Vec<u64> = (0..LEAST_SHARED + more).map(|_| next()).collect();
            let mut slow = records.clone();
            slow.sort_by_key(|r| r >> low & ((1 << width) - 1));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
            pool.install(|| sort_by_bits(&mut records, &mut Vec::new(), low, low + width));
            prop_assert!(records == slow);
        }
    }
}
