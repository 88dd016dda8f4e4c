//! A submap takes back what it handed over.

use super::strain::Strain;
use super::transfer::{BLOCKS_PER_PART, Transfer};
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::tsdf_sampling::{TargetBlock, TsdfSampling};
use crate::atlas::{Atlas, HandedOver, Submap};
use crate::field::tsdf::{Block, ObservationCount};
use crate::octree::{BLOCK_EDGE, Cursor, block_key};
use rayon::prelude::*;

/// Blocks are taken back where corrections moved the two submaps apart by more than this, finest voxels.
const MOVED: f32 = 1.0;

/// What submaps take back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TakeBack {
    /// Blocks where corrections have moved the two submaps apart by more than a voxel since.
    Moved,
    /// All.
    All,
}

/// Gives submaps back blocks that they handed over, as they are in the submaps that have them, at the places where they lay when they were handed over. The others keep them,
/// too. Returns the number of blocks. What is in submaps that `atlas` does not have stays handed over.
pub fn take_back(atlas: &mut Atlas, what: TakeBack) -> usize {
    let mut count = 0;
    for i in 0..atlas.submaps().len() {
        for record in std::mem::take(&mut atlas.submaps_mut()[i].handed_over) {
            let (submap, other) = (&atlas.submaps()[i], atlas.submap(record.to));
            let wanted = match (other, what) {
                (None, _) => Vec::new(),
                (Some(_), TakeBack::All) => record.keys.to_vec(),
                (Some(other), TakeBack::Moved) => moved(submap, other, &record),
            };
            if let Some(other) = other.filter(|_| !wanted.is_empty()) {
                let samples = sampled(submap, other, &record, &wanted);
                let submap = &mut atlas.submaps_mut()[i];
                samples.merge_into(&mut submap.tsdf, u16::MAX);
                submap.revision += 1;
                count += wanted.len();
            }
            let left: Vec<u64> = record.keys.iter().copied().filter(|key| wanted.binary_search(key).is_err()).collect();
            if !left.is_empty() {
                atlas.submaps_mut()[i].handed_over.push(HandedOver { keys: left.into(), ..record });
            }
        }
    }
    count
}

/// The keys of those blocks that corrections have moved apart, ascending.
fn moved(submap: &Submap, other: &Submap, record: &HandedOver) -> Vec<u64> {
    let part = |keys: &[u64]| {
        let mut strain = Strain::new(submap, other, &record.t_to_submap);
        // A pose that is not finite is far away.
        let is_moved = |key: &u64| {
            let apart = strain.at(*key);
            apart > MOVED || apart.is_nan()
        };
        keys.iter().copied().filter(is_moved).collect::<Vec<u64>>()
    };
    record.keys.par_chunks(BLOCKS_PER_PART).map(part).collect::<Vec<_>>().concat()
}

/// Samples blocks `keys` of a submap, ascending, in the submap that has them.
fn sampled(submap: &Submap, other: &Submap, record: &HandedOver, keys: &[u64]) -> Transfer {
    let placement = Placement::new(&record.t_to_submap.inverse(), submap.voxel_size);
    let in_other = Placement::new(&record.t_to_submap, submap.voxel_size);
    let part = |keys: &[u64]| {
        let mut cursor = Cursor::new(other.tsdf.tree());
        let block_at = |key: u64| {
            let at = in_other.middle_in_target(key).map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
            cursor.block(other.tsdf.tree(), block_key(at)).map(|id| other.tsdf.block(id))
        };
        let there: Vec<_> = keys.iter().copied().map(block_at).collect();
        let target = |(key, there): (&u64, &Option<_>)| TargetBlock::new(*key, there.map_or(0, |block: &Block| block.finest));
        let sampling = TsdfSampling::new(&other.tsdf, &placement, keys.iter().zip(&there).map(target).collect());
        let mut blocks = sampling.sample(0..keys.len());
        for block in &mut blocks {
            // Fewer than the other submap has, so that they can be handed over again.
            let most = keys.binary_search(&block.key).ok().and_then(|i| there[i]).map_or(0, |there| there.observation_count.get());
            block.observation_count = ObservationCount::default().plus(most / 2);
        }
        Transfer::new(&other.tsdf, &placement, blocks)
    };
    Transfer::joined(keys.par_chunks(BLOCKS_PER_PART).map(part).collect())
}
