//! The input of the integrators: the returns of one scan, borrowed.

use crate::sensor::Returns;

/// The returns of one scan. All slices are equally long, or empty where that is allowed.
#[derive(Clone, Copy, Debug)]
pub struct ReturnsView<'a> {
    /// Points in the lidar frame, metres.
    pub points: &'a [[f32; 3]],
    /// Unit normals of the local surface, facing the sensor, in the lidar frame; zero where no plane is known. May be empty for occupancy, which does not
    /// use them.
    pub normals: &'a [[f32; 3]],
    /// Intensity of each return, 0 to 255; empty when the scan has none.
    pub intensities: &'a [u8],
    /// Distance between returns around each of them, metres, where that is measured; else empty, and it follows from the range.
    pub spacing: &'a [f32],
    /// Number of points that were measured; those after them lie between returns on one plane, and are for surfaces only.
    pub measured: usize,
    /// Position of the lidar when it measured each return, lidar frame, metres; empty when it stood still.
    pub origins: &'a [[f32; 3]],
    /// Smallest angle between adjacent beams of the sensor, radians.
    pub smallest_angle: f32,
}

impl<'a> ReturnsView<'a> {
    /// The returns of a prepared scan, without intensities.
    pub fn new(returns: &'a Returns) -> Self {
        let Returns { points, normals, spacing, measured, origins, smallest_angle, .. } = returns;
        Self { points, normals, intensities: &[], spacing, measured: *measured, origins, smallest_angle: *smallest_angle }
    }

    /// `points` with `normals`, all of them measured, without any of the rest.
    pub fn of_points(points: &'a [[f32; 3]], normals: &'a [[f32; 3]], smallest_angle: f32) -> Self {
        Self { points, normals, intensities: &[], spacing: &[], measured: points.len(), origins: &[], smallest_angle }
    }

    /// The returns that were measured.
    pub(crate) fn measured_only(&self) -> Self {
        self.first(self.measured)
    }

    /// The first `count` returns.
    pub(crate) fn first(&self, count: usize) -> Self {
        fn head<T>(all: &[T], count: usize) -> &[T] {
            &all[..count.min(all.len())]
        }
        Self {
            points: head(self.points, count),
            normals: head(self.normals, count),
            intensities: head(self.intensities, count),
            spacing: head(self.spacing, count),
            measured: self.measured.min(count),
            origins: head(self.origins, count),
            smallest_angle: self.smallest_angle,
        }
    }
}
