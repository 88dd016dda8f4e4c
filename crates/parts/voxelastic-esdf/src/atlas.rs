//! The distance fields of all submaps of an atlas.

use crate::submap::SubmapEsdf;
use crate::surfaces::Surfaces;
use crate::transform::MAX_REACH;
use std::collections::BTreeMap;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::query::UnknownAs;

/// What distances are measured to, and how far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EsdfSettings {
    /// Largest distance that is told apart, metres; at most 48 finest voxels.
    pub max_distance: f64,
    /// Whether distances end at unknown space, too, or at obstacles only.
    pub unknown: UnknownAs,
}

impl Default for EsdfSettings {
    /// Distances to obstacles up to two metres.
    fn default() -> Self {
        Self { max_distance: 2.0, unknown: UnknownAs::Free }
    }
}

/// Settings that no distance field can have.
#[derive(Debug, thiserror::Error, PartialEq)]
#[non_exhaustive]
pub enum EsdfError {
    /// The largest distance is out of range.
    #[error("the largest distance is {value} m: must be above 0 and at most {most:.3} m, which are 48 voxels of {voxel_size} m")]
    MaxDistance {
        /// What was asked for, metres.
        value: f64,
        /// The largest that is possible, metres.
        most: f64,
        /// Edge of the finest voxel, metres.
        voxel_size: f64,
    },
}

/// What an update did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsdfStats {
    /// Blocks of 8 x 8 x 8 voxels that were recomputed.
    pub recomputed: usize,
    /// Blocks that are stored.
    pub blocks: usize,
}

/// Euclidean distance fields of all submaps of an atlas, each in the frame of its submap.
#[derive(Clone, Debug)]
pub struct Esdf {
    settings: EsdfSettings,
    pub(crate) voxel_size: f64,
    pub(crate) submaps: BTreeMap<SubmapId, SubmapEsdf>,
    /// Triangles of the submaps' surfaces, where queries have needed them.
    pub(crate) surfaces: Surfaces,
}

impl Esdf {
    /// An empty field for an atlas with finest voxels of `voxel_size` metres.
    ///
    /// # Errors
    /// [`EsdfError::MaxDistance`] for a largest distance that is not positive, or of more than 48 voxels.
    pub fn new(settings: EsdfSettings, voxel_size: f32) -> Result<Self, EsdfError> {
        let voxel_size = f64::from(voxel_size);
        let most = MAX_REACH as f64 * voxel_size;
        if !(settings.max_distance > 0.0 && settings.max_distance <= most) {
            return Err(EsdfError::MaxDistance { value: settings.max_distance, most, voxel_size });
        }
        Ok(Self { settings, voxel_size, submaps: BTreeMap::new(), surfaces: Surfaces::default() })
    }

    /// Its settings.
    pub fn settings(&self) -> EsdfSettings {
        self.settings
    }

    /// The largest distance in finest voxels, rounded up.
    pub(crate) fn reach(&self) -> usize {
        ((self.settings.max_distance / self.voxel_size - 1e-6).ceil() as usize).clamp(1, MAX_REACH)
    }

    /// Whether distances end at unknown space, too.
    pub(crate) fn has_unknown(&self) -> bool {
        self.settings.unknown == UnknownAs::Blocked
    }

    /// Brings the field up to date with an atlas: recomputes what lies within the largest distance of voxels that changed their state since the last update. The
    /// result is the same as that of a field made anew. Uses the threads of the current pool; the result does not depend on them.
    pub fn update(&mut self, atlas: &Atlas) -> EsdfStats {
        let all: Vec<&Submap> = atlas.placed().map(|(submap, _)| submap).collect();
        self.retain(|id| all.iter().any(|submap| submap.id() == id));
        let (reach, with_unknown) = (self.reach(), self.has_unknown());
        let recomputed = all.iter().map(|submap| self.submaps.entry(submap.id()).or_default().update(submap, reach, with_unknown)).sum();
        EsdfStats { recomputed, blocks: self.blocks() }
    }

    /// Forgets submaps that are no more.
    pub(crate) fn retain(&mut self, is_kept: impl Fn(SubmapId) -> bool) {
        self.submaps.retain(|id, _| is_kept(*id));
        self.surfaces.retain(is_kept);
    }

    /// Blocks of 8 x 8 x 8 voxels that are stored.
    pub fn blocks(&self) -> usize {
        self.submaps.values().map(SubmapEsdf::blocks).sum()
    }

    /// Memory held, bytes, with that of the surfaces around points that were asked about.
    pub fn bytes(&self) -> usize {
        self.submaps.values().map(SubmapEsdf::bytes).sum::<usize>() + self.surfaces.bytes()
    }
}
