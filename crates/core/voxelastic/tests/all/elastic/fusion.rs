//! Fusion against integrating everything into one frame.

use crate::common::room::Room;
use nalgebra::{Translation3, UnitQuaternion};
use proptest::prelude::*;
use voxelastic::Pose;
use voxelastic::atlas::Submap;
use voxelastic::atlas::fusion::{FusionSettings, Merge, Sampling, fuse};
use voxelastic::event::NodeId;
use voxelastic::field::occupancy::{OccupancyField, State, UNKNOWN, state_of};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{OccupancyIntegrator, OccupancySettings, ReturnsView, TsdfIntegrator, TsdfSettings};
use voxelastic::octree::{BLOCK_EDGE, NONE, block_coords, voxel_coords};
use voxelastic::sensor::{BeamModel, CloudLayout, RangeLimits, ScanPreprocessor};

const ROWS: usize = 48;
const COLUMNS: usize = 360;
const VOXEL: f32 = 0.08;

fn pose_of(rigid: &Rigid) -> Pose {
    let r = rigid.rotation;
    let matrix = nalgebra::Matrix3::from_fn(|i, k| f64::from(r[i][k]));
    let t = rigid.translation.map(f64::from);
    Pose::from_parts(Translation3::new(t[0], t[1], t[2]), UnitQuaternion::from_matrix(&matrix))
}

/// Integrates scans of a room into submaps.
struct Bench {
    room: Room,
    tsdf: TsdfIntegrator,
    occupancy: OccupancyIntegrator,
    preprocessor: ScanPreprocessor,
}

impl Bench {
    fn new(seed: u64, max_scale: usize) -> Self {
        let limits = RangeLimits { near: 0.3, max: 30.0 };
        let elevations = Room::elevations(ROWS);
        let model = BeamModel::even(ROWS, COLUMNS, elevations[0], elevations[ROWS - 1]).unwrap();
        let occupancy = OccupancySettings { voxel_size: VOXEL, max_range: 30.0, ..OccupancySettings::default() };
        let tsdf = TsdfSettings { voxel_size: VOXEL, max_range: 30.0, max_scale, ..TsdfSettings::default() };
        Self {
            room: Room::random(seed),
            tsdf: TsdfIntegrator::new(tsdf),
            occupancy: OccupancyIntegrator::new(occupancy, &model),
            preprocessor: ScanPreprocessor::new(model, CloudLayout::Projected, limits),
        }
    }

    fn integrate(&mut self, submap: &mut Submap, index: usize) {
        let (t_map_lidar, points, _) = self.room.scan(index, ROWS, COLUMNS, 0.01);
        let t_submap_lidar = submap.add_scan(index as NodeId, &pose_of(&t_map_lidar));
        let t_submap_lidar = Rigid::from(&t_submap_lidar);
        let scan = self.preprocessor.prepare(&voxelastic::Cloud::from_points(points));
        let returns = ReturnsView { origins: &[], ..ReturnsView::new(&scan.returns) };
        self.tsdf.integrate(submap.tsdf_mut(), &t_submap_lidar, &returns);
        self.occupancy.integrate(submap.occupancy_mut(), &t_submap_lidar, &scan.image, &returns, true);
    }
}

/// Mean difference of the distances near the surface, finest voxels, and how many voxels of `b` there `a` has not.
fn compare_tsdf(a: &TsdfField, b: &TsdfField) -> (f64, f64) {
    let (mut sum, mut count, mut missing, mut all) = (0.0, 0usize, 0usize, 0usize);
    for id in b.ids() {
        let block = b.block(id);
        let other = a.find(block.key).map(|id| a.block(id));
        for (i, voxel) in b.current(block).iter().enumerate() {
            if !voxel.is_observed() || voxel.distance_in_voxels().abs() > 1.0 {
                continue;
            }
            all += 1;
            let edge = f64::from(1u32 << block.scale);
            match other {
                Some(other) if other.scale == block.scale && a.current(other)[i].is_observed() => {
                    sum += f64::from((voxel.distance_in_voxels() - a.current(other)[i].distance_in_voxels()).abs()) * edge;
                    count += 1;
                }
                Some(other) if other.scale != block.scale => all -= 1,
                _ => missing += 1,
            }
        }
    }
    (sum / count as f64, missing as f64 / all as f64)
}

/// Calls `visit` with finest voxels of `field`'s tree: all of those in blocks, some of those in uniform space.
fn for_voxels(field: &OccupancyField, mut visit: impl FnMut([i32; 3])) {
    field.tree().for_each(|key, level, octant| {
        if level > 0 {
            return;
        }
        let corner = block_coords(key).map(|c| c * BLOCK_EDGE as i32);
        for i in (0..512).step_by(if octant.link == u32::MAX { 37 } else { 1 }) {
            let c = voxel_coords(i, 0);
            visit(std::array::from_fn(|k| corner[k] + c[k] as i32));
        }
    });
}

/// Occupancy of two submaps at a voxel of the first, by the obvious rule: what both know, added.
fn sum_at(target: &OccupancyField, source: &OccupancyField, t_source_target: &Rigid, c: [i32; 3]) -> State {
    let there = t_source_target.apply(c.map(|v| (v as f32 + 0.5) * VOXEL)).map(|v| (v / VOXEL).floor() as i32);
    let known = [target.value_at(c), source.value_at(there)].into_iter().filter(|v| *v != UNKNOWN);
    known.map(i16::from).reduce(|a, b| a + b).map_or(State::Unknown, |sum| state_of(sum.clamp(-127, 127) as i8))
}

/// Share of the voxels of `fused` that are known to the obvious rule and unknown in `fused`, that are the opposite, and that
/// are known to `fused` only.
fn compare_occupancy(fused: &OccupancyField, expected: impl Fn([i32; 3]) -> State) -> [f64; 3] {
    let (mut unknown, mut opposite, mut more, mut all) = (0usize, 0usize, 0usize, 0usize);
    for_voxels(fused, |c| match (fused.state_at(c), expected(c)) {
        (State::Unknown, State::Unknown) => {}
        (mine, theirs) => {
            all += 1;
            unknown += usize::from(mine == State::Unknown);
            more += usize::from(theirs == State::Unknown);
            opposite += usize::from(mine != State::Unknown && theirs != State::Unknown && mine != theirs);
        }
    });
    [unknown, opposite, more].map(|n| n as f64 / all as f64)
}

/// Known space, in finest voxels.
fn known(field: &OccupancyField) -> f64 {
    let volumes = field.volumes();
    volumes.free.iter().chain(&volumes.occupied).sum::<u64>() as f64
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn fused_equals_integrated_directly(
        seed in 0u64..1000, angles in prop::array::uniform3(-0.5f64..0.5), yaw in -3.1f64..3.1, t in prop::array::uniform3(-8.0f64..8.0),
        max_scale in 0usize..3,
    ) {
        let mut bench = Bench::new(seed, max_scale);
        let root = Pose::from_parts(Translation3::new(t[0], t[1], t[2]), UnitQuaternion::from_euler_angles(angles[0], angles[1], yaw));
        let (mut target, mut source, mut direct) = (Submap::new(0, VOXEL, Pose::identity()), Submap::new(1, VOXEL, root), Submap::new(2, VOXEL, Pose::identity()));
        for i in 0..6 {
            bench.integrate(if i < 3 { &mut target } else { &mut source }, i);
            bench.integrate(&mut direct, i);
        }
        let weight = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };
        let before = target.occupancy().clone();
        fuse(&mut target, &source, &root, &weight);
        prop_assert_eq!(target.scans().len(), 6);
        for (fused, direct) in target.scans().iter().zip(direct.scans()) {
            prop_assert!((fused.t_submap_lidar.translation.vector - direct.t_submap_lidar.translation.vector).norm() < 1e-9);
        }
        let (difference, missing) = compare_tsdf(target.tsdf(), direct.tsdf());
        println!("scale {max_scale}: {difference:.3} voxels, {:.1} % missing", 100.0 * missing);
        prop_assert!(difference <= 0.15, "zero crossings differ by {difference} voxels");
        prop_assert!(missing <= 0.08, "{missing} of the surface is missing");
        let t_source_target = Rigid::from(&root.inverse());
        let shares = compare_occupancy(target.occupancy(), |c| sum_at(&before, source.occupancy(), &t_source_target, c));
        // Two lattices cut free space into cubes differently, but in all neither knows more.
        let volume = known(target.occupancy()) / known(direct.occupancy());
        println!("unknown, opposite, more: {shares:.3?}; {volume:.3} of the direct volume");
        let [unknown, opposite, more] = shares;
        prop_assert!(unknown <= 0.01 && opposite <= 0.01 && more <= 0.01, "unknown, opposite, more: {shares:?}");
        prop_assert!((volume - 1.0).abs() <= 0.05, "{volume} of the direct volume");
    }
}

/// Everything that the fields of a submap hold.
fn image(submap: &Submap) -> (Vec<(u64, u8, Vec<u32>)>, String) {
    let tsdf = submap.tsdf().ids_in_morton_order().into_iter().map(|id| {
        let voxels = submap.tsdf().stored_voxels(id).into_iter().map(|v| u32::from(v.distance as u16) | u32::from(v.weight) << 16);
        (submap.tsdf().block(id).key, submap.tsdf().block(id).scale, voxels.collect())
    });
    let mut occupancy = String::new();
    submap.occupancy().tree().for_each(|key, level, octant| {
        let values = if level == 0 && octant.link != NONE { submap.occupancy().values(submap.occupancy().block(octant.link)) } else { &[] };
        occupancy += &format!("{key} {level} {:?} {values:?}\n", octant.payload);
    });
    (tsdf.collect(), occupancy)
}

#[test]
fn fused_in_parts_and_in_steps_of_any_size_is_the_same_bit_for_bit() {
    let mut bench = Bench::new(11, 2);
    let root = Pose::from_parts(Translation3::new(0.7, -0.4, 0.1), UnitQuaternion::from_euler_angles(0.05, -0.02, 0.9));
    let (mut target, mut source) = (Submap::new(0, VOXEL, Pose::identity()), Submap::new(1, VOXEL, root));
    (0..4).for_each(|i| bench.integrate(if i < 2 { &mut target } else { &mut source }, i));
    let settings = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };
    let mut fused = target.clone();
    fuse(&mut fused, &source, &root, &settings);
    let expected = image(&fused);
    assert!(expected != image(&target) && source.tsdf().len() > 1000);
    let sampling = Sampling::new(&source, &root);
    assert!(sampling.parts() > 3, "there are parts to be taken in turn");
    let sampled_first: Vec<_> = (0..sampling.parts()).map(|number| sampling.part(number)).collect();
    let mut at_once = target.clone();
    for part in sampled_first {
        Merge::new(part, settings).step(&mut at_once, usize::MAX);
    }
    assert!(image(&at_once) == expected, "sampled before anything is merged");
    for step in [1, 64, 100] {
        let mut streamed = target.clone();
        for number in 0..sampling.parts() {
            let mut merge = Merge::new(sampling.part(number), settings);
            while !merge.step(&mut streamed, step) {}
        }
        assert!(image(&streamed) == expected, "steps of {step}");
    }
}

#[test]
fn fusing_by_whole_voxels_loses_nothing() {
    let mut bench = Bench::new(3, 0);
    // 16 voxels along x: both lattices coincide.
    let root = Pose::translation(f64::from(VOXEL) * 16.0, 0.0, 0.0);
    let (mut empty, mut source) = (Submap::new(0, VOXEL, Pose::identity()), Submap::new(1, VOXEL, root));
    bench.integrate(&mut source, 0);
    fuse(&mut empty, &source, &root, &FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 });
    let mut compared = 0;
    for id in source.tsdf().ids() {
        let block = source.tsdf().block(id);
        let c = block_coords(block.key);
        let moved = empty.tsdf().find(voxelastic::octree::block_key([c[0] + 2, c[1], c[2]]));
        for (i, voxel) in source.tsdf().current(block).iter().enumerate().filter(|(_, v)| v.is_observed()) {
            let there = empty.tsdf().current(empty.tsdf().block(moved.unwrap()))[i];
            assert!((there.distance - voxel.distance).abs() <= 2 && there.weight.abs_diff(voxel.weight) <= 1, "{there:?} {voxel:?}");
            compared += 1;
        }
    }
    assert!(compared > 10_000);
}
