//! The occupancy integrator against a dense reference map and against the geometry of random rooms.

mod bad_input;
mod own_space;
mod reference;
mod thin;

use crate::common::room::Room;
use proptest::prelude::*;
use reference::DenseOccupancy;
use voxelastic::Cloud;
use voxelastic::field::occupancy::{OccupancyField, State, state_of};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{OccupancyIntegrator, OccupancySettings, ReturnsView};
use voxelastic::sensor::{BeamModel, CloudLayout, RangeLimits, ScanPreprocessor};

const ROWS: usize = 48;
const COLUMNS: usize = 256;
/// Angle between columns, radians: wider than between rows.
const SPACING: f32 = std::f32::consts::TAU / COLUMNS as f32;
/// Range noise, 1 sigma, metres.
const NOISE: f32 = 0.01;

type Scan = (Rigid, Vec<[f32; 3]>);

fn scans_of(room: &Room, count: usize) -> Vec<Scan> {
    (0..count).map(|i| room.scan(i, ROWS, COLUMNS, NOISE)).map(|(pose, points, _)| (pose, points)).collect()
}

/// The sensor of [`Room::scan`].
fn model() -> BeamModel {
    let elevations = Room::elevations(ROWS);
    BeamModel::even(ROWS, COLUMNS, elevations[0], elevations[ROWS - 1]).expect("a valid model")
}

/// Integrates scans one by one.
struct Integration {
    preprocessor: ScanPreprocessor,
    integrator: OccupancyIntegrator,
    field: OccupancyField,
    smallest_angle: f32,
}

impl Integration {
    fn new(settings: &OccupancySettings, smallest_angle: f32) -> Self {
        Self::with_near(settings, smallest_angle, 0.0)
    }

    fn with_near(settings: &OccupancySettings, smallest_angle: f32, near: f32) -> Self {
        let preprocessor = ScanPreprocessor::new(model(), CloudLayout::Projected, RangeLimits { near, max: settings.max_range });
        Self { preprocessor, integrator: OccupancyIntegrator::new(settings.clone(), &model()), field: OccupancyField::default(), smallest_angle }
    }

    fn add(&mut self, pose: &Rigid, points: &[[f32; 3]]) {
        let scan = self.preprocessor.prepare(&Cloud::from_points(points.to_vec()));
        let returns = ReturnsView { origins: &[], smallest_angle: self.smallest_angle, ..ReturnsView::new(&scan.returns) };
        self.integrator.integrate(&mut self.field, pose, &scan.image, &returns, false);
    }
}

fn integrate(scans: &[Scan], settings: &OccupancySettings, smallest_angle: f32) -> OccupancyField {
    let mut integration = Integration::new(settings, smallest_angle);
    scans.iter().for_each(|(pose, points)| integration.add(pose, points));
    integration.field
}

/// Corners of the box that holds the room, in voxels.
fn bounds(voxel: f32) -> ([i32; 3], [i32; 3]) {
    let reach = [9.5, 7.5, 3.0].map(|c: f32| (c / voxel).ceil() as i32);
    (reach.map(|c| -c), reach)
}

/// Distance from the sensor at `pose` to the centre of voxel `c`, metres.
fn distance(c: [i32; 3], voxel: f32, pose: &Rigid) -> f32 {
    (0..3).map(|k| ((c[k] as f32 + 0.5) * voxel - pose.translation[k]).powi(2)).sum::<f32>().sqrt()
}

/// Whether the descent must find the free voxel `c`.
fn is_expected(c: [i32; 3], voxel: f32, scans: &[Scan]) -> bool {
    // Free space is no finer than the spacing of the rays.
    scans.iter().any(|(pose, _)| distance(c, voxel, pose) * SPACING <= voxel) && !scans.iter().any(|(pose, _)| is_at_rim(c, voxel, pose))
}

/// Whether the four-voxel cube around `c` may extend beyond the upper or lower limit of the field of view: there the descent stays coarse.
fn is_at_rim(c: [i32; 3], voxel: f32, pose: &Rigid) -> bool {
    let offset: [f32; 3] = std::array::from_fn(|k| (c[k] as f32 + 0.5) * voxel - pose.translation[k]);
    let range = offset.iter().map(|v| v * v).sum::<f32>().sqrt();
    let elevations = Room::elevations(ROWS);
    // The cube's diagonal, because `c` may be any of its voxels, and a pixel of the coarser texel.
    let reach = (4.0 * 3f32.sqrt() * voxel / range).min(1.0).asin() + 2.0 * (elevations[0] - elevations[1]);
    let elevation = (offset[2] / range).asin();
    elevation > elevations[0] - reach || elevation < elevations[ROWS - 1] + reach
}

fn voxels_of(voxel: f32) -> impl Iterator<Item = [i32; 3]> {
    let (low, high) = bounds(voxel);
    (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y, z])))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]
    #[test]
    fn agrees_with_the_dense_reference(seed in any::<u64>(), voxel in 0.13f32..0.2) {
        let room = Room::random(seed);
        let scans = scans_of(&room, 4);
        let settings = OccupancySettings { voxel_size: voxel, ..OccupancySettings::default() };
        // One scale for surfaces, so that both maps have the same voxels.
        let field = integrate(&scans, &settings, 1e-6);
        let (low, high) = bounds(voxel);
        let mut dense = DenseOccupancy::new(settings.clone(), &model());
        scans.iter().for_each(|(pose, points)| dense.integrate(pose, points, low, high));
        let (mut same, mut different, mut only_dense, mut only_fast) = (0usize, Vec::new(), 0usize, 0usize);
        for c in voxels_of(voxel) {
            let fast = field.state_at(c);
            let slow = match dense.voxels.get(&c) {
                // A step of the field is 1/32: with the rounding of four scans, values this near zero may have either sign.
                Some(v) if v.abs() < 0.1 => continue,
                Some(v) if *v < 0.0 => State::Free,
                Some(_) => State::Occupied,
                None => State::Unknown,
            };
            match (fast, slow) {
                (State::Unknown, State::Unknown) => {}
                (State::Unknown, _) => only_dense += usize::from(is_expected(c, voxel, &scans)),
                (_, State::Unknown) => only_fast += 1,
                (a, b) if a == b => same += 1,
                _ => different.push(c),
            }
        }
        prop_assert!(same > 10_000);
        prop_assert!(different.len() * 200 <= same, "{} of {} differ", different.len(), same);
        for c in &different {
            let centre: [f32; 3] = c.map(|v| (v as f32 + 0.5) * voxel);
            prop_assert!(room.distance(centre).abs() < 1.8 * voxel, "{c:?} differs {} m from a surface", room.distance(centre));
        }
        // A texel may be larger than the patch of a near voxel, so the descent misses a few free voxels.
        prop_assert!(only_fast * 2000 <= same, "{only_fast} known in the fast map only, {same} in both");
        prop_assert!(only_dense * 20 <= same, "{only_dense} known in the dense map only, {same} in both");
    }

    #[test]
    fn nothing_behind_a_surface_is_free(seed in any::<u64>(), voxel in 0.05f32..0.2) {
        let room = Room::random(seed);
        let scans = scans_of(&room, 5);
        let settings = OccupancySettings { voxel_size: voxel, ..OccupancySettings::default() };
        let field = integrate(&scans, &settings, SPACING);
        let mut free = 0usize;
        for c in voxels_of(voxel) {
            let Some(leaf) = field.leaf_at(c).filter(|leaf| state_of(leaf.value) == State::Free) else { continue };
            free += 1;
            // A local voxel that extends into the air may be free: its corners are half its diagonal from its centre. A scan from far away may have resolved larger
            // voxels only. The range noise is smaller than the margin of free voxels.
            let farthest = scans.iter().map(|(pose, _)| distance(c, voxel, pose)).fold(0.0, f32::max);
            let local = (voxel * (1 << leaf.edge_log2.min(3)) as f32).max(SPACING * farthest);
            let depth = -room.distance(c.map(|v| (v as f32 + 0.5) * voxel));
            prop_assert!(depth < 0.87 * local, "{c:?} of a leaf of {local} m is free {depth} m behind a surface");
        }
        prop_assert!(free > 10_000);
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_voxel() {
    let room = Room::random(3);
    let scans = scans_of(&room, 5);
    let settings = OccupancySettings { voxel_size: 0.1, robot_radius: 0.7, ..OccupancySettings::default() };
    let fields: Vec<OccupancyField> = [1, 2, 5]
        .map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads").install(|| integrate(&scans, &settings, 0.02)))
        .into();
    for other in &fields[1..] {
        assert_eq!((fields[0].len(), fields[0].tree().octants()), (other.len(), other.tree().octants()));
        assert!(voxels_of(0.1).all(|c| fields[0].value_at(c) == other.value_at(c)));
    }
}

#[test]
fn ancestors_hold_the_largest_value_below_and_whether_all_is_observed() {
    let settings = OccupancySettings { voxel_size: 0.1, robot_radius: 0.7, ..OccupancySettings::default() };
    let field = integrate(&scans_of(&Room::random(11), 4), &settings, 0.02);
    let tree = field.tree();
    let mut checked = 0;
    tree.for_each(|_, level, octant| {
        if octant.link == voxelastic::octree::NONE {
            assert_eq!((octant.payload.max, octant.payload.observed), (octant.payload.value, octant.payload.value != i8::MIN));
        } else if level == 0 {
            let values = field.values(field.block(octant.link));
            assert_eq!(octant.payload.max, *values.iter().max().expect("voxels"));
            assert_eq!(octant.payload.observed, !values.contains(&i8::MIN));
            assert!(values.iter().any(|v| *v != values[0]), "a uniform block was not removed");
        } else {
            let below = tree.siblings(octant.link);
            assert_eq!(octant.payload.max, below.iter().map(|o| o.payload.max).max().expect("siblings"));
            assert_eq!(octant.payload.observed, below.iter().all(|o| o.payload.observed));
            checked += 1;
        }
    });
    assert!(checked > 100);
}

#[test]
fn an_object_arrives_and_leaves_within_a_few_scans() {
    let room = Room::random(21);
    let settings = OccupancySettings { voxel_size: 0.1, ..OccupancySettings::default() };
    let mut integration = Integration::new(&settings, 0.02);
    let (pose, empty, _) = room.scan(0, ROWS, COLUMNS, 0.0);
    // A ball of 0.4 m, 2 m in front of the sensor.
    let ball = [2.0f32, 0.0, 0.0];
    let full: Vec<[f32; 3]> = empty
        .iter()
        .map(|p| {
            let range = p.iter().map(|c| c * c).sum::<f32>().sqrt();
            let ray = p.map(|c| c / range);
            let along: f32 = (0..3).map(|k| ray[k] * ball[k]).sum();
            let aside = 4.0 - along * along;
            if along > 0.0 && aside < 0.16 { ray.map(|c| c * (along - (0.16 - aside).sqrt())) } else { *p }
        })
        .collect();
    let front = pose.apply([1.62, 0.02, 0.02]).map(|c| (c / 0.1).floor() as i32);
    let mut run = |points: &[[f32; 3]], scans: usize| {
        (0..scans).for_each(|_| integration.add(&pose, points));
        integration.field.state_at(front)
    };
    assert_eq!(run(&empty, 20), State::Free);
    assert_eq!(run(&full, 4), State::Occupied, "an object that arrives shows within four scans");
    run(&full, 20);
    assert_eq!(run(&empty, 8), State::Free, "an object that leaves is gone within eight scans");
}
