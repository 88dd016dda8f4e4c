//! Answers to what others ask of the node.

use crate::ros::services::{Distance, Request, Response};
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic::Pose;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, DistanceQuery};
use voxelastic_esdf::{EsdfSettings, LocalEsdf};
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_plan::{Robot, plan};
use voxelastic_run::surfaces::{self, SurfaceOptions};
use voxelastic_run::{Error, Mapping, MappingRun, Result, Warnings};

/// Radius of the robot for which paths are planned, metres.
const RADIUS: f64 = 0.3;
/// Largest distance that is told apart, voxels.
const MOST_VOXELS: f64 = 48.0;
/// Time for a path: mapping waits meanwhile.
const PLANNING: Duration = Duration::from_millis(300);

/// What requests are answered with.
#[derive(Default)]
pub struct Service {
    /// Distances to obstacles, once somebody has asked for them.
    pub esdf: Option<LocalEsdf>,
}

impl Service {
    /// Answers a request that does not change the map.
    pub fn answer(&mut self, request: &Request, run: &mut MappingRun) -> Response {
        let done = match request {
            Request::Distances(points) => {
                return Response::Distances(run.mapping().pool().install(|| self.distances(points, run)));
            }
            Request::Save => save(run),
            Request::Mesh => mesh(run),
            _ => Err(Error::new("this cannot be asked here", "")),
        };
        if let Ok(words) = &done {
            tracing::info!("on request: {words}");
        }
        Response::Done(done.map_err(|problem| problem.one_line()))
    }

    /// Distances to the nearest surface: of maps with occupancy up to some metres in all known space, else near surfaces only. They are those of the moment.
    pub fn distances(&mut self, points: &[[f64; 3]], run: &MappingRun) -> Result<Vec<Option<Distance>>, String> {
        let (atlas, origin) = (run.mapping().atlas(), run.origin().coordinates());
        let points: Vec<[f64; 3]> = points.iter().map(|p| std::array::from_fn(|k| p[k] - origin[k])).collect();
        let space = AtlasQuery::new(atlas);
        if space.is_empty() {
            let near = DistanceQuery::new(atlas).sample_many(&points).into_iter();
            return Ok(near
                .map(|sample| sample.map(|at| Distance { distance: at.distance.abs(), gradient: at.gradient.map(|c| c * at.distance.signum()) }))
                .collect());
        }
        let most = EsdfSettings::default().max_distance.min(MOST_VOXELS * f64::from(atlas.voxel_size()));
        let new = || LocalEsdf::new(EsdfSettings { max_distance: most, ..EsdfSettings::default() }, atlas.voxel_size());
        let esdf = match self.esdf.take() {
            Some(esdf) => esdf,
            None => new().map_err(|problem| problem.to_string())?,
        };
        let esdf = self.esdf.insert(esdf);
        let samples = esdf.sample_many_to_surfaces(atlas, &points);
        let known = |(sample, state): (voxelastic_esdf::EsdfSample, State)| {
            (state != State::Unknown).then_some(Distance { distance: sample.distance, gradient: sample.gradient })
        };
        Ok(samples.into_iter().zip(space.states(&points)).map(known).collect())
    }
}

fn save(run: &mut MappingRun) -> Result<String> {
    let path = path(run)?;
    if run.scans() == 0 {
        return Err(Error::new("the map is empty", ""));
    }
    run.save()?;
    Ok(format!("{} scans saved in {}", run.scans(), path.display()))
}

fn path(run: &MappingRun) -> Result<PathBuf> {
    let target = run.target().ok_or_else(|| Error::new("nothing is saved here: this is a viewer", ""))?;
    Ok(target.path().to_owned())
}

fn mesh(run: &MappingRun) -> Result<String> {
    let (path, mapping) = (path(run)?.with_extension("ply"), run.mapping());
    let made = mapping.pool().install(|| surfaces::of_map(mapping.atlas(), &SurfaceOptions::default(), &mut Warnings::default()))?;
    if made.mesh.triangles.is_empty() {
        return Err(Error::new("the map has no surface", "map more scans"));
    }
    write_mesh(&path, &made.mesh, run.origin())?;
    Ok(format!("{} triangles in {}", made.mesh.triangles.len(), path.display()))
}

fn write_mesh(path: &Path, mesh: &voxelastic::surface::Mesh, origin: Origin) -> Result<()> {
    let intensity: Vec<f32> = mesh.intensities.iter().map(|&s| f32::from(s)).collect();
    let file = MeshRef {
        positions: &mesh.positions,
        origin: origin.coordinates(),
        normals: &mesh.normals,
        colours: (!mesh.colours.is_empty()).then_some(&mesh.colours),
        intensity: (!intensity.is_empty()).then_some(&intensity),
        triangles: &mesh.triangles,
    };
    Ok(write_ply(path, &file)?)
}

/// A path between two places in the map frame; none if there is no way.
pub fn find_path(mapping: &Mapping, start: &Pose, goal: &Pose) -> Vec<Pose> {
    let [from, to] = [start, goal].map(|pose| <[f64; 3]>::from(pose.translation.vector));
    let request = voxelastic_plan::Request { time: PLANNING, ..voxelastic_plan::Request::new(from, to, Robot::flying(RADIUS)) };
    match mapping.pool().install(|| plan(&AtlasQuery::new(mapping.atlas()), &request)) {
        Ok(found) => {
            tracing::info!("on request: a path of {:.1} m", found.length);
            found.path.iter().map(|[x, y, z]| Pose::translation(*x, *y, *z)).collect()
        }
        Err(problem) => {
            tracing::warn!("no path: {problem}");
            Vec::new()
        }
    }
}
