//! The speed at which a recording is played.

/// A factor, or as fast as possible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate(Option<f64>);

/// Rates beyond these are mistakes.
const LIMITS: [f64; 2] = [0.01, 100.0];

impl Default for Rate {
    /// Its own speed.
    fn default() -> Self {
        Self(Some(1.0))
    }
}

impl Rate {
    /// Parses the argument.
    pub fn parse(text: &str) -> Result<Self, String> {
        let number = || text.parse().ok().filter(|r: &f64| (LIMITS[0]..=LIMITS[1]).contains(r));
        match text {
            "max" => Ok(Self(None)),
            _ => number().map(|rate| Self(Some(rate))).ok_or_else(|| format!("must be `max` or a number from {} to {}", LIMITS[0], LIMITS[1])),
        }
    }

    /// The factor; none for as fast as possible.
    pub fn factor(self) -> Option<f64> {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_factors_or_max() {
        assert_eq!((Rate::parse("max"), Rate::parse("0.5")), (Ok(Rate(None)), Ok(Rate(Some(0.5)))));
        assert!(["0", "-1", "nan", "inf", "101", "fast", ""].iter().all(|text| Rate::parse(text).is_err()));
    }
}
