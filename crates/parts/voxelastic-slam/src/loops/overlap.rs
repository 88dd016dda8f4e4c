//! Where two images lie on each other best: candidates for how one place was seen from another.

use super::density_image::{cell_size, image};
use super::place::Place;
use super::plane_fft::SIDE;
use super::signature::SignatureMaker;
use nalgebra::{UnitQuaternion, Vector3};
use rustfft::num_complex::Complex32;
use std::f32::consts::PI;
use voxelastic::geometry::Pose;

/// Headings that are tried, each also with half a turn more.
const HEADINGS: usize = 4;

/// Headings that are known are known to within this, radians.
pub(crate) const HEADING_ERROR: f64 = std::f64::consts::FRAC_PI_4;

/// The angle between two headings, radians.
pub(crate) fn turn_between(a: f64, b: f64) -> f64 {
    let turn = (a - b).rem_euclid(std::f64::consts::TAU);
    turn.min(std::f64::consts::TAU - turn)
}

/// A guess of how a place lies in the frame of another.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guess {
    /// Pose of the anchor of the second place in the frame of the first.
    pub(crate) t_first_second: Pose,
    /// Correlation of the images, 0 to 1.
    pub(crate) correlation: f32,
}

/// The best guess of how `second` lies in the frame of `first`. If it is known about how far `second` is turned there (radians, both levelled), only such
/// headings count.
pub(crate) fn best_guess(first: &Place, second: &Place, about: Option<f64>, voxel: f32, maker: &SignatureMaker) -> Option<Guess> {
    let plane = maker.plane();
    let target = image(&first.columns, voxel, 0.0);
    let spectrum = plane.forward(&target);
    let headings = maker.compare(&first.signature, &second.signature, HEADINGS);
    let is_about = |yaw: &f32| about.is_none_or(|about| turn_between(f64::from(*yaw), about) <= HEADING_ERROR);
    let yaws = headings.iter().flat_map(|likeness| [likeness.yaw, likeness.yaw + PI]).filter(is_about).chain(about.map(|yaw| yaw as f32));
    let mut best: Option<(f32, f32, usize)> = None;
    for yaw in yaws {
        let turned = image(&second.columns, voxel, yaw);
        let product: Vec<Complex32> = spectrum.iter().zip(plane.forward(&turned)).map(|(a, b)| a * b.conj()).collect();
        let correlation = plane.inverse(product);
        let (at, peak) = correlation.iter().copied().enumerate().fold((0, f32::NEG_INFINITY), |best, (k, v)| if v > best.1 { (k, v) } else { best });
        let energy = |image: &[f32]| image.iter().map(|v| v * v).sum::<f32>();
        let score = peak / ((SIDE * SIDE) as f32 * (energy(&target) * energy(&turned)).sqrt().max(1e-6));
        if best.is_none_or(|(most, ..)| score > most) {
            best = Some((score, yaw, at));
        }
    }
    let (correlation, yaw, at) = best?;
    // Beyond half an image a shift is one to the other side.
    let metres = |cells: usize| (if cells >= SIDE / 2 { cells as f32 - SIDE as f32 } else { cells as f32 }) * cell_size(voxel);
    // The transforms exchange rows and columns twice, so that the image is as it was.
    let shift = Vector3::new(f64::from(metres(at % SIDE)), f64::from(metres(at / SIDE)), 0.0);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(yaw));
    let levelled = Pose::from_parts(shift.into(), turn * second.level);
    let t_first_second = Pose::from_parts(Vector3::zeros().into(), first.level.inverse()) * levelled;
    Some(Guess { t_first_second, correlation })
}
