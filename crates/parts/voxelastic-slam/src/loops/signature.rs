//! What a place looks like from above, whatever the position and the heading from which it was seen.
//!
//! The magnitude of the Fourier transform of an image does not change when the image is shifted, and turns with it. Along circles it is
//! therefore a set of periodic functions of the heading, and two places are compared for all headings at once by correlating these.

use super::density_image::{Column, image};
use super::plane_fft::{PlaneFft, SIDE};
use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use serde::{Deserialize, Serialize};
use std::f32::consts::PI;
use std::fmt;
use std::sync::Arc;

/// Headings on half a circle; the other half repeats them.
const HEADINGS: usize = 90;
/// Radii of the circles, in cycles per image.
const RADII: std::ops::Range<usize> = 4..44;

/// Computes and compares signatures.
#[derive(Clone)]
pub(crate) struct SignatureMaker {
    plane: PlaneFft,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl fmt::Debug for SignatureMaker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SignatureMaker").finish_non_exhaustive()
    }
}

/// The transform along each circle, half of it as the functions are real.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "Vec<[f32; 2]>", from = "Vec<[f32; 2]>")]
pub(crate) struct Signature(Vec<Complex32>);

impl From<Signature> for Vec<[f32; 2]> {
    fn from(signature: Signature) -> Self {
        signature.0.iter().map(|v| [v.re, v.im]).collect()
    }
}

impl From<Vec<[f32; 2]>> for Signature {
    fn from(parts: Vec<[f32; 2]>) -> Self {
        Self(parts.into_iter().map(|[re, im]| Complex32::new(re, im)).collect())
    }
}

/// How alike two places look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Likeness {
    /// From -1 to 1, for a place itself.
    pub(crate) score: f32,
    /// Angle by which the second must be turned to look like the first, radians; it may be half a turn more.
    pub(crate) yaw: f32,
}

impl SignatureMaker {
    pub(crate) fn new() -> Self {
        let mut planner = FftPlanner::new();
        Self { plane: PlaneFft::new(), forward: planner.plan_fft_forward(HEADINGS), inverse: planner.plan_fft_inverse(HEADINGS) }
    }

    /// The transforms of images.
    pub(crate) fn plane(&self) -> &PlaneFft {
        &self.plane
    }

    /// The signature of a place with these columns.
    pub(crate) fn signature(&self, columns: &[Column], voxel: f32) -> Signature {
        let spectrum = self.plane.forward(&image(columns, voxel, 0.0));
        let magnitudes: Vec<f32> = spectrum.iter().map(|v| v.norm().ln_1p()).collect();
        let half = HEADINGS / 2 + 1;
        let mut out = Vec::with_capacity(RADII.len() * half);
        for radius in RADII {
            let mut circle: Vec<f32> = (0..HEADINGS).map(|k| at(&magnitudes, radius as f32, PI * k as f32 / HEADINGS as f32)).collect();
            let mean = circle.iter().sum::<f32>() / HEADINGS as f32;
            circle.iter_mut().for_each(|v| *v -= mean);
            let norm = circle.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
            let mut values: Vec<Complex32> = circle.iter().map(|v| Complex32::new(v / norm, 0.0)).collect();
            self.forward.process(&mut values);
            out.extend_from_slice(&values[..half]);
        }
        Signature(out)
    }

    /// The headings at which `b` looks most like `a`, best first, at most `most`.
    pub(crate) fn compare(&self, a: &Signature, b: &Signature, most: usize) -> Vec<Likeness> {
        let half = HEADINGS / 2 + 1;
        let mut sum = vec![Complex32::new(0.0, 0.0); HEADINGS];
        for (a, b) in a.0.chunks(half).zip(b.0.chunks(half)) {
            for (s, (a, b)) in sum.iter_mut().zip(a.iter().zip(b)) {
                *s += a * b.conj();
            }
        }
        for k in half..HEADINGS {
            sum[k] = sum[HEADINGS - k].conj();
        }
        self.inverse.process(&mut sum);
        let scores: Vec<f32> = sum.iter().map(|v| v.re / (HEADINGS * RADII.len()) as f32).collect();
        let neighbour = |k: usize, step: usize| scores[(k + step) % HEADINGS];
        let is_peak = |k: &usize| scores[*k] >= neighbour(*k, 1) && scores[*k] > neighbour(*k, HEADINGS - 1);
        let mut peaks: Vec<usize> = (0..HEADINGS).filter(is_peak).collect();
        peaks.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        peaks.truncate(most);
        let likeness = |k: usize| {
            let (before, here, after) = (neighbour(k, HEADINGS - 1), scores[k], neighbour(k, 1));
            let bend = before - 2.0 * here + after;
            let offset = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
            Likeness { score: here, yaw: PI * (k as f32 + offset) / HEADINGS as f32 }
        };
        peaks.into_iter().map(likeness).collect()
    }
}

/// The magnitude at a radius and an angle of the plane of frequencies, interpolated.
fn at(magnitudes: &[f32], radius: f32, angle: f32) -> f32 {
    // Rows and columns are exchanged: the first index is the frequency along x.
    let (x, y) = (radius * angle.cos(), radius * angle.sin());
    let (x0, y0) = (x.floor(), y.floor());
    let (a, b) = (x - x0, y - y0);
    let value = |dx: f32, dy: f32| {
        let wrap = |v: f32| (v as i32).rem_euclid(SIDE as i32) as usize;
        magnitudes[wrap(x0 + dx) * SIDE + wrap(y0 + dy)]
    };
    (value(0.0, 0.0) * (1.0 - a) + value(1.0, 0.0) * a) * (1.0 - b) + (value(0.0, 1.0) * (1.0 - a) + value(1.0, 1.0) * a) * b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of some walls, turned by `yaw` and moved.
    fn walls(seed: u64, yaw: f32, shift: [f32; 2]) -> Vec<Column> {
        let mut state = seed;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let (sin, cos) = yaw.sin_cos();
        let wall = |(x, y, dx, dy): (f32, f32, f32, f32)| (0..60).map(move |k| (x + dx * k as f32 / 60.0, y + dy * k as f32 / 60.0));
        let ends: Vec<_> = (0..9).map(|_| (20.0 * random() - 10.0, 20.0 * random() - 10.0, 12.0 * random() - 6.0, 12.0 * random() - 6.0)).collect();
        ends.into_iter()
            .flat_map(wall)
            .map(|(x, y)| Column { x: cos * x - sin * y + shift[0], y: sin * x + cos * y + shift[1], value: 2.0 })
            .collect()
    }

    #[test]
    fn a_place_is_known_again_from_elsewhere_and_others_are_not() {
        let maker = SignatureMaker::new();
        let signature = |columns: &[Column]| maker.signature(columns, 0.2);
        let place = signature(&walls(1, 0.0, [0.0, 0.0]));
        assert!((maker.compare(&place, &place, 1)[0].score - 1.0).abs() < 1e-3);
        for (yaw, shift) in [(0.4, [2.0, -1.0]), (1.3, [-3.0, 2.5]), (2.9, [0.5, 4.0])] {
            // Turned back by `yaw`, what was turned looks like the place.
            let best = maker.compare(&place, &signature(&walls(1, yaw, shift)), 1)[0];
            let off = (best.yaw + yaw).rem_euclid(PI);
            assert!(best.score > 0.5 && off.min(PI - off) < 0.06, "{yaw}: {best:?}");
            for seed in 2..8 {
                let other = maker.compare(&place, &signature(&walls(seed, yaw, shift)), 1)[0];
                assert!(other.score < 0.8 * best.score, "{other:?} {best:?}");
            }
        }
    }
}
