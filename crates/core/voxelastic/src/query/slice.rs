//! Cross-sections of a map as images.

use super::shape::moved;
use super::{AtlasQuery, FieldQuery};
use crate::atlas::Atlas;
use crate::field::occupancy::State;
use crate::field::tsdf::TsdfField;
use crate::geometry::{Aabb, Pose};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, block_coords, block_key, voxel_index};
use rayon::prelude::*;

/// An axis of the frame of a query.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Usually forward.
    X,
    /// Usually to the left.
    Y,
    /// Usually up.
    Z,
}

impl Axis {
    /// Indices of the axes along the image's rows and columns, and of the viewing direction.
    pub fn frame(self) -> [usize; 3] {
        match self {
            Self::X => [1, 2, 0],
            Self::Y => [0, 2, 1],
            Self::Z => [0, 1, 2],
        }
    }
}

/// Position, size and resolution of a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceRequest {
    /// Axis perpendicular to the slice.
    pub axis: Axis,
    /// Position on the axis, metres.
    pub at: f64,
    /// Thickness of the slice from `at` in the direction of the axis, metres; 0 for a plane. A pixel of a thick slice is occupied if any
    /// point along the axis is, otherwise free if any is.
    pub thickness: f64,
    /// Edge of a pixel, metres.
    pub pixel: f64,
    /// Bounds of the image in the frame of the query, metres.
    pub bounds: Aabb,
}

/// An image of states.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Slice {
    /// Pixels across: along y for a slice on x, along x otherwise.
    pub width: usize,
    /// Pixels up: along y for a slice on z, along z otherwise.
    pub height: usize,
    /// States row by row, the row with the smallest coordinate first.
    pub states: Vec<State>,
}

/// An image of signed distances to surfaces.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceSlice {
    /// Pixels across, as in [`Slice`].
    pub width: usize,
    /// Pixels up.
    pub height: usize,
    /// Distances in metres, positive in front of surfaces, in the order of [`Slice::states`]; NaN where none is stored.
    pub distances: Vec<f32>,
}

/// Largest number of pixels along an edge of a slice.
const MAX_EDGE: usize = 16_384;

/// Sample points of a request: pixels along rows and columns, layers through its thickness.
struct SampleRaster<'a> {
    request: &'a SliceRequest,
    width: usize,
    height: usize,
    layers: usize,
}

impl<'a> SampleRaster<'a> {
    /// Layers are at most `step` metres apart.
    fn new(request: &'a SliceRequest, step: f64) -> Self {
        let [u, v, _] = request.axis.frame();
        let size = request.bounds.size();
        let pixels = |k: usize| ((f64::from(size[k]) / request.pixel - 1e-6).ceil() as usize).clamp(1, MAX_EDGE);
        let layers = ((request.thickness / step).ceil() as usize).clamp(1, MAX_EDGE);
        Self { request, width: pixels(u), height: pixels(v), layers }
    }

    fn point(&self, i: usize, j: usize, layer: usize) -> [f64; 3] {
        let ([u, v, w], request) = (self.request.axis.frame(), self.request);
        let mut p = [0.0; 3];
        p[u] = f64::from(request.bounds.min[u]) + (i as f64 + 0.5) * request.pixel;
        p[v] = f64::from(request.bounds.min[v]) + (j as f64 + 0.5) * request.pixel;
        p[w] = request.at + (layer as f64 + 0.5) * request.thickness / self.layers as f64;
        p
    }

    /// One value per pixel, computed from its points from the lowest layer up.
    fn pixels<T: Send>(&self, value: impl Fn(&mut dyn Iterator<Item = [f64; 3]>) -> T + Sync) -> Vec<T> {
        let pixel = |at: usize| value(&mut (0..self.layers).map(|layer| self.point(at % self.width, at / self.width, layer)));
        (0..self.width * self.height).into_par_iter().map(pixel).collect()
    }
}

/// The image of `state`.
fn states(request: &SliceRequest, step: f64, state: impl Fn([f64; 3]) -> State + Sync) -> Slice {
    let raster = SampleRaster::new(request, step);
    let strongest = |points: &mut dyn Iterator<Item = [f64; 3]>| {
        let mut best = State::Unknown;
        for p in points {
            best = best.max(state(p));
            if best == State::Occupied {
                break;
            }
        }
        best
    };
    Slice { width: raster.width, height: raster.height, states: raster.pixels(strongest) }
}

impl FieldQuery<'_> {
    /// An image of a slice of the field in the submap frame, at most 16,384 pixels along an edge.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        states(request, self.voxel, |p| self.state(p))
    }
}

impl AtlasQuery<'_> {
    /// An image of a slice of the map in the map frame, at most 16,384 pixels along an edge.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        states(request, self.voxel_size(), |p| self.state(p))
    }
}

/// Queries on the TSDFs of an atlas in the map frame.
#[derive(Clone, Debug)]
pub struct DistanceQuery<'a> {
    pub(super) voxel: f64,
    pub(super) parts: Vec<(&'a TsdfField, Pose)>,
}

impl<'a> DistanceQuery<'a> {
    /// Queries on `atlas`.
    pub fn new(atlas: &'a Atlas) -> Self {
        let parts = atlas.submaps().iter().filter(|s| !s.tsdf.is_empty()).map(|s| (&s.tsdf, s.t_map_submap.inverse()));
        Self { voxel: f64::from(atlas.voxel_size()), parts: parts.collect() }
    }

    /// Whether no submap has a TSDF.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Box around all blocks of all submaps, map frame.
    pub fn bounds(&self) -> Aabb {
        let mut bounds = Aabb::default();
        for (field, t_submap_map) in &self.parts {
            let t_map_submap = t_submap_map.inverse();
            for id in field.ids() {
                let centre = block_coords(field.block(id).key).map(|c| (f64::from(c) + 0.5) * BLOCK_EDGE as f64 * self.voxel);
                bounds.add(moved(&t_map_submap, centre).map(|c| c as f32));
            }
        }
        bounds
    }

    /// Signed distance stored in the voxel at `p`, metres, positive in front of the surface; of all submaps the value nearest to zero. None
    /// if no submap has an observed voxel there.
    pub fn distance(&self, p: [f64; 3]) -> Option<f32> {
        let stored = self.parts.iter().filter_map(|(field, t_submap_map)| self.stored(field, moved(t_submap_map, p)));
        stored.min_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    fn stored(&self, field: &TsdfField, p: [f64; 3]) -> Option<f32> {
        let c = p.map(|c| (c / self.voxel).floor());
        if !c.iter().all(|v| v.abs() < f64::from(MAX_BLOCK_COORD) * BLOCK_EDGE as f64) {
            return None;
        }
        let c = c.map(|v| v as i32);
        let block = field.block(field.find(block_key(c.map(|v| v >> BLOCK_SHIFT)))?);
        let scale = usize::from(block.scale);
        let local = c.map(|v| (v as usize & (BLOCK_EDGE - 1)) >> scale);
        let voxel = field.voxel(block, voxel_index(local, scale));
        voxel.is_observed().then(|| voxel.distance_in_voxels() * (self.voxel * f64::from(1 << scale)) as f32)
    }

    /// An image of a slice of the map; in a thick slice each pixel is the distance nearest to zero.
    pub fn slice(&self, request: &SliceRequest) -> DistanceSlice {
        let raster = SampleRaster::new(request, self.voxel);
        let nearest = |points: &mut dyn Iterator<Item = [f64; 3]>| {
            let distances = points.filter_map(|p| self.distance(p));
            distances.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(f32::NAN)
        };
        DistanceSlice { width: raster.width, height: raster.height, distances: raster.pixels(nearest) }
    }
}
