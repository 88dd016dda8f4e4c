//! The TSDFs of all submaps as one field in the map frame (paper Sec. V-A): what a surface is extracted from.
//!
//! The blocks that any submap reaches are gone through in Morton order, some at a time: every submap is sampled there, and the samples are
//! combined. A voxel's value depends on its own place in the map frame alone.

use super::colour::ColourPatch;
use super::combine::{Agreement, combine};
use super::placement::Placement;
use super::sampled_block::SampledBlock;
use super::tsdf::{PatchBlock, TsdfPatch};
use super::tsdf_sampling::{TargetBlock, TsdfSampling, target_blocks};
use crate::atlas::Atlas;
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use rayon::prelude::*;
use std::sync::Arc;

/// Blocks per part: few enough for little memory and an even load of threads, many enough that most neighbours are decompressed once.
const BLOCKS_PER_PART: usize = 1024;
/// Parts that are made at a time, while those before are put into the field.
const PARTS_AT_ONCE: usize = 8;

/// One TSDF of the whole map.
#[derive(Debug, Default)]
pub struct OneField {
    /// The field in the map frame, with the atlas' voxel size.
    pub field: TsdfField,
    /// How well the submaps agree where they overlap.
    pub agreement: Agreement,
}

/// A submap in the lattice of the map frame.
struct Source<'a> {
    field: &'a TsdfField,
    placement: Placement,
    blocks: Arc<[TargetBlock]>,
    sampling: TsdfSampling<'a>,
}

impl OneField {
    /// Fuses the TSDFs of all submaps, and of a submap that is being merged into another one, at their current root poses.
    ///
    /// Submaps whose poses are not finite, and blocks farther from the map's origin than a key can hold, are left out. The result does not
    /// depend on the number of threads.
    pub fn new(atlas: &Atlas) -> Self {
        let sources: Vec<Source<'_>> = atlas.tsdfs().into_iter().map(|(field, pose)| Source::new(field, &pose, atlas.voxel_size())).collect();
        let mut keys: Vec<u64> = sources.iter().flat_map(|source| source.blocks.iter().map(TargetBlock::key)).collect();
        keys.par_sort_unstable();
        keys.dedup();
        let mut one = Self::default();
        let parts: Vec<&[u64]> = keys.chunks(BLOCKS_PER_PART).collect();
        let mut made: Vec<Part> = Vec::new();
        for parts in parts.chunks(PARTS_AT_ONCE) {
            let before = std::mem::take(&mut made);
            let make = || parts.par_iter().map(|keys| Part::new(&sources, keys)).collect();
            made = rayon::join(make, || before.into_iter().for_each(|part| one.add(part))).0;
        }
        made.into_iter().for_each(|part| one.add(part));
        one
    }

    fn add(&mut self, part: Part) {
        let Part { mut blocks, colours, agreement } = part;
        blocks.merge(0..blocks.len(), &mut self.field, u16::MAX);
        colours.iter().for_each(|colours| colours.merge(0..usize::MAX, &mut self.field));
        self.agreement.add(&agreement);
    }
}

impl<'a> Source<'a> {
    fn new(field: &'a TsdfField, t_map_submap: &Pose, voxel_size: f32) -> Self {
        let placement = Placement::new(t_map_submap, voxel_size);
        let blocks = target_blocks(field, &placement);
        Self { field, placement, sampling: TsdfSampling::new(field, &placement, Arc::clone(&blocks)), blocks }
    }
}

/// Some blocks of the map, combined.
struct Part {
    blocks: TsdfPatch,
    colours: Vec<ColourPatch>,
    agreement: Agreement,
}

impl Part {
    /// Combines the blocks `keys`, ascending and not empty.
    fn new(sources: &[Source<'_>], keys: &[u64]) -> Self {
        let (mut samples, mut colours) = (Vec::new(), Vec::new());
        for source in sources {
            let start = source.blocks.partition_point(|block| block.key() < keys[0]);
            let end = source.blocks.partition_point(|block| block.key() <= keys[keys.len() - 1]);
            let blocks = source.sampling.sample(start..end);
            let keys_and_scales: Vec<(u64, u8)> = blocks.iter().map(|block| (block.key, block.scale)).collect();
            colours.push(ColourPatch::sample(source.field, &source.placement, &keys_and_scales));
            samples.extend(blocks);
        }
        // Stable: samples of one block stay in the order of the submaps.
        samples.sort_by_key(|block: &SampledBlock| block.key);
        let (mut blocks, mut agreement, mut same): (Vec<PatchBlock>, _, _) = (Vec::new(), Agreement::default(), Vec::new());
        for block in samples {
            if same.last().is_some_and(|last: &SampledBlock| last.key != block.key) {
                blocks.extend(combine(std::mem::take(&mut same), &mut agreement).map(|block| block.encode()));
            }
            same.push(block);
        }
        blocks.extend(combine(same, &mut agreement).map(|block| block.encode()));
        Self { blocks: TsdfPatch::of(blocks), colours, agreement }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::Submap;
    use crate::geometry::Rigid;
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    const VOXEL: f32 = 0.1;
    const RADIUS: f64 = 1.5;

    /// A submap at `t_map_submap` of a sphere around `centre` (map frame), observed `times` times from its middle.
    fn sphere(id: u32, t_map_submap: Pose, centre: [f64; 3], times: usize) -> Submap {
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
            points.push(of(d * RADIUS));
            normals.push(of(-d));
        }
        let returns = ReturnsView { points: &points, normals: &normals, intensities: &[], origins: &[], smallest_angle: 0.01 };
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
    fn two(shift: f64, times: usize) -> OneField {
        let submaps = vec![sphere(0, Pose::identity(), [0.04, 0.03, 0.02], 2), sphere(1, turned(), [0.04 + shift, 0.03, 0.02], times)];
        OneField::new(&Atlas::from_submaps(VOXEL, submaps))
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

    fn image(field: &TsdfField) -> Vec<(u64, Vec<crate::field::tsdf::Voxel>)> {
        field.ids_in_morton_order().into_iter().map(|id| (field.block(id).key, field.current(field.block(id)))).collect()
    }

    #[test]
    fn submaps_of_one_sphere_make_one_sphere() {
        for shift in [0.0, 0.02, 0.1] {
            let one = two(shift, 2);
            assert_eq!(crossings(&one.field), 2, "{shift} m");
            let Agreement { merged, refused, .. } = one.agreement;
            assert!(merged > 5_000 && refused == 0, "{shift} m: {:?}", one.agreement);
            let apart = one.agreement.merged_apart() * f64::from(VOXEL);
            assert!((shift / 4.0 - 0.01..=shift + 0.02).contains(&apart), "{shift} m: {apart}");
        }
    }

    #[test]
    fn far_surfaces_stay_apart_and_contradictions_are_counted() {
        let far = two(5.0, 2);
        assert_eq!((crossings(&far.field), far.agreement.merged, far.agreement.refused), (4, 0, 0));
        let near = two(0.25, 2);
        assert!(near.agreement.refused > 100, "{:?}", near.agreement);
        assert!((2.0..=3.0).contains(&near.agreement.refused_apart()), "{:?}", near.agreement);
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
        let one = OneField::new(&atlas);
        assert_eq!((one.agreement.merged, one.agreement.refused, crossings(&one.field)), (0, 0, 2));
        let empty = OneField::new(&Atlas::new(VOXEL));
        assert!(empty.field.is_empty() && empty.agreement == Agreement::default());
    }

    #[test]
    fn a_submap_at_the_maps_origin_is_what_it_was() {
        let submap = sphere(0, Pose::identity(), [0.04, 0.03, 0.02], 2);
        let expected = image(&submap.tsdf);
        let one = OneField::new(&Atlas::from_submaps(VOXEL, vec![submap]));
        let is_observed = |(_, voxels): &(u64, Vec<crate::field::tsdf::Voxel>)| voxels.iter().any(|v| v.is_observed());
        assert!(image(&one.field) == expected.into_iter().filter(is_observed).collect::<Vec<_>>());
    }
}
