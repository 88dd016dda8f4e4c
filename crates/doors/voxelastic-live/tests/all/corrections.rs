//! What corrections bend is rebuilt while a robot goes on.

use crate::node::{atlas, given, live, setup, world};
use std::collections::VecDeque;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic::surface::MeshOptions;
use voxelastic_io::OpenOptions;
use voxelastic_live::node::Setup;
use voxelastic_run::Input;
use voxelastic_sim::{PoseSource, Simulation};

/// Scans whose poses drift by 3 cm each, then all of them corrected, then more scans with right poses.
fn drifting(sim: &Simulation, [corrected, to]: [usize; 2]) -> VecDeque<Input> {
    let mut inputs = given(sim, [0, to], &Pose::identity());
    let mut scans = 0;
    let mut at = inputs.len();
    for (k, input) in inputs.iter_mut().enumerate() {
        let Input::Event(Event::Scan(scan)) = input else { continue };
        if scans < corrected {
            scan.t_map_lidar = Pose::translation(0.03 * scans as f64, 0.0, 0.0) * scan.t_map_lidar;
        } else {
            at = at.min(k);
        }
        scans += 1;
    }
    let truth = sim.poses(PoseSource::Truth);
    let update = Event::PoseUpdate((0..corrected).map(|k| (k as NodeId, truth[k])).collect());
    inputs.insert(at, Input::Event(update));
    inputs
}

fn surface(atlas: &Atlas) -> Vec<Vec<[f32; 3]>> {
    atlas.submaps().iter().map(|submap| submap.mesh(&MeshOptions::default()).positions).collect()
}

#[test]
fn walls_go_where_corrections_put_them() {
    let (dir, sim) = (tempfile::tempdir().unwrap(), world("room"));
    let corrected = |setup: Setup| Setup { reading: OpenOptions { correction_topic: Some("/corrected".into()), ..OpenOptions::default() }, ..setup };
    let maps = ["right", "rebuilt", "bent"].map(|name| dir.path().join(format!("{name}.vox")));
    live(&setup(&maps[0]), given(&sim, [0, 16], &Pose::identity()), None);
    live(&corrected(setup(&maps[1])), drifting(&sim, [12, 16]), None);
    live(&corrected(Setup { keep_scans: 0, ..setup(&maps[2]) }), drifting(&sim, [12, 16]), None);
    let [right, rebuilt, bent] = maps.map(|map| atlas(&map));
    let off = |atlas: &Atlas| {
        let scans =
            atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(|scan| (scan.node, submap.t_map_submap() * scan.t_submap_lidar)));
        scans.map(|(node, pose)| pose.translation_distance(&sim.poses(PoseSource::Truth)[node as usize])).fold(0.0, f64::max)
    };
    assert!(off(&bent) > 0.3 && off(&rebuilt) < 1e-6, "{} m where scans are not kept, {} m", off(&bent), off(&rebuilt));
    assert!(surface(&rebuilt) == surface(&right) && surface(&bent) != surface(&right), "as if poses had been right from the beginning");
}
