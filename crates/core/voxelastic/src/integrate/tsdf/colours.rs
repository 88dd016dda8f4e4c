//! Colours of a scan into the colour layer of a TSDF: a pass of its own after that of the distances, only for scans that have colours.
//!
//! A return colours the voxel in which it lies; a mesh looks on both sides of its vertices. Neighbouring returns of a row mostly lie in the same voxel: their
//! mean is found first, by several threads, and voxels take the means one after the other, so that any number of threads gives the same colours.

use crate::field::tsdf::colour::descendants;
use crate::field::tsdf::{Block, ColourVoxel, TsdfField};
use crate::geometry::Rigid;
use crate::integrate::rays::dda::LANES;
use crate::integrate::rays::returns::ReturnsView;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, Octree, Pool, block_key, voxel_index};
use crate::simd::{Kernel, dispatch, floor_positive};
use rayon::prelude::*;

/// Returns that one task takes.
const CHUNK: usize = 4096;
/// How far ahead voxels are prefetched: few of them are in a cache.
const AHEAD: usize = 16;

/// Colours the voxels of the returns of a scan taken at `t_submap_lidar`, which must have been integrated into the field. `colours` has one sRGB entry a
/// return, [0, 0, 0] where a return has no colour. Finest voxels are `voxel` metres wide; returns beyond `max_range` metres are skipped.
pub fn colour_voxels(field: &mut TsdfField, t_submap_lidar: &Rigid, returns: &ReturnsView<'_>, colours: &[[u8; 3]], voxel: f32, max_range: f32) {
    let window = Window::new(t_submap_lidar, voxel, max_range);
    let TsdfField { tree, blocks, colours: layer, .. } = field;
    let count = returns.points.len().min(colours.len());
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(|chunk| {
        let part = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
        let mut cells = [UNSEEN; CHUNK];
        let origins = returns.origins.get(part.clone()).unwrap_or(&[]);
        dispatch(CellsOfReturns { points: &returns.points[part.clone()], origins, window: &window, cells: &mut cells });
        window.means(tree, blocks, &cells[..part.len()], &colours[part])
    });
    let seen: Vec<Vec<Observation>> = chunks.collect();
    let seen = seen.concat();
    for (i, one) in seen.iter().enumerate() {
        if let Some(later) = seen.get(i + AHEAD) {
            layer.prefetch(later.block, later.index());
        }
        let (own_scale, voxels) = layer.block_mut(one.block, usize::from(one.finest));
        one.enter(voxels, own_scale);
    }
}

/// The mean colour of consecutive returns in a voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Observation {
    block: u32,
    /// The scale of the block, and the finest that it has had.
    scale: u8,
    finest: u8,
    /// The voxel within the block, at its scale.
    voxel: [u8; 3],
    colour: ColourVoxel,
}

impl Observation {
    fn index(&self) -> usize {
        voxel_index(self.voxel.map(usize::from), usize::from(self.scale))
    }

    /// Adds the colour to those of its block, stored at `own_scale`, which is no coarser; where it is finer, because the block was once observed from nearer, only
    /// unknown colours take it.
    fn enter(&self, voxels: &mut [ColourVoxel], own_scale: usize) {
        if usize::from(self.scale) == own_scale {
            let colour = &mut voxels[self.index()];
            *colour = colour.with(self.colour);
            return;
        }
        for index in descendants(self.voxel.map(usize::from), self.scale.into(), own_scale) {
            if !voxels[index].is_known() {
                voxels[index] = self.colour;
            }
        }
    }
}

/// A finest voxel, by its coordinates in a [`Window`], [`CELL_BITS`] each; that of a return that is skipped.
type Cell = u64;
const CELL_BITS: u32 = 21;
const UNSEEN: Cell = Cell::MAX;
/// The bits of a cell that tell its block.
const OF_BLOCK: u64 = {
    let one = ((1 << CELL_BITS) - 1) >> BLOCK_SHIFT << BLOCK_SHIFT;
    one | one << CELL_BITS | one << (2 * CELL_BITS)
};

/// The cube of blocks around the sensor that holds all returns within the range: relative to its corner, no coordinate is negative.
struct Window {
    t_submap_lidar: Rigid,
    /// Finest voxels, a multiple of a block's edge.
    corner: [i32; 3],
    per_metre: f32,
    max_range: f32,
}

impl Window {
    fn new(t_submap_lidar: &Rigid, voxel: f32, max_range: f32) -> Self {
        let per_metre = 1.0 / voxel;
        // Returns farther away than a cell can tell are not in the field, either.
        let reach = (max_range * per_metre).min((1 << (CELL_BITS - 2)) as f32);
        let edge = BLOCK_EDGE as i32;
        let corner = t_submap_lidar.translation.map(|c| ((c * per_metre - reach).floor() as i32).div_euclid(edge) * edge - edge);
        Self { t_submap_lidar: *t_submap_lidar, corner, per_metre, max_range: reach * voxel }
    }

    /// The coordinates of a cell, finest voxels.
    fn coords(&self, cell: Cell) -> [i32; 3] {
        std::array::from_fn(|k| self.corner[k] + ((cell >> (k as u32 * CELL_BITS)) as i32 & ((1 << CELL_BITS) - 1)))
    }

    /// The mean colours of runs of consecutive returns in one voxel of the blocks' own scales.
    fn means(&self, tree: &Octree<()>, blocks: &Pool<Block>, cells: &[Cell], colours: &[[u8; 3]]) -> Vec<Observation> {
        let mut cursor = Cursor::new(tree);
        let mut means = Vec::new();
        let mut context: (u64, Option<u32>) = (UNSEEN, None);
        let (mut last, mut run) = (UNSEEN, Run::default());
        for (&cell, &[r, g, b]) in cells.iter().zip(colours) {
            if cell != last {
                last = cell;
                if context.0 != cell & OF_BLOCK {
                    let block = if cell == UNSEEN { None } else { cursor.block(tree, block_key(self.coords(cell).map(|c| c >> BLOCK_SHIFT))) };
                    context = (cell & OF_BLOCK, block);
                }
                let place = context.1.map(|id| {
                    let Block { scale, finest, .. } = blocks[id];
                    let within = self.coords(cell).map(|c| (c & (BLOCK_EDGE as i32 - 1)) as u8 >> scale);
                    Observation { block: id, scale, finest, voxel: within, colour: ColourVoxel::default() }
                });
                if run.place != place {
                    means.extend(run.mean());
                    run = Run { place, ..Run::default() };
                }
            }
            // No branch on black, which is no colour.
            let colour = u64::from(r) | u64::from(g) << SUM_BITS | u64::from(b) << (2 * SUM_BITS);
            run.sum += colour;
            run.count += u32::from(colour != 0);
        }
        means.extend(run.mean());
        means
    }
}

/// Bits of the sum of one channel over a chunk.
const SUM_BITS: u32 = 21;
const _: () = assert!(CHUNK * 255 < 1 << SUM_BITS);

/// Consecutive returns in one voxel.
#[derive(Default)]
struct Run {
    /// The voxel, without a colour; none if there is no block.
    place: Option<Observation>,
    /// Sum of the colours, a channel in each [`SUM_BITS`].
    sum: u64,
    /// Returns that have a colour.
    count: u32,
}

impl Run {
    fn mean(&self) -> Option<Observation> {
        let sum = std::array::from_fn(|k| (self.sum >> (k as u32 * SUM_BITS)) as u32 & ((1 << SUM_BITS) - 1));
        self.place.filter(|_| self.count > 0).map(|place| Observation { colour: ColourVoxel::mean_of(sum, self.count), ..place })
    }
}

/// Finds the voxels of the returns of a chunk. Origins may be empty.
struct CellsOfReturns<'a> {
    points: &'a [[f32; 3]],
    origins: &'a [[f32; 3]],
    window: &'a Window,
    cells: &'a mut [Cell; CHUNK],
}

impl Kernel for CellsOfReturns<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { points, origins, window: Window { t_submap_lidar, corner, per_metre, max_range }, cells } = self;
        let corner = corner.map(|c| c as f32);
        for (step, cells) in cells.chunks_exact_mut(LANES).enumerate().take(points.len().div_ceil(LANES)) {
            let (mut p, mut origin) = ([[0.0f32; LANES]; 3], [[0.0f32; LANES]; 3]);
            for (lanes, from) in [(&mut p, points), (&mut origin, origins)] {
                for (l, v) in from.iter().skip(step * LANES).take(LANES).enumerate() {
                    (0..3).for_each(|k| lanes[k][l] = v[k]);
                }
            }
            for l in 0..LANES {
                let way = [0, 1, 2].map(|k| p[k][l] - origin[k][l]);
                let is_near = way[0] * way[0] + way[1] * way[1] + way[2] * way[2] <= max_range * max_range;
                let at = t_submap_lidar.apply([p[0][l], p[1][l], p[2][l]]);
                let at = [0, 1, 2].map(|k| floor_positive(at[k] * per_metre - corner[k]) as u64);
                let cell = at[0] | at[1] << CELL_BITS | at[2] << (2 * CELL_BITS);
                cells[l] = if is_near { cell } else { UNSEEN };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::integrate::tsdf::{TsdfIntegrator, TsdfSettings};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    const VOXEL: f32 = 0.1;
    const MAX_RANGE: f32 = 30.0;

    /// The colour that each voxel of a block's own scale has after the scan, by block and index: the returns one after the other.
    fn one_by_one(field: &TsdfField, pose: &Rigid, returns: &ReturnsView<'_>, colours: &[[u8; 3]], known: &mut BTreeMap<(u32, usize), ColourVoxel>) {
        let place = |i: usize| {
            let (p, origin) = (returns.points[i], returns.origins.get(i).copied().unwrap_or_default());
            let range = (0..3).map(|k| (p[k] - origin[k]).powi(2)).sum::<f32>().sqrt();
            let at = pose.apply(p).map(|c| (c / VOXEL).floor() as i32);
            let id = Cursor::new(&field.tree).block(&field.tree, block_key(at.map(|c| c.div_euclid(8))))?;
            let scale = field.blocks[id].scale;
            (range <= MAX_RANGE).then(|| (id, voxel_index(at.map(|c| c.rem_euclid(8) as usize >> scale), scale.into())))
        };
        let all: Vec<usize> = (0..returns.points.len()).collect();
        for chunk in all.chunks(CHUNK) {
            for run in chunk.chunk_by(|&a, &b| place(a) == place(b)) {
                let coloured: Vec<[u8; 3]> = run.iter().map(|&i| colours[i]).filter(|c| *c != [0; 3]).collect();
                let Some(place) = place(run[0]).filter(|_| !coloured.is_empty()) else { continue };
                let n = coloured.len();
                let rgb = std::array::from_fn(|k| ((coloured.iter().map(|c| usize::from(c[k])).sum::<usize>() + n / 2) / n) as u8);
                let voxel = known.entry(place).or_default();
                *voxel = voxel.with(ColourVoxel { rgb, observations: n.min(16) as u8 });
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(30))]
        #[test]
        fn runs_of_returns_colour_as_returns_one_by_one(
            rows in prop::collection::vec((prop::array::uniform3(-25f32..25.0), prop::array::uniform3(-0.08f32..0.08), 1usize..700), 1..16),
            translation in prop::array::uniform3(-50f32..50.0),
            seed in any::<u64>(),
            has_origins in any::<bool>(),
        ) {
            let pose = Rigid { rotation: [[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]], translation };
            let row = |(from, step, count): &([f32; 3], [f32; 3], usize)| {
                let (from, step) = (*from, *step);
                (0..*count).map(move |i| [0, 1, 2].map(|k| from[k] + i as f32 * step[k])).collect::<Vec<[f32; 3]>>()
            };
            // None that rounding might put on the other side of a voxel's face.
            let is_inside = |p: &[f32; 3]| pose.apply(*p).iter().all(|c| (0.005..0.995).contains(&(c / VOXEL).rem_euclid(1.0)));
            let points: Vec<[f32; 3]> = rows.iter().flat_map(row).filter(is_inside).collect();
            let normals = vec![[0.0; 3]; points.len()];
            let origins: Vec<[f32; 3]> = points.iter().map(|p| p.map(|c| 0.01 * c)).collect();
            let mut random = seed;
            let mut next = || {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (random >> 56) as u8
            };
            let returns = ReturnsView { origins: if has_origins { &origins } else { &[] }, ..ReturnsView::of_points(&points, &normals, 0.01) };
            let (mut field, mut known) = (TsdfField::default(), BTreeMap::new());
            let mut integrator = TsdfIntegrator::new(TsdfSettings { voxel_size: VOXEL, max_range: MAX_RANGE, ..TsdfSettings::default() });
            // All scans are alike, so that no block changes its scale.
            integrator.integrate(&mut field, &pose, &returns);
            for _ in 0..3 {
                let colours: Vec<[u8; 3]> = points.iter().map(|_| if next() < 40 { [0; 3] } else { [next(), next(), next()] }).collect();
                colour_voxels(&mut field, &pose, &returns, &colours, VOXEL, MAX_RANGE);
                one_by_one(&field, &pose, &returns, &colours, &mut known);
            }
            for id in field.ids() {
                let Some((scale, colours)) = field.colours().block(id) else { continue };
                prop_assert_eq!(scale, usize::from(field.blocks[id].scale));
                for (i, colour) in colours.iter().enumerate() {
                    prop_assert_eq!(known.remove(&(id, i)).unwrap_or_default(), *colour);
                }
            }
            prop_assert!(known.is_empty(), "{} voxels have no colour", known.len());
        }
    }
}
