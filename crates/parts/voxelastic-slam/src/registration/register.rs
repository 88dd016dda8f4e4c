//! Registration of points to the local map: Gauss-Newton with a robust kernel that narrows, from coarse voxels to fine ones.

use super::degeneracy::Solution;
use super::information::information;
use super::larger_planes::{LargerPlanes, Surfaces};
use super::local_map::{LocalMap, RANGE_NOISE, Surfel};
use super::normal_equations::{Kernel, NormalEquations};
use nalgebra::{Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use voxelastic::geometry::{Pose, PoseExt};

/// Fewer matches than this hold no pose.
const LEAST_MATCHES: usize = 30;

/// Poses farther apart than this are different places: metres, radians.
const ELSEWHERE: (f64, f64) = (1.0, 0.2);

/// Starts of a search that are refined.
const REFINED: usize = 4;

/// One point of this many is asked whether only lines of single beams hold the pose.
const SPARSE: usize = 4;

/// Settings of a registration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RegistrationSettings {
    /// Most iterations on each level.
    pub(crate) max_iterations: usize,
    /// A step that moves no point farther than this ends the iterations, metres.
    pub(crate) convergence: f64,
    /// Narrowest scale of the kernel, metres.
    pub(crate) least_scale: f64,
    /// Weight of a distance to a surface that is no plane, relative to that of its spread.
    pub(crate) point_weight: f64,
}

/// The outcome of a registration.
#[derive(Clone, Debug)]
pub(crate) struct Registration {
    pub(crate) t_map_lidar: Pose,
    /// Directions along which the surfaces did not hold the pose: translation in the map frame, rotation about the sensor around the map's axes.
    pub(crate) degenerate: Vec<Vector6<f64>>,
    /// Share of the points that have a surface within the gate.
    pub(crate) overlap: f64,
    /// Mean weight of the points: 1 where all lie on perfect planes.
    pub(crate) score: f64,
    /// Robust mean distance to the surfaces, metres.
    pub(crate) spread: f64,
    pub(crate) iterations: usize,
    pub(crate) is_converged: bool,
    /// Whether lines of single beams would have held the pose, and were taken for the planes on which they lie.
    has_larger_planes: bool,
    /// At the end.
    equations: NormalEquations,
    kernel: Kernel,
}

impl Registration {
    /// Information of the pose in the frame of the points (x y z roll pitch yaw), inverse square metres and radians, from the points and the levels that were
    /// registered.
    pub(crate) fn information(&self, points: &[Surfel], levels: &[LocalMap]) -> Matrix6<f64> {
        let independent = || self.equations.information / (self.spread * self.spread);
        let (pose, kernel, equations) = (&self.t_map_lidar, &self.kernel, &self.equations);
        let along_map = match self.has_larger_planes {
            false => information(points, pose, &levels[0], kernel, equations),
            true => information(points, pose, &LargerPlanes::of(levels, 0), kernel, equations),
        };
        let along_map = along_map.unwrap_or_else(independent);
        let rotation = *self.t_map_lidar.rotation.to_rotation_matrix().matrix();
        let mut axes = Matrix6::zeros();
        axes.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        axes.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
        let turned = axes.transpose() * along_map * axes;
        (turned + turned.transpose()) * 0.5
    }
}

/// Moves a pose by a small step: translation in the map frame, rotation about the sensor around the map's axes.
pub(crate) fn stepped(pose: &Pose, step: &Vector6<f64>) -> Pose {
    let mut rotation = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5])) * pose.rotation;
    rotation.renormalize();
    Pose::from_parts(Translation3::from(pose.translation.vector + Vector3::new(step[0], step[1], step[2])), rotation)
}

/// Registers points in the sensor's frame from a guess that is wrong by about `sigma`, metres. Where that is more than the finest voxels
/// capture, coarser levels refine the guess first; as these can also lead astray, the outcome with the best score counts.
pub(crate) fn register(points: &[Surfel], guess: &Pose, levels: &[LocalMap], sigma: f64, settings: &RegistrationSettings) -> Option<Registration> {
    let needed = levels.iter().take_while(|level| level.size() <= levels[0].size() || level.size() < 4.0 * sigma).count();
    let mut best: Option<Registration> = None;
    let mut iterations = 0;
    for first in 0..needed {
        let Some(found) = descend(points, guess, levels, first, sigma, settings) else { continue };
        iterations += found.iterations;
        if best.as_ref().is_none_or(|best| found.score > best.score) {
            best = Some(found);
        }
    }
    best.map(|best| Registration { iterations, ..best })
}

/// The same from many starts, without an idea which is right: the coarsest level orders them, and the best few are refined.
pub(crate) fn search(points: &[Surfel], starts: &[Pose], levels: &[LocalMap], settings: &RegistrationSettings) -> Vec<Registration> {
    let Some(coarsest) = levels.last() else { return Vec::new() };
    let finer = levels.len().saturating_sub(2);
    let radius = mean_radius(points);
    let sparse: Vec<Surfel> = points.iter().step_by(1 << levels.len()).copied().collect();
    let size = coarsest.size();
    let schedule = Schedule { gate: 2.0 * size, first_scale: size, last_scale: 0.2 * size, convergence: 0.02 * size };
    let aligned = starts.iter().filter_map(|start| align(&sparse, start, coarsest, radius, &schedule, &[], settings));
    let mut scored: Vec<(f64, Pose)> = aligned.map(|a| (a.equations.fit, a.pose)).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.truncate(REFINED);
    scored.iter().filter_map(|(_, pose)| descend(points, pose, levels, finer, 0.25 * size, settings)).collect()
}

/// The outcomes of different poses, best score first; the first of equals.
pub(crate) fn ranked(mut all: Vec<Registration>) -> Vec<Registration> {
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut ranked: Vec<Registration> = Vec::new();
    for found in all {
        if ranked.iter().all(|better| is_elsewhere(&found.t_map_lidar, &better.t_map_lidar)) {
            ranked.push(found);
        }
    }
    ranked
}

fn is_elsewhere(a: &Pose, b: &Pose) -> bool {
    a.translation_distance(b) > ELSEWHERE.0 || a.rotation_distance(b) > ELSEWHERE.1
}

/// Aligns to the levels from `first` to the finest. If only lines of single beams hold the pose then, again with the planes on which these lie.
fn descend(points: &[Surfel], guess: &Pose, levels: &[LocalMap], first: usize, sigma: f64, settings: &RegistrationSettings) -> Option<Registration> {
    let found = descend_by(points, guess, levels.iter().take(first + 1), sigma, &[], settings)?;
    if levels.len() == 1 {
        return Some(found);
    }
    let sparse: Vec<Surfel> = points.iter().step_by(SPARSE).copied().collect();
    let with_planes = NormalEquations::of(&sparse, &found.t_map_lidar, &LargerPlanes::of(levels, 0), &found.kernel);
    let held = Solution::of(&with_planes, mean_radius(points), &[])?;
    if held.degenerate.len() <= found.degenerate.len() {
        return Some(found);
    }
    let with_planes: Vec<LargerPlanes<'_>> = (0..=first).map(|k| LargerPlanes::of(levels, k)).collect();
    let again = descend_by(points, guess, with_planes.iter(), sigma, &held.degenerate, settings)?;
    Some(Registration { iterations: found.iterations + again.iterations, has_larger_planes: true, degenerate: held.degenerate, ..again })
}

/// Aligns to each level, from the coarsest of these to the finest; nothing moves along the unit directions in `fixed`.
fn descend_by<'a, S: Surfaces + 'a>(
    points: &[Surfel],
    guess: &Pose,
    levels: impl DoubleEndedIterator<Item = &'a S> + ExactSizeIterator + Clone,
    sigma: f64,
    fixed: &[Vector6<f64>],
    settings: &RegistrationSettings,
) -> Option<Registration> {
    let radius = mean_radius(points);
    let (mut pose, mut iterations) = (*guess, 0);
    for (k, level) in levels.clone().enumerate().skip(1).rev() {
        let size = level.size();
        let sparse: Vec<Surfel> = points.iter().step_by(1 << k).copied().collect();
        let schedule = Schedule { gate: (3.0 * sigma).max(size), first_scale: sigma / 3.0, last_scale: 0.2 * size, convergence: 0.02 * size };
        let aligned = align(&sparse, &pose, level, radius, &schedule, fixed, settings)?;
        (pose, iterations) = (aligned.pose, iterations + aligned.iterations);
    }
    let finest = levels.into_iter().next()?;
    let scale = settings.least_scale;
    let schedule =
        Schedule { gate: (3.0 * sigma).max(finest.size()), first_scale: sigma / 3.0, last_scale: scale, convergence: settings.convergence };
    let aligned = align(points, &pose, finest, radius, &schedule, fixed, settings)?;
    Some(summary(points.len(), aligned, iterations))
}

/// How the kernel of an alignment narrows, and when it ends.
struct Schedule {
    gate: f64,
    first_scale: f64,
    last_scale: f64,
    convergence: f64,
}

/// A pose aligned to one level.
struct Aligned {
    pose: Pose,
    kernel: Kernel,
    equations: NormalEquations,
    solution: Solution,
    iterations: usize,
    is_converged: bool,
}

fn align(
    points: &[Surfel],
    start: &Pose,
    level: &impl Surfaces,
    radius: f64,
    schedule: &Schedule,
    fixed: &[Vector6<f64>],
    settings: &RegistrationSettings,
) -> Option<Aligned> {
    let mut kernel = Kernel { gate: schedule.gate, scale: schedule.first_scale.max(schedule.last_scale), point_weight: settings.point_weight };
    let mut pose = *start;
    for iterations in 1..=settings.max_iterations {
        let equations = NormalEquations::of(points, &pose, level, &kernel);
        if equations.matched < LEAST_MATCHES {
            return None;
        }
        let solution = Solution::of(&equations, radius, fixed)?;
        pose = stepped(&pose, &solution.step);
        let moved = solution.step.fixed_rows::<3>(0).norm() + radius * solution.step.fixed_rows::<3>(3).norm();
        let is_converged = kernel.scale <= schedule.last_scale && moved < schedule.convergence;
        if is_converged || iterations == settings.max_iterations {
            return Some(Aligned { pose, kernel, equations, solution, iterations, is_converged });
        }
        // The kernel narrows once the pose is right for its scale.
        if moved < 0.5 * kernel.scale || iterations % 8 == 0 {
            kernel.scale = (kernel.scale * 0.5).max(schedule.last_scale);
        }
    }
    None
}

fn summary(points: usize, aligned: Aligned, coarse_iterations: usize) -> Registration {
    let Aligned { pose, kernel, equations, solution, iterations, is_converged } = aligned;
    let variance = (equations.squares / equations.weight).max(RANGE_NOISE * RANGE_NOISE * 0.01);
    Registration {
        t_map_lidar: pose,
        degenerate: solution.degenerate,
        overlap: equations.matched as f64 / points.max(1) as f64,
        score: equations.fit / points.max(1) as f64,
        spread: variance.sqrt(),
        iterations: iterations + coarse_iterations,
        is_converged,
        has_larger_planes: false,
        equations,
        kernel,
    }
}

/// Root mean square distance of the points from the sensor: what a rotation moves them by.
pub(crate) fn mean_radius(points: &[Surfel]) -> f64 {
    let sum: f64 = points.iter().map(|s| s.point.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>()).sum();
    (sum / points.len().max(1) as f64).sqrt().max(1.0)
}
