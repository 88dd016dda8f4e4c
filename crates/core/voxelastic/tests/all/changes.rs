//! What two maps of one place differ in, against worlds that are known exactly.

use voxelastic::atlas::fusion::FusionSettings;
use voxelastic::atlas::{Atlas, SubmapId, laps};
use voxelastic::changes::{ChangeError, ChangeOptions, ChangedPiece, Changes, RemovedVoxels, changes, keep_newest};
use voxelastic::event::{Edge, Event, Scan};
use voxelastic::field::occupancy::State;
use voxelastic::mapper::Assignment;
use voxelastic::sensor::BeamModel;
use voxelastic::settings::{Dynamic, FieldKind, Laps};
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
    assert_eq!(all.query().unwrap().state(side), State::Occupied);
    assert_eq!(newest.query().unwrap().state(side), State::Free);
    let grid = (-60..60).flat_map(|x| (-50..50).map(move |y| [0.13 * f64::from(x), 0.11 * f64::from(y), 0.8]));
    for p in grid.filter(|p| !near_pillar(&p.map(|c| c as f32))) {
        assert_eq!(all.query().unwrap().state(p), newest.query().unwrap().state(p), "at {p:?}");
    }

    // The other way round the chest goes. Without a later session nothing does, nor where the later one has no free space.
    let (older_wins, _) = keep_newest(all.clone(), |id| u32::from(id < firsts), 0.3, &settings);
    assert_eq!(older_wins.query().unwrap().state([-1.4, 2.0, 0.9]), State::Free);
    assert_eq!(older_wins.query().unwrap().state(side), State::Occupied);
    assert_eq!(keep_newest(all.clone(), |_| 3, 0.3, &settings).1, RemovedVoxels::default());
    let (surfaces, firsts) = together([&before, &map(&with_chest, FieldKind::Tsdf, 0.0)]);
    assert_eq!(keep_newest(surfaces, |id| u32::from(id >= firsts), 0.3, &settings).1, RemovedVoxels::default());
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| keep_newest(all.clone(), age, 0.3, &settings).0.mesh(&MeshOptions::default()))
    };
    assert_eq!(with(1), with(3));
}

/// A car that is parked during the first lap, and a chest that is there during the second.
const CAR: [[f64; 3]; 2] = [[9.5, -2.0, 0.0], [11.3, 2.0, 1.5]];
const CHEST: [[f64; 3]; 2] = [[-11.5, -3.0, 0.0], [-10.3, -1.8, 1.2]];

/// A yard of 26 x 26 m with a house in its middle, in the first or in the second lap.
fn around_a_house(lap: u32) -> World {
    let mut builder = WorldBuilder::new("around", 1);
    builder.ground(0.0, 0.4);
    builder.cuboid([-4.0, -4.0, 0.0], [4.0, 4.0, 3.0], 0.5);
    for (a, b) in [([-13.2, -13.2], [13.2, -13.0]), ([-13.2, 13.0], [13.2, 13.2]), ([-13.2, -13.0], [-13.0, 13.0]), ([13.0, -13.0], [13.2, 13.0])] {
        builder.cuboid([a[0], a[1], 0.0], [b[0], b[1], 3.0], 0.5);
    }
    let [low, high] = if lap == 1 { CAR } else { CHEST };
    builder.cuboid(low, high, 0.5);
    builder.build().unwrap()
}

/// Scans of nearly two laps around the house, 1.6 m apart: 37 of the first and 37 of the second, which lies `aside` metres beside the first.
fn two_laps(settings: Settings, aside: [f64; 3]) -> (Mapper, Vec<Assignment>) {
    let lidar = Lidar::new(BeamModel::even(64, 1024, 0.39, -0.39).unwrap(), LidarSettings::default()).unwrap();
    let worlds = [1, 2].map(around_a_house);
    let mut mapper = Mapper::new(Settings { voxel_size: 0.1, max_range: 30.0, lambda_odom: 12.0, ..settings }).unwrap();
    let mut assignments = Vec::new();
    for node in 0..74u32 {
        let (way, lap) = (1.6 * f64::from(node), usize::from(node >= 37));
        let (side, along) = ((way / 16.0) as usize % 4, way % 16.0 - 8.0);
        let [x, y] = [[8.0, along], [-along, 8.0], [-8.0, -along], [along, -8.0]][side];
        let cloud = lidar.scan(&worlds[lap], |_| Pose::translation(x, y, 1.5), &Stream::new(5, &[u64::from(node)]));
        let [dx, dy, dz] = aside.map(|c| c * lap as f64);
        let t_map_lidar = Pose::translation(x + dx, y + dy, 1.5 + dz);
        let report = mapper.handle(Event::Scan(Scan { node: node.into(), time: f64::from(node), t_map_lidar, cloud })).unwrap().unwrap();
        assignments.push(report.assignment);
        if node >= 40 {
            // A loop that is closed by the poses as they are.
            let t_from_to = mapper.pose((node - 40).into()).unwrap().inv_mul(&t_map_lidar);
            mapper.handle(Event::LoopEdge(Edge { from: (node - 40).into(), to: node.into(), t_from_to, information: None })).unwrap();
        }
    }
    mapper.finish();
    (mapper, assignments)
}

/// The first lap, and the second.
fn parts(atlas: &Atlas) -> [Atlas; 2] {
    let laps = laps(atlas.submaps());
    [1, 2].map(|lap| {
        let submaps = atlas.submaps().iter().filter(|submap| laps[&submap.id()] == lap);
        Atlas::from_submaps(atlas.voxel_size(), submaps.cloned().collect())
    })
}

/// Whether a point is within `by` metres of a box.
fn is_near_box(p: &[f32; 3], [low, high]: [[f64; 3]; 2], by: f64) -> bool {
    (0..3).all(|k| f64::from(p[k]) > low[k] - by && f64::from(p[k]) < high[k] + by)
}

/// Fails unless one thing vanished, the car, and one appeared, the chest.
fn assert_car_and_chest(found: &Changes, by: f64, least_area: f64) {
    for (pieces, thing) in [(&found.vanished, CAR), (&found.appeared, CHEST)] {
        let at: Vec<_> = pieces.iter().map(|piece| (piece.bounds, piece.area)).collect();
        assert!(pieces.len() == 1 && pieces[0].area > least_area, "{at:?}");
        assert!(pieces[0].mesh.positions.iter().all(|p| is_near_box(p, thing, by)), "{at:?}");
    }
}

#[test]
fn what_changed_between_laps_is_found_and_the_map_shows_the_last() {
    let apart = Settings { field: FieldKind::Both, laps: Laps::Apart, ..Settings::default() };
    // The second lap lies 11 cm beside the first and 2 cm above it.
    let aside = [0.09, -0.07, 0.02];
    let (mapper, assignments) = two_laps(apart.clone(), aside);
    assert!(assignments.iter().all(|assignment| matches!(assignment, Assignment::NewSubmap | Assignment::Continue)));
    assert_eq!(mapper.elastic_counts().fusions, 0);
    let atlas = mapper.into_atlas();
    let of_lap = |lap: u32| laps(atlas.submaps()).into_iter().filter(|(_, of)| *of == lap).map(|(id, _)| id).collect::<Vec<SubmapId>>();
    assert_eq!(of_lap(1).len() + of_lap(2).len(), atlas.submaps().len());
    for lap in [1, 2] {
        let nodes: Vec<u64> = of_lap(lap).iter().flat_map(|id| atlas.submap(*id).unwrap().scans()).map(|scan| scan.node).collect();
        assert!(nodes.iter().all(|node| (*node >= 37) == (lap == 2)), "{nodes:?}");
        assert!(of_lap(lap).len() >= 3);
    }
    let [first, second] = parts(&atlas);
    assert_car_and_chest(&compare(&first, &second), 0.3, 1.5);

    let settings = FusionSettings::from(&Settings { voxel_size: 0.1, ..Settings::default() });
    let lap_of = laps(atlas.submaps());
    let (newest, removed) = keep_newest(atlas.clone(), |id| lap_of[&id], 0.3, &settings);
    assert!(removed.surface > 500 && removed.occupied > 100, "{removed:?}");
    let count =
        |atlas: &Atlas, wanted: &dyn Fn(&[f32; 3]) -> bool| atlas.mesh(&MeshOptions::default()).positions.iter().filter(|p| wanted(p)).count();
    let on_car = |p: &[f32; 3]| is_near_box(p, CAR, 0.3) && p[2] > 0.45;
    let (was, is) = (count(&atlas, &on_car), count(&newest, &on_car));
    assert!(was > 500 && is == 0, "{is} of {was} vertices of the car");
    let elsewhere = |p: &[f32; 3]| !is_near_box(p, CAR, 0.5);
    let (old, new) = (count(&atlas, &elsewhere), count(&newest, &elsewhere));
    assert!(new * 1000 > old * 998 && old > 20_000, "{new} of {old} vertices");

    // What moves is removed within a lap: a car that stood all the time is there, and vanishes with the second.
    let (mapper, _) = two_laps(Settings { dynamic: Dynamic::Remove, ..apart }, aside);
    let [first, second] = parts(&mapper.into_atlas());
    assert_car_and_chest(&compare(&first, &second), 0.3, 1.5);

    // Laps that are not kept apart share submaps.
    let (mapper, assignments) = two_laps(Settings { field: FieldKind::Both, ..Settings::default() }, aside);
    assert!(assignments.iter().any(|assignment| !matches!(assignment, Assignment::NewSubmap | Assignment::Continue)));
    assert!(mapper.atlas().submaps().len() < atlas.submaps().len());
}

#[test]
fn laps_that_do_not_fit_erase_no_walls() {
    // Farther than the margin, to one side and upwards.
    let apart = Settings { field: FieldKind::Both, laps: Laps::Apart, ..Settings::default() };
    let atlas = two_laps(apart.clone(), [0.47, 0.0, 0.05]).0.into_atlas();
    let [first, second] = parts(&atlas);
    let with_margin = |is_fitted| changes(&first, &second, &ChangeOptions { is_fitted, ..ChangeOptions::for_voxels(0.1) }).unwrap();
    let exact = with_margin(false);
    let walls: f64 = exact.vanished.iter().filter(|piece| !is_near_box(&piece.mesh.positions[0], CAR, 0.5)).map(|piece| piece.area).sum();
    assert!(walls > 5.0 && (exact.widest_margin - 0.3).abs() < 1e-6, "{walls} m2 of walls beside their places");
    let fitted = with_margin(true);
    assert!(fitted.widest_margin > 0.5 && fitted.widest_margin <= 1.0, "{}", fitted.widest_margin);
    assert_car_and_chest(&fitted, 0.6, 0.3);

    let settings = FusionSettings::from(&Settings { voxel_size: 0.1, ..Settings::default() });
    let lap_of = laps(atlas.submaps());
    let newest = |atlas: &Atlas| keep_newest(atlas.clone(), |id| lap_of[&id], 0.3, &settings).0;
    let elsewhere = |atlas: &Atlas| {
        let positions: Vec<[f32; 3]> = parts(atlas)[0].mesh(&MeshOptions::default()).positions;
        positions.iter().filter(|p| !is_near_box(p, CAR, 0.8)).count()
    };
    let (old, new) = (elsewhere(&atlas), elsewhere(&newest(&atlas)));
    assert!(new * 1000 > old * 998 && old > 20_000, "{new} of {old} vertices");

    // A metre apart, nothing can be told.
    let atlas = two_laps(apart, [1.0, 0.3, 0.0]).0.into_atlas();
    let [first, second] = parts(&atlas);
    let found = compare(&first, &second);
    assert!(found.appeared.is_empty() && found.vanished.is_empty());
    let removed = keep_newest(atlas, |id| lap_of[&id], 0.3, &settings).1;
    assert_eq!(removed, RemovedVoxels::default());
}
