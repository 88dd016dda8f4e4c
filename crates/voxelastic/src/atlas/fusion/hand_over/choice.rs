//! Which blocks are handed over, and to which submap.

use super::strain::Strain;
use super::transfer::{BLOCKS_PER_PART, voxels_of};
use crate::atlas::Submap;
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::tsdf_sampling::{TargetBlock, TsdfSampling};
use crate::field::tsdf::Voxel;
use crate::octree::{BLOCK_EDGE, Cursor, block_key};
use hashbrown::HashSet;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Voxels nearer than this to a surface are the surface, voxels.
const NEAR: f32 = 1.0;
/// The other submap must have observed at least this share of the surface in a block ...
const KNOWN: f32 = 0.2;
/// ... and distances must differ by at most this in the mean, voxels: the mean of two surfaces is near both then.
const APART: f32 = 0.3;
/// Of a block without surface, the other submap must have observed at least this share.
const KNOWN_WITHOUT_SURFACE: f32 = 0.9;
/// Corrections may say that the surfaces are no farther apart than this, finest voxels.
const STRAIN: f32 = 0.5;

/// Blocks of a submap that another one may know better.
pub(super) struct Choice {
    /// Number of the other submap in its atlas.
    pub to: usize,
    /// Ids of the blocks, in Morton order.
    pub blocks: Vec<u32>,
}

/// For submap number `from`, which blocks another submap has observed with more rays, without those that it `received`; by the submap that has observed them most.
pub(super) fn choices(submaps: &[Submap], from: usize, received: &HashSet<u64>) -> Vec<Choice> {
    let (submap, field) = (&submaps[from], &submaps[from].tsdf);
    let is_finite = |submap: &Submap| submap.t_map_submap.to_matrix().iter().all(|v| v.is_finite());
    if !is_finite(submap) {
        return Vec::new();
    }
    let others = submaps.iter().enumerate().filter(|(i, other)| *i != from && !other.tsdf.is_empty() && is_finite(other));
    let others: Vec<(usize, &Submap, Placement)> =
        others.map(|(i, other)| (i, other, Placement::new(&other.t_map_submap.inv_mul(&submap.t_map_submap), submap.voxel_size))).collect();
    let part = |ids: &[u32]| {
        let mut cursors: Vec<Cursor> = others.iter().map(|(_, other, _)| Cursor::new(other.tsdf.tree())).collect();
        let best = |id: &u32| {
            let block = field.block(*id);
            let own = block.observation_count.get();
            // Blocks that were loaded have no count.
            if own == 0 || received.contains(&block.key) {
                return None;
            }
            let mut best: Option<(u32, usize)> = None;
            for ((i, other, placement), cursor) in others.iter().zip(&mut cursors) {
                let at = placement.middle_in_target(block.key).map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
                let Some(there) = cursor.block(other.tsdf.tree(), block_key(at)) else { continue };
                let there = other.tsdf.block(there);
                let count = there.observation_count.get();
                // What is finer than there would become finer there.
                if there.finest <= block.finest && count > best.map_or(own, |(most, _)| most) {
                    best = Some((count, *i));
                }
            }
            best.map(|(_, to)| (to, *id))
        };
        ids.iter().filter_map(best).collect::<Vec<(usize, u32)>>()
    };
    let parts: Vec<Vec<(usize, u32)>> = field.ids_in_morton_order().par_chunks(BLOCKS_PER_PART).map(part).collect();
    let mut all: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
    parts.into_iter().flatten().for_each(|(to, id)| all.entry(to).or_default().push(id));
    all.into_iter().map(|(to, blocks)| Choice { to, blocks }).collect()
}

/// Those of some blocks of a submap, in Morton order, whose surface the other one knows at the same place.
pub(super) fn known_there(from: &Submap, to: &Submap, blocks: &[u32]) -> Vec<u32> {
    let t_from_to = from.t_map_submap.inv_mul(&to.t_map_submap);
    let placement = Placement::new(&t_from_to, from.voxel_size);
    let part = |ids: &[u32]| {
        let mut strain = Strain::new(from, to, &t_from_to.inverse());
        let ids: Vec<u32> = ids.iter().copied().filter(|id| strain.at(from.tsdf.block(*id).key) <= STRAIN).collect();
        let target = |id: &u32| TargetBlock::new(from.tsdf.block(*id).key, from.tsdf.block(*id).finest);
        let sampling = TsdfSampling::new(&to.tsdf, &placement, ids.iter().map(target).collect());
        let mut samples = sampling.sample(0..ids.len()).into_iter().peekable();
        let is_known = |id: &u32| {
            let there = samples.next_if(|block| block.key == from.tsdf.block(*id).key);
            there.is_some_and(|there| agree(&voxels_of(&from.tsdf, *id).1, &there.voxels))
        };
        ids.iter().copied().filter(is_known).collect::<Vec<u32>>()
    };
    blocks.par_chunks(BLOCKS_PER_PART).map(part).collect::<Vec<_>>().concat()
}

/// Whether the voxels of a block are known at the same place elsewhere, and say the same: of a block with a surface, those next to it.
fn agree(own: &[Voxel], there: &[Voxel]) -> bool {
    let known_and_apart = |is_meant: &dyn Fn(&Voxel) -> bool| {
        let (mut all, mut known, mut apart) = (0u32, 0u32, 0.0);
        for (own, there) in own.iter().zip(there).filter(|(own, _)| own.is_observed() && is_meant(own)) {
            all += 1;
            if there.is_observed() {
                known += 1;
                apart += (own.distance_in_voxels() - there.distance_in_voxels()).abs();
            }
        }
        (all as f32, known as f32, apart)
    };
    let (mut all, mut known, mut apart) = known_and_apart(&|voxel| voxel.distance_in_voxels().abs() <= NEAR);
    let mut share = KNOWN;
    if all == 0.0 {
        ((all, known, apart), share) = (known_and_apart(&|_| true), KNOWN_WITHOUT_SURFACE);
    }
    known > 0.0 && known >= share * all && apart <= APART * known
}
