//! What is true: a survey, a mesh, a simulated world, or poses.

use super::measured::Surface;
use crate::failure::Failure;
use crate::map_files;
use anyhow::Context;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_eval::align::moved;
use voxelastic_eval::mesh_distance::{MeshIndex, sample_surface};
use voxelastic_eval::metrics::exact_errors;
use voxelastic_eval::{MeshView, PointIndex, metrics};
use voxelastic_io::dataset;
use voxelastic_sim::dataset::WORLD_FILE;
use voxelastic_sim::{Simulation, World};

/// Most points that a mesh is sampled with.
const MOST_SAMPLES: f64 = 3e7;

/// Map that lies deeper than this inside of things counts as this far from the true surface, metres.
const DEEPEST_M: f64 = 10.0;

/// What of a truth counts.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// It is thinned to one point in each cube of this edge, metres.
    pub truth_voxel: f32,
    /// Simulated surface farther from the sensor than this does not count for completeness, metres.
    pub max_range: f32,
    /// Simulated surface farther from the sensor than this, or than the sensor sees, is no truth at all, metres: only exact distances are then
    /// right for what lies there.
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
    /// The true surface, where it is known.
    pub surface: Option<TrueSurface>,
    /// What the scans were simulated with.
    pub simulation: Option<Simulation>,
    /// True poses of the lidar, in the frame of the truth.
    pub poses: Vec<(NodeId, Pose)>,
}

impl Truth {
    /// Distance of each point of the map from the true surface, metres; none where the truth has no surface.
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
    /// As the evaluation wants it.
    pub fn as_truth(&self) -> metrics::Truth<'_> {
        let distance = self.distance.as_deref().map(|d| d as &(dyn Fn([f32; 3]) -> f32 + Sync));
        metrics::Truth { points: &self.points, visible: self.visible.as_deref(), distance }
    }
}

impl Truth {
    /// Reads it. `poses` names the true ones among the pose files of a folder of scans.
    pub fn open(path: &Path, poses: Option<&Path>, limits: &Limits) -> anyhow::Result<Self> {
        if !path.exists() {
            return Err(Failure::new(format!("{}: there is nothing of this name", path.display()), "check the path after --truth").into());
        }
        let is_world = path.is_file() && path.extension().is_some_and(|e| e == "toml") || path.join(WORLD_FILE).is_file();
        if poses.is_some() && (is_world || !path.is_dir()) {
            let what = format!("{}: --poses chooses among the pose files of a folder of scans, and this is none", path.display());
            return Err(Failure::usage(what, "leave out --poses: a simulated world knows its true poses, a cloud or mesh has none").into());
        }
        if is_world {
            return Self::of_world(Simulation::load(path)?, limits);
        }
        if map_files::looks_like_map(path) {
            let remedy = "make a mesh of it with `voxelastic mesh`, and give that";
            return Err(Failure::new(format!("{}: a map, not a truth", path.display()), remedy).into());
        }
        if path.is_dir() {
            return Self::of_folder(path, poses);
        }
        Self::of_file(path, limits).with_context(|| format!("{}: no truth to measure against", path.display()))
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

    /// A simulated world: exact, and visible as far as beams of the simulated scans reach.
    pub fn of_world(simulation: Simulation, limits: &Limits) -> anyhow::Result<Self> {
        let spacing = f64::from(limits.truth_voxel);
        let reach = simulation.lidar().settings().max_range.min(f64::from(limits.reach));
        tracing::info!("casting the beams of {} scans of the world `{}`", simulation.len(), simulation.world().name());
        let mut points = Vec::new();
        // Near surface counts for completeness. Far surface is truth too: what the map says of it is not wrong.
        let near = f64::from(limits.max_range).min(reach);
        let mut add = |range: f64| {
            points.extend(simulation.visible_surface(spacing, range).iter().map(|s| s.point.map(|c| c as f32)));
            points.len()
        };
        let near_count = add(near);
        if near_count == 0 {
            let remedy = "raise --max-range";
            return Err(Failure::new(format!("the sensor sees no surface within {near} m"), remedy).into());
        }
        let all = if near < reach { add(reach) } else { near_count };
        let visible = Some((0..all).map(|i| i < near_count).collect());
        let world: World = simulation.world().clone();
        let distance: Distance = Box::new(move |p| world.distance_within(p.map(f64::from), DEEPEST_M) as f32);
        let poses = (0..).zip(simulation.ground_truth().iter().copied()).collect();
        Ok(Self { kind: "world", surface: Some(TrueSurface { points, visible, distance: Some(distance) }), simulation: Some(simulation), poses })
    }

    /// A folder of scans, one of whose pose files is the truth.
    fn of_folder(path: &Path, poses: Option<&Path>) -> anyhow::Result<Self> {
        let found = dataset::open_truth(path, poses).with_context(|| format!("{}: no truth to measure against", path.display()))?;
        let Some((file, data)) = found else {
            let what = format!("{}: neither a simulated folder ({WORLD_FILE} is missing) nor one with ground truth poses", path.display());
            let remedy = "name the file with the true poses (--poses FILE), or give a survey (a cloud or mesh) as --truth; \
                          `voxelastic heldout` measures a map with scans alone";
            return Err(Failure::new(what, remedy).into());
        };
        tracing::info!("true poses from {}", file.display());
        let poses = data.scans().iter().map(|scan| (scan.node, scan.t_map_lidar)).collect();
        Ok(Self { kind: "poses", surface: None, simulation: None, poses })
    }
}

/// A mesh as truth: samples as dense as the truth is to be after thinning, and distances to its triangles.
fn of_mesh(mesh: &Surface, voxel: f32) -> anyhow::Result<TrueSurface> {
    let view = MeshView::new(&mesh.positions, &mesh.triangles)?;
    let area = area(&view);
    let wanted = 4.0 / f64::from(voxel).powi(2);
    let density = wanted.min(MOST_SAMPLES / area.max(1e-9));
    if density < wanted {
        tracing::warn!("the truth is large ({area:.0} square metres): its samples lie {:.2} m apart", density.sqrt().recip());
    }
    let mut points = sample_surface(&view, density);
    // Triangles too small to get a sample have corners.
    points.extend(mesh.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())));
    let index = MeshIndex::new(&view)?;
    let distance: Distance = Box::new(move |p| index.closest(p, f32::INFINITY).map_or(f32::NAN, |c| c.distance));
    Ok(TrueSurface { points, visible: None, distance: Some(distance) })
}

/// Square metres of the finite triangles.
fn area(mesh: &MeshView<'_>) -> f64 {
    let sizes = (0..mesh.triangles().len()).filter(|&i| mesh.is_finite(i)).map(|i| {
        let [a, b, c] = mesh.corners(i).map(|p| nalgebra::Vector3::from(p.map(f64::from)));
        0.5 * (b - a).cross(&(c - a)).norm()
    });
    sizes.sum()
}
