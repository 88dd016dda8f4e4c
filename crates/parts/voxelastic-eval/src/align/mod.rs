//! Alignment of two clouds: robust point-to-plane ICP, coarse to fine.
//!
//! Each level downsamples both clouds, estimates the target's normals, and iterates Gauss-Newton steps on the distances of source points
//! to the planes of their nearest target points, weighted by a robust kernel whose width follows the residuals. Directions that the geometry
//! does not determine (along a corridor, on a plane) keep the initial guess. After Chen and Medioni 1992.

mod checks;
mod normals;
mod settings;
mod solve;
#[cfg(test)]
pub(crate) mod tests;

pub use settings::{AlignSettings, Kernel};

use crate::cloud_distance::{PointIndex, downsample};
use crate::error::Result;
use rayon::prelude::*;
use serde::Serialize;
use solve::{PointToPlane, System};
use voxelastic::Pose;
use voxelastic::geometry::Rigid;

/// Result of [`align`].
#[derive(Clone, Debug)]
pub struct Alignment {
    /// Maps source to target coordinates.
    pub t_target_source: Pose,
    /// Quality of the fit.
    pub quality: AlignQuality,
}

/// Quality of an alignment, with stable JSON keys.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlignQuality {
    /// Share of the source's voxels that have a target point within reach at the finest level, 0 to 1.
    pub overlap: f64,
    /// Root mean square distance of the matched points to the target's planes at the finest level, metres.
    pub rms_m: f64,
    /// Whether the last step at the finest level was below a tenth of a millimetre.
    pub converged: bool,
    /// Iterations at all levels.
    pub iterations: usize,
    /// Directions (of 6) that the geometry did not determine in the last iteration.
    pub undetermined: usize,
}

/// Computes the rigid motion from `source` to `target` (points in metres, each in its own frame; points that are not finite are left out). The result
/// does not depend on the number of threads.
///
/// # Errors
/// [`EvalError::Empty`](crate::EvalError::Empty) for clouds without points; [`EvalError::Units`](crate::EvalError::Units) when the ratio of the extents
/// is about 100 or 1000, or that of feet to metres and the clouds do not fit; [`EvalError::Disjoint`](crate::EvalError::Disjoint) when less than [`AlignSettings::min_overlap`] of the source is near the target;
/// [`EvalError::Setting`](crate::EvalError::Setting) for voxel sizes or a reach that are not positive.
///
/// ```
/// use voxelastic_eval::align::{AlignSettings, align};
/// let target: Vec<[f32; 3]> = (0..8000)
///     .map(|i| ((i % 20) as f32 * 0.2, (i / 20 % 20) as f32 * 0.2, i / 400))
///     .map(|(a, b, side)| match side % 3 { 0 => [a, b, 0.0], 1 => [a, 0.0, b], _ => [0.0, a, b] })
///     .collect();
/// let source: Vec<[f32; 3]> = target.iter().map(|p| [p[0] + 0.1, p[1] - 0.05, p[2] + 0.02]).collect();
/// let found = align(&source, &target, &AlignSettings::default())?;
/// assert!((found.t_target_source.translation.x + 0.1).abs() < 1e-3);
/// # Ok::<(), voxelastic_eval::EvalError>(())
/// ```
pub fn align(source: &[[f32; 3]], target: &[[f32; 3]], settings: &AlignSettings) -> Result<Alignment> {
    checks::settings(settings)?;
    let extents = checks::extents(source, target)?;
    let mut t = settings.t_target_source;
    let mut quality = AlignQuality { overlap: 0.0, rms_m: 0.0, converged: false, iterations: 0, undetermined: 0 };
    for (number, &voxel) in settings.voxels.iter().enumerate() {
        let level = Level::new(source, target, voxel, settings)?;
        if number == 0 {
            let overlap = level.overlap(&t);
            if overlap < settings.min_overlap {
                return Err(extents.disjoint(overlap, level.reach, &t));
            }
        }
        level.refine(&mut t, &mut quality);
        tracing::debug!(voxel, overlap = quality.overlap, rms_m = quality.rms_m, iterations = quality.iterations, "alignment level done");
    }
    if quality.overlap < settings.min_overlap || quality.overlap < 0.5 && extents.looks_like_feet() {
        let reach = settings.voxels.last().map_or(0.0, |v| v * settings.reach);
        return Err(extents.disjoint(quality.overlap, reach, &t));
    }
    Ok(Alignment { t_target_source: t, quality })
}

/// Transforms points by a pose.
pub fn moved(points: &[[f32; 3]], t: &Pose) -> Vec<[f32; 3]> {
    let rigid = Rigid::from(t);
    points.par_iter().map(|p| rigid.apply(*p)).collect()
}

/// Both clouds at one level.
struct Level<'a> {
    source: Vec<[f32; 3]>,
    target: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    index: PointIndex,
    reach: f32,
    /// Centre of the target, about which rotations are estimated, and half its diagonal, which scales them to metres.
    centre: [f64; 3],
    radius: f64,
    settings: &'a AlignSettings,
}

/// Source points that one task handles; fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 2048;
/// A shorter step (metres, at the target's radius) ends a level.
const STEP_M: f64 = 1e-4;

impl<'a> Level<'a> {
    fn new(source: &[[f32; 3]], target: &[[f32; 3]], voxel: f32, settings: &'a AlignSettings) -> Result<Self> {
        let (source, target) = (downsample(source, voxel)?, downsample(target, voxel)?);
        let index = PointIndex::new(&target, "the target cloud")?;
        let normals = normals::estimate(&target, &index);
        let bounds = crate::mesh::bounds(&target);
        let centre = std::array::from_fn(|k| 0.5 * (f64::from(bounds.min[k]) + f64::from(bounds.max[k])));
        let radius = bounds.size().iter().map(|s| f64::from(*s).powi(2)).sum::<f64>().sqrt().max(f64::from(voxel)) / 2.0;
        Ok(Self { source, target, normals, index, reach: voxel * settings.reach, centre, radius, settings })
    }

    /// Share of the source that has a target point within reach.
    fn overlap(&self, t: &Pose) -> f64 {
        let near = |p: &&[f32; 3]| self.index.nearest(**p).1 <= self.reach * self.reach;
        let points = moved(&self.source, t);
        points.par_iter().filter(near).count() as f64 / points.len().max(1) as f64
    }

    fn refine(&self, t: &mut Pose, quality: &mut AlignQuality) {
        quality.converged = false;
        for _ in 0..self.settings.max_iterations {
            let matches = self.matches(t);
            let system = self.system(&matches);
            quality.overlap = matches.len() as f64 / self.source.len().max(1) as f64;
            quality.rms_m = system.rms();
            let Some(step) = system.solve() else { return };
            quality.undetermined = step.undetermined;
            *t = step.pose(self.centre, self.radius) * *t;
            quality.iterations += 1;
            if step.length() < STEP_M {
                quality.converged = true;
                return;
            }
        }
    }

    /// Residual and derivative of each matched point.
    fn matches(&self, t: &Pose) -> Vec<PointToPlane> {
        let points = moved(&self.source, t);
        let row = |p: &[f32; 3]| {
            let (i, distance2) = self.index.nearest(*p);
            let (q, n) = (self.target[i], self.normals[i].map(f64::from));
            if distance2 > self.reach * self.reach || n == [0.0; 3] {
                return None;
            }
            let gap: [f64; 3] = std::array::from_fn(|k| f64::from(q[k]) - f64::from(p[k]));
            let arm: [f64; 3] = std::array::from_fn(|k| (f64::from(p[k]) - self.centre[k]) / self.radius);
            Some(PointToPlane::new(n, arm, gap))
        };
        let parts: Vec<Vec<PointToPlane>> = points.par_chunks(CHUNK).map(|c| c.iter().filter_map(row).collect()).collect();
        parts.concat()
    }

    fn system(&self, matches: &[PointToPlane]) -> System {
        let width = match self.settings.kernel {
            Kernel::Squares => f64::INFINITY,
            Kernel::Huber => 1.345 * scale(matches),
            Kernel::Cauchy => 2.385 * scale(matches),
        };
        let weight = |r: f64| match self.settings.kernel {
            Kernel::Squares => 1.0,
            Kernel::Huber => (width / r.abs().max(1e-12)).min(1.0),
            Kernel::Cauchy => 1.0 / (1.0 + (r / width).powi(2)),
        };
        let parts: Vec<System> = matches.par_chunks(CHUNK).map(|c| System::of(c, weight)).collect();
        parts.iter().fold(System::default(), |a, b| a.plus(b))
    }
}

/// Robust standard deviation of the residuals, metres: the scaled median of their sizes, at least a tenth of a millimetre.
fn scale(matches: &[PointToPlane]) -> f64 {
    let mut sizes: Vec<f64> = matches.iter().map(|m| m.residual.abs()).collect();
    if sizes.is_empty() {
        return 1.0;
    }
    let half = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(half, f64::total_cmp);
    (1.4826 * *median).max(1e-4)
}
