//! Places along the beams of a simulated sensor, where a map can be compared with the world.

use super::Simulation;
use rayon::prelude::*;
use voxelastic::Pose;

/// Largest number of scans, evenly selected.
const SCANS: usize = 120;
/// Beams per scan, approximately.
const BEAMS: usize = 4096;
/// Points in the free space of a beam.
const STEPS: usize = 8;

impl Simulation {
    /// Points along true beams of at most `range` metres, world frame: in the space before the surface, and half a voxel of `voxel` metres behind it.
    pub fn probes(&self, range: f64, voxel: f32) -> Vec<[f32; 3]> {
        let scans = self.ground_truth();
        let range = range.min(self.lidar().settings().max_range);
        spread(scans.len(), SCANS).par_iter().flat_map_iter(|&k| along_beams(self, &scans[k], range, voxel)).collect()
    }
}

/// Up to `most` of the numbers below `count`, evenly spaced.
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
        // Column by column, so that all rows are used.
        let (row, column) = (beam % model.rows(), beam / model.rows());
        let direction = t_map_lidar.rotation * nalgebra::Vector3::from(model.direction(row as f32, column as f32).map(f64::from));
        let direction = direction / direction.norm().max(1e-9);
        let Some(hit) = world.cast(origin.into(), direction.into(), range).filter(|h| h.range > nearest) else { continue };
        let at = |distance: f64| <[f32; 3]>::from((origin + direction * distance).map(|c| c as f32));
        // A different offset on each beam, so that distances are uniform.
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
    fn numbers_are_evenly_spaced() {
        assert_eq!(spread(10, 4), [0, 2, 5, 7]);
        assert_eq!(spread(3, 8), [0, 1, 2]);
        assert!(spread(0, 8).is_empty());
    }
}
