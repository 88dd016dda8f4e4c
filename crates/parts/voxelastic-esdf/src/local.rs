//! Distance fields that are made only where they are asked for.

use crate::atlas::{Esdf, EsdfError, EsdfSettings};
use crate::frame::{SubmapFrame, corner_below};
use crate::query::EsdfSample;
use crate::targets::BlockSet;
use std::collections::BTreeMap;
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::octree::BLOCK_SHIFT;

/// Blocks of a submap that are kept, beside those that were asked for last: 16 MB.
const MOST_KEPT: usize = 16_384;

/// As an [`Esdf`], with the same answers to the last bit, but made only around the points that are asked about: for a few points in a large map that is a small part
/// of its time and memory. What was made stays for the next points, as long as the map does not change there.
#[derive(Clone, Debug)]
pub struct LocalEsdf {
    field: Esdf,
    /// The blocks of each submap that are up to date.
    made: BTreeMap<SubmapId, BlockSet>,
}

impl LocalEsdf {
    /// An empty field for an atlas with finest voxels of `voxel_size` metres.
    ///
    /// # Errors
    /// As [`Esdf::new`].
    pub fn new(settings: EsdfSettings, voxel_size: f32) -> Result<Self, EsdfError> {
        Ok(Self { field: Esdf::new(settings, voxel_size)?, made: BTreeMap::new() })
    }

    /// The distance at each of `points` (metres, map frame) as the map is now, as [`EsdfQuery::sample_many`](crate::EsdfQuery::sample_many) gives it. Uses the
    /// threads of the current pool.
    pub fn sample_many(&mut self, atlas: &Atlas, points: &[[f64; 3]]) -> Vec<EsdfSample> {
        self.make(atlas, points);
        self.field.query(atlas).sample_many(points)
    }

    /// As [`sample_many`](Self::sample_many), but to the surfaces of the map where it has them:
    /// [`EsdfQuery::sample_many_to_surfaces`](crate::EsdfQuery::sample_many_to_surfaces).
    pub fn sample_many_to_surfaces(&mut self, atlas: &Atlas, points: &[[f64; 3]]) -> Vec<EsdfSample> {
        self.make(atlas, points);
        self.field.query(atlas).sample_many_to_surfaces(points)
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.field.bytes()
    }

    /// Brings the blocks up to date that a query of `points` looks up.
    fn make(&mut self, atlas: &Atlas, points: &[[f64; 3]]) {
        let all: Vec<_> = atlas.placed().collect();
        self.field.retain(|id| all.iter().any(|(submap, _)| submap.id() == id));
        self.made.retain(|id, _| self.field.submaps.contains_key(id));
        let settings = self.field.settings();
        let (reach, with_unknown) = (self.field.reach(), self.field.has_unknown());
        for (submap, t_map_submap) in all {
            let frame = SubmapFrame::new(submap, &t_map_submap, self.field.voxel_size, settings.max_distance);
            let mut wanted = BlockSet::default();
            let local = points.iter().map(|p| frame.to_submap(*p)).filter(|p| frame.reaches(p));
            for (base, _) in local.filter_map(|p| corner_below(p, self.field.voxel_size)) {
                for corner in 0..8 {
                    wanted.add(std::array::from_fn(|k| (base[k] + (corner >> k & 1)) >> BLOCK_SHIFT));
                }
            }
            if wanted.is_empty() {
                continue;
            }
            let (esdf, made) = (self.field.submaps.entry(submap.id()).or_default(), self.made.entry(submap.id()).or_default());
            esdf.update_near(submap, reach, with_unknown, &wanted, made);
            if made.len() > MOST_KEPT.max(2 * wanted.len()) {
                esdf.keep(&wanted, made);
            }
        }
    }
}
