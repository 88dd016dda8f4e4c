//! Answers to what others ask of the node.

use crate::failure::one_line;
use crate::mapping::Session;
use crate::meshing::{LayerArgs, SurfaceArgs, map_mesh};
use crate::target::Target;
use anyhow::Context;
use std::path::Path;
use std::time::Duration;
use voxelastic::field::occupancy::State;
use voxelastic::query::DistanceQuery;
use voxelastic::{Pose, Settings};
use voxelastic_esdf::{EsdfSettings, LocalEsdf};
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_live::ros::services::{Distance, Request, Response};
use voxelastic_plan::{Robot, plan};

/// Radius of the robot for which paths are planned, metres.
const RADIUS: f64 = 0.3;
/// Largest distance that is told apart, voxels.
const MOST_VOXELS: f64 = 48.0;
/// Time for a path: mapping waits meanwhile.
const PLANNING: Duration = Duration::from_millis(300);

/// What requests are answered with.
pub struct Service<'a> {
    /// Where the map is saved, if it is.
    pub target: Option<&'a mut Target>,
    /// The settings of the map.
    pub settings: &'a Settings,
    /// Distances to obstacles, once somebody has asked for them.
    pub esdf: Option<LocalEsdf>,
}

impl Service<'_> {
    /// Answers a request that does not change the map.
    pub fn answer(&mut self, request: &Request, session: &Session) -> Response {
        let done = match request {
            Request::Plan { start, goal, .. } => return Response::Path(find_path(session, start, goal)),
            Request::Distances(points) => return Response::Distances(session.pool().install(|| self.distances(points, session))),
            Request::Save => self.save(session),
            Request::Mesh => self.mesh(session),
            _ => Err(anyhow::anyhow!("this cannot be asked here")),
        };
        if let Ok(words) = &done {
            tracing::info!("on request: {words}");
        }
        Response::Done(done.map_err(|problem| one_line(&problem)))
    }

    fn save(&mut self, session: &Session) -> anyhow::Result<String> {
        let target = self.target.as_mut().context("nothing is saved here: this is a viewer")?;
        anyhow::ensure!(session.scans() > 0, "the map is empty");
        target.save(session, &session.details())?;
        Ok(format!("{} scans saved in {}", session.scans(), target.path().display()))
    }

    /// Distances to the nearest surface: of maps with occupancy up to some metres in all known space, else near surfaces only. They are those of the moment.
    pub fn distances(&mut self, points: &[[f64; 3]], session: &Session) -> Result<Vec<Option<Distance>>, String> {
        let (atlas, origin) = (session.mapper().atlas(), session.origin().coordinates());
        let points: Vec<[f64; 3]> = points.iter().map(|p| std::array::from_fn(|k| p[k] - origin[k])).collect();
        let space = atlas.query();
        if space.is_empty() {
            let near = DistanceQuery::new(atlas).sample_many(&points).into_iter();
            return Ok(near
                .map(|sample| sample.map(|at| Distance { distance: at.distance.abs(), gradient: at.gradient.map(|c| c * at.distance.signum()) }))
                .collect());
        }
        let most = EsdfSettings::default().max_distance.min(MOST_VOXELS * f64::from(self.settings.voxel_size));
        let new = || LocalEsdf::new(EsdfSettings { max_distance: most, ..EsdfSettings::default() }, self.settings.voxel_size);
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

    fn mesh(&self, session: &Session) -> anyhow::Result<String> {
        let target = self.target.as_ref().context("nothing is saved here: this is a viewer")?;
        let path = target.path().with_extension("ply");
        let (surface, voxel) = (SurfaceArgs::default(), self.settings.voxel_size);
        let made = session.pool().install(|| map_mesh(session.mapper().atlas(), voxel, &surface, LayerArgs::default()))?;
        write_mesh(&path, &made.mesh, session.origin())?;
        Ok(format!("{} triangles in {}", made.mesh.triangles.len(), path.display()))
    }
}

fn write_mesh(path: &Path, mesh: &voxelastic::surface::Mesh, origin: Origin) -> anyhow::Result<()> {
    let intensity: Vec<f32> = mesh.intensities.iter().map(|&s| f32::from(s)).collect();
    let file = MeshRef {
        positions: &mesh.positions,
        origin: origin.coordinates(),
        normals: &mesh.normals,
        colours: (!mesh.colours.is_empty()).then_some(&mesh.colours),
        intensity: (!intensity.is_empty()).then_some(&intensity),
        triangles: &mesh.triangles,
    };
    write_ply(path, &file).with_context(|| format!("cannot write the mesh {}", path.display()))
}

/// A path between two places; none if there is no way.
fn find_path(session: &Session, start: &Pose, goal: &Pose) -> Vec<Pose> {
    let [from, to] = [start, goal].map(|pose| <[f64; 3]>::from(pose.translation.vector));
    let request = voxelastic_plan::Request { time: PLANNING, ..voxelastic_plan::Request::new(from, to, Robot::flying(RADIUS)) };
    match session.pool().install(|| plan(&session.mapper().atlas().query(), &request)) {
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
