//! The number of beams that observed a block, saturating, in one byte: a floating-point number with a 4-bit exponent and a 4-bit mantissa.

/// A count that is exact up to 31 and has a relative precision of a sixteenth beyond, rounded down; adding less than that may change nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ObservationCount(u8);

impl ObservationCount {
    /// The largest count.
    #[cfg(test)]
    const MAX: u32 = 31 << 14;

    /// As [`bits`](Self::bits) gave it.
    pub fn from_bits(bits: u8) -> Self {
        Self(bits)
    }

    /// The count as it is stored.
    pub fn bits(self) -> u8 {
        self.0
    }

    /// The count.
    #[inline(always)]
    pub fn get(self) -> u32 {
        let (exponent, mantissa) = (u32::from(self.0 >> 4), u32::from(self.0 & 15));
        if exponent == 0 { mantissa } else { (16 + mantissa) << (exponent - 1) }
    }

    /// The count plus `beams`.
    #[inline(always)]
    pub fn plus(self, beams: u32) -> Self {
        let sum = self.get().saturating_add(beams);
        if sum < 16 {
            return Self(sum as u8);
        }
        let shift = sum.ilog2() - 4;
        Self(if shift > 14 { u8::MAX } else { (((shift + 1) << 4) | (sum >> shift & 15)) as u8 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_precise_to_a_sixteenth() {
        for beams in 0..ObservationCount::MAX + 100_000 {
            let counted = ObservationCount::default().plus(beams).get();
            let expected = beams.min(ObservationCount::MAX);
            assert!(counted <= expected && expected - counted <= expected / 16, "{beams} became {counted}");
            assert!(beams >= 32 || counted == beams);
        }
        assert_eq!(ObservationCount::default().plus(u32::MAX).plus(u32::MAX).get(), ObservationCount::MAX);
    }

    #[test]
    fn equal_counts_add_up_until_one_is_below_the_precision() {
        for beams in [1, 7, 10, 333] {
            let sum = |times| (0..times).fold(ObservationCount::default(), |count, _| count.plus(beams)).get();
            assert!((1..=10).all(|times| sum(times) <= times * beams && sum(times) * 16 >= times * beams * 11));
            assert!((16 * beams..=32 * beams).contains(&sum(1000)), "a thousand times {beams} became {}", sum(1000));
        }
    }
}
