//! Sensors whose beams never repeat: the directions of their beams as functions of time.

use crate::Ray;
use crate::solid::Vec3;
use std::f64::consts::TAU;

/// The law by which the beams move.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Law {
    /// Two wedge prisms, one behind the other, turn at different speeds in opposite directions, and each bends the beam by half of the field of view (first
    /// order of a Risley scanner: Brazeal et al., "A Rigorous Observation Model for the Risley Prism-Based Livox Mid-40 Lidar Sensor", Sensors 21(14), 2021).
    Rosette {
        /// Turns per second of the prisms.
        prisms: [f64; 2],
        /// Half of the field of view across and upwards, radians.
        half: [f64; 2],
        /// Angle between neighbouring lines, radians.
        gap: f64,
    },
    /// The beams turn around the upright axis while their elevation swings.
    Spiral {
        /// Turns and swings per second; no small ratio, so that the curve does not close.
        rates: [f64; 2],
        /// Lowest and highest elevation, radians.
        elevations: [f64; 2],
    },
}

/// A sensor whose beams never repeat. Several lasers, its lines, fire at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pattern {
    /// What the sensor is called.
    pub name: &'static str,
    /// Lasers.
    pub lines: usize,
    /// Times per second that all of them fire.
    pub rate: f64,
    /// Lowest and highest elevation, radians.
    pub elevations: [f64; 2],
    law: Law,
}

const DEGREE: f64 = TAU / 360.0;

/// Fields of view, lines and rates of the makers' data sheets. The speeds of the Avia's prisms are not published: they are those that Brazeal et al. measured
/// of the Mid-40. Nor are the rates of the Mid-360: with these it looks alike, 40 strokes of each line a turn, shifted from turn to turn.
const PATTERNS: [Pattern; 2] = [
    Pattern {
        name: "avia",
        lines: 6,
        rate: 40_000.0,
        elevations: [-38.6 * DEGREE, 38.6 * DEGREE],
        law: Law::Rosette { prisms: [7294.0 / 60.0, -4664.0 / 60.0], half: [35.2 * DEGREE, 38.6 * DEGREE], gap: 0.3 * DEGREE },
    },
    Pattern {
        name: "mid-360",
        lines: 4,
        rate: 50_000.0,
        elevations: [-7.0 * DEGREE, 52.0 * DEGREE],
        law: Law::Spiral { rates: [9.7, 201.3], elevations: [-7.0 * DEGREE, 52.0 * DEGREE] },
    },
];

impl Pattern {
    /// The sensor called `name` (`avia`, `mid-360`), if it is one whose beams never repeat.
    pub fn named(name: &str) -> Option<Self> {
        let plain = |name: &str| name.to_ascii_lowercase().replace(['-', '_'], "");
        PATTERNS.into_iter().find(|pattern| plain(pattern.name) == plain(name))
    }

    /// Names of all of them.
    pub fn names() -> impl Iterator<Item = &'static str> {
        PATTERNS.iter().map(|pattern| pattern.name)
    }

    /// The beams of `firings` firings from `start` seconds on, lidar frame, x ahead and z up: firing by firing, line by line.
    pub(super) fn beams(&self, start: f64, firings: usize) -> Vec<Ray> {
        let direction = |firing: usize, line: usize| self.law.direction(start + firing as f64 / self.rate, line, self.lines);
        (0..firings).flat_map(|firing| (0..self.lines).map(move |line| (Vec3::zeros(), direction(firing, line)))).collect()
    }
}

impl Law {
    fn direction(&self, time: f64, line: usize, lines: usize) -> Vec3 {
        let line = line as f64;
        match *self {
            Self::Rosette { prisms, half, gap } => {
                let [a, b] = prisms.map(|speed| (TAU * (speed * time).fract()).sin_cos());
                let across = 0.5 * half[0] * (a.1 + b.1);
                let up = 0.5 * half[1] * (a.0 + b.0) + gap * (line - 0.5 * (lines as f64 - 1.0));
                // The deflections are angles: their length is the angle from the axis.
                let angle = across.hypot(up).max(1e-12);
                let share = angle.sin() / angle;
                Vec3::new(angle.cos(), share * across, share * up)
            }
            Self::Spiral { rates, elevations: [low, high] } => {
                let [turn, swing] = rates.map(|rate| (rate * time + line / lines as f64).fract());
                let elevation = 0.5 * (low + high) + 0.5 * (high - low) * (TAU * swing).sin();
                let (sin, cos) = (-TAU * turn).sin_cos();
                Vec3::new(elevation.cos() * cos, elevation.cos() * sin, elevation.sin())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_fill_their_field_of_view_and_do_not_repeat() {
        for name in ["avia", "Mid360"] {
            let pattern = Pattern::named(name).unwrap();
            let sweep = |k: usize| pattern.beams(0.1 * k as f64, (0.1 * pattern.rate) as usize);
            let beams: Vec<Ray> = (0..10).flat_map(sweep).collect();
            let elevation = |ray: &Ray| ray.1.z.asin();
            let (low, high) = beams.iter().map(elevation).fold((1.0f64, -1.0f64), |(low, high), e| (low.min(e), high.max(e)));
            let slack = DEGREE;
            assert!((low - pattern.elevations[0]).abs() < slack && (high - pattern.elevations[1]).abs() < slack, "{name}: {low} to {high}");
            assert!(beams.iter().all(|ray| (ray.1.norm() - 1.0).abs() < 1e-9));
            // Cells of a degree that ten sweeps reach, and that the first alone does.
            let cells = |beams: &[Ray]| {
                let cell = |ray: &Ray| ((ray.1.y.atan2(ray.1.x) / DEGREE).floor() as i32, (elevation(ray) / DEGREE).floor() as i32);
                beams.iter().map(cell).collect::<std::collections::BTreeSet<_>>().len()
            };
            let (all, first) = (cells(&beams), cells(&sweep(0)));
            assert!(all as f64 > 1.15 * first as f64, "{name}: {first} cells of {all} in one sweep");
        }
        assert!(Pattern::named("os1-64").is_none());
    }
}
