//! Fourier transforms of square images, by the library rustfft.

use rustfft::num_complex::Complex32;
use rustfft::{Fft, FftPlanner};
use std::fmt;
use std::sync::Arc;

/// Cells on a side of an image.
pub(crate) const SIDE: usize = 128;

/// Plans for transforms of images.
#[derive(Clone)]
pub(crate) struct PlaneFft {
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
}

impl fmt::Debug for PlaneFft {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlaneFft").finish_non_exhaustive()
    }
}

impl PlaneFft {
    pub(crate) fn new() -> Self {
        let mut planner = FftPlanner::new();
        Self { forward: planner.plan_fft_forward(SIDE), inverse: planner.plan_fft_inverse(SIDE) }
    }

    /// The transform of an image; rows and columns are exchanged.
    pub(crate) fn forward(&self, image: &[f32]) -> Vec<Complex32> {
        transformed(&*self.forward, image.iter().map(|v| Complex32::new(*v, 0.0)).collect())
    }

    /// The image of a transform whose rows and columns are exchanged, times the number of cells.
    pub(crate) fn inverse(&self, spectrum: Vec<Complex32>) -> Vec<f32> {
        transformed(&*self.inverse, spectrum).iter().map(|v| v.re).collect()
    }
}

fn transformed(fft: &dyn Fft<f32>, mut data: Vec<Complex32>) -> Vec<Complex32> {
    fft.process(&mut data);
    let mut turned: Vec<Complex32> = (0..SIDE * SIDE).map(|k| data[(k % SIDE) * SIDE + k / SIDE]).collect();
    fft.process(&mut turned);
    turned
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_gives_the_image_back() {
        let image: Vec<f32> = (0..SIDE * SIDE).map(|k| ((k * 7919) % 101) as f32).collect();
        let fft = PlaneFft::new();
        let back = fft.inverse(fft.forward(&image));
        let cells = (SIDE * SIDE) as f32;
        assert!(image.iter().zip(&back).all(|(a, b)| (a - b / cells).abs() < 1e-2));
    }
}
