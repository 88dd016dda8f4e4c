//! Hands blocks over, one submap after the other.

use super::choice::{Choice, choices, known_there};
use super::transfer::sampled;
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::settings::FusionSettings;
use crate::atlas::{Atlas, HandedOver, SubmapId};
use hashbrown::HashSet;

/// Hands blocks over between all submaps of a map whose bricks are compressed; the submap `except` keeps its own. Returns the number of blocks that were handed over.
///
/// What was handed over before has to be [taken back](fn@super::take_back) first. The result does not depend on the number of threads.
pub fn hand_over(atlas: &mut Atlas, except: Option<SubmapId>, settings: &FusionSettings) -> usize {
    let mut received: Vec<HashSet<u64>> = vec![HashSet::new(); atlas.submaps().len()];
    let mut count = 0;
    for from in (0..received.len()).filter(|i| except != Some(atlas.submaps()[*i].id)).collect::<Vec<_>>() {
        let mut gone: HashSet<u64> = HashSet::new();
        for Choice { to, blocks } in choices(atlas.submaps(), from, &received[from]) {
            let submaps = atlas.submaps_mut();
            let blocks = known_there(&submaps[from], &submaps[to], &blocks);
            if blocks.is_empty() {
                continue;
            }
            let (id, t_to_submap) = (submaps[to].id, submaps[to].t_map_submap.inv_mul(&submaps[from].t_map_submap));
            let mut keys: Vec<u64> = blocks.iter().map(|block| submaps[from].tsdf.block(*block).key).collect();
            keys.sort_unstable();
            let moved = sampled(&submaps[from].tsdf, &Placement::new(&t_to_submap, submaps[from].voxel_size), &blocks);
            received[to].extend(moved.keys());
            moved.merge_into(&mut submaps[to].tsdf, settings.weight_cap());
            submaps[to].revision += 1;
            gone.extend(&keys);
            submaps[from].handed_over.push(HandedOver { to: id, t_to_submap, keys: keys.into() });
        }
        if !gone.is_empty() {
            let submap = &mut atlas.submaps_mut()[from];
            let left: Vec<u32> = submap.tsdf.ids().filter(|id| !gone.contains(&submap.tsdf.block(*id).key)).collect();
            submap.tsdf = submap.tsdf.excerpt(&left);
            submap.revision += 1;
            count += gone.len();
        }
    }
    // Arrays that became longer left gaps.
    for (submap, _) in atlas.submaps_mut().iter_mut().zip(&received).filter(|(_, keys)| !keys.is_empty()) {
        submap.tsdf = submap.tsdf.excerpt(&submap.tsdf.ids().collect::<Vec<_>>());
    }
    count
}
