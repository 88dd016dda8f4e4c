//! Free and occupied space against a simulated world, where the sensor's beams went.

use crate::map_files::LoadedMap;
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic::field::occupancy::State as Known;
use voxelastic::query::AtlasQuery;
use voxelastic_eval::occupancy::{self, OccupancyScores, State};
use voxelastic_sim::Simulation;

/// Scans whose beams are followed, at most; evenly spread.
const SCANS: usize = 120;
/// Beams of each, about.
const BEAMS: usize = 4096;
/// Points looked at in the free space of a beam.
const STEPS: usize = 8;

/// What is to be judged.
pub struct Task<'a> {
    /// The world and the ride through it.
    pub simulation: &'a Simulation,
    /// The map.
    pub map: &'a LoadedMap,
    /// Maps map to world coordinates.
    pub t_truth_map: Pose,
    /// Beams end here, metres from the sensor.
    pub max_range: f32,
}

/// Judges the map along true beams: in the space that they cross, and half a voxel behind the surface that they meet.
pub fn score(task: &Task<'_>) -> OccupancyScores {
    let Task { simulation, map, t_truth_map, max_range } = task;
    let voxel = map.settings.voxel;
    let range = f64::from(max_range.min(map.settings.max_range)).min(simulation.lidar().settings().max_range);
    let scans = simulation.ground_truth();
    let points: Vec<[f32; 3]> = spread(scans.len(), SCANS).par_iter().flat_map_iter(|&k| along_beams(simulation, &scans[k], range, voxel)).collect();
    tracing::info!("asking for free or occupied at {} places", points.len());
    let query = AtlasQuery::new(&map.atlas, voxel);
    let t_map_truth = t_truth_map.inverse();
    let ask = |p: [f32; 3]| {
        let p = t_map_truth * nalgebra::Point3::from(p.map(f64::from));
        match query.state(p.coords.into()) {
            Known::Free => State::Free,
            Known::Occupied => State::Occupied,
            Known::Unknown => State::Unknown,
        }
    };
    occupancy::score(&points, ask, |p| simulation.world().distance(p.map(f64::from)) as f32, voxel)
}

/// Up to `most` of the numbers below `count`, evenly spread.
fn spread(count: usize, most: usize) -> Vec<usize> {
    let taken = count.min(most);
    (0..taken).map(|i| i * count / taken).collect()
}

fn along_beams(simulation: &Simulation, t_map_lidar: &Pose, range: f64, voxel: f32) -> Vec<[f32; 3]> {
    let (model, world) = (simulation.lidar().model(), simulation.world());
    let nearest = simulation.lidar().settings().min_range;
    let origin = t_map_lidar.translation.vector;
    let mut points = Vec::new();
    for beam in spread(model.rows() * model.columns(), BEAMS) {
        // Column by column: a count of beams that the rows do not divide meets all rows in turn.
        let (row, column) = (beam % model.rows(), beam / model.rows());
        let direction = t_map_lidar.rotation * nalgebra::Vector3::from(model.direction(row as f32, column as f32).map(f64::from));
        let direction = direction / direction.norm().max(1e-9);
        let Some(hit) = world.cast(origin.into(), direction.into(), range).filter(|h| h.range > nearest) else { continue };
        let at = |distance: f64| <[f32; 3]>::from((origin + direction * distance).map(|c| c as f32));
        // A different start on each beam, so that no distance is preferred.
        let start = (beam as f64 * 0.618_033_988_749_895).fract();
        points.extend((0..STEPS).map(|i| at(hit.range * (i as f64 + start) / STEPS as f64)));
        let surface = origin + direction * hit.range;
        let normal = nalgebra::Vector3::from(world.normal(hit.solid, surface.into()));
        points.push((surface - normal * (0.5 * f64::from(voxel))).map(|c| c as f32).into());
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_spread_over_all() {
        assert_eq!(spread(10, 4), [0, 2, 5, 7]);
        assert_eq!(spread(3, 8), [0, 1, 2]);
        assert!(spread(0, 8).is_empty());
    }
}
