//! Indexed loads that the compiler can vectorise.
#![allow(unsafe_code)]

/// Copies the items of `from` at each `index` to `to`. One bounds check covers all of them; a check for each would prevent vectorisation.
///
/// # Panics
/// If an index is out of bounds.
#[inline(always)]
pub(crate) fn gather<T: Copy>(from: &[T], index: &[u32], to: &mut [T]) {
    let mut last = 0;
    for &i in index {
        last = if i > last { i } else { last };
    }
    assert!((last as usize) < from.len());
    for (to, &i) in to.iter_mut().zip(index) {
        // SAFETY: no index is larger than `last`, which is in bounds.
        *to = unsafe { *from.get_unchecked(i as usize) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn gathering_equals_indexing(items in prop::collection::vec(0u32..1000, 1..50), indices in prop::collection::vec(any::<prop::sample::Index>(), 0..40)) {
            let indices: Vec<u32> = indices.iter().map(|index| index.index(items.len()) as u32).collect();
            let mut gathered = vec![0; indices.len()];
            gather(&items, &indices, &mut gathered);
            prop_assert_eq!(gathered, indices.iter().map(|&i| items[i as usize]).collect::<Vec<u32>>());
        }
    }

    #[test]
    #[should_panic(expected = "last as usize")]
    fn an_index_out_of_bounds_panics() {
        gather(&[1, 2, 3], &[0, 3, 1], &mut [0; 3]);
    }
}
