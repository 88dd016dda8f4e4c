//! Answers to what others ask of the node.

use crate::failure::one_line;
use crate::mapping::Session;
use crate::meshing::{LayerArgs, SurfaceArgs, map_mesh};
use crate::target::Target;
use anyhow::Context;
use std::path::Path;
use std::time::Duration;
use voxelastic::{Pose, Settings};
use voxelastic_io::Origin;
use voxelastic_io::mesh_io::{MeshRef, write_ply};
use voxelastic_live::ros::services::{Request, Response};
use voxelastic_plan::{Robot, plan};

/// Radius of the robot for which paths are planned, metres.
const RADIUS: f64 = 0.3;
/// Time for a path: mapping waits meanwhile.
const PLANNING: Duration = Duration::from_millis(300);

/// What requests are answered with.
pub struct Service<'a> {
    /// Where the map is saved, if it is.
    pub target: Option<&'a mut Target>,
    /// The settings of the map.
    pub settings: &'a Settings,
}

impl Service<'_> {
    /// Answers a request that does not change the map.
    pub fn answer(&mut self, request: &Request, session: &Session) -> Response {
        let done = match request {
            Request::Plan { start, goal, .. } => return Response::Path(find_path(session, start, goal)),
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
