//! Pose corrections during mapping: a drifting trajectory with loop closures, and what the atlas does with them.
//!
//! ```sh
//! cargo run --release -p voxelastic --example 02_follow_corrections
//! ```

use voxelastic::event::Event;
use voxelastic::{Mapper, Settings};
use voxelastic_sim::{SimOptions, Simulation};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = Settings { voxel_size: 0.1, lambda_odom: 10.0, lambda_cluster: 5.0, ..Settings::default() };
    let mut mapper = Mapper::builder().settings(settings).build()?;
    // Scans with drifting poses, odometry edges, and at each loop closure the loop edge and corrected poses of all nodes.
    let simulation = Simulation::new(SimOptions { columns: Some(512), drift: 2.0, ..SimOptions::of("room") })?;
    for event in simulation.events() {
        let correction = matches!(event, Event::PoseUpdate(_));
        mapper.handle(event)?;
        if correction {
            let counts = mapper.elastic_counts();
            println!("correction {}: {} root poses moved so far, {} fusions queued", counts.pose_updates, counts.submap_moves, counts.fusions_due);
        }
    }
    mapper.finish();

    // A correction moved root poses only. Submaps whose scans moved against each other could be rebuilt from their scans.
    for submap in mapper.atlas().submaps() {
        let position = submap.t_map_submap().translation.vector;
        println!("submap {}: {} scans, root at {:.2?} m", submap.id(), submap.scans().len(), position.as_slice());
    }
    println!("{} fusions; {} submaps to rebuild", mapper.elastic_counts().fusions, mapper.deformed().len());
    Ok(())
}
