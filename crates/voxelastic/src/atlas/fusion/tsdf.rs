//! TSDF fusion: the source sampled at the target's voxels, then weighted means.

use super::Placement;
use super::corners::Corners;
use super::points::{Points, between};
use super::seen::Seen;
use crate::field::tsdf::packed::PackedArray;
use crate::field::tsdf::propagate::{Guesses, propagate_down};
use crate::field::tsdf::{DISTANCE_STEPS, Told, TsdfField, Voxel};
use crate::octree::{
    BLOCK_EDGE, BLOCK_SHIFT, Cursor, MAX_BLOCK_COORD, NONE, SCALES, block_coords, block_key, edge_at, voxel_coords, voxel_index, voxels_at,
};
use crate::surface::view::settle;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// A block of the target's lattice.
#[derive(Debug)]
struct PatchBlock {
    key: u64,
    scale: u8,
    /// Beams that told the source something there.
    told: Told,
    /// Its array, until it is merged.
    array: PackedArray,
}

/// The source in the target's lattice, blocks in Morton order.
#[derive(Debug, Default)]
pub(super) struct TsdfPatch {
    blocks: Vec<PatchBlock>,
}

impl TsdfPatch {
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Keys and scales of its blocks.
    pub fn places(&self) -> Vec<(u64, u8)> {
        self.blocks.iter().map(|block| (block.key, block.scale)).collect()
    }

    /// Adds the blocks numbered `range` to `target`, and forgets them.
    pub fn merge(&mut self, range: Range<usize>, target: &mut TsdfField, max_weight: u16) {
        let blocks = &mut self.blocks[range];
        for block in blocks.iter() {
            if !target.tree.covers(block.key) {
                target.tree.grow_to(block.key);
            }
        }
        let mut cursor = Cursor::new(&target.tree);
        for block in blocks {
            let (array, scale) = (std::mem::take(&mut block.array), usize::from(block.scale));
            let (id, is_new) = target.make(&mut cursor, block.key, block.scale, array.is_shaded());
            let told = &mut target.blocks[id].told;
            *told = told.and(block.told.beams());
            if is_new {
                target.install(id, scale, &array);
            } else {
                merge_block(target, id, Addend::unpack(scale, &array), max_weight);
            }
        }
    }
}

/// Most blocks of the source along an axis that a block of the target can need: its diagonal, and a coarsest voxel on both sides.
const NEAR_EDGE: usize = 5;

/// The source's blocks around a block of the target, looked up once for all of its voxels: places among those that a part sees.
struct Near {
    low: [i32; 3],
    places: [u32; NEAR_EDGE * NEAR_EDGE * NEAR_EDGE],
}

impl Near {
    /// The block at `home` (blocks, source frame), or [`NONE`].
    #[inline(always)]
    fn place(&self, home: [i32; 3]) -> u32 {
        let [x, y, z] = std::array::from_fn(|k| (home[k] - self.low[k]) as usize);
        if x.max(y).max(z) < NEAR_EDGE { self.places[x + NEAR_EDGE * (y + NEAR_EDGE * z)] } else { NONE }
    }
}

/// A block of the target that the source reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reached {
    key: u64,
    /// The scale to sample at.
    scale: u8,
    /// Beams that told the source something there.
    told: Told,
}

/// Samples a field in the lattice of another one, part by part.
pub(super) struct TsdfSampling<'a> {
    source: &'a TsdfField,
    placement: Placement,
    reached: Vec<Reached>,
}

impl<'a> TsdfSampling<'a> {
    pub fn new(source: &'a TsdfField, placement: &Placement) -> Self {
        Self { source, placement: *placement, reached: reached(source, placement) }
    }

    /// Blocks that may hold something.
    pub fn len(&self) -> usize {
        self.reached.len()
    }

    /// Samples the blocks numbered `range`. Each part sees for itself what it needs of the source: all of it unpacked would take as much
    /// memory as the samples.
    pub fn part(&self, range: Range<usize>) -> TsdfPatch {
        let reached = &self.reached[range];
        let mut cursor = Cursor::new(self.source.tree());
        let (mut ids, mut places) = (Vec::new(), HashMap::new());
        let mut place_of = |id: u32| {
            *places.entry(id).or_insert_with(|| {
                ids.push(id);
                ids.len() as u32 - 1
            })
        };
        let near: Vec<Near> = reached.iter().map(|block| self.near(&mut cursor, block.key, &mut place_of)).collect();
        let sampler = Sampler { placement: &self.placement, seen: Seen::new(self.source, ids) };
        let mut points = Points::new();
        let blocks = reached.iter().zip(&near).filter_map(|(block, near)| sampler.block(near, block, &mut points));
        TsdfPatch { blocks: blocks.collect() }
    }

    /// The source's blocks around the target's block `key`.
    fn near(&self, cursor: &mut Cursor, key: u64, mut place_of: impl FnMut(u32) -> u32) -> Near {
        let half = 0.5 * BLOCK_EDGE as f32;
        let (middle, extent) = self.placement.box_in_source(block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half), half);
        let low = std::array::from_fn(|k| ((middle[k] - extent[k]) / BLOCK_EDGE as f32).floor() as i32 - 1);
        let places = std::array::from_fn(|i| {
            let step = [i % NEAR_EDGE, i / NEAR_EDGE % NEAR_EDGE, i / (NEAR_EDGE * NEAR_EDGE)];
            cursor.block(self.source.tree(), block_key(std::array::from_fn(|k| low[k] + step[k] as i32))).map_or(NONE, &mut place_of)
        });
        Near { low, places }
    }
}

/// Reads a field at any point and scale.
struct Sampler<'a> {
    placement: &'a Placement,
    seen: Seen<'a>,
}

/// A sample: distance in finest voxels, weight, and where the intensity comes from.
struct Sample {
    distance: f32,
    weight: f32,
    shade: Option<u8>,
}

impl Sampler<'_> {
    /// The array of a block of the target; none when nothing of it was observed. Leaves its voxels' places in `points`.
    fn block(&self, near: &Near, block: &Reached, points: &mut Points) -> Option<PatchBlock> {
        let Reached { key, scale: at, told } = *block;
        let scale = usize::from(at);
        let edge = (1 << scale) as f32;
        let t = &self.placement.t_source_target;
        points.place(t, key, scale);
        let mut voxels = vec![Voxel::default(); voxels_at(scale)];
        let mut shades: Option<Vec<u8>> = None;
        let mut is_observed = false;
        for (i, voxel) in voxels.iter_mut().enumerate() {
            let sample = match self.cell(near, points.at(i), scale) {
                Cell::Unknown => continue,
                Cell::Of(sample) => sample,
                Cell::Coarser => {
                    let (corner, c) = (block_coords(key), voxel_coords(i, scale));
                    let centre = std::array::from_fn(|k| (corner[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * edge);
                    let Some(sample) = self.coarser(near, t.apply(centre), scale) else { continue };
                    sample
                }
            };
            let steps = (sample.distance / edge * DISTANCE_STEPS).round().clamp(f32::from(i16::MIN), f32::from(i16::MAX));
            *voxel = Voxel { distance: steps as i16, weight: sample.weight.round().clamp(1.0, f32::from(u16::MAX)) as u16 };
            is_observed = true;
            if let Some(shade) = sample.shade {
                shades.get_or_insert_with(|| vec![0; voxels_at(scale)])[i] = shade;
            }
        }
        is_observed.then(|| PatchBlock { key, scale: at, told, array: PackedArray::new(scale, &voxels, shades.as_deref()) })
    }

    /// The field at `point` (finest voxels, source frame) beside a block coarser than `scale`: at the finest scale at which all samples that are
    /// interpolated are of one, finer ones as means.
    fn coarser(&self, near: &Near, point: [f32; 3], scale: usize) -> Option<Sample> {
        (scale + 1..SCALES).find_map(|scale| match self.cell(near, between(point, scale), scale) {
            Cell::Coarser => None,
            Cell::Unknown => Some(None),
            Cell::Of(sample) => Some(Some(sample)),
        })?
    }

    /// The eight voxels of `scale` around the point that is `fraction` beyond the centre of voxel `base`.
    #[inline(always)]
    fn cell(&self, near: &Near, (base, fraction): ([i32; 3], [f32; 3]), scale: usize) -> Cell {
        let (shift, mask) = (BLOCK_SHIFT as usize - scale, edge_at(scale) - 1);
        let within = base.map(|v| v as usize & mask);
        if within.iter().all(|&v| v < mask) {
            // Most cells lie in one block.
            let place = near.place(base.map(|v| v >> shift));
            if place == NONE {
                return Cell::Unknown;
            }
            if !self.seen.is_seen_at(place, scale) {
                return Cell::Coarser;
            }
            if !self.seen.is_near_any(place, scale, within) {
                return Cell::Unknown;
            }
            let index = |i: usize| voxel_index(std::array::from_fn(|k| within[k] + (i >> k & 1)), scale);
            let voxels = self.seen.voxels(place, scale);
            return self.interpolate(fraction, std::array::from_fn(|i| voxels[index(i)]), scale, |i| (place, index(i)));
        }
        let corner = |i: usize| -> [i32; 3] { std::array::from_fn(|k| base[k] + (i >> k & 1) as i32) };
        let index = |i: usize| voxel_index(corner(i).map(|v| v as usize & mask), scale);
        let places: [u32; 8] = std::array::from_fn(|i| near.place(corner(i).map(|v| v >> shift)));
        let mut voxels = [Voxel::default(); 8];
        for i in (0..8).filter(|&i| places[i] != NONE) {
            if !self.seen.is_seen_at(places[i], scale) {
                return Cell::Coarser;
            }
            voxels[i] = self.seen.voxels(places[i], scale)[index(i)];
        }
        self.interpolate(fraction, voxels, scale, |i| (places[i], index(i)))
    }

    /// What eight voxels of `scale` say of the point at `fraction` between them; `place` tells block and index of each.
    #[inline(always)]
    fn interpolate(&self, fraction: [f32; 3], voxels: [Voxel; 8], scale: usize, place: impl Fn(usize) -> (u32, usize)) -> Cell {
        let Some(corners) = Corners::around(fraction, voxels) else { return Cell::Unknown };
        let (distance, weight) = corners.interpolate();
        let (block, index) = place(corners.nearest());
        Cell::Of(Sample { distance: distance * (1 << scale) as f32, weight, shade: self.seen.shade(block, scale, index) })
    }
}

/// The target's blocks that the source reaches, in Morton order, each as the source's block in its middle
/// has it, or the coarsest of those that only touch it.
fn reached(field: &TsdfField, placement: &Placement) -> Vec<Reached> {
    let half = 0.5 * BLOCK_EDGE as f32;
    let touching = |&id: &u32| {
        let (scale, told) = (field.block(id).finest, field.block(id).told);
        let home = block_coords(field.block(id).key);
        let centre = home.map(|c| c as f32 * BLOCK_EDGE as f32 + half);
        let (middle, extent) = placement.box_in_target(centre, half);
        let low: [i32; 3] = std::array::from_fn(|k| ((middle[k] - extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let high: [i32; 3] = std::array::from_fn(|k| ((middle[k] + extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let mut found = Vec::new();
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let c = [x, y, z];
                    let (at, reach) = placement.box_in_source(c.map(|v| v as f32 * BLOCK_EDGE as f32 + half), half);
                    let apart = (0..3).any(|k| (at[k] - centre[k]).abs() > reach[k] + half);
                    if !apart && c.iter().all(|v| v.abs() < MAX_BLOCK_COORD) {
                        let is_middle = at.map(|v| (v / BLOCK_EDGE as f32).floor() as i32) == home;
                        // Sorts the block in the middle first, then the coarsest.
                        let rank = if is_middle { 0 } else { SCALES as u8 - scale };
                        found.push((rank, Reached { key: block_key(c), scale, told }));
                    }
                }
            }
        }
        found
    };
    let ids: Vec<u32> = field.ids().collect();
    let mut reached: Vec<(u8, Reached)> = ids.par_iter().with_min_len(256).flat_map_iter(touching).collect();
    // All there is to a block is compared: which one is kept must not depend on threads.
    reached.par_sort_unstable_by_key(|(rank, block)| (block.key, *rank, block.scale, block.told));
    reached.dedup_by_key(|(_, block)| block.key);
    reached.into_iter().map(|(_, block)| block).collect()
}

/// What is known at a point at one scale.
enum Cell {
    /// A block there is coarser.
    Coarser,
    /// Too little was observed.
    Unknown,
    Of(Sample),
}

/// The arrays of a block that is added to another.
struct Addend {
    scale: usize,
    voxels: Vec<Voxel>,
    shades: Option<Vec<u8>>,
}

impl Addend {
    fn unpack(scale: usize, array: &PackedArray) -> Self {
        let (voxels, shades) = array.unpack(scale);
        Self { scale, voxels, shades }
    }
}

/// Adds to block `id` of the target: brought to the finer of both scales, it takes the weighted means.
fn merge_block(target: &mut TsdfField, id: u32, addend: Addend, max_weight: u16) {
    let block = *target.block(id);
    let own_scale = usize::from(block.scale);
    let Addend { scale, voxels, shades } = addend;
    let (seen_at, settled) = settle(target, id, 0);
    let seen_at = usize::from(seen_at);
    let finest = seen_at.min(scale);
    let own = settled.map_or_else(|| target.current(&block), Vec::from);
    let own_shades = target.is_shaded(&block).then(|| resize_shades(target.shades(&block, own_scale), own_scale, finest));
    let mut sum = refine(own, seen_at, finest);
    let other = refine(voxels, scale, finest);
    let shades = merge_shades(own_shades, shades.map(|s| resize_shades(s, scale, finest)), &sum, &other);
    // An observation of a coarser voxel is shared by those that it is divided into.
    let shared_by = [seen_at, scale].map(|from| 3 * (from - finest) as u32);
    for (voxel, &other) in sum.iter_mut().zip(&other).filter(|(_, other)| other.is_observed()) {
        *voxel =
            if voxel.is_observed() { mean([*voxel, other], shared_by, max_weight) } else { Voxel { weight: other.weight.min(max_weight), ..other } };
    }
    target.install(id, finest, &PackedArray::new(finest, &sum, shades.as_deref()));
}

/// The mean of two intensities by the weights of their voxels.
fn mean_shade((a, at): (u8, Voxel), (b, bt): (u8, Voxel)) -> u8 {
    // Unknown ones weigh nothing.
    let weight = |shade: u8, at: Voxel| if shade == 0 { 0 } else { u32::from(at.weight) };
    let (wa, wb) = (weight(a, at), weight(b, bt));
    ((u32::from(a) * wa + u32::from(b) * wb) / (wa + wb).max(1)) as u8
}

/// The weighted mean of two observed voxels, whose observations count as one in 2^`shared_by`.
fn mean(voxels: [Voxel; 2], shared_by: [u32; 2], max_weight: u16) -> Voxel {
    let weights: [i64; 2] = std::array::from_fn(|i| i64::from(voxels[i].weight >> shared_by[i]).max(1));
    let total: i64 = (0..2).map(|i| i64::from(voxels[i].distance) * weights[i]).sum();
    let sum = weights[0] + weights[1];
    // Rounded to nearest: truncation would pull surfaces towards the sensor with every fusion.
    let distance = (2 * total + sum * total.signum()) / (2 * sum);
    Voxel { distance: distance as i16, weight: sum.min(i64::from(max_weight)) as u16 }
}

/// `voxels` of scale `from` at the finer scale `to`.
fn refine(mut voxels: Vec<Voxel>, from: usize, to: usize) -> Vec<Voxel> {
    for scale in (to..from).rev() {
        let mut fine = vec![Voxel::default(); voxels_at(scale)];
        propagate_down(&voxels, &mut fine, scale, &Guesses::NEAR);
        voxels = fine;
    }
    voxels
}

/// Intensities of scale `from` at scale `to`, each from the voxel that holds its place.
fn resize_shades(shades: Vec<u8>, from: usize, to: usize) -> Vec<u8> {
    if from == to {
        return shades;
    }
    let place = |v: usize| if from >= to { v >> (from - to) } else { v << (to - from) };
    (0..voxels_at(to)).map(|i| shades[voxel_index(voxel_coords(i, to).map(place), from)]).collect()
}

/// Means of intensities by the weights of their voxels.
fn merge_shades(own: Option<Vec<u8>>, other: Option<Vec<u8>>, weights: &[Voxel], others: &[Voxel]) -> Option<Vec<u8>> {
    match (own, other) {
        (Some(a), Some(b)) => Some((0..a.len()).map(|i| mean_shade((a[i], weights[i]), (b[i], others[i]))).collect()),
        (one, None) | (None, one) => one,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::tsdf::WEIGHT_ONE;

    #[test]
    fn what_was_seen_coarsely_counts_less_where_it_was_seen_finely() {
        let [fine, coarse] = [0, 900].map(|distance| Voxel { distance, weight: 8 * WEIGHT_ONE });
        assert_eq!(mean([fine, coarse], [0, 0], u16::MAX), Voxel { distance: 450, weight: 16 * WEIGHT_ONE });
        assert_eq!(mean([fine, coarse], [0, 3], u16::MAX), Voxel { distance: 100, weight: 9 * WEIGHT_ONE });
        assert_eq!(mean([coarse, fine], [6, 0], u16::MAX), Voxel { distance: 14, weight: 8 * WEIGHT_ONE + 2 });
    }
}
