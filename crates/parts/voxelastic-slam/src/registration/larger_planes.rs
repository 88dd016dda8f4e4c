//! The local map for scenes that hold the pose along a direction only by lines of single beams.
//!
//! The returns of one beam on a wall are a line. In a voxel that holds nothing else it looks like an edge, which holds the pose in all directions; but the
//! beams move with the sensor, so in a tunnel they hold it where it was. Where a larger voxel around such a line has a plane on which the line lies, that
//! plane is what the line was measured on.

use super::local_map::{LocalMap, RANGE_NOISE, Surface};

/// A line lies on a plane if it is nearer to it than this, in standard deviations of the plane's own points.
const ON_PLANE: f64 = 2.0;

/// Where points look for the surface that they belong to.
pub(crate) trait Surfaces: Sync {
    /// Edge of a voxel, metres.
    fn size(&self) -> f64;

    /// The surface whose mean is nearest to a point in the map frame, and the point relative to that mean. `normal` is that of the point's own plane, zero if
    /// it has none.
    fn nearest(&self, p: [f64; 3], normal: [f32; 3]) -> Option<([f32; 3], Surface)>;
}

impl Surfaces for LocalMap {
    #[inline(always)]
    fn size(&self) -> f64 {
        LocalMap::size(self)
    }

    #[inline(always)]
    fn nearest(&self, p: [f64; 3], normal: [f32; 3]) -> Option<([f32; 3], Surface)> {
        LocalMap::nearest(self, p, normal).map(|(d, surface)| (d, *surface))
    }
}

/// A level of the local map whose lines are taken for the planes on which they lie.
#[derive(Clone, Copy)]
pub(crate) struct LargerPlanes<'a> {
    level: &'a LocalMap,
    /// Levels of larger voxels, from fine to coarse.
    larger: &'a [LocalMap],
}

impl<'a> LargerPlanes<'a> {
    /// Level `k` of a map.
    pub(crate) fn of(levels: &'a [LocalMap], k: usize) -> Self {
        Self { level: &levels[k], larger: &levels[k + 1..] }
    }
}

impl Surfaces for LargerPlanes<'_> {
    fn size(&self) -> f64 {
        self.level.size()
    }

    fn nearest(&self, p: [f64; 3], normal: [f32; 3]) -> Option<([f32; 3], Surface)> {
        let (d, surface) = self.level.nearest(p, normal)?;
        if surface.is_plane() {
            return Some((d, *surface));
        }
        let mean: [f64; 3] = std::array::from_fn(|i| p[i] - f64::from(d[i]));
        let plane = self.larger.iter().find_map(|level| level.plane_through(mean));
        Some((d, Surface { mean: surface.mean, ..plane.unwrap_or(*surface) }))
    }
}

impl LocalMap {
    /// The plane in the voxel around a point in the map frame, if the point lies on it.
    fn plane_through(&self, p: [f64; 3]) -> Option<Surface> {
        let (from_mean, surface) = self.at(p)?;
        let distance: f64 = (0..3).map(|i| f64::from(surface.normal[i]) * f64::from(from_mean[i])).sum();
        // The weight is the share of the noise of ranges in the variance across the plane.
        let variance = RANGE_NOISE * RANGE_NOISE / f64::from(surface.weight);
        (surface.is_plane() && distance * distance < ON_PLANE * ON_PLANE * variance).then_some(*surface)
    }
}
