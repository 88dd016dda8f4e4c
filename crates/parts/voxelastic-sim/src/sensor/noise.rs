//! Noise model: range noise, lost returns, mixed pixels, intensity noise.

use super::sample::Sample;
use crate::SimError;
use crate::random::Stream;
use serde::{Deserialize, Serialize};

/// Noise of a sensor. The default is that of an Ouster OS1: 1 cm near, 3 cm at 100 m, and half of the returns lost at the range of its data sheet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Standard deviation of a range at distance zero, metres.
    pub range_sigma: f64,
    /// Increase of the standard deviation per metre of range, metres.
    pub range_sigma_per_metre: f64,
    /// Relative increase of the standard deviation per unit of 1 / cos(angle of incidence) above 1, up to 80 degrees.
    pub grazing: f64,
    /// Share of returns lost at random.
    pub dropout: f64,
    /// Range at which half of the returns from a surface of albedo 0.8 at normal incidence are lost, metres. Weaker returns are lost at shorter ranges.
    /// Infinite: none are lost.
    pub reach: f64,
    /// Share of mixed pixels at depth edges, whose range is between those of the two sides.
    pub mixed: f64,
    /// Largest depth step of a mixed pixel, metres: a sensor separates returns that are farther apart.
    pub mixed_depth: f64,
    /// Relative standard deviation of the intensity.
    pub intensity_sigma: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self {
            range_sigma: 0.01,
            range_sigma_per_metre: 0.0002,
            grazing: 0.1,
            dropout: 0.003,
            reach: 120.0,
            mixed: 0.3,
            mixed_depth: 1.5,
            intensity_sigma: 0.05,
        }
    }
}

/// Cosine of the incidence beyond which noise does not increase.
const MIN_COSINE: f64 = 0.17;

/// True ranges of the two neighbours of a pixel along a line.
pub(super) type Neighbours = [Option<f64>; 2];

impl Noise {
    /// No noise.
    pub fn none() -> Self {
        Self {
            range_sigma: 0.0,
            range_sigma_per_metre: 0.0,
            grazing: 0.0,
            dropout: 0.0,
            reach: f64::INFINITY,
            mixed: 0.0,
            mixed_depth: 0.0,
            intensity_sigma: 0.0,
        }
    }

    /// The same noise times `factor`; none for 0. Probabilities stay at most 1.
    pub fn times(&self, factor: f64) -> Self {
        if factor == 0.0 {
            return Self::none();
        }
        // Not `min`, which would turn NaN into 1.
        let share = |s: f64| if s * factor > 1.0 { 1.0 } else { s * factor };
        Self {
            range_sigma: self.range_sigma * factor,
            range_sigma_per_metre: self.range_sigma_per_metre * factor,
            dropout: share(self.dropout),
            mixed: share(self.mixed),
            intensity_sigma: self.intensity_sigma * factor,
            ..*self
        }
    }

    /// Checks all settings.
    ///
    /// # Errors
    /// [`SimError::Setting`] for a value out of range or NaN.
    pub(crate) fn check(&self) -> Result<(), SimError> {
        let lengths = [
            ("noise.range_sigma", self.range_sigma),
            ("noise.range_sigma_per_metre", self.range_sigma_per_metre),
            ("noise.grazing", self.grazing),
            ("noise.mixed_depth", self.mixed_depth),
            ("noise.intensity_sigma", self.intensity_sigma),
        ];
        let shares = [("noise.dropout", self.dropout), ("noise.mixed", self.mixed)];
        for (setting, value) in lengths {
            if !(0.0..=1e3).contains(&value) {
                return Err(SimError::Setting { setting, value, allowed: "from 0 to 1000" });
            }
        }
        for (setting, value) in shares {
            if !(0.0..=1.0).contains(&value) {
                return Err(SimError::Setting { setting, value, allowed: "from 0 to 1" });
            }
        }
        if self.reach > 0.0 { Ok(()) } else { Err(SimError::Setting { setting: "noise.reach", value: self.reach, allowed: "above 0" }) }
    }

    /// Standard deviation of a range, metres.
    pub fn sigma(&self, range: f64, cosine: f64) -> f64 {
        let steep = 1.0 / cosine.max(MIN_COSINE) - 1.0;
        (self.range_sigma + self.range_sigma_per_metre * range) * (1.0 + self.grazing * steep)
    }

    /// Probability that a return is detected: its strength decreases with the square of the range and with the albedo; rough surfaces reflect some
    /// light at any angle.
    pub fn detection_probability(&self, sample: &Sample) -> f64 {
        let strength = f64::from(sample.albedo) * (0.3 + 0.7 * f64::from(sample.cosine)) / 0.8;
        let share = sample.range / (self.reach * strength.sqrt());
        // A smooth step from all to none between 90 % and 110 % of the range.
        let t = ((share - 0.9) / 0.2).clamp(0.0, 1.0);
        (1.0 - self.dropout) * (1.0 - t * t * (3.0 - 2.0 * t))
    }

    /// The measured range, or `None` for a lost return. `neighbours` are those across and along the columns.
    pub(super) fn measure(&self, sample: &Sample, neighbours: [Neighbours; 2], random: &mut Stream) -> Option<f64> {
        if random.uniform() >= self.detection_probability(sample) {
            return None;
        }
        let mut range = sample.range;
        if self.mixed > 0.0 {
            let line = neighbours[random.index(2)];
            let (one, other) = if random.uniform() < 0.5 { (line[0], line[1]) } else { (line[1], line[0]) };
            let mixes = random.uniform() < self.mixed;
            let share = random.uniform();
            if let Some(across) = one.filter(|across| mixes && self.is_edge(range, *across, other)) {
                range += share * (across - range);
            }
        }
        Some(range + self.sigma(sample.range, f64::from(sample.cosine)) * random.normal())
    }

    /// Whether a depth step is an edge: much larger than the slope of the surface explains.
    fn is_edge(&self, range: f64, across: f64, opposite: Option<f64>) -> bool {
        let step = (across - range).abs();
        let slope = opposite.map_or(0.0, |o| (o - range).abs().min(0.5 * step));
        step < self.mixed_depth && step > 0.1 + 3.0 * slope
    }
}
