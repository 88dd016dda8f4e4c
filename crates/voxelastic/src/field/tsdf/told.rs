//! How many beams told a block something, in a byte: a floating point number of four bits and four.

/// A count that is exact up to 31, and beyond rounded down to a sixteenth: what is less than a sixteenth of it may add nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Told(u8);

impl Told {
    /// The largest count.
    #[cfg(test)]
    const MOST: u32 = 31 << 14;

    /// The count.
    #[inline(always)]
    pub fn beams(self) -> u32 {
        let (octave, part) = (u32::from(self.0 >> 4), u32::from(self.0 & 15));
        if octave == 0 { part } else { (16 + part) << (octave - 1) }
    }

    /// `beams` more.
    #[inline(always)]
    pub fn and(self, beams: u32) -> Self {
        let sum = self.beams().saturating_add(beams);
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
    fn counts_are_kept_to_a_sixteenth() {
        for beams in 0..Told::MOST + 100_000 {
            let told = Told::default().and(beams).beams();
            let expected = beams.min(Told::MOST);
            assert!(told <= expected && expected - told <= expected / 16, "{beams} became {told}");
            assert!(beams >= 32 || told == beams);
        }
        assert_eq!(Told::default().and(u32::MAX).and(u32::MAX).beams(), Told::MOST);
    }

    #[test]
    fn equal_counts_add_up_until_one_is_little() {
        for beams in [1, 7, 10, 333] {
            let sum = |times| (0..times).fold(Told::default(), |told, _| told.and(beams)).beams();
            assert!((1..=10).all(|times| sum(times) <= times * beams && sum(times) * 16 >= times * beams * 11));
            assert!((16 * beams..=32 * beams).contains(&sum(1000)), "a thousand times {beams} became {}", sum(1000));
        }
    }
}
