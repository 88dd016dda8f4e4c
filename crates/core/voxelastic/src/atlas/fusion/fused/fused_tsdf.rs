//! The TSDFs of all submaps as one field in the map frame (paper Sec. V-A): what a surface is extracted from.
//!
//! The blocks that any submap reaches are gone through in Morton order, some at a time: every submap is sampled there, and the samples are
//! combined. A voxel's value depends on its own place in the map frame, and on how the submaps are bent onto each other.

use super::combine::{Agreement, BlockAgreement, combine};
use crate::atlas::fusion::alignment::{Alignment, Corrections, Displacement, PairAgreement};
use crate::atlas::fusion::colour::ColourPatch;
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::samples::sampled_block::{EncodedBlock, SampledBlock};
use crate::atlas::fusion::samples::tsdf_sampling::{TargetBlock, TsdfSampling, displaced_target_blocks};
use crate::atlas::{Atlas, Submap, SubmapId};
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{ObservationCount, TsdfField, Voxel};
use crate::geometry::Pose;
use crate::octree::{Cursor, SCALES, block_coords, voxels_at};
use hashbrown::HashMap;
use rayon::prelude::*;
use std::sync::Arc;

/// Blocks per part: few enough for little memory and an even load of threads, many enough that most neighbours are decompressed once.
const BLOCKS_PER_PART: usize = 1024;
/// Parts that are made at a time, while those before are put into the field.
const PARTS_AT_ONCE: usize = 8;

/// One TSDF of the whole map.
#[derive(Debug, Default)]
pub struct FusedTsdf {
    /// The field in the map frame, with the atlas' voxel size.
    pub field: TsdfField,
    /// The same by pairs of submaps that have surfaces in the same places, before they are bent onto each other.
    pub pairs: Vec<PairAgreement>,
    /// How well the submaps agree, by block.
    agreement: HashMap<u64, BlockAgreement>,
}

/// A TSDF in the lattice of the map frame.
pub(crate) struct Source<'a> {
    pub id: (SubmapId, bool),
    pub submap: &'a Submap,
    pub field: &'a TsdfField,
    pub pose: Pose,
    pub revision: u64,
    pub(in crate::atlas::fusion) placement: Placement,
}

/// A TSDF and the blocks of the map that it reaches.
pub(crate) struct Reached<'a> {
    pub field: &'a TsdfField,
    pub(in crate::atlas::fusion) placement: Placement,
    pub(in crate::atlas::fusion) displacement: &'a Displacement,
    pub blocks: Arc<[TargetBlock]>,
}

impl<'a> Reached<'a> {
    fn sampling(&self) -> TsdfSampling<'a> {
        TsdfSampling::displaced(self.field, &self.placement, self.displacement.clone(), Arc::clone(&self.blocks))
    }
}

impl FusedTsdf {
    /// Fuses the TSDFs of all submaps, and of a submap that is being merged into another one, at their current root poses.
    ///
    /// Submaps whose poses are not finite, and blocks farther from the map's origin than a key can hold, are left out. The result does not
    /// depend on the number of threads.
    pub fn new(atlas: &Atlas) -> Self {
        Self::of(atlas, None)
    }

    /// The same, of the blocks from `low` to `high` alone, by their coordinates. They are what they are in the whole field.
    pub fn within(atlas: &Atlas, low: [i32; 3], high: [i32; 3]) -> Self {
        Self::of(atlas, Some([low, high]))
    }

    fn of(atlas: &Atlas, within: Option<[[i32; 3]; 2]>) -> Self {
        let sources = sources(atlas);
        let (displacements, pairs) = align(&sources);
        let reached: Vec<Reached<'_>> =
            sources.iter().zip(&displacements).map(|(source, displacement)| source.reached(displacement, within)).collect();
        let mut keys: Vec<u64> = reached.iter().flat_map(|source| source.blocks.iter().map(TargetBlock::key)).collect();
        keys.par_sort_unstable();
        keys.dedup();
        let mut one = Self { pairs, ..Self::default() };
        one.sample(&reached, &keys, BLOCKS_PER_PART);
        one
    }

    /// How well the submaps agree where they overlap.
    pub fn agreement(&self) -> Agreement {
        let mut sum = Agreement::default();
        self.agreement.values().for_each(|block| block.add_to(&mut sum));
        sum
    }

    /// Samples and combines the blocks `keys`, ascending, `per_part` at a time, and replaces what was there.
    pub(crate) fn sample(&mut self, sources: &[Reached<'_>], keys: &[u64], per_part: usize) {
        let samplings: Vec<(&Reached<'_>, TsdfSampling<'_>)> = sources.iter().map(|source| (source, source.sampling())).collect();
        let mut made: Vec<Part> = Vec::new();
        let parts: Vec<&[u64]> = keys.chunks(per_part).collect();
        for parts in parts.chunks(PARTS_AT_ONCE) {
            let before = std::mem::take(&mut made);
            let make = || parts.par_iter().map(|keys| Part::new(&samplings, keys)).collect();
            made = rayon::join(make, || before.into_iter().for_each(|part| self.put(part))).0;
        }
        made.into_iter().for_each(|part| self.put(part));
    }

    /// Replaces blocks.
    fn put(&mut self, part: Part) {
        let field = &mut self.field;
        for key in part.blocks.iter().map(|block| block.key) {
            if !field.tree.covers(key) {
                field.tree.grow_to(key);
            }
        }
        let mut cursor = Cursor::new(&field.tree);
        for EncodedBlock { key, scale, observation_count, array } in &part.blocks {
            let (id, _) = field.find_or_create(&mut cursor, *key, *scale, array.has_intensity());
            field.blocks[id].observation_count = *observation_count;
            field.install(id, usize::from(*scale), array);
            if field.colours.block(id).is_some() {
                field.colours.replace(id, usize::from(*scale));
            }
        }
        part.colours.iter().for_each(|colours| colours.merge(0..usize::MAX, field));
        for key in part.empty {
            if let Some(id) = field.find(key) {
                let coarsest = SCALES - 1;
                field.install(id, coarsest, &EncodedArray::new(coarsest, &vec![Voxel::default(); voxels_at(coarsest)], None));
                field.blocks[id].observation_count = ObservationCount::default();
            }
        }
        self.agreement.extend(part.agreement);
    }
}

impl Atlas {
    /// How the TSDFs of the submaps agree, by pairs that have surfaces in the same places: where they lie apart because of drift, and where they contradict because poses are
    /// wrong. Faster than a mesh.
    pub fn pair_agreement(&self) -> Vec<PairAgreement> {
        align(&sources(self)).1
    }
}

/// The displacements that bring sources onto each other, and how they agree.
pub(crate) fn align(sources: &[Source<'_>]) -> (Vec<Displacement>, Vec<PairAgreement>) {
    let corrections = |source: &Source<'_>| Corrections::new(source.submap, &source.pose);
    let fields: Vec<_> = sources.iter().map(|source| (source.field, source.placement, corrections(source))).collect();
    let Alignment { displacements, agreement } = Alignment::new(&fields);
    let id = |number: SubmapId| sources.get(number as usize).map_or(number, |source| source.id.0);
    (displacements, agreement.into_iter().map(|pair| PairAgreement { submaps: pair.submaps.map(id), ..pair }).collect())
}

/// All TSDFs that have blocks, in the order of [`Atlas::tsdfs`].
pub(crate) fn sources(atlas: &Atlas) -> Vec<Source<'_>> {
    let merging = atlas.merging().map(|merging| (merging.submap, merging.t_map_submap, true));
    let all = atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap(), false)).chain(merging);
    let is_finite = |pose: &Pose| pose.to_matrix().iter().all(|v| v.is_finite());
    let used = all.filter(|(submap, pose, _)| !submap.tsdf.is_empty() && is_finite(pose));
    used.map(|(submap, pose, is_merging)| Source {
        id: (submap.id, is_merging),
        submap,
        field: &submap.tsdf,
        pose,
        revision: submap.revision,
        placement: Placement::new(&pose, atlas.voxel_size()),
    })
    .collect()
}

impl<'a> Source<'a> {
    /// Whether, since it had a revision and a time of its last scan, another submap was merged into it, or it was changed by other means than scans.
    pub(crate) fn was_merged_since(&self, revision: u64, clock: u32) -> bool {
        // Each scan counts in both.
        self.revision.wrapping_sub(revision) as u32 != self.field.change_log.clock.wrapping_sub(clock)
    }

    /// The blocks of the map that it reaches.
    fn reached<'b>(&self, displacement: &'b Displacement, within: Option<[[i32; 3]; 2]>) -> Reached<'b>
    where
        'a: 'b,
    {
        let all = displaced_target_blocks(self.field, &self.placement, displacement, &self.field.ids().collect::<Vec<_>>());
        let blocks = if within.is_none() { all } else { all.iter().filter(|block| is_within(block.key(), within)).copied().collect() };
        Reached { field: self.field, placement: self.placement, displacement, blocks }
    }
}

/// Whether a block is between the lowest and the highest that are asked for.
fn is_within(key: u64, within: Option<[[i32; 3]; 2]>) -> bool {
    let c = block_coords(key);
    within.is_none_or(|[low, high]| (0..3).all(|k| low[k] <= c[k] && c[k] <= high[k]))
}

/// Some blocks of the map, combined.
struct Part {
    blocks: Vec<EncodedBlock>,
    /// Blocks in which nothing is observed.
    empty: Vec<u64>,
    colours: Vec<ColourPatch>,
    agreement: Vec<(u64, BlockAgreement)>,
}

impl Part {
    /// Combines the blocks `keys`, ascending and not empty.
    fn new(sources: &[(&Reached<'_>, TsdfSampling<'_>)], keys: &[u64]) -> Self {
        let (mut samples, mut colours) = (Vec::new(), Vec::new());
        for (source, sampling) in sources {
            let blocks = sampling.sample_of(keys);
            let keys_and_scales: Vec<(u64, u8)> = blocks.iter().map(|block| (block.key, block.scale)).collect();
            colours.push(ColourPatch::sample(source.field, &source.placement, source.displacement, &keys_and_scales));
            samples.extend(blocks);
        }
        // Stable: samples of one block stay in the order of the submaps.
        samples.sort_by_key(|block: &SampledBlock| block.key);
        let mut part = Self { blocks: Vec::new(), empty: Vec::new(), colours, agreement: Vec::new() };
        let mut samples = samples.into_iter().peekable();
        for &key in keys {
            let mut same = Vec::new();
            while let Some(block) = samples.next_if(|block| block.key == key) {
                same.push(block);
            }
            let mut agreement = Agreement::default();
            match combine(same, &mut agreement) {
                Some(block) => part.blocks.push(block.encode()),
                None => part.empty.push(key),
            }
            part.agreement.push((key, agreement.of_block()));
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, Rigid};
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    const VOXEL: f32 = 0.1;
    const RADIUS: f64 = 1.5;

    /// A submap at `t_map_submap` of a sphere around `centre` (map frame), observed `times` times from its middle.
    fn sphere(id: u32, t_map_submap: Pose, centre: [f64; 3], times: usize) -> Submap {
        ball(id, t_map_submap, centre, RADIUS, times)
    }

    /// The same of a sphere with another radius.
    fn ball(id: u32, t_map_submap: Pose, centre: [f64; 3], radius: f64, times: usize) -> Submap {
        let t_submap_map = t_map_submap.inverse();
        let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let directions = (0..60_000).map(|i| {
            let z: f64 = 1.0 - 2.0 * (f64::from(i) + 0.5) / 60_000.0;
            let (r, a) = ((1.0 - z * z).sqrt(), golden * f64::from(i));
            Vector3::new(r * a.cos(), r * a.sin(), z)
        });
        let middle = Vector3::from(centre);
        let of = |v: Vector3<f64>| <[f32; 3]>::from(v.map(|c| c as f32));
        let (mut points, mut normals) = (Vec::new(), Vec::new());
        // Beams start at the origin of the lidar frame, the middle of the sphere.
        let t_submap_lidar = t_submap_map * Pose::from_parts(Translation3::from(middle), UnitQuaternion::identity());
        for d in directions {
            points.push(of(d * radius));
            normals.push(of(-d));
        }
        let returns = ReturnsView::of_points(&points, &normals, 0.01);
        let mut submap = Submap::new(id, VOXEL, t_map_submap);
        let mut integrator = TsdfIntegrator::new(TsdfSettings { voxel_size: VOXEL, ..TsdfSettings::default() });
        (0..times).for_each(|_| {
            integrator.integrate(&mut submap.tsdf, &Rigid::from(&t_submap_lidar), &returns);
        });
        submap
    }

    fn turned() -> Pose {
        Pose::new(Vector3::new(0.33, -1.21, 0.47), Vector3::new(0.2, -0.5, 1.1))
    }

    /// Two submaps of a sphere, the second with the sphere `shift` metres along x and `times` observations.
    fn two(shift: f64, times: usize) -> FusedTsdf {
        let submaps = vec![sphere(0, Pose::identity(), [0.04, 0.03, 0.02], 2), sphere(1, turned(), [0.04 + shift, 0.03, 0.02], times)];
        FusedTsdf::new(&Atlas::from_submaps(VOXEL, submaps))
    }

    /// Zero crossings of a field between neighbouring voxels along x through the middle of the sphere, from behind a surface to its front or back.
    fn crossings(field: &TsdfField) -> usize {
        let distance = |x: i32| {
            let c = [x, 0, 0];
            let id = field.find(crate::octree::block_key(c.map(|v| v >> 3)))?;
            let block = field.block(id);
            assert_eq!(block.scale, 0);
            let voxel = field.voxel(block, crate::octree::voxel_index(c.map(|v| (v & 7) as usize), 0));
            voxel.is_observed().then_some(voxel.distance)
        };
        (-40..120).filter(|&x| matches!((distance(x), distance(x + 1)), (Some(a), Some(b)) if (a < 0) != (b < 0))).count()
    }

    /// Where the first and the last zero crossing along x through the middle of the sphere lie, finest voxels.
    fn ends(field: &TsdfField) -> [f32; 2] {
        let distance = |x: i32| {
            let c = [x, 0, 0];
            let id = field.find(crate::octree::block_key(c.map(|v| v >> 3)))?;
            let voxel = field.voxel(field.block(id), crate::octree::voxel_index(c.map(|v| (v & 7) as usize), 0));
            voxel.is_observed().then_some(voxel.distance_in_voxels())
        };
        let crossing = |x: i32| match (distance(x), distance(x + 1)) {
            (Some(a), Some(b)) if (a < 0.0) != (b < 0.0) => Some(x as f32 + 0.5 + a / (a - b)),
            _ => None,
        };
        let found: Vec<f32> = (-40..120).filter_map(crossing).collect();
        [found[0], found[found.len() - 1]]
    }

    fn image(field: &TsdfField) -> Vec<(u64, Vec<Voxel>)> {
        field.ids_in_morton_order().into_iter().map(|id| (field.block(id).key, field.current(field.block(id)))).collect()
    }

    #[test]
    fn submaps_of_one_sphere_make_one_sphere() {
        for shift in [0.0, 0.02, 0.1, 0.25, 0.35] {
            let one = two(shift, 2);
            assert_eq!(crossings(&one.field), 2, "{shift} m");
            let Agreement { merged, refused, .. } = one.agreement();
            assert!(merged > 5_000 && refused == 0, "{shift} m: {:?}", one.agreement());
            // They are bent onto each other.
            let [pair] = one.pairs[..] else { panic!("{:?}", one.pairs) };
            assert!(pair.submaps == [0, 1] && pair.places > 60 && pair.matched * 10 > pair.places * 7, "{shift} m: {pair:?}");
            assert!((shift / 4.0 - 0.01..=shift + 0.02).contains(&(pair.apart * f64::from(VOXEL))), "{shift} m: {pair:?}");
            assert!(pair.left < 0.35, "{shift} m: {pair:?}");
            assert!(one.agreement().merged_apart() < 0.5, "{shift} m: {:?}", one.agreement());
            // Each moved half the way: the sphere is where the mean of both is, in all directions.
            let ends = ends(&one.field).map(|c| f64::from(c) * f64::from(VOXEL));
            for (end, expected) in ends.iter().zip([-RADIUS, RADIUS]) {
                let middle = 0.04 + 0.5 * shift;
                assert!((end - middle - expected).abs() < 0.04, "{shift} m: {ends:?}");
            }
        }
    }

    #[test]
    fn a_correction_of_scans_moves_their_surface() {
        let mut submap = sphere(0, turned(), [0.04, 0.03, 0.02], 2);
        submap.add_scan(7, &Pose::translation(0.04, 0.03, 0.02));
        let mut atlas = Atlas::from_submaps(VOXEL, vec![submap]);
        let before = ends(&FusedTsdf::new(&atlas).field);
        let corrected = turned().inv_mul(&Pose::translation(0.29, 0.03, 0.02));
        for (corrected, shift) in [(vec![corrected], 2.5), (vec![], 0.0)] {
            atlas.submap_mut(0).unwrap().corrected = corrected;
            for (now, before) in ends(&FusedTsdf::new(&atlas).field).iter().zip(before) {
                assert!((now - before - shift).abs() < 0.05, "{now} instead of {before} + {shift}");
            }
        }
    }

    #[test]
    fn far_surfaces_stay_apart_and_contradictions_are_counted() {
        let far = two(5.0, 2);
        assert_eq!((crossings(&far.field), far.agreement().merged, far.agreement().refused), (4, 0, 0));
        // One around the other: no displacement brings them together, because both lie in one cell.
        let middle = [3.2; 3];
        let submaps = vec![ball(0, Pose::identity(), middle, 1.5, 2), ball(1, turned(), middle, 1.25, 2)];
        let near = FusedTsdf::new(&Atlas::from_submaps(VOXEL, submaps));
        assert!(near.agreement().refused > 100, "{:?}", near.agreement());
        assert!((2.0..=3.0).contains(&near.agreement().refused_apart()), "{:?}", near.agreement());
    }

    #[test]
    fn the_field_does_not_depend_on_threads_or_on_frames_of_empty_submaps() {
        let with_threads = |n: usize| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| image(&two(0.05, 3).field));
        let expected = with_threads(1);
        assert!(expected.len() > 50 && with_threads(3) == expected);
        let nowhere = Pose::translation(f64::NAN, 0.0, 0.0);
        let submaps = vec![sphere(0, Pose::identity(), [0.0; 3], 1), Submap::new(1, VOXEL, turned()), sphere(2, nowhere, [0.0; 3], 1)];
        let atlas = Atlas::from_submaps(VOXEL, submaps);
        assert_eq!(atlas.tsdfs().len(), 1);
        let one = FusedTsdf::new(&atlas);
        assert_eq!((one.agreement().merged, one.agreement().refused, crossings(&one.field)), (0, 0, 2));
        let empty = FusedTsdf::new(&Atlas::new(VOXEL));
        assert!(empty.field.is_empty() && empty.agreement() == Agreement::default());
    }

    #[test]
    fn a_submap_at_the_maps_origin_is_what_it_was() {
        let submap = sphere(0, Pose::identity(), [0.04, 0.03, 0.02], 2);
        let expected = image(&submap.tsdf);
        let one = FusedTsdf::new(&Atlas::from_submaps(VOXEL, vec![submap]));
        let is_observed = |(_, voxels): &(u64, Vec<Voxel>)| voxels.iter().any(|v| v.is_observed());
        assert!(image(&one.field) == expected.into_iter().filter(is_observed).collect::<Vec<_>>());
    }
}
