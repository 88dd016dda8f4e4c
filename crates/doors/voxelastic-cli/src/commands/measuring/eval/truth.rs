//! The truth: a survey, a mesh, a simulated world, or poses.

use super::surface::Surface;
use crate::failure::Failure;
use anyhow::Context;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_eval::align::moved;
use voxelastic_eval::mesh_distance::{MeshIndex, sample_surface};
use voxelastic_eval::metrics::exact_errors;
use voxelastic_eval::{MeshView, PointIndex, metrics};
use voxelastic_io::dataset;
use voxelastic_run::map_files;
use voxelastic_sim::dataset::WORLD_FILE;
use voxelastic_sim::{Simulation, World};

/// Largest number of samples of a mesh.
const MOST_SAMPLES: f64 = 3e7;

/// Largest depth inside of solids, metres: deeper points count as this far from the surface.
const DEEPEST_M: f64 = 10.0;

/// Limits on the truth.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// It is downsampled to one point per cube of this edge, metres.
    pub truth_voxel: f32,
    /// Maximum range of simulated surface for completeness, metres.
    pub max_range: f32,
    /// Maximum range of simulated surface that is sampled, metres; also limited by that of the sensor. Beyond it only exact distances are
    /// right.
    pub reach: f32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { truth_voxel: 0.05, max_range: 30.0, reach: f32::INFINITY }
    }
}

/// The truth.
pub struct Truth {
    /// `cloud`, `mesh`, `world` or `poses`.
    pub kind: &'static str,
    /// The true surface, if it is known.
    pub surface: Option<TrueSurface>,
    /// The simulation of the scans, if they are simulated.
    pub simulation: Option<Simulation>,
    /// True poses of the lidar, in the frame of the truth.
    pub poses: Vec<(NodeId, Pose)>,
}

impl Truth {
    /// Distance of each point of the map from the true surface, metres; none if the truth has no surface.
    pub fn errors(&self, points: &[[f32; 3]], t_truth_map: &Pose) -> anyhow::Result<Option<Vec<f32>>> {
        let Some(surface) = &self.surface else { return Ok(None) };
        let points = moved(points, t_truth_map);
        Ok(Some(match surface.as_truth().distance {
            Some(distance) => exact_errors(&points, distance),
            None => PointIndex::new(&surface.points, "the truth")?.distances(&points, f32::INFINITY),
        }))
    }
}

/// The true surface.
pub struct TrueSurface {
    /// Points on it, metres.
    pub points: Vec<[f32; 3]>,
    visible: Option<Vec<bool>>,
    distance: Option<Distance>,
}

type Distance = Box<dyn Fn([f32; 3]) -> f32 + Sync>;

impl TrueSurface {
    /// As input of the evaluation.
    pub fn as_truth(&self) -> metrics::Truth<'_> {
        let distance = self.distance.as_deref().map(|d| d as &(dyn Fn([f32; 3]) -> f32 + Sync));
        metrics::Truth { points: &self.points, visible: self.visible.as_deref(), distance }
    }
}

impl Truth {
    /// Reads the truth. `poses` selects the pose file in a folder of scans.
    pub fn open(path: &Path, poses: Option<&Path>, limits: &Limits) -> anyhow::Result<Self> {
        if !path.exists() {
            return Err(Failure::new(format!("{}: no such file or folder", path.display()), "check the path after --truth").into());
        }
        let is_world = path.is_file() && path.extension().is_some_and(|e| e == "toml") || path.join(WORLD_FILE).is_file();
        if poses.is_some() && (is_world || !path.is_dir()) {
            let what = format!("{}: --poses selects a pose file in a folder of scans, and this is not one", path.display());
            return Err(Failure::usage(what, "leave out --poses: a simulated world has its true poses, a cloud or mesh has none").into());
        }
        if is_world {
            return Self::of_world(Simulation::load(path)?, limits);
        }
        if map_files::is_map(path) {
            let remedy = "extract a mesh with `voxelastic mesh` and use that";
            return Err(Failure::new(format!("{}: this is a map, not a truth", path.display()), remedy).into());
        }
        if path.is_dir() {
            return Self::of_folder(path, poses);
        }
        Self::of_file(path, limits).with_context(|| format!("{}: cannot be used as truth", path.display()))
    }

    /// A cloud or a mesh.
    fn of_file(path: &Path, limits: &Limits) -> anyhow::Result<Self> {
        let read = Surface::read(path)?;
        let (kind, surface) = if read.triangles.is_empty() {
            ("cloud", TrueSurface { points: read.positions, visible: None, distance: None })
        } else {
            ("mesh", of_mesh(&read, limits.truth_voxel)?)
        };
        Ok(Self { kind, surface: Some(surface), simulation: None, poses: Vec::new() })
    }

    /// A simulated world: exact distances, and the surface that beams of the simulated scans reach.
    pub fn of_world(simulation: Simulation, limits: &Limits) -> anyhow::Result<Self> {
        let spacing = f64::from(limits.truth_voxel);
        let reach = simulation.lidar().settings().max_range.min(f64::from(limits.reach));
        tracing::info!("casting the beams of {} scans of the world `{}`", simulation.len(), simulation.world().name());
        let mut points = Vec::new();
        // Surface within `max_range` counts for completeness; surface beyond it is true, too.
        let near = f64::from(limits.max_range).min(reach);
        let mut add = |range: f64| {
            points.extend(simulation.visible_surface(spacing, range).iter().map(|s| s.point.map(|c| c as f32)));
            points.len()
        };
        let near_count = add(near);
        if near_count == 0 {
            let remedy = "raise --max-range";
            return Err(Failure::new(format!("no surface is visible to the sensor within {near} m"), remedy).into());
        }
        let all = if near < reach { add(reach) } else { near_count };
        let visible = Some((0..all).map(|i| i < near_count).collect());
        let world: World = simulation.world().clone();
        let distance: Distance = Box::new(move |p| world.distance_within(p.map(f64::from), DEEPEST_M) as f32);
        let poses = (0..).zip(simulation.ground_truth().iter().copied()).collect();
        Ok(Self { kind: "world", surface: Some(TrueSurface { points, visible, distance: Some(distance) }), simulation: Some(simulation), poses })
    }

    /// A folder of scans with a file of true poses.
    fn of_folder(path: &Path, poses: Option<&Path>) -> anyhow::Result<Self> {
        let found = dataset::open_truth(path, poses).with_context(|| format!("{}: cannot be used as truth", path.display()))?;
        let Some((file, data)) = found else {
            let what =
                format!("{}: this is this is neither a simulated folder ({WORLD_FILE} is missing) nor one with ground truth poses", path.display());
            let remedy = "name the file with the true poses (--poses FILE), or use a survey (a cloud or mesh) as --truth; \
                          `voxelastic heldout` measures a map with scans alone";
            return Err(Failure::new(what, remedy).into());
        };
        tracing::info!("true poses from {}", file.display());
        let poses = data.scans().iter().map(|scan| (scan.node, scan.t_map_lidar)).collect();
        Ok(Self { kind: "poses", surface: None, simulation: None, poses })
    }
}

/// A mesh as truth: samples with the density of the downsampled truth, and distances to its triangles.
fn of_mesh(mesh: &Surface, voxel: f32) -> anyhow::Result<TrueSurface> {
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?;
    let area = area(&view);
    let wanted = 4.0 / f64::from(voxel).powi(2);
    let density = wanted.min(MOST_SAMPLES / area.max(1e-9));
    if density < wanted {
        tracing::warn!("the truth is large ({area:.0} square metres): its samples are {:.2} m apart", density.sqrt().recip());
    }
    let mut points = sample_surface(&view, density);
    // Vertices represent triangles that are too small for a sample.
    points.extend(mesh.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())));
    let index = MeshIndex::new(&view)?;
    let distance: Distance = Box::new(move |p| index.closest(p, f32::INFINITY).map_or(f32::NAN, |c| c.distance));
    Ok(TrueSurface { points, visible: None, distance: Some(distance) })
}

/// Area of the finite triangles, square metres.
fn area(mesh: &MeshView<'_>) -> f64 {
    let sizes = (0..mesh.triangles().len()).filter(|&i| mesh.is_finite(i)).map(|i| {
        let [a, b, c] = mesh.corners(i).map(|p| nalgebra::Vector3::from(p.map(f64::from)));
        0.5 * (b - a).cross(&(c - a)).norm()
    });
    sizes.sum()
}
