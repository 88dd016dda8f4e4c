//! What a real sensor adds to the truth and leaves out of it.

use super::Sample;
use crate::SimError;
use crate::random::Stream;
use serde::{Deserialize, Serialize};

/// How a sensor errs. The default is an Ouster OS1: 1 cm near, 3 cm at 100 m, and half of the returns lost where its data sheet ends.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Standard deviation of a range at no distance, metres.
    pub range_sigma: f64,
    /// What each metre of range adds to it, metres.
    pub range_sigma_per_metre: f64,
    /// By what share each unit of 1 / cos(angle of incidence) above 1 raises it (no further than at 80 degrees).
    pub grazing: f64,
    /// Share of returns that are lost for no reason.
    pub dropout: f64,
    /// Range at which half of the returns of a surface of albedo 0.8 are lost when hit squarely, metres; others are lost
    /// nearer by, as their light is weaker. Infinite: none are lost.
    pub reach: f64,
    /// Share of the pixels at edges of depth whose range lies somewhere between the two sides.
    pub mixed: f64,
    /// Largest step of depth that can mix, metres: beyond it a sensor tells the two returns apart.
    pub mixed_depth: f64,
    /// Standard deviation of the intensity, relative.
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

/// Steepest incidence that still adds noise, as a cosine.
const LEAST_COSINE: f64 = 0.17;

/// The returns of the two neighbours on a line through a pixel.
pub(super) type Neighbours = [Option<f64>; 2];

impl Noise {
    /// A sensor that measures the truth.
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

    /// # Errors
    /// [`SimError::Setting`] for a number below zero, a share above one, or none at all.
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
        let steep = 1.0 / cosine.max(LEAST_COSINE) - 1.0;
        (self.range_sigma + self.range_sigma_per_metre * range) * (1.0 + self.grazing * steep)
    }

    /// Chance that a return is strong enough to be noticed: light falls with the square of the range and with the albedo; rough
    /// surfaces throw some of it back at any angle.
    pub fn chance(&self, sample: &Sample) -> f64 {
        let strength = f64::from(sample.albedo) * (0.3 + 0.7 * f64::from(sample.cosine)) / 0.8;
        let share = sample.range / (self.reach * strength.sqrt());
        // From all to none within a tenth of the range on either side.
        let t = ((share - 0.9) / 0.2).clamp(0.0, 1.0);
        (1.0 - self.dropout) * (1.0 - t * t * (3.0 - 2.0 * t))
    }

    /// The range measured, or `None` when the return is lost. `beside` are the neighbours across and along the columns.
    pub(super) fn measure(&self, sample: &Sample, beside: [Neighbours; 2], random: &mut Stream) -> Option<f64> {
        if random.uniform() >= self.chance(sample) {
            return None;
        }
        let mut range = sample.range;
        if self.mixed > 0.0 {
            let line = beside[random.index(2)];
            let (one, other) = if random.uniform() < 0.5 { (line[0], line[1]) } else { (line[1], line[0]) };
            let mixes = random.uniform() < self.mixed;
            let share = random.uniform();
            if let Some(across) = one.filter(|across| mixes && self.is_edge(range, *across, other)) {
                range += share * (across - range);
            }
        }
        Some(range + self.sigma(sample.range, f64::from(sample.cosine)) * random.normal())
    }

    /// A step is an edge when it is much more than the slope of the surface explains.
    fn is_edge(&self, range: f64, across: f64, opposite: Option<f64>) -> bool {
        let step = (across - range).abs();
        let slope = opposite.map_or(0.0, |o| (o - range).abs().min(0.5 * step));
        step < self.mixed_depth && step > 0.1 + 3.0 * slope
    }
}
