//! A bit stream in 32-bit words, lowest bits first.

/// Appends numbers of any width to a bit stream.
pub(crate) struct BitWriter<'a> {
    words: &'a mut [u32],
    len: usize,
    /// Bits that are not written yet, and their number.
    pending: u64,
    count: u32,
}

impl<'a> BitWriter<'a> {
    /// A stream that overwrites `words` from their beginning.
    #[inline(always)]
    pub fn new(words: &'a mut [u32]) -> Self {
        Self { words, len: 0, pending: 0, count: 0 }
    }

    /// Appends `number`, which is less than 2^`bits`; `bits` is at most 32.
    #[inline(always)]
    pub fn push(&mut self, number: u32, bits: u32) {
        self.pending |= u64::from(number) << self.count;
        self.count += bits;
        // Written whether or not the word is full, because a branch on that would be unpredictable.
        self.words[self.len] = self.pending as u32;
        let full = self.count / 32;
        self.len += full as usize;
        self.pending >>= 32 * full;
        self.count %= 32;
    }

    /// Pads the last word with zeros; returns the number of words written.
    #[inline(always)]
    pub fn finish(self) -> usize {
        if self.count > 0 {
            self.words[self.len] = self.pending as u32;
        }
        self.len + usize::from(self.count > 0)
    }
}

/// The number of `bits` bits (at most 32) that begins at bit `first`; bits beyond the last word are zero.
#[inline(always)]
pub(crate) fn read(words: &[u32], first: usize, bits: u32) -> u32 {
    let word = |i: usize| u64::from(words.get(first / 32 + i).copied().unwrap_or(0));
    ((word(0) | word(1) << 32) >> (first % 32) & low_mask(bits)) as u32
}

#[inline(always)]
fn low_mask(bits: u32) -> u64 {
    (1u64 << bits) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_read_as_written(numbers in prop::collection::vec(any::<u32>(), 0..70), bits in 0u32..=32) {
            let numbers: Vec<u32> = numbers.into_iter().map(|n| (u64::from(n) & low_mask(bits)) as u32).collect();
            let mut words = [7; 72];
            let mut writer = BitWriter::new(&mut words);
            numbers.iter().for_each(|&n| writer.push(n, bits));
            let len = writer.finish();
            prop_assert_eq!(len, (numbers.len() * bits as usize).div_ceil(32));
            for (i, &number) in numbers.iter().enumerate() {
                prop_assert_eq!(read(&words[..len], i * bits as usize, bits), number);
            }
        }
    }
}
