//! Distance fields of simulated places against their exact distances, and over submaps.

use proptest::prelude::*;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, UnknownAs};
use voxelastic::settings::FieldKind;
use voxelastic::{Pose, Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfError, EsdfSettings, LocalEsdf};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

fn room(scans: usize, field: FieldKind, voxel_size: f32) -> (Atlas, Simulation) {
    let simulation =
        Simulation::new(SimOptions { scans: Some(scans), columns: Some(512), sensor: "os0-64".into(), ..SimOptions::of("room") }).unwrap();
    let mut mapper = Mapper::new(Settings { voxel_size, field, ..Settings::default() }).unwrap();
    simulation.scans(PoseSource::Truth).for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).unwrap().is_some()));
    (mapper.into_atlas(), simulation)
}

fn esdf(atlas: &Atlas, max_distance: f64, unknown: UnknownAs) -> Esdf {
    let mut esdf = Esdf::new(EsdfSettings { max_distance, unknown }, atlas.voxel_size()).unwrap();
    esdf.update(atlas);
    esdf
}

/// Points in the room, on a lattice that the voxels do not share.
fn points() -> Vec<[f64; 3]> {
    let lattice = |n: usize, low: f64, step: f64| (0..n).map(move |i| low + step * i as f64);
    lattice(30, -4.7, 0.31).flat_map(|x| lattice(24, -3.7, 0.29).flat_map(move |y| lattice(9, 0.3, 0.27).map(move |z| [x, y, z]))).collect()
}

#[test]
fn distances_and_gradients_are_those_of_the_room() {
    for (field, to_surfaces, worst_mean) in [(FieldKind::Both, true, 0.02), (FieldKind::Occupancy, false, 0.07), (FieldKind::Tsdf, true, 0.02)] {
        let (atlas, simulation) = room(12, field, 0.1);
        let esdf = esdf(&atlas, 1.5, UnknownAs::Free);
        let (query, space) = (esdf.query(&atlas), AtlasQuery::new(&atlas));
        let points = points();
        let samples = if to_surfaces { query.sample_many_to_surfaces(&points) } else { query.sample_many(&points) };
        let (mut errors, mut turns, mut count) = (0.0, 0.0, 0);
        for (p, sample) in points.iter().zip(&samples) {
            let truth = simulation.world().distance(*p);
            if !(0.1..1.3).contains(&truth) || (!space.is_empty() && space.state(*p) != State::Free) {
                continue;
            }
            errors += (f64::from(sample.distance) - truth).abs();
            let step = |k: usize, by: f64| simulation.world().distance(std::array::from_fn(|j| if j == k { p[j] + by } else { p[j] }));
            let gradient: [f64; 3] = std::array::from_fn(|k| (step(k, 1e-3) - step(k, -1e-3)) / 2e-3);
            turns += 1.0 - (0..3).map(|k| gradient[k] * f64::from(sample.gradient[k])).sum::<f64>();
            count += 1;
        }
        let (error, turn) = (errors / f64::from(count), turns / f64::from(count));
        assert!(count > 3000 && error < worst_mean, "{field:?}: {error:.4} m in {count} points");
        assert!(turn < 0.12, "{field:?}: gradients are off by {turn:.3}");
    }
}

#[test]
fn what_is_unknown_to_one_submap_may_be_free_in_another() {
    let (atlas, _) = room(6, FieldKind::Occupancy, 0.1);
    let whole = &atlas.submaps()[0];
    let t_map_submap = Pose::new(nalgebra::Vector3::new(0.4, 0.2, 0.1), nalgebra::Vector3::new(0.0, 0.0, 0.7));
    let moved = Submap::new(1, 0.1, t_map_submap).with_fields(whole.tsdf().clone(), whole.occupancy().clone());
    let two = Atlas::from_submaps(0.1, vec![whole.clone(), moved]);
    let map = two.query().unwrap();
    for unknown in [UnknownAs::Free, UnknownAs::Blocked] {
        let esdf = esdf(&two, 1.0, unknown);
        let query = esdf.query(&two);
        let mut seen = [0; 2];
        for p in points() {
            let (sample, clearance) = (query.sample(p), map.clearance(p, 1.0, unknown));
            // Clearance ends at faces of voxels, the field at their centres: half a diagonal. Interpolated it is at most what it is a diagonal away.
            let slack = if unknown == UnknownAs::Free { 0.12 } else { f64::INFINITY };
            assert!(f64::from(sample.distance) < clearance + 0.26, "{p:?}: {} and {clearance} m", sample.distance);
            assert!(f64::from(sample.distance) > clearance - slack, "{p:?}: {} and {clearance} m", sample.distance);
            seen[usize::from(sample.distance > 0.3)] += 1;
            if map.state(p) != State::Free && unknown == UnknownAs::Blocked {
                assert!(sample.distance < 0.18, "{p:?} is not free");
            }
        }
        assert!(seen[0] > 100 && seen[1] > 100, "{seen:?}");
    }
}

/// Scans of a room, then of a plane where it was, then of the room again, in several submaps: obstacles appear and vanish between the questions.
#[test]
fn a_field_that_is_made_where_it_is_asked_for_answers_the_same() {
    let simulated = |world: &str, scans| Simulation::new(SimOptions { scans: Some(scans), columns: Some(256), ..SimOptions::of(world) }).unwrap();
    for (field, unknown) in [(FieldKind::Both, UnknownAs::Free), (FieldKind::Occupancy, UnknownAs::Blocked), (FieldKind::Tsdf, UnknownAs::Free)] {
        let settings = Settings { voxel_size: 0.15, max_range: 12.0, field, lambda_odom: 3.0, min_overlap: 1.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let settings = EsdfSettings { max_distance: 1.5, unknown };
        let mut whole = Esdf::new(settings, 0.15).unwrap();
        let mut local = LocalEsdf::new(settings, 0.15).unwrap();
        let (mut node, mut near) = (0, 0);
        for (world, scans) in [("room", 3), ("plane", 6), ("room", 3)] {
            for scan in simulated(world, scans).scans(PoseSource::Truth) {
                let here = scan.t_map_lidar.translation.vector;
                mapper.handle(Event::Scan(voxelastic::event::Scan { node, ..scan })).unwrap();
                node += 1;
                if node == 7 {
                    let moved = |id: u64| Pose::translation(0.07 * id as f64, 0.0, 0.03) * mapper.pose(id).unwrap();
                    let update = (0..node).map(|id| (id, moved(id))).collect();
                    mapper.handle(Event::PoseUpdate(update)).unwrap();
                }
                // Around the robot, so that some blocks are asked for again and others are not; and what is in no submap.
                let mut points: Vec<[f64; 3]> = points().into_iter().filter(|p| (p[0] - here.x).abs() < 1.0 && (p[1] - here.y).abs() < 2.0).collect();
                points.extend([[1e9, 0.0, 0.0], [f64::NAN, 0.0, 0.0], [-30.0, 2.0, 1.0]]);
                whole.update(mapper.atlas());
                let query = whole.query(mapper.atlas());
                assert_eq!(local.sample_many(mapper.atlas(), &points), query.sample_many(&points), "{field:?}, scan {node}");
                assert_eq!(local.sample_many_to_surfaces(mapper.atlas(), &points), query.sample_many_to_surfaces(&points));
                near += query.sample_many(&points).iter().filter(|sample| sample.distance < 1.5).count();
            }
        }
        assert!(mapper.atlas().submaps().len() > 1 && near > 1000, "{} submaps, {near} points near obstacles", mapper.atlas().submaps().len());
        assert!(local.bytes() < whole.bytes() / 2, "{field:?}: {} bytes instead of {}", local.bytes(), whole.bytes());
    }
}

#[test]
fn any_number_of_points_has_the_same_answers() {
    let (atlas, _) = room(3, FieldKind::Occupancy, 0.1);
    let esdf = esdf(&atlas, 1.0, UnknownAs::Blocked);
    let query = esdf.query(&atlas);
    let share = |i: usize, step: f64| (i as f64 * step).fract();
    let points: Vec<[f64; 3]> =
        (0..40_000).map(|i| [12.0 * share(i, 0.7549) - 6.0, 10.0 * share(i, 0.5698) - 5.0, 4.0 * share(i, 0.4302) - 0.5]).collect();
    let few: Vec<_> = points.chunks(1000).flat_map(|points| query.sample_many(points)).collect();
    assert_eq!(query.sample_many(&points), few);
    assert!(few.iter().filter(|sample| sample.distance > 0.1).count() > 5000);
}

proptest! {
    #[test]
    fn one_by_one_or_many_at_once_is_the_same(p in prop::array::uniform3(-8.0f64..8.0)) {
        static ROOM: std::sync::LazyLock<(Atlas, Esdf)> = std::sync::LazyLock::new(|| {
            let (atlas, _) = room(2, FieldKind::Occupancy, 0.1);
            let esdf = esdf(&atlas, 1.0, UnknownAs::Blocked);
            (atlas, esdf)
        });
        let query = ROOM.1.query(&ROOM.0);
        prop_assert_eq!(query.sample_many(&[[0.0; 3], p, [1.0; 3]])[1], query.sample(p));
    }
}

#[test]
fn an_empty_map_is_far_from_everything_or_unknown_and_impossible_distances_are_refused() {
    let atlas = Atlas::new(0.1);
    for (unknown, expected) in [(UnknownAs::Free, 1.0), (UnknownAs::Blocked, 0.0)] {
        let esdf = esdf(&atlas, 1.0, unknown);
        for p in [[0.0; 3], [f64::NAN, 0.0, 0.0], [1e300, 0.0, -1e300]] {
            assert_eq!(esdf.query(&atlas).sample(p).distance, expected);
        }
    }
    for max_distance in [0.0, -1.0, f64::NAN, 4.9] {
        let refused = Esdf::new(EsdfSettings { max_distance, ..EsdfSettings::default() }, 0.1).unwrap_err();
        assert!(matches!(refused, EsdfError::MaxDistance { .. }));
        assert!(refused.to_string().contains("at most 4.800 m"), "{refused}");
    }
}
