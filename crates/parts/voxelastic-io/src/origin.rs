//! The origin of a map: where its coordinates are counted from.
//!
//! Surveys give coordinates of millions of metres (UTM), which single precision holds in steps of half a metre. So a map whose first pose is far from
//! zero is made around an origin near that pose. Poses that come have it taken off, and everything that goes out of a map has it added again, in
//! double precision. To users, coordinates are those of the poses that they gave.

use nalgebra::Vector3;
use std::fmt;
use voxelastic::Pose;
use voxelastic::event::Event;

/// Coordinates up to this are kept as they are, metres: single precision has steps of 1 mm there.
const FAR: f64 = 10_000.0;
/// Origins are multiples of this, metres.
const GRID: f64 = 1000.0;

/// Where coordinates in a map are counted from, map frame, metres. Usually zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Origin([f64; 3]);

impl Origin {
    /// That of a map whose first scan was taken at this pose: zero, or near it in whole kilometres if any of its coordinates is larger than ten.
    ///
    /// ```
    /// use voxelastic::Pose;
    /// use voxelastic_io::Origin;
    /// assert!(Origin::near(&Pose::translation(120.0, -9_000.0, 3.0)).is_zero());
    /// assert_eq!(Origin::near(&Pose::translation(448_123.4, 5_411_987.6, 312.0)).coordinates(), [448_000.0, 5_412_000.0, 0.0]);
    /// ```
    pub fn near(t_map_lidar: &Pose) -> Self {
        let position = t_map_lidar.translation.vector;
        if position.amax() <= FAR || !position.iter().all(|c| c.is_finite()) {
            return Self::default();
        }
        Self(position.map(|c| (c / GRID).round() * GRID + 0.0).into())
    }

    /// With these coordinates; none unless they are finite.
    pub fn new(coordinates: [f64; 3]) -> Option<Self> {
        coordinates.iter().all(|c| c.is_finite()).then_some(Self(coordinates))
    }

    /// Its coordinates, map frame, metres.
    pub fn coordinates(&self) -> [f64; 3] {
        self.0
    }

    /// Whether coordinates are as they are.
    pub fn is_zero(&self) -> bool {
        self.0 == [0.0; 3]
    }

    /// A pose with the origin taken off.
    pub fn to_local(&self, mut pose: Pose) -> Pose {
        pose.translation.vector -= Vector3::from(self.0);
        pose
    }

    /// A pose with the origin added.
    pub fn to_map(&self, mut pose: Pose) -> Pose {
        pose.translation.vector += Vector3::from(self.0);
        pose
    }

    /// A point with the origin taken off.
    pub fn point_to_local(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| point[k] - self.0[k])
    }

    /// A point with the origin added.
    pub fn point_to_map(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| point[k] + self.0[k])
    }

    /// An event with the origin taken off its poses. Edges are relative.
    pub fn event_to_local(&self, mut event: Event) -> Event {
        match &mut event {
            Event::Scan(scan) => scan.t_map_lidar = self.to_local(scan.t_map_lidar),
            Event::PoseUpdate(poses) => poses.iter_mut().for_each(|(_, pose)| *pose = self.to_local(*pose)),
            _ => {}
        }
        event
    }

    /// Reads what [`fmt::Display`] writes.
    pub fn parse(text: &str) -> Option<Self> {
        let numbers: Option<Vec<f64>> = text.split_whitespace().map(|number| number.parse().ok()).collect();
        Self::new(numbers?.try_into().ok()?)
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "{x} {y} {z}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_come_back() {
        let pose = Pose::translation(448_123.456, 5_411_987.654, 12.5);
        let origin = Origin::near(&pose);
        assert_eq!(Origin::parse(&origin.to_string()), Some(origin));
        let local = origin.to_local(pose);
        assert!(local.translation.vector.amax() < 501.0);
        assert!((origin.to_map(local).translation.vector - pose.translation.vector).amax() < 1e-9);
        assert!(Origin::near(&Pose::translation(f64::NAN, 0.0, 1e7)).is_zero());
        for wrong in ["", "1 2", "1 2 x", "1 2 inf", "1 2 3 4"] {
            assert_eq!(Origin::parse(wrong), None, "{wrong}");
        }
    }
}
