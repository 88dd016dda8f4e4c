//! Cuts through a map as images of states.

use super::shape::moved;
use super::{AtlasQuery, FieldQuery};
use crate::atlas::Atlas;
use crate::field::occupancy::State;
use crate::field::tsdf::TsdfField;
use crate::geometry::{Aabb, Pose};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, block_coords, block_key, voxel_index};
use rayon::prelude::*;

/// An axis of the frame that is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Forward, mostly.
    X,
    /// To the left, mostly.
    Y,
    /// Up, mostly.
    Z,
}

impl Axis {
    /// The axes of the image across and up, and the one that it looks along.
    pub fn frame(self) -> [usize; 3] {
        match self {
            Self::X => [1, 2, 0],
            Self::Y => [0, 2, 1],
            Self::Z => [0, 1, 2],
        }
    }
}

/// What to cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceRequest {
    /// Axis that the slice stands on.
    pub axis: Axis,
    /// Where on the axis, metres.
    pub at: f64,
    /// Thickness of the slice from `at` upwards, metres; 0 for a plane. Of a thick slice the image has the strongest state
    /// along the axis: occupied if anything is, otherwise free if anything is.
    pub thickness: f64,
    /// Edge of a pixel, metres.
    pub pixel: f64,
    /// What part of the frame to show, metres.
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

/// Most pixels of a slice along an edge.
const MAX_EDGE: usize = 16_384;

/// The points of a request: pixels across and up, layers through its thickness.
struct Raster<'a> {
    request: &'a SliceRequest,
    width: usize,
    height: usize,
    layers: usize,
}

impl<'a> Raster<'a> {
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

    /// One value per pixel, from its points from the lowest layer up.
    fn pixels<T: Send>(&self, ask: impl Fn(&mut dyn Iterator<Item = [f64; 3]>) -> T + Sync) -> Vec<T> {
        let pixel = |at: usize| ask(&mut (0..self.layers).map(|layer| self.point(at % self.width, at / self.width, layer)));
        (0..self.width * self.height).into_par_iter().map(pixel).collect()
    }
}

/// Asks `state` at the points of every pixel.
fn states(request: &SliceRequest, step: f64, state: impl Fn([f64; 3]) -> State + Sync) -> Slice {
    let raster = Raster::new(request, step);
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
    /// An image of a cut through the field, submap frame. A side of more than 16,384 pixels is cut off there.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        states(request, self.voxel, |p| self.state(p))
    }
}

impl AtlasQuery<'_> {
    /// An image of a cut through the map, map frame. A side of more than 16,384 pixels is cut off there.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        states(request, self.voxel(), |p| self.state(p))
    }
}

/// Asks the TSDFs of an atlas: a cut through the bands around the surfaces, map frame.
#[derive(Clone, Debug)]
pub struct DistanceQuery<'a> {
    voxel: f64,
    parts: Vec<(&'a TsdfField, Pose)>,
}

impl<'a> DistanceQuery<'a> {
    /// Asks `atlas`, whose finest voxels have edges of `voxel` metres.
    pub fn new(atlas: &'a Atlas, voxel: f32) -> Self {
        let parts = atlas.submaps().iter().filter(|s| !s.tsdf.is_empty()).map(|s| (&s.tsdf, s.t_map_submap.inverse()));
        Self { voxel: f64::from(voxel), parts: parts.collect() }
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

    /// Signed distance stored in the voxel at `p`, metres, positive in front of the surface: of all submaps the one nearest to
    /// zero. None where nothing was observed near a surface.
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

    /// An image of a cut through the map. Of a thick slice it has the smallest distances, by their size.
    pub fn slice(&self, request: &SliceRequest) -> DistanceSlice {
        let raster = Raster::new(request, self.voxel);
        let nearest = |points: &mut dyn Iterator<Item = [f64; 3]>| {
            let distances = points.filter_map(|p| self.distance(p));
            distances.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(f32::NAN)
        };
        DistanceSlice { width: raster.width, height: raster.height, distances: raster.pixels(nearest) }
    }
}
