//! The local map: voxels with running statistics of the points in them, and the plane or the spread that follows from these.

use super::block_index::{ABSENT, BlockIndex};
use serde::{Deserialize, Serialize};
use voxelastic::geometry::smallest_eigenvector;

/// A voxel with this many points takes no more: the map stays where it was first measured, and does not follow the drift.
const FULL: f32 = 60.0;
/// Fewer points than this do not say where a surface is.
const LEAST_FOR_POINT: f32 = 3.0;
/// A plane needs this many points.
const LEAST_FOR_PLANE: f32 = 5.0;
/// The spread of a plane's points across it, as a share of their spread within it (standard deviations).
const FLATNESS: f64 = 0.3;
/// The smaller spread within a plane, in voxel edges: less, and the points are a line, like those of a single beam.
const LEAST_WIDTH: f64 = 0.08;
/// Cosine of the largest angle between planes that may be the same.
const LEAST_COSINE: f32 = 0.8;
/// Standard deviation of a return from a flat surface, metres.
pub(crate) const RANGE_NOISE: f64 = 0.02;

/// Sums over the points of a voxel, relative to its centre.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Moments {
    coordinates: [i32; 3],
    count: f32,
    /// Number of points when the surface was last computed.
    computed: f32,
    /// Path of the sensor when the first point came, metres.
    born: f32,
    sum: [f32; 3],
    squares: [f32; 6],
}

/// What a voxel says about the surface in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Surface {
    /// Mean of the points, relative to the voxel's centre, metres.
    pub(crate) mean: [f32; 3],
    /// Relative information of a distance to it: 1 for a perfect plane, 0 where there is no surface yet.
    pub(crate) weight: f32,
    /// Normal of the plane; zero where the points are no plane.
    pub(crate) normal: [f32; 3],
}

impl Surface {
    const NONE: Self = Self { mean: [0.0; 3], weight: 0.0, normal: [0.0; 3] };

    /// Whether it is a plane.
    #[inline(always)]
    pub(crate) fn is_plane(&self) -> bool {
        self.normal != [0.0; 3]
    }
}

/// A piece of a scan's surface: the mean of the points in a voxel, in the sensor's frame, and their normal, zero where they are no plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Surfel {
    pub(crate) point: [f32; 3],
    pub(crate) normal: [f32; 3],
}

/// Voxels of one size around the sensor.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(from = "StoredMap", into = "StoredMap")]
pub(crate) struct LocalMap {
    size: f64,
    /// Path of the sensor so far, metres.
    path: f32,
    index: BlockIndex,
    moments: Vec<Moments>,
    surfaces: Vec<Surface>,
    changed: Vec<u32>,
}

/// The serialised form of a map: everything else follows from the moments.
#[derive(Serialize, Deserialize)]
struct StoredMap {
    size: f64,
    path: f32,
    moments: Vec<Moments>,
}

impl From<LocalMap> for StoredMap {
    fn from(map: LocalMap) -> Self {
        Self { size: map.size, path: map.path, moments: map.moments }
    }
}

impl From<StoredMap> for LocalMap {
    fn from(StoredMap { size, path, moments }: StoredMap) -> Self {
        let surfaces = moments.iter().map(|m| surface(m, size)).collect();
        let mut map = Self { path, moments, surfaces, ..Self::new(size) };
        map.make_index();
        map
    }
}

impl LocalMap {
    /// An empty map of voxels of edge `size`, metres.
    pub(crate) fn new(size: f64) -> Self {
        Self { size, path: 0.0, index: BlockIndex::default(), moments: Vec::new(), surfaces: Vec::new(), changed: Vec::new() }
    }

    /// Removes all voxels and keeps the memory.
    pub(crate) fn clear(&mut self) {
        self.index.clear();
        self.moments.clear();
        self.surfaces.clear();
    }

    /// Writes a surfel per voxel.
    pub(crate) fn surfels(&self, out: &mut Vec<Surfel>) {
        out.clear();
        out.extend(self.moments.iter().zip(&self.surfaces).map(|(m, s)| {
            let point = std::array::from_fn(|i| ((f64::from(m.coordinates[i]) + 0.5) * self.size) as f32 + m.sum[i] / m.count);
            Surfel { point, normal: s.normal }
        }));
    }

    /// Edge of a voxel, metres.
    pub(crate) fn size(&self) -> f64 {
        self.size
    }

    /// Notes how far the sensor has moved so far, metres: points that are added from now on are seen from there.
    pub(crate) fn set_path(&mut self, path: f64) {
        self.path = path as f32;
    }

    /// How far the sensor has moved since the surface at a point was first seen, metres.
    pub(crate) fn age_at(&self, p: [f64; 3]) -> Option<f64> {
        let position = self.index.get(p.map(|v| floor(v / self.size)))? as usize;
        (self.surfaces[position].weight > 0.0).then(|| f64::from(self.path - self.moments[position].born))
    }

    /// Adds points in the map frame.
    pub(crate) fn insert(&mut self, points: impl Iterator<Item = [f64; 3]>) {
        self.changed.clear();
        let per_metre = 1.0 / self.size;
        for p in points {
            let scaled = p.map(|v| v * per_metre);
            let coordinates = scaled.map(floor);
            let (position, is_new) = self.index.get_or_insert(coordinates, self.moments.len() as u32);
            if is_new {
                self.moments.push(Moments { coordinates, count: 0.0, computed: 0.0, born: self.path, sum: [0.0; 3], squares: [0.0; 6] });
                self.surfaces.push(Surface::NONE);
            }
            let moments = &mut self.moments[position as usize];
            if moments.count >= FULL {
                continue;
            }
            if moments.count == moments.computed {
                self.changed.push(position);
            }
            let [x, y, z]: [f32; 3] = std::array::from_fn(|i| ((scaled[i] - f64::from(coordinates[i]) - 0.5) * self.size) as f32);
            moments.count += 1.0;
            (moments.sum[0], moments.sum[1], moments.sum[2]) = (moments.sum[0] + x, moments.sum[1] + y, moments.sum[2] + z);
            for (sum, product) in moments.squares.iter_mut().zip([x * x, x * y, x * z, y * y, y * z, z * z]) {
                *sum += product;
            }
        }
        for &position in &self.changed {
            let moments = &mut self.moments[position as usize];
            moments.computed = moments.count;
            self.surfaces[position as usize] = surface(moments, self.size);
        }
    }

    /// The surface whose mean is nearest to a point, among the eight voxels nearest to the point, and the point relative to that mean.
    /// Planes that are not parallel to the point's own plane are left out; `normal` is zero if it has none.
    #[inline]
    pub(crate) fn nearest(&self, p: [f64; 3], normal: [f32; 3]) -> Option<([f32; 3], &Surface)> {
        let scaled = p.map(|v| v / self.size - 0.5);
        let base = scaled.map(floor);
        // Relative to the centre of the voxel at `base`.
        let local: [f32; 3] = std::array::from_fn(|i| ((scaled[i] - f64::from(base[i])) * self.size) as f32);
        let size = self.size as f32;
        let mut best: Option<([f32; 3], &Surface)> = None;
        let has_normal = normal != [0.0; 3];
        let mut best_distance = f32::INFINITY;
        for (corner, position) in self.index.corners(base).into_iter().enumerate() {
            if position == ABSENT {
                continue;
            }
            let step = [corner & 1, corner >> 1 & 1, corner >> 2];
            let surface = &self.surfaces[position as usize];
            let d: [f32; 3] = std::array::from_fn(|i| local[i] - step[i] as f32 * size - surface.mean[i]);
            let distance = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            if surface.weight <= 0.0 || distance >= best_distance {
                continue;
            }
            let n = surface.normal;
            let cosine = n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2];
            let is_other = cosine.abs() < LEAST_COSINE && has_normal && surface.is_plane();
            if !is_other {
                (best, best_distance) = (Some((d, surface)), distance);
            }
        }
        best
    }

    /// The surface in the voxel that a point lies in, and the point relative to its mean.
    pub(super) fn at(&self, p: [f64; 3]) -> Option<([f32; 3], &Surface)> {
        let scaled = p.map(|v| v / self.size);
        let coordinates = scaled.map(floor);
        let surface = &self.surfaces[self.index.get(coordinates)? as usize];
        let from_mean = |i: usize| ((scaled[i] - f64::from(coordinates[i]) - 0.5) * self.size) as f32 - surface.mean[i];
        (surface.weight > 0.0).then(|| (std::array::from_fn(from_mean), surface))
    }

    /// Removes voxels farther than `radius` from a point.
    pub(crate) fn prune(&mut self, centre: [f64; 3], radius: f64) {
        let limit = (radius / self.size).powi(2);
        let centre = centre.map(|v| v / self.size - 0.5);
        let is_near = |m: &Moments| (0..3).map(|i| (f64::from(m.coordinates[i]) - centre[i]).powi(2)).sum::<f64>() <= limit;
        let mut kept = 0;
        for position in 0..self.moments.len() {
            if is_near(&self.moments[position]) {
                self.moments[kept] = self.moments[position];
                self.surfaces[kept] = self.surfaces[position];
                kept += 1;
            }
        }
        self.moments.truncate(kept);
        self.surfaces.truncate(kept);
        self.make_index();
    }

    fn make_index(&mut self) {
        self.index.clear();
        for (position, moments) in self.moments.iter().enumerate() {
            self.index.get_or_insert(moments.coordinates, position as u32);
        }
    }
}

/// `v.floor() as i32`, without a call where the processor may have no instruction for it.
#[inline(always)]
fn floor(v: f64) -> i32 {
    let towards_zero = v as i32;
    towards_zero.saturating_sub(i32::from(v < f64::from(towards_zero)))
}

/// The surface that follows from a voxel's points.
fn surface(moments: &Moments, size: f64) -> Surface {
    let n = f64::from(moments.count);
    if moments.count < LEAST_FOR_POINT {
        return Surface::NONE;
    }
    let mean = moments.sum.map(|v| f64::from(v) / n);
    let product = |k: usize, i: usize, j: usize| f64::from(moments.squares[k]) / n - mean[i] * mean[j];
    let covariance = [product(0, 0, 0), product(1, 0, 1), product(2, 0, 2), product(3, 1, 1), product(4, 1, 2), product(5, 2, 2)];
    let (values, normal) = smallest_eigenvector(covariance);
    let noise = RANGE_NOISE * RANGE_NOISE;
    let mean = mean.map(|v| v as f32);
    let is_wide = values[1] > (LEAST_WIDTH * size).powi(2);
    let is_flat = values[0] < FLATNESS * FLATNESS * values[1];
    match normal.filter(|_| moments.count >= LEAST_FOR_PLANE && is_wide && is_flat) {
        Some(normal) => Surface { mean, weight: (noise / (noise + values[0].max(0.0))) as f32, normal: normal.map(|v| v as f32) },
        None => Surface { mean, weight: (noise / (noise + (values[0] + values[1] + values[2]).max(0.0))) as f32, normal: [0.0; 3] },
    }
}

#[cfg(test)]
mod tests {
    use super::floor;

    #[test]
    fn floor_is_that_of_the_library() {
        let random = (0..1000u32).map(|k| f64::from(k.wrapping_mul(2_654_435_761)) / 1e6 - 2000.0);
        let special =
            [0.0, -0.0, -1.0, 1.0, -1e-300, 0.999, -2_147_483_648.0, -2_147_483_648.5, 1e300, -1e300, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        for v in random.chain(special) {
            assert_eq!(floor(v), v.floor() as i32, "{v}");
        }
    }
}
