//! Sizes of memory as people write them.

use super::MemoryError;
use std::fmt;
use std::str::FromStr;

/// A number of bytes as text, such as `500MB`, `2GB` or `1.5 GiB`; `none` is zero and stands for no limit. Without a unit, megabytes (10^6).
///
/// ```
/// use voxelastic::memory::MemorySize;
/// assert_eq!("500MB".parse(), Ok(MemorySize(500_000_000)));
/// assert_eq!("none".parse(), Ok(MemorySize(0)));
/// assert_eq!(MemorySize(2_500_000_000).to_string(), "2500MB");
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemorySize(pub u64);

impl MemorySize {
    /// Makes this size the [budget](super::limit) of the process, with its file in the default folder; `none` leaves the budget as it is.
    ///
    /// # Errors
    /// [`MemoryError`]; the budget is then as it was.
    pub fn set_budget(self) -> Result<(), MemoryError> {
        if self.0 == 0 { Ok(()) } else { super::limit(self.0, None) }
    }
}

/// Units and their bytes. The longer of two with one end comes first.
const UNITS: [(&str, u64); 10] = [
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
    ("tib", 1 << 40),
    ("kb", 1_000),
    ("mb", 1_000_000),
    ("gb", 1_000_000_000),
    ("tb", 1_000_000_000_000),
    ("b", 1),
    ("", 1_000_000),
];

/// Text that is no size of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("must be a size such as 500MB or 2GB, or none")]
pub struct NotASize;

impl FromStr for MemorySize {
    type Err = NotASize;

    fn from_str(text: &str) -> Result<Self, NotASize> {
        let text = text.trim().to_ascii_lowercase();
        if text == "none" {
            return Ok(Self(0));
        }
        let number_and_unit = UNITS.iter().find_map(|&(unit, bytes)| Some((text.strip_suffix(unit)?, bytes)));
        let (number, unit) = number_and_unit.ok_or(NotASize)?;
        let number: f64 = number.trim().parse().map_err(|_| NotASize)?;
        let bytes = number * unit as f64;
        // Beyond 2^53 a double does not count single bytes, and no machine has as many.
        if bytes >= 1.0 && bytes < 2f64.powi(53) { Ok(Self(bytes as u64)) } else { Err(NotASize) }
    }
}

impl fmt::Display for MemorySize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            0 => write!(f, "none"),
            bytes if bytes % 1_000_000 == 0 => write!(f, "{}MB", bytes / 1_000_000),
            bytes => write!(f, "{bytes}B"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn sizes_are_read_as_people_write_them() {
        let size = |text: &str| text.parse::<MemorySize>().map(|size| size.0);
        assert_eq!(["1.5GiB", "2 gb", "700", "64 MiB", "9999B"].map(size), [Ok(3 << 29), Ok(2_000_000_000), Ok(700_000_000), Ok(1 << 26), Ok(9999)]);
        for text in ["", "MB", "-1MB", "0", "0GB", "1e30", "inf", "nan", "5XB", "many", "500 000 MB"] {
            assert_eq!(size(text), Err(NotASize), "{text:?}");
        }
    }

    proptest! {
        #[test]
        fn written_sizes_are_read_again(bytes in 1u64..1 << 52) {
            prop_assert_eq!(MemorySize(bytes).to_string().parse(), Ok(MemorySize(bytes)));
        }
    }
}
