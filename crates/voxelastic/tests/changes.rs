//! What two maps of one place differ in, against worlds that are known exactly.

use voxelastic::atlas::Atlas;
use voxelastic::atlas::fusion::FusionSettings;
use voxelastic::changes::{ChangeError, ChangeOptions, ChangedPiece, Changes, RemovedVoxels, changes, keep_newest};
use voxelastic::event::{Event, Scan};
use voxelastic::field::occupancy::State;
use voxelastic::sensor::BeamModel;
use voxelastic::settings::FieldKind;
use voxelastic::surface::MeshOptions;
use voxelastic::{Mapper, Pose, Settings};
use voxelastic_sim::random::Stream;
use voxelastic_sim::sensor::{Lidar, LidarSettings};
use voxelastic_sim::{World, WorldBuilder};

/// Scans of a map.
const SCANS: u32 = 6;

/// A yard of 16 x 12 m with walls of 3 m, and what else is in it.
fn yard(things: impl Fn(&mut WorldBuilder)) -> World {
    let mut builder = WorldBuilder::new("yard", 1);
    builder.ground(0.0, 0.4);
    for (a, b) in [([-8.2, -6.2], [8.2, -6.0]), ([-8.2, 6.0], [8.2, 6.2]), ([-8.2, -6.0], [-8.0, 6.0]), ([8.0, -6.0], [8.2, 6.0])] {
        builder.cuboid([a[0], a[1], 0.0], [b[0], b[1], 3.0], 0.5);
    }
    things(&mut builder);
    builder.build().unwrap()
}

/// The map of scans along x, which lies `aside` metres beside where it should in y.
fn map(world: &World, field: FieldKind, aside: f64) -> Atlas {
    let model = BeamModel::even(64, 1024, 0.39, -0.39).unwrap();
    let lidar = Lidar::new(model, LidarSettings::default()).unwrap();
    let mut mapper = Mapper::new(Settings { field, voxel_size: 0.1, ..Settings::default() }).unwrap();
    for node in 0..SCANS {
        let [x, y, z] = position(node);
        let cloud = lidar.scan(world, |_| Pose::translation(x, y, z), &Stream::new(5, &[u64::from(node)]));
        let t_map_lidar = Pose::translation(x, y + aside, z);
        mapper.handle(Event::Scan(Scan { node: node.into(), time: f64::from(node), t_map_lidar, cloud })).unwrap();
    }
    mapper.into_atlas()
}

fn compare(before: &Atlas, after: &Atlas) -> Changes {
    changes(before, after, &ChangeOptions::for_voxels(0.1)).unwrap()
}

/// Where the sensor stands in scan `node`.
fn position(node: u32) -> [f64; 3] {
    [1.5 * f64::from(node) - 3.75, 0.0, 1.5]
}

/// Points 10 cm apart on the box from `low` to `high` that some scan of `world` sees, more than `least_height` metres above the ground.
fn visible_points(world: &World, low: [f64; 3], high: [f64; 3], least_height: f64) -> Vec<[f64; 3]> {
    let count = |k: usize| ((high[k] - low[k]) / 0.1).round() as usize;
    let mut points = Vec::new();
    for index in 0..(count(0) + 1) * (count(1) + 1) * (count(2) + 1) {
        let at = [index % (count(0) + 1), index / (count(0) + 1) % (count(1) + 1), index / (count(0) + 1) / (count(1) + 1)];
        let p: [f64; 3] = std::array::from_fn(|k| low[k] + 0.1 * at[k] as f64);
        let is_visible = |node: u32| {
            let from = position(node);
            let way: [f64; 3] = std::array::from_fn(|k| p[k] - from[k]);
            let range = way.iter().map(|c| c * c).sum::<f64>().sqrt();
            // Beams reach 22 degrees up and down, and graze a surface below 10.
            let hit = world.cast(from, way.map(|c| c / range), 60.0);
            let cosine = hit.map_or(0.0, |hit| (0..3).map(|k| -world.normal(hit.solid, p)[k] * way[k] / range).sum::<f64>());
            (way[2] / range).abs() < 0.38 && hit.is_some_and(|hit| (hit.range - range).abs() < 0.02) && cosine > 0.17
        };
        if p[2] > least_height && (0..SCANS).any(is_visible) {
            points.push(p);
        }
    }
    points
}

/// Fails unless all of `piece` is on the box from `low` to `high` of `world`, and nearly all of the box that was seen is part of it.
fn assert_is_box(piece: &ChangedPiece, world: &World, low: [f64; 3], high: [f64; 3]) {
    let distance = |p: &[f32; 3]| {
        let outside = (0..3).map(|k| (low[k] as f32 - p[k]).max(p[k] - high[k] as f32)).fold(f32::NEG_INFINITY, f32::max);
        outside.abs()
    };
    // The maps lie 6 cm beside each other, and surfaces hang over edges by up to two voxels.
    let mut distances: Vec<f32> = piece.mesh.positions.iter().map(distance).collect();
    distances.sort_by(f32::total_cmp);
    let (most, worst) = (distances[distances.len() * 19 / 20], distances[distances.len() - 1]);
    assert!(most < 0.12 && worst < 0.26, "95 % within {most}, all within {worst} m of the box");
    let visible = visible_points(world, low, high, 0.45);
    let squared = |p: &[f64; 3], q: &[f32; 3]| (0..3).map(|k| (p[k] - f64::from(q[k])).powi(2)).sum::<f64>();
    let is_found = |p: &&[f64; 3]| piece.mesh.positions.iter().any(|q| squared(p, q) < 0.2f64.powi(2));
    let found = visible.iter().filter(is_found).count();
    assert!(visible.len() > 100 && found * 10 > visible.len() * 9, "{found} of {} points", visible.len());
}

#[test]
fn a_thing_that_came_and_one_that_left_are_found_and_nothing_else() {
    let pillar = ([2.0, -3.0, 0.0], [2.6, -2.4, 2.2]);
    let chest = ([-2.0, 2.0, 0.0], [-0.8, 3.0, 1.2]);
    let (with_pillar, with_chest) = ([pillar, chest]).map(|thing| yard(|world| world.cuboid(thing.0, thing.1, 0.5))).into();
    let before = map(&with_pillar, FieldKind::Both, 0.0);
    // The maps lie 6 cm beside each other.
    let after = map(&with_chest, FieldKind::Both, 0.06);
    let found = compare(&before, &after);
    assert_eq!(
        [found.appeared.len(), found.vanished.len()],
        [1, 1],
        "{:?}",
        [&found.appeared, &found.vanished].map(|all| all.iter().map(|p| (p.bounds, p.area)).collect::<Vec<_>>())
    );
    let (appeared, vanished) = (&found.appeared[0], &found.vanished[0]);
    assert_is_box(appeared, &with_chest, chest.0, chest.1);
    assert_is_box(vanished, &with_pillar, pillar.0, pillar.1);
    // The other way round, the same things came and left.
    let back = compare(&after, &before);
    assert_eq!([&back.appeared, &back.vanished], [&found.vanished, &found.appeared]);
    assert!(found.compared_area > 0.8 * found.area && found.area > 200.0, "{} of {} m2", found.compared_area, found.area);
}

#[test]
fn what_one_map_did_not_see_is_no_change() {
    // Behind the wall, only the second map has seen anything.
    let wall = |world: &mut WorldBuilder| world.cuboid([-1.0, -6.0, 0.0], [-0.8, 6.0, 3.0], 0.5);
    let with_chest = |world: &mut WorldBuilder| world.cuboid([5.0, 2.0, 0.0], [6.0, 3.0, 1.0], 0.5);
    let seen_half = {
        let world = yard(|world| {
            wall(world);
            with_chest(world);
        });
        let model = BeamModel::even(64, 1024, 0.39, -0.39).unwrap();
        let lidar = Lidar::new(model, LidarSettings::default()).unwrap();
        let mut mapper = Mapper::new(Settings { field: FieldKind::Both, voxel_size: 0.1, ..Settings::default() }).unwrap();
        let pose = Pose::translation(-4.0, 0.0, 1.5);
        let cloud = lidar.scan(&world, |_| pose, &Stream::new(5, &[0]));
        mapper.handle(Event::Scan(Scan { node: 0, time: 0.0, t_map_lidar: pose, cloud })).unwrap();
        mapper.into_atlas()
    };
    let all = map(&yard(with_chest), FieldKind::Both, 0.0);
    let found = compare(&seen_half, &all);
    assert!(found.appeared.is_empty(), "{:?}", found.appeared.iter().map(|p| p.bounds).collect::<Vec<_>>());
    // The wall is gone.
    assert!(!found.vanished.is_empty() && found.vanished.iter().all(|p| p.bounds.min[0] > -1.2 && p.bounds.max[0] < -0.6));
    assert!(found.compared_area < 0.8 * found.area);
}

#[test]
fn one_map_does_not_differ_from_itself_and_threads_do_not_count() {
    let world = yard(|world| world.cuboid([2.0, -3.0, 0.0], [2.6, -2.4, 2.2], 0.5));
    let atlas = map(&world, FieldKind::Both, 0.0);
    let same = compare(&atlas, &atlas);
    assert!(same.appeared.is_empty() && same.vanished.is_empty());
    assert!((same.compared_area - same.area).abs() < 0.02 * same.area);
    let other = map(&yard(|_| ()), FieldKind::Both, 0.0);
    let with = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| compare(&atlas, &other));
    assert_eq!(with(1), with(3));
}

#[test]
fn maps_that_cannot_be_compared_are_refused() {
    let world = yard(|_| ());
    let (both, surfaces) = (map(&world, FieldKind::Both, 0.0), map(&world, FieldKind::Tsdf, 0.0));
    let options = ChangeOptions::for_voxels(0.1);
    assert_eq!(changes(&both, &surfaces, &options), Err(ChangeError::NoOccupancy("newer")));
    assert_eq!(changes(&Atlas::new(0.1), &both, &options), Err(ChangeError::NoSurfaces("older")));
    for (margin, least_area) in [(f64::NAN, 0.1), (11.0, 0.1), (0.2, -1.0)] {
        let bad = ChangeOptions { margin, least_area, ..options.clone() };
        assert_eq!(changes(&both, &both, &bad), Err(ChangeError::Options));
    }
    let far = changes(&both, &map(&world, FieldKind::Both, 500.0), &options).unwrap();
    assert!(far.appeared.is_empty() && far.vanished.is_empty() && far.compared_area == 0.0);
}

/// The submaps of `maps`, with ids in the order of the maps, and how many the first one has.
fn together(maps: [&Atlas; 2]) -> (Atlas, u32) {
    let submaps = maps.iter().flat_map(|map| map.submaps().to_vec()).zip(0..).map(|(submap, id)| submap.with_id(id));
    (Atlas::from_submaps(maps[0].voxel_size(), submaps.collect()), maps[0].submaps().len() as u32)
}

#[test]
fn what_later_sessions_saw_to_be_gone_leaves_the_map() {
    let pillar = ([2.0, -3.0, 0.0], [2.6, -2.4, 2.2]);
    let chest = ([-2.0, 2.0, 0.0], [-0.8, 3.0, 1.2]);
    let [with_pillar, with_chest] = [pillar, chest].map(|thing| yard(|world| world.cuboid(thing.0, thing.1, 0.5)));
    let (before, after) = (map(&with_pillar, FieldKind::Both, 0.0), map(&with_chest, FieldKind::Both, 0.02));
    let (all, firsts) = together([&before, &after]);
    let settings = FusionSettings::from(&Settings { voxel_size: 0.1, ..Settings::default() });
    let age = |id| u32::from(id >= firsts);
    let (newest, removed) = keep_newest(all.clone(), age, 0.3, &settings);
    assert!(removed.surface > 100 && removed.occupied > 50, "{removed:?}");

    // Of the pillar only its foot is left, within the margin of the ground; everything else is as it was.
    let near_pillar = |p: &[f32; 3]| p[0] > 1.7 && p[0] < 2.9 && p[1] > -3.3 && p[1] < -2.1;
    let count =
        |atlas: &Atlas, wanted: &dyn Fn(&[f32; 3]) -> bool| atlas.mesh(&MeshOptions::default()).positions.iter().filter(|p| wanted(p)).count();
    let above_foot = |p: &[f32; 3]| near_pillar(p) && p[2] > 0.45;
    assert!(count(&all, &above_foot) > 200);
    assert_eq!(count(&newest, &above_foot), 0);
    let elsewhere = |p: &[f32; 3]| !near_pillar(p);
    let (old, new) = (count(&all, &elsewhere), count(&newest, &elsewhere));
    assert!(new * 1000 > old * 995 && old > 10_000, "{new} of {old} vertices");

    // Free space, too, and nothing occupied vanished elsewhere.
    let side = [2.0, -2.7, 1.2];
    assert_eq!(all.query().state(side), State::Occupied);
    assert_eq!(newest.query().state(side), State::Free);
    let grid = (-60..60).flat_map(|x| (-50..50).map(move |y| [0.13 * f64::from(x), 0.11 * f64::from(y), 0.8]));
    for p in grid.filter(|p| !near_pillar(&p.map(|c| c as f32))) {
        assert_eq!(all.query().state(p), newest.query().state(p), "at {p:?}");
    }

    // The other way round the chest goes. Without a later session nothing does, nor where the later one has no free space.
    let (older_wins, _) = keep_newest(all.clone(), |id| u32::from(id < firsts), 0.3, &settings);
    assert_eq!(older_wins.query().state([-1.4, 2.0, 0.9]), State::Free);
    assert_eq!(older_wins.query().state(side), State::Occupied);
    assert_eq!(keep_newest(all.clone(), |_| 3, 0.3, &settings).1, RemovedVoxels::default());
    let (surfaces, firsts) = together([&before, &map(&with_chest, FieldKind::Tsdf, 0.0)]);
    assert_eq!(keep_newest(surfaces, |id| u32::from(id >= firsts), 0.3, &settings).1, RemovedVoxels::default());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| keep_newest(all.clone(), age, 0.3, &settings).0.mesh(&MeshOptions::default()))
    };
    assert_eq!(with(1), with(3));
}
