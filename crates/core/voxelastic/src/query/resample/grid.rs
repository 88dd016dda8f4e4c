//! The grid, its cubes, and where submaps lie in it.

use super::super::atlas::PlacedField;
use super::super::shape::moved;
use crate::geometry::morton;
use nalgebra::{Matrix3, Vector3};

/// The grid, and the precision of the values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// Edge of the smallest cube, metres: the map's finest voxel or larger. The grid contains the origin.
    pub voxel: f64,
    /// Whether only states are needed: free cubes all have the value -1 then and occupied ones 1, so that they are larger.
    pub states_only: bool,
}

/// A cube with one value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cube {
    /// Smallest corner in multiples of the smallest cube's edge, plus 2^20.
    pub corner: [u32; 3],
    /// log2 of the edge in smallest cubes. Corners are multiples of the edge.
    pub level: u32,
    /// Log-odds in steps; never unknown.
    pub value: i8,
}

/// Value of [`Cube::corner`] at the origin: the middle of the range of Morton keys.
const ORIGIN: u32 = 1 << (morton::AXIS_BITS - 1);

/// A cube to resample, and the submaps around it.
#[derive(Clone)]
pub(super) struct Region<'a, 'b> {
    pub corner: [u32; 3],
    pub level: u32,
    pub submaps: Vec<&'a PlacedField<'b>>,
}

pub(super) struct Resampler {
    /// Edge of the map's finest voxel, metres.
    pub voxel_size: f64,
    pub to: Resampling,
    /// Points along an edge of a smallest cube.
    pub samples: usize,
}

impl Resampler {
    pub fn edge(&self, level: u32) -> f64 {
        self.to.voxel * f64::from(1u32 << level)
    }

    /// First corner of a smallest cube, map frame.
    pub fn corner(&self, corner: [u32; 3]) -> [f64; 3] {
        corner.map(|c| (f64::from(c) - f64::from(ORIGIN)) * self.to.voxel)
    }

    /// Centre of a cube, map frame, and the radius of the ball around it.
    pub fn ball(&self, region: &Region<'_, '_>) -> ([f64; 3], f64) {
        let half = 0.5 * self.edge(region.level);
        (self.corner(region.corner).map(|c| c + half), half * 3f64.sqrt())
    }

    /// The children of a cube that overlap the bounds of some submap.
    pub fn split<'a, 'b>(&self, region: &Region<'a, 'b>) -> Vec<Region<'a, 'b>> {
        let level = region.level - 1;
        let child = |i: u32| {
            let corner = std::array::from_fn(|k| region.corner[k] + ((i >> k & 1) << level));
            let mut child = Region { corner, level, submaps: region.submaps.clone() };
            self.keep_near(&mut child);
            (!child.submaps.is_empty()).then_some(child)
        };
        (0..8).filter_map(child).collect()
    }

    /// Takes submaps off the list whose bounds a cube does not overlap.
    pub fn keep_near(&self, region: &mut Region<'_, '_>) {
        let (middle, radius) = self.ball(region);
        region.submaps.retain(|submap| {
            let p = moved(&submap.t_submap_map, middle);
            submap.reaches(p.map(|c| c - radius), p.map(|c| c + radius))
        });
    }

    /// From smallest cubes, counted from the first corner of a region, to finest voxels of a submap.
    pub fn grid_of(&self, region: &Region<'_, '_>, submap: &PlacedField<'_>) -> Affine {
        let per_metre = submap.query.per_metre;
        let rotation = submap.t_submap_map.rotation.to_rotation_matrix().into_inner();
        let corner = moved(&submap.t_submap_map, self.corner(region.corner));
        Affine { linear: rotation * (self.to.voxel * per_metre), offset: Vector3::from(corner) * per_metre }
    }
}

/// A map from one frame to another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Affine {
    pub linear: Matrix3<f64>,
    offset: Vector3<f64>,
}

impl Affine {
    #[inline(always)]
    pub fn apply(&self, p: [f64; 3]) -> [f64; 3] {
        (self.linear * Vector3::from(p) + self.offset).into()
    }

    /// The map back.
    pub fn inverse(&self) -> Self {
        let linear = self.linear.try_inverse().unwrap_or_else(Matrix3::zeros);
        Self { linear, offset: -(linear * self.offset) }
    }

    /// The map of coordinates that are counted from `offset`.
    pub fn moved(&self, offset: [f64; 3]) -> Self {
        Self { offset: Vector3::from(self.apply(offset)), ..*self }
    }

    /// The map of coordinates that are counted in `unit`.
    pub fn scaled(&self, unit: f64) -> Self {
        Self { linear: self.linear * unit, ..*self }
    }

    /// Whole numbers around the image of the cuboid from zero to `size`: smallest and largest, with one to spare for rounding.
    pub fn bounds(&self, size: [f64; 3]) -> [[i32; 3]; 2] {
        let sum = |k: usize, pick: fn(f64, f64) -> f64| self.offset[k] + (0..3).map(|j| pick(self.linear[(k, j)] * size[j], 0.0)).sum::<f64>();
        [std::array::from_fn(|k| floor(sum(k, f64::min)) - 1), std::array::from_fn(|k| floor(sum(k, f64::max)) + 1)]
    }
}

/// The largest integer not above `x`. `f64::floor` is a function call on processors without the instruction.
#[inline(always)]
fn floor(x: f64) -> i32 {
    let whole = x as i32;
    whole - i32::from(f64::from(whole) > x)
}
