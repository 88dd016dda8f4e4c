//! The frontier of a submap: where free space meets unknown space, by blocks, recomputed only where voxels changed their state.

mod affected;

use hashbrown::{HashMap, HashSet};
use nalgebra::Point3;
use std::collections::BTreeMap;
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::field::occupancy::{BlockBits, BlockStates, OccupancyField};
use voxelastic::octree::{BLOCK_EDGE, NONE, block_coords, block_key};
use voxelastic_plan::Point;

/// The frontier in one block: the faces of its free voxels towards unknown ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BlockFrontier {
    /// Mean of the faces' centres, finest voxels of the submap.
    pub position: [f32; 3],
    /// Sum of the faces' normals, from free towards unknown space, voxel faces.
    pub normal: [f32; 3],
    /// Number of faces.
    pub faces: u32,
    /// Centre of an unknown voxel at one of the faces, finest voxels of the submap: what another submap may know.
    pub probe: [f32; 3],
    /// What other submaps know of it.
    pub known: Known,
}

/// Whether another submap knows a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Known {
    /// Nobody was asked yet.
    Unasked,
    /// No other submap knows it.
    Nowhere,
    /// This one knows it.
    In(SubmapId),
}

impl Known {
    /// None if nobody was asked yet.
    pub fn is_known(self) -> Option<bool> {
        match self {
            Self::Unasked => None,
            Self::Nowhere => Some(false),
            Self::In(_) => Some(true),
        }
    }
}

/// Where voxels of a field changed their state between two updates.
#[derive(Clone, Debug)]
pub(crate) struct Changes {
    /// In these octants: by level, the keys of their first blocks without the bits below that level.
    levels: Vec<(u32, HashSet<u64>)>,
    /// Whether they may have changed elsewhere, too: then the octants are all that hold free space.
    is_anywhere: bool,
}

impl Changes {
    fn of(octants: &[(u64, u32)], is_anywhere: bool) -> Self {
        let mut levels: Vec<(u32, HashSet<u64>)> = Vec::new();
        for &(key, level) in octants {
            match levels.iter_mut().find(|(other, _)| *other == level) {
                Some((_, keys)) => {
                    keys.insert(key >> (3 * level));
                }
                None => levels.push((level, HashSet::from([key >> (3 * level)]))),
            }
        }
        Self { levels, is_anywhere }
    }

    pub fn is_empty(&self) -> bool {
        self.levels.is_empty() && !self.is_anywhere
    }

    /// Whether voxels of a block may have changed.
    pub fn has(&self, block: [i32; 3]) -> bool {
        let key = block_key(block);
        self.is_anywhere || self.levels.iter().any(|(level, keys)| keys.contains(&(key >> (3 * level))))
    }

    /// Corners of the box around the octants in the submap's frame, metres, for blocks of `edge` metres; without limits if they may have changed elsewhere, too.
    pub fn bounds(&self, edge: f64) -> [[f64; 3]; 2] {
        if self.is_anywhere {
            return [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]];
        }
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for (level, key) in self.levels.iter().flat_map(|(level, keys)| keys.iter().map(move |key| (*level, *key))) {
            let low = block_coords(key << (3 * level)).map(|c| f64::from(c) * edge);
            for k in 0..3 {
                bounds[0][k] = bounds[0][k].min(low[k]);
                bounds[1][k] = bounds[1][k].max(low[k] + edge * f64::from(1u32 << level));
            }
        }
        bounds
    }

    /// Balls around the octants: centres in the submap's frame and radii, metres, for blocks of `edge` metres.
    pub fn balls(&self, edge: f64) -> impl Iterator<Item = ([f64; 3], f64)> + '_ {
        let ball = move |level: u32, key: u64| {
            let octant = edge * f64::from(1u32 << level);
            (block_coords(key << (3 * level)).map(|c| f64::from(c) * edge + 0.5 * octant), 0.5 * 3f64.sqrt() * octant)
        };
        self.levels.iter().flat_map(move |(level, keys)| keys.iter().map(move |key| ball(*level, *key)))
    }
}

/// The part of a submap of which the frontier is kept: what is, or may come with a correction, in the box to explore.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    t_map_submap: Pose,
    bounds: [Point; 2],
    block: f64,
    /// Half of a block's extents along the axes of the map, metres.
    half: [f64; 3],
}

impl Part {
    /// What is in the box with the corners `bounds` (map frame, metres) of a submap at a pose, in blocks of `block` metres.
    pub fn new(t_map_submap: Pose, bounds: [Point; 2], block: f64) -> Self {
        let rotation = t_map_submap.rotation.to_rotation_matrix();
        let half = std::array::from_fn(|k| 0.5 * block * (0..3).map(|j| rotation[(k, j)].abs()).sum::<f64>());
        Self { t_map_submap, bounds, block, half }
    }

    /// Whether an octant, given by its first block and its level, is in the part, or not farther from it than so many blocks.
    fn has(&self, key: u64, level: u32, blocks: f64) -> bool {
        let edge = f64::from(1u32 << level);
        let centre = self.t_map_submap * Point3::from(block_coords(key).map(|c| (f64::from(c) + 0.5 * edge) * self.block));
        let reach = self.half.map(|half| (edge + 2.0 * blocks) * half);
        (0..3).all(|k| centre[k] >= self.bounds[0][k] - reach[k] && centre[k] <= self.bounds[1][k] + reach[k])
    }
}

/// The frontier of one submap.
#[derive(Clone, Debug, Default)]
pub(crate) struct SubmapFrontier {
    revision: Option<u64>,
    /// In Morton order.
    pub blocks: BTreeMap<u64, BlockFrontier>,
}

impl SubmapFrontier {
    /// Makes the frontier anew in another part.
    pub fn remake(&mut self, field: &OccupancyField, part: &Part) {
        self.revision = None;
        self.update(field, part);
    }

    /// Brings the frontier in a part up to date with a field; returns how many blocks were looked at, and where the field changed since the last time, in the part or not.
    pub fn update(&mut self, field: &OccupancyField, part: &Part) -> (usize, Changes) {
        let flips = self.revision.replace(field.revision()).and_then(|revision| field.changes_since(revision));
        let (mut octants, is_logged): (Vec<(u64, u32)>, bool) = (Vec::new(), flips.is_some());
        match flips {
            Some(flips) => octants.extend(flips.map(|flip| (flip.key, u32::from(flip.level)))),
            None => {
                self.blocks.clear();
                field.tree().for_each(|key, level, octant| {
                    // Frontier belongs to free space.
                    if (octant.link == NONE || level == 0) && octant.payload.max != i8::MIN {
                        octants.push((key, level));
                    }
                });
            }
        }
        octants.sort_unstable();
        octants.dedup();
        let mut states = States::new(field);
        let mut changed: Vec<u64> = Vec::with_capacity(4 * octants.len());
        for &(key, level) in octants.iter().filter(|(key, level)| part.has(*key, *level, 1.0)) {
            if level == 0 {
                self.add_block(&mut states, key, &mut changed);
            } else {
                self.add_octant(field, key, level, &mut changed);
            }
        }
        // In Morton order, so that what is looked up one after the other is near each other in memory.
        changed.sort_unstable();
        changed.dedup();
        changed.retain(|key| part.has(*key, 0, 0.0));
        for key in &changed {
            match block_frontier(&mut states, *key) {
                Some(frontier) => drop(self.blocks.insert(*key, frontier)),
                None => drop(self.blocks.remove(key)),
            }
        }
        (changed.len(), Changes::of(&octants, !is_logged))
    }
}

/// The states of blocks that were looked up.
struct States<'a> {
    field: &'a OccupancyField,
    /// Where those of each block are: a table of the states themselves would be mostly empty memory.
    index: HashMap<u64, u32>,
    states: Vec<BlockStates>,
}

impl<'a> States<'a> {
    fn new(field: &'a OccupancyField) -> Self {
        Self { field, index: HashMap::new(), states: Vec::new() }
    }

    fn of(&mut self, key: u64) -> &BlockStates {
        let next = self.states.len() as u32;
        let index = *self.index.entry(key).or_insert(next);
        if index == next {
            self.states.push(self.field.block_states(key));
        }
        &self.states[index as usize]
    }
}

/// Whether any of a block's voxels in question is at its face towards `side` along `axis`.
fn at_face(bits: &BlockBits, axis: usize, side: i32) -> bool {
    const LOWEST: u64 = 0x0101_0101_0101_0101;
    let all = || bits.iter().fold(0, |all, word| all | word);
    match (axis, side) {
        (0, 1) => all() & LOWEST << 7 != 0,
        (0, _) => all() & LOWEST != 0,
        (1, 1) => all() >> 56 != 0,
        (1, _) => all() & 0xff != 0,
        (_, 1) => bits[7] != 0,
        _ => bits[0] != 0,
    }
}

/// The frontier in a block; none if there is none.
fn block_frontier(states: &mut States<'_>, key: u64) -> Option<BlockFrontier> {
    let own = *states.of(key);
    if own.free == [0; 8] {
        return None;
    }
    let (free, own) = (own.free, own.unknown());
    let block = block_coords(key);
    let (mut faces, mut sum, mut normal, mut probe) = (0u32, [0u32; 3], [0i32; 3], None);
    for axis in 0..3 {
        for side in [-1i32, 1] {
            let next = if at_face(&free, axis, side) {
                let mut neighbour = block;
                neighbour[axis] += side;
                states.of(block_key(neighbour)).unknown()
            } else if own == [0; 8] {
                continue;
            } else {
                [0; 8]
            };
            let found: BlockBits = {
                let unknown = shifted(&own, &next, axis, side);
                std::array::from_fn(|z| free[z] & unknown[z])
            };
            for (z, &word) in found.iter().enumerate().filter(|(_, word)| **word != 0) {
                let mut bits = word;
                while bits != 0 {
                    let bit = bits.trailing_zeros();
                    bits &= bits - 1;
                    let c = [bit & 7, bit >> 3, z as u32];
                    // Twice the coordinates of the face's centre.
                    (0..3).for_each(|k| sum[k] += 2 * c[k] + 1);
                    sum[axis] = sum[axis].wrapping_add_signed(side);
                    faces += 1;
                    normal[axis] += side;
                    probe.get_or_insert_with(|| {
                        let mut c = c.map(|v| v as f32 + 0.5);
                        c[axis] += side as f32;
                        c
                    });
                }
            }
        }
    }
    let corner = block.map(|c| (c * BLOCK_EDGE as i32) as f32);
    let absolute = |local: [f32; 3]| std::array::from_fn(|k| corner[k] + local[k]);
    probe.map(|probe| BlockFrontier {
        position: absolute(sum.map(|c| c as f32 / (2 * faces) as f32)),
        normal: normal.map(|c| c as f32),
        faces,
        probe: absolute(probe),
        known: Known::Unasked,
    })
}

/// For each voxel of a block the bit of its neighbour along an axis, which may be in the `next` block.
fn shifted(own: &BlockBits, next: &BlockBits, axis: usize, side: i32) -> BlockBits {
    const LOWEST: u64 = 0x0101_0101_0101_0101;
    const HIGHEST: u64 = LOWEST << 7;
    std::array::from_fn(|z| match (axis, side) {
        (0, 1) => own[z] >> 1 & !HIGHEST | next[z] << 7 & HIGHEST,
        (0, _) => own[z] << 1 & !LOWEST | next[z] >> 7 & LOWEST,
        (1, 1) => own[z] >> 8 | next[z] << 56,
        (1, _) => own[z] << 8 | next[z] >> 56,
        (_, 1) => own.get(z + 1).copied().unwrap_or(next[0]),
        _ => z.checked_sub(1).map_or(next[7], |z| own[z]),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;
    use voxelastic::field::occupancy::State;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    fn everywhere() -> Part {
        Part::new(Pose::identity(), [[-1e3; 3], [1e3; 3]], 1.6)
    }

    /// Faces between free and unknown voxels, voxel by voxel, with their sums of positions and normals.
    fn slow(field: &OccupancyField, block: [i32; 3]) -> (u32, [f64; 3], [i32; 3]) {
        let (mut faces, mut sum, mut normal) = (0, [0.0; 3], [0; 3]);
        for i in 0..512i32 {
            let c: [i32; 3] = std::array::from_fn(|k| 8 * block[k] + (i >> (3 * k) & 7));
            if field.state_at(c) != State::Free {
                continue;
            }
            for axis in 0..3 {
                for side in [-1, 1] {
                    let mut other = c;
                    other[axis] += side;
                    if field.state_at(other) == State::Unknown {
                        faces += 1;
                        (0..3).for_each(|k| sum[k] += f64::from(c[k]) + 0.5);
                        sum[axis] += 0.5 * f64::from(side);
                        normal[axis] += side;
                    }
                }
            }
        }
        (faces, sum, normal)
    }

    #[test]
    fn the_frontier_is_that_of_all_voxels_after_every_scan() {
        let settings =
            Settings { voxel_size: 0.2, max_range: 15.0, field: FieldKind::Occupancy, lambda_odom: 1e4, min_overlap: 1.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let simulated = |world: &str, scans| Simulation::new(SimOptions { scans: Some(scans), columns: Some(256), ..SimOptions::of(world) }).unwrap();
        let (mut frontier, mut node, mut looked, mut whole) = (SubmapFrontier::default(), 0, 0, 0);
        for (world, scans) in [("room", 2), ("plane", 6), ("room", 2)] {
            for scan in simulated(world, scans).scans(PoseSource::Truth) {
                mapper.handle(Event::Scan(voxelastic::event::Scan { node, ..scan })).unwrap();
                node += 1;
                let field = mapper.atlas().submaps()[0].occupancy();
                looked += frontier.update(field, &everywhere()).0;
                let query = mapper.atlas().submaps()[0].query();
                assert_eq!(query.bounds(), query.bounds_in(&Pose::identity()), "kept since the scan before");
                let (again, changes) = frontier.update(field, &everywhere());
                assert!(again == 0 && changes.is_empty());
                let mut anew = SubmapFrontier::default();
                whole += anew.update(field, &everywhere()).0;
                let sorted = |frontier: &SubmapFrontier| {
                    frontier.blocks.iter().map(|(k, b)| (*k, (b.faces, b.position, b.normal))).collect::<BTreeMap<_, _>>()
                };
                assert!(sorted(&frontier) == sorted(&anew), "scan {node}");
            }
        }
        assert!(looked < whole, "{looked} blocks instead of {whole}");
        let field = mapper.atlas().submaps()[0].occupancy();
        let (mut with, mut total) = (0, 0);
        let reach = 11;
        for i in 0..(2 * reach + 1i32).pow(3) {
            let n = 2 * reach + 1;
            let block = [i % n - reach, i / n % n - reach, i / n / n - reach];
            let (faces, sum, normal) = slow(field, block);
            let found = frontier.blocks.get(&block_key(block));
            assert_eq!(found.map_or(0, |found| found.faces), faces, "{block:?}");
            total += faces;
            let Some(found) = found else { continue };
            with += 1;
            assert_eq!(found.normal.map(|c| c as i32), normal);
            assert!((0..3).all(|k| (f64::from(found.position[k]) - sum[k] / f64::from(faces)).abs() < 1e-3), "{found:?}");
            assert_eq!(field.state_at(found.probe.map(|c| c.floor() as i32)), State::Unknown);
        }
        assert!(with > 300 && total > 10_000, "{with} blocks, {total} faces");
    }
}
