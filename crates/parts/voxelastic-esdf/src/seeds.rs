//! What distances are measured to.

use crate::transform::SeedBits;
use voxelastic::field::occupancy::{BlockBits, OccupancyField};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, NONE, block_key, voxel_coords};

/// A TSDF voxel is a part of the surface if its centre is nearer to it than this, voxels: half a voxel's diagonal.
const ON_SURFACE: f32 = 0.87;

/// The voxels that distances are measured to, and where they are stored.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Seeds<'a> {
    /// Occupied voxels.
    Occupied(&'a OccupancyField),
    /// Voxels that are not free.
    NotFree(&'a OccupancyField),
    /// Voxels next to a surface, of a map without occupancy.
    Surface(&'a TsdfField),
}

impl SeedBits for Seeds<'_> {
    fn of_block(&self, block: [i32; 3]) -> BlockBits {
        if block.iter().any(|c| c.abs() > MAX_BLOCK_COORD) {
            return match self {
                Self::NotFree(_) => [u64::MAX; 8],
                _ => [0; 8],
            };
        }
        let key = block_key(block);
        match self {
            Self::Occupied(field) => field.block_states(key).occupied,
            Self::NotFree(field) => field.block_states(key).free.map(|bits| !bits),
            Self::Surface(field) => surface_bits(field, key),
        }
    }

    fn are_none(&self, blocks: [i32; 3]) -> bool {
        if blocks.iter().any(|c| c.abs() >= MAX_BLOCK_COORD) {
            return false;
        }
        // An octant of level one, or a larger one that is uniform.
        let octant = |field: &OccupancyField| field.tree().find_at_least(block_key(blocks), 1).map(|(_, octant)| octant.payload);
        match self {
            Self::Occupied(field) => octant(field).is_none_or(|summary| summary.max <= 0),
            Self::NotFree(field) => octant(field).is_some_and(|summary| summary.observed && summary.max < 0),
            Self::Surface(_) => false,
        }
    }
}

impl Seeds<'_> {
    /// Whether all voxels of a block are seeds, which is quick to tell for large cubes.
    pub fn are_all(&self, block: [i32; 3]) -> bool {
        match self {
            Self::NotFree(field) => {
                let is_free = |field: &OccupancyField| match field.tree().find(block_key(block)) {
                    Some((_, octant)) => octant.link != NONE || octant.payload.max < 0 && octant.payload.observed,
                    None => false,
                };
                block.iter().any(|c| c.abs() > MAX_BLOCK_COORD) || !is_free(field)
            }
            _ => false,
        }
    }

    /// Calls `visit` with the key and level of every octant in which seeds begin or end.
    pub fn for_each_octant(&self, mut visit: impl FnMut(u64, u32)) {
        match self {
            Self::Occupied(field) => field.tree().for_each(|key, level, octant| {
                if octant.payload.max > 0 && (octant.link == NONE || level == 0) {
                    visit(key, level);
                }
            }),
            Self::NotFree(field) => field.tree().for_each(|key, level, octant| {
                if octant.payload.max != i8::MIN && (octant.link == NONE || level == 0) {
                    visit(key, level);
                }
            }),
            Self::Surface(field) => field.tree().for_each(|key, level, octant| {
                if level == 0 && octant.link != NONE {
                    visit(key, level);
                }
            }),
        }
    }
}

fn surface_bits(field: &TsdfField, key: u64) -> BlockBits {
    let Some(id) = field.find(key) else { return [0; 8] };
    let block = field.block(id);
    let scale = usize::from(block.scale);
    let edge = BLOCK_EDGE >> scale;
    let mut seeds: BlockBits = [0; 8];
    for i in 0..edge.pow(3) {
        let voxel = field.voxel(block, i);
        if voxel.is_observed() && voxel.distance_in_voxels().abs() < ON_SURFACE {
            let [x, y, z] = voxel_coords(i, scale).map(|c| c << scale);
            let row = (u64::MAX >> (64 - (1u32 << scale))) << x;
            let plane = (y..y + (1 << scale)).fold(0, |plane, y| plane | row << (8 * y));
            seeds[z..z + (1 << scale)].iter_mut().for_each(|word| *word |= plane);
        }
    }
    seeds
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    #[test]
    fn where_there_are_none_no_block_has_any() {
        let settings = Settings { voxel_size: 0.06, max_range: 12.0, field: FieldKind::Occupancy, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let room = Simulation::new(SimOptions { scans: Some(2), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        room.scans(PoseSource::Truth).for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).unwrap().is_some()));
        let field = mapper.atlas().submaps()[0].occupancy();
        for seeds in [Seeds::Occupied(field), Seeds::NotFree(field)] {
            let (mut none, mut some) = (0, 0);
            for i in 0..20i32.pow(3) {
                let low = [i % 20, i / 20 % 20, i / 400].map(|c| 2 * c - 20);
                let any = (0..8).any(|j| seeds.of_block(std::array::from_fn(|k| low[k] + (j >> k & 1))) != [0; 8]);
                assert!(!(any && seeds.are_none(low)), "{seeds:?} at {low:?}");
                none += usize::from(seeds.are_none(low));
                some += usize::from(any);
            }
            assert!(none > 5 && some > 50, "{none} without, {some} with");
        }
    }
}
