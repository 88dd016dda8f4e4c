//! Cuts through a map as images of states.

use super::{AtlasQuery, FieldQuery};
use crate::field::occupancy::State;
use crate::geometry::Aabb;
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

/// Most pixels of a slice along an edge.
const MAX_EDGE: usize = 16_384;

/// Asks `state` at the middle of every pixel of the request; at steps of at most `step` metres through its thickness.
fn rasterise(request: &SliceRequest, step: f64, state: impl Fn([f64; 3]) -> State + Sync) -> Slice {
    let [u, v, w] = request.axis.frame();
    let size = request.bounds.size();
    let pixels = |k: usize| ((f64::from(size[k]) / request.pixel).ceil() as usize).clamp(1, MAX_EDGE);
    let (width, height) = (pixels(u), pixels(v));
    let layers = if request.thickness > 0.0 { (request.thickness / step).ceil() as usize } else { 1 }.clamp(1, MAX_EDGE);
    let at = |i: usize, j: usize, layer: usize| {
        let mut p = [0.0; 3];
        p[u] = f64::from(request.bounds.min[u]) + (i as f64 + 0.5) * request.pixel;
        p[v] = f64::from(request.bounds.min[v]) + (j as f64 + 0.5) * request.pixel;
        p[w] = request.at + if layers > 1 { (layer as f64 + 0.5) * request.thickness / layers as f64 } else { 0.5 * request.thickness };
        p
    };
    let strongest = |i: usize, j: usize| {
        let mut best = State::Unknown;
        for layer in 0..layers {
            best = best.max(state(at(i, j, layer)));
            if best == State::Occupied {
                break;
            }
        }
        best
    };
    let states = (0..height).into_par_iter().flat_map_iter(|j| (0..width).map(move |i| (i, j))).map(|(i, j)| strongest(i, j)).collect();
    Slice { width, height, states }
}

impl FieldQuery<'_> {
    /// An image of a cut through the field, submap frame. A side of more than 16,384 pixels is cut off there.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        rasterise(request, self.voxel, |p| self.state(p))
    }
}

impl AtlasQuery<'_> {
    /// An image of a cut through the map, map frame. A side of more than 16,384 pixels is cut off there.
    pub fn slice(&self, request: &SliceRequest) -> Slice {
        rasterise(request, self.voxel(), |p| self.state(p))
    }
}
