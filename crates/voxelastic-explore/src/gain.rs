//! What a sensor would see from a place: the volume of unknown space along its rays.

use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Ray, UnknownAs};
use voxelastic_plan::Point;

/// The field of view of a spinning sensor, coarsely.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorView {
    /// Lowest and highest elevation, radians.
    pub elevations: [f64; 2],
    /// Range, metres.
    pub range: f64,
    /// Rows and columns of rays that are cast.
    pub rays: [usize; 2],
    /// Unknown space is assumed to be seen so far into, metres: something will be in the way.
    pub depth: f64,
}

impl Default for SensorView {
    /// A sensor with 45 degrees from the lowest to the highest row.
    fn default() -> Self {
        Self { elevations: [-0.39, 0.39], range: 20.0, rays: [7, 36], depth: 8.0 }
    }
}

impl SensorView {
    /// That of a sensor with rows at these elevations, radians, whose returns are mapped up to `max_range` metres; no more than 20 m of them count.
    pub fn of(elevations: impl IntoIterator<Item = f64>, max_range: f64) -> Self {
        let (low, high) = elevations.into_iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), e| (low.min(e), high.max(e)));
        let view = Self::default();
        Self { elevations: if low < high { [low, high] } else { view.elevations }, range: max_range.min(view.range), ..view }
    }

    /// Radius within which space has to count as free because the robot is there (the mapper's setting `robot_radius`), metres: farther away the field of view is high
    /// enough for a ball of `radius` metres in voxels of `voxel` metres. On wheels, with the sensor `height` metres above the floor, it must not reach below
    /// the floor, and has a voxel more for rounding; in the air that would claim more of the floor that a narrow field of view does not see.
    pub fn own_radius(&self, radius: f64, voxel: f64, height: Option<f64>) -> f64 {
        let [low, high] = self.elevations;
        let voxels = if height.is_some() { 2.0 } else { 1.0 };
        let needed = (radius + voxels * voxel) / (-low).min(high).clamp(0.1, 1.5).sin();
        height.map_or(needed, |height| needed.min(height - 0.1)).clamp(0.0, 5.0)
    }

    /// The volume of unknown space that the sensor at `place` would see within the box `bounds`, cubic metres. All in the map frame.
    pub fn unknown_volume(&self, map: &AtlasQuery<'_>, place: Point, bounds: [Point; 2]) -> f64 {
        let [rows, columns] = self.rays;
        let [low, high] = self.elevations;
        let (step, turn) = ((high - low) / rows as f64, std::f64::consts::TAU / columns as f64);
        let ray = |i: usize| {
            let (elevation, azimuth) = (low + step * ((i / columns) as f64 + 0.5), turn * ((i % columns) as f64 + 0.5));
            let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            self.along_ray(map, place, direction, bounds) * elevation.cos() * step * turn
        };
        (0..rows * columns).map(ray).sum()
    }

    /// Unknown volume along a ray, per steradian.
    fn along_ray(&self, map: &AtlasQuery<'_>, origin: Point, direction: Point, bounds: [Point; 2]) -> f64 {
        let length = leaves(origin, direction, bounds).min(self.range);
        if length <= 0.0 {
            return 0.0;
        }
        let Some(first) = map.ray_cast(&Ray { origin, direction, length }, UnknownAs::Blocked) else { return 0.0 };
        if first.state != State::Unknown {
            return 0.0;
        }
        let depth = self.depth.min(length - first.distance);
        let from = std::array::from_fn(|k| origin[k] + direction[k] * first.distance);
        let behind = map.ray_cast(&Ray { origin: from, direction, length: depth }, UnknownAs::Free);
        let last = first.distance + behind.map_or(depth, |hit| hit.distance);
        (last.powi(3) - first.distance.powi(3)) / 3.0
    }
}

/// How far a ray that starts in a box goes until it leaves the box.
fn leaves(origin: Point, direction: Point, [low, high]: [Point; 2]) -> f64 {
    let along = |k: usize| match direction[k] {
        d if d > 0.0 => (high[k] - origin[k]) / d,
        d if d < 0.0 => (low[k] - origin[k]) / d,
        _ => f64::INFINITY,
    };
    along(0).min(along(1)).min(along(2)).max(0.0)
}
