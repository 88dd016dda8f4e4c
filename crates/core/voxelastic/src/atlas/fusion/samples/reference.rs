//! A slow and obvious sampling of a field, which the fast one must equal bit by bit: voxel by voxel, each corner looked up by itself.

use super::sample_grid::{SampleGrid, base_and_fraction};
use super::trilinear::{MAX_DIFFERENCE, MAX_MISSING};
use super::tsdf_sampling::{TsdfSampling, target_blocks};
use crate::atlas::fusion::alignment::CubeOffset;
use crate::atlas::fusion::placement::Placement;
use crate::field::tsdf::resolve::{intensity_at, resolve_block};
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{DISTANCE_STEPS, ObservationCount, TsdfField, Voxel, WEIGHT_ONE};
use crate::geometry::{Pose, Rigid};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, SCALES, block_coords, block_key, edge_at, voxel_coords, voxel_index, voxels_at};
use nalgebra::Vector3;
use proptest::prelude::*;

/// Eight neighbouring voxels of one scale and a point between them. Bit k of a corner's number is its side along axis k.
struct Corners {
    voxels: [Voxel; 8],
    /// Position of the point between them, 0 to 1.
    fraction: [f32; 3],
    /// Interpolation weight of each corner; they sum to 1.
    shares: [f32; 8],
}

impl Corners {
    /// The voxels around the point at `fraction` between them; none if too many of them are unobserved.
    fn around(fraction: [f32; 3], voxels: [Voxel; 8]) -> Option<Self> {
        if voxels.iter().fold(0, |any, voxel| any | voxel.weight) == 0 {
            return None;
        }
        let along = fraction.map(|f| [1.0 - f, f]);
        let shares: [f32; 8] = std::array::from_fn(|i| along[0][i & 1] * along[1][i >> 1 & 1] * along[2][i >> 2]);
        let missing: f32 = (0..8).map(|i| if voxels[i].is_observed() { 0.0 } else { shares[i] }).sum();
        (missing <= MAX_MISSING).then_some(Self { voxels, fraction, shares })
    }

    /// The observed corner with the largest interpolation weight.
    fn nearest(&self) -> usize {
        let share = |i: usize| if self.voxels[i].is_observed() { self.shares[i] } else { 0.0 };
        (1..8).fold(0, |best, i| if share(i) > share(best) { i } else { best })
    }

    /// Distance in voxels of this scale, and weight. Trilinear if all eight are observed. Otherwise the observed ones are extrapolated to
    /// the point along the gradient between them, which is exact for planes. Between two surfaces, the values of the nearest corner.
    fn interpolate(&self) -> (f32, f32) {
        let observed = self.voxels.map(Voxel::is_observed);
        let values = self.voxels.map(Voxel::distance_in_voxels);
        let (low, high) = (0..8).filter(|&i| observed[i]).fold((f32::MAX, f32::MIN), |(l, h), i| (l.min(values[i]), h.max(values[i])));
        if high - low > MAX_DIFFERENCE {
            let nearest = self.nearest();
            return (values[nearest], f32::from(self.voxels[nearest].weight));
        }
        let mean = |of: &[f32; 8]| (0..8).map(|i| self.shares[i] * of[i]).sum::<f32>();
        let weights = self.voxels.map(|voxel| f32::from(voxel.weight));
        if observed == [true; 8] {
            return (mean(&values), mean(&weights));
        }
        let gradient: [f32; 3] = std::array::from_fn(|k| {
            let pairs = (0..8).filter(|i| i >> k & 1 == 0 && observed[*i] && observed[i | 1 << k]);
            let (sum, count) = pairs.fold((0.0, 0), |(sum, count), i| (sum + values[i | 1 << k] - values[i], count + 1));
            if count == 0 { 0.0 } else { sum / count as f32 }
        });
        let along_gradient = |i: usize| (0..3).map(|k| gradient[k] * (self.fraction[k] - (i >> k & 1) as f32)).sum::<f32>();
        let known = mean(&observed.map(|o| f32::from(u8::from(o))));
        let extrapolated = std::array::from_fn(|i| if observed[i] { values[i] + along_gradient(i) } else { 0.0 });
        // Unobserved voxels have weight zero.
        (mean(&extrapolated) / known, mean(&weights) / known)
    }
}

/// A corner of a cell: its voxel and its intensity, 0 if unknown.
type Corner = (Voxel, u8);

/// The eight voxels of `scale` around cell `base`; none if one of their blocks is coarser.
fn corners(field: &TsdfField, base: [i32; 3], scale: usize) -> Option<[Corner; 8]> {
    let (shift, mask) = (BLOCK_SHIFT as usize - scale, edge_at(scale) - 1);
    let mut corners = [(Voxel::default(), 0); 8];
    for (i, corner) in corners.iter_mut().enumerate() {
        let c: [i32; 3] = std::array::from_fn(|k| base[k] + (i >> k & 1) as i32);
        let Some(id) = field.find(block_key(c.map(|v| v >> shift))) else { continue };
        let block = field.block(id);
        if usize::from(block.finest) > scale {
            return None;
        }
        let at = c.map(|v| v as usize & mask);
        let voxels = resolve_block(field, id, scale).1.unwrap_or_else(|| field.current(block).into());
        corner.0 = voxels[voxel_index(at, scale)];
        if field.has_intensity(block) {
            corner.1 = intensity_at(at, scale, block.scale.into(), |i| field.intensity(block, i));
        }
    }
    Some(corners)
}

/// The voxels and intensities of block `key` at `scale`.
fn sample(field: &TsdfField, t: &Rigid, key: u64, scale: usize) -> (Vec<Voxel>, Vec<u8>) {
    let mut grid = SampleGrid::new();
    grid.fill(t, &CubeOffset::default(), key, scale);
    let edge = (1 << scale) as f32;
    let voxel = |i: usize| {
        let (corner, c) = (block_coords(key), voxel_coords(i, scale));
        let centre = t.apply(std::array::from_fn(|k| (corner[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * edge));
        let place = |at: usize| if at == scale { grid.at(i) } else { base_and_fraction(centre, at) };
        // The finest scale at which all corners exist.
        let found = (scale..SCALES).find_map(|at| Some((at, place(at).1, corners(field, place(at).0, at)?)));
        let sampled = found.and_then(|(at, fraction, corners)| Some((at, Corners::around(fraction, corners.map(|c| c.0))?, corners)));
        let Some((at, between, corners)) = sampled else { return (Voxel::default(), 0) };
        let (distance, weight) = between.interpolate();
        let steps = (distance * (1 << at) as f32 / edge * DISTANCE_STEPS).round().clamp(f32::from(i16::MIN), f32::from(i16::MAX));
        (Voxel { distance: steps as i16, weight: weight.round().clamp(1.0, f32::from(u16::MAX)) as u16 }, corners[between.nearest()].1)
    };
    (0..voxels_at(scale)).map(voxel).unzip()
}

/// A field of blocks at `blocks`, each with its scale, with a noisy plane through it, voxels missing here and there, and intensities in some blocks.
pub(crate) fn field(blocks: &[([i32; 3], u8)], normal: Vector3<f32>, missing: f32, mut random: impl FnMut() -> f32) -> TsdfField {
    let mut field = TsdfField::default();
    for &(c, at) in blocks {
        let (key, scale) = (block_key(c), usize::from(at));
        let edge = (1 << scale) as f32;
        let voxel = |i: usize, random: &mut dyn FnMut() -> f32| {
            let centre =
                Vector3::from(voxel_coords(i, scale).map(|v| (v as f32 + 0.5) * edge)) + Vector3::from(c.map(|v| (v * BLOCK_EDGE as i32) as f32));
            let distance = normal.dot(&centre) / edge + 0.3 * random();
            let is_observed = distance.abs() < 2.0 && random() > missing;
            let weight = (1.0 + 9.0 * random()) as u16 * WEIGHT_ONE;
            if is_observed { Voxel { distance: (distance * DISTANCE_STEPS) as i16, weight } } else { Voxel::default() }
        };
        let voxels: Vec<Voxel> = (0..voxels_at(scale)).map(|i| voxel(i, &mut random)).collect();
        let intensities: Vec<u8> = voxels.iter().map(|voxel| if voxel.is_observed() { (300.0 * random()) as u8 } else { 0 }).collect();
        let array = EncodedArray::new(scale, &voxels, (random() > 0.5).then_some(&intensities[..]));
        if !field.tree.covers(key) {
            field.tree.grow_to(key);
        }
        let mut cursor = Cursor::new(&field.tree);
        let (id, _) = field.find_or_create(&mut cursor, key, at, array.has_intensity());
        field.blocks[id].observation_count = ObservationCount::default().plus(1 + id);
        field.install(id, scale, &array);
    }
    field
}

proptest! {
    #[test]
    fn sampling_equals_sampling_voxel_by_voxel(
        blocks in prop::collection::btree_map(prop::array::uniform3(-3i32..3), prop_oneof![4 => Just(0u8), 1 => 0u8..4], 1..60),
        angles in prop_oneof![Just([0.0; 3]), prop::array::uniform3(-3f64..3.0)], shift in prop_oneof![Just([0.0; 3]), prop::array::uniform3(-99f64..99.0)],
        normal in prop::array::uniform3(-1f32..1.0), missing in 0f32..0.6, seed in any::<u64>(),
    ) {
        let mut state = seed;
        let random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let normal = (Vector3::from(normal) + Vector3::new(0.0, 0.0, 1e-3)).normalize();
        let source = field(&blocks.into_iter().collect::<Vec<_>>(), normal, missing, random);
        let placement = Placement::new(&Pose::new(Vector3::from(shift), Vector3::from(angles)), 1.0);
        let targets = target_blocks(&source, &placement);
        let sampled = TsdfSampling::new(&source, &placement, targets.clone()).sample(0..targets.len());
        let mut next = sampled.iter().peekable();
        for target in targets.iter() {
            let (voxels, intensities) = sample(&source, &placement.t_source_target, target.key(), target.scale());
            if voxels.iter().all(|voxel| !voxel.is_observed()) {
                prop_assert!(next.peek().is_none_or(|block| block.key != target.key()), "a block without samples");
                continue;
            }
            let Some(block) = next.next() else { return Err(TestCaseError::fail("a block is missing")) };
            prop_assert_eq!((block.key, usize::from(block.scale)), (target.key(), target.scale()));
            let first = (0..voxels.len()).find(|&i| block.voxels[i] != voxels[i]);
            prop_assert!(first.is_none(), "voxel {:?}: {:?} instead of {:?}", first, first.map(|i| block.voxels[i]), first.map(|i| voxels[i]));
            for (i, voxel) in voxels.iter().enumerate() {
                prop_assert_eq!(block.observed[i / 64] >> (i % 64) & 1 == 1, voxel.is_observed());
                prop_assert_eq!(block.intensities.as_ref().map_or(0, |values| values[i]), intensities[i]);
            }
        }
        prop_assert!(next.next().is_none());
    }
}

/// Interpolates a plane with `normal` at `distance` voxels from the point `fraction`, with the corners of `observed` observed.
fn plane(fraction: [f32; 3], distance: f32, normal: [f32; 3], observed: u8) -> Option<(f32, f32)> {
    let voxels = std::array::from_fn(|i| {
        let at: f32 = (0..3).map(|k| normal[k] * ((i >> k & 1) as f32 - fraction[k])).sum();
        let steps = ((distance + at) * DISTANCE_STEPS).round() as i16;
        if observed >> i & 1 == 1 { Voxel { distance: steps, weight: 3 * WEIGHT_ONE } } else { Voxel::default() }
    });
    Corners::around(fraction, voxels).map(|corners| corners.interpolate())
}

proptest! {
    #[test]
    fn a_plane_is_reproduced_where_enough_corners_are_observed(
        fraction in prop::array::uniform3(0f32..1.0), distance in -1f32..1.0, turn in prop::array::uniform2(-3f32..3.0), observed in any::<u8>(),
    ) {
        let normal = [turn[0].cos() * turn[1].cos(), turn[0].sin() * turn[1].cos(), turn[1].sin()];
        let share = |i: &usize| (0..3).map(|k| if i >> k & 1 == 1 { fraction[k] } else { 1.0 - fraction[k] }).product::<f32>();
        let known: f32 = (0..8).filter(|i| observed >> i & 1 == 1).map(|i| share(&i)).sum();
        prop_assume!((1.0 - MAX_MISSING - known).abs() > 1e-4);
        let found = plane(fraction, distance, normal, observed);
        prop_assert_eq!(found.is_some(), known > 1.0 - MAX_MISSING);
        let pairs = |k: usize| (0..8u32).any(|i| i >> k & 1 == 0 && observed >> i & 1 == 1 && observed >> (i | 1 << k) & 1 == 1);
        if let Some((found, weight)) = found {
            prop_assert!((weight - f32::from(3 * WEIGHT_ONE)).abs() < 1e-3);
            // Without two observed neighbours along an axis the gradient along it is unknown.
            prop_assert!((found - distance).abs() < if (0..3).all(pairs) { 2e-3 } else { 0.75 }, "{} instead of {}", found, distance);
        }
    }
}

#[test]
fn distances_of_two_surfaces_are_not_interpolated() {
    let side = |i: usize| Voxel { distance: (if i & 1 == 0 { -1.25 } else { 1.5 } * DISTANCE_STEPS) as i16, weight: WEIGHT_ONE };
    let between = |first: Voxel| {
        let corners = Corners::around([0.3, 0.4, 0.4], std::array::from_fn(|i| if i == 0 { first } else { side(i) }));
        corners.map(|corners| corners.interpolate())
    };
    assert_eq!(between(Voxel { distance: -2048, weight: 32 }), Some((-1.0, 32.0)));
    assert_eq!(between(Voxel::default()), Some((-1.25, f32::from(WEIGHT_ONE))), "the next corner is on the same side");
}
