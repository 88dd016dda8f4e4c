//! The TSDF of a whole map: that of its submaps, fused, or that of a single submap as it is.

use crate::atlas::Atlas;
use crate::atlas::fusion::FusedTsdf;
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use crate::octree::BLOCK_EDGE;
use std::borrow::Borrow;

/// What the surface of a map is extracted from. `A` is an atlas or a reference to one.
#[derive(Debug)]
pub(crate) enum FusedField<A> {
    /// A field in the map frame. The atlas is not needed any more.
    Submaps(Box<FusedTsdf>),
    /// A single submap is not resampled.
    Single(A),
}

impl<A: Borrow<Atlas>> FusedField<A> {
    /// That of all of the map.
    pub fn new(atlas: A) -> Self {
        if atlas.borrow().tsdfs().len() < 2 { Self::Single(atlas) } else { Self::Submaps(Box::new(FusedTsdf::new(atlas.borrow()))) }
    }

    /// The same, fused only in a box of the map frame, metres.
    pub fn within(atlas: A, low: [f64; 3], high: [f64; 3]) -> Self {
        if atlas.borrow().tsdfs().len() < 2 {
            return Self::Single(atlas);
        }
        let block = f64::from(atlas.borrow().voxel_size()) * BLOCK_EDGE as f64;
        let [low, high] = [low, high].map(|at| at.map(|c| (c / block).floor() as i32));
        Self::Submaps(Box::new(FusedTsdf::within(atlas.borrow(), low, high)))
    }

    /// The field, and its frame in the map frame; none if no submap has a TSDF.
    pub fn field(&self) -> Option<(&TsdfField, Pose)> {
        match self {
            Self::Submaps(one) => Some((&one.field, Pose::identity())),
            Self::Single(atlas) => atlas.borrow().tsdfs().first().copied(),
        }
    }
}
