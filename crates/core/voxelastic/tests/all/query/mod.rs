//! Queries on the map of a real hall: shapes and rays compared with points.
// Tests say when they skip.
#![allow(clippy::print_stdout)]

mod hall;

use nalgebra::Point3;
use proptest::prelude::*;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::event::Event;
use voxelastic::field::occupancy::State;
use voxelastic::query::{Capsule, MissingField, Ray, Resampling, Shape, Sphere, UnknownAs};
use voxelastic::settings::FieldKind;
use voxelastic::{Mapper, Pose, Settings};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

const VOXEL: f32 = 0.1;

/// Points within a ball, a third of a voxel apart.
fn points_within(centre: [f64; 3], radius: f64) -> impl Iterator<Item = [f64; 3]> {
    let step = f64::from(VOXEL) / 3.0;
    let n = (radius / step) as i32;
    let axis = move || -n..=n;
    let all = axis().flat_map(move |x| axis().flat_map(move |y| axis().map(move |z| [x, y, z])));
    all.map(move |c| c.map(|v| f64::from(v) * step))
        .filter(move |d| d.iter().map(|c| c * c).sum::<f64>() <= radius * radius)
        .map(move |d| std::array::from_fn(|k| centre[k] + d[k]))
}

/// The hall in several submaps, so that most of it is in two of them.
#[test]
fn shapes_rays_and_points_agree() {
    let settings =
        Settings { voxel_size: VOXEL, max_range: 25.0, lambda_odom: 20.0, min_overlap: 1.0, sensor: "os0-64".to_owned(), ..Settings::default() };
    let Some(atlas) = hall::map(settings, 4) else { return };
    assert!(atlas.submaps().len() >= 3, "{} submaps", atlas.submaps().len());
    let map = atlas.query().unwrap();
    let place = (-12.0..12.0f64, -12.0..12.0f64, -1.0..2.5f64).prop_map(|(x, y, z)| [x, y, z]);
    let direction = prop::array::uniform3(-1.0..1.0f64);
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(3000));
    let (free, ended) = (std::cell::Cell::new(0), std::cell::Cell::new(0));
    let check = |(centre, direction): ([f64; 3], [f64; 3])| {
        // Submap by submap.
        let in_submap = |(submap, t_map_submap): (&Submap, Pose)| submap.query().state((t_map_submap.inverse() * Point3::from(centre)).coords.into());
        let states: Vec<State> = atlas.placed().map(in_submap).collect();
        let union = [State::Occupied, State::Free].into_iter().find(|state| states.contains(state)).unwrap_or(State::Unknown);
        prop_assert_eq!(map.state(centre), union);
        let sphere: Shape = Sphere { centre, radius: 0.2 }.into();
        if map.is_free(&sphere, UnknownAs::Blocked) {
            free.set(free.get() + 1);
            prop_assert!(points_within(centre, 0.2).all(|p| map.state(p) == State::Free));
        } else if map.is_free(&sphere, UnknownAs::Free) {
            prop_assert!(points_within(centre, 0.2).all(|p| map.state(p) != State::Occupied));
        }
        let to = std::array::from_fn(|k| centre[k] + 2.0 * direction[k]);
        let sweep: Shape = Capsule { from: centre, to, radius: 0.2 }.into();
        if map.is_free(&sweep, UnknownAs::Blocked) {
            let end: Shape = Sphere { centre: to, radius: 0.2 }.into();
            prop_assert!(map.is_free(&end, UnknownAs::Blocked), "the end of a free capsule is not free");
            let length = 2.0 * direction.iter().map(|c| c * c).sum::<f64>().sqrt();
            let hit = map.ray_cast(&Ray { origin: centre, direction, length }, UnknownAs::Blocked);
            prop_assert!(hit.is_none(), "a ray within a free capsule ends: {hit:?}");
        }
        let Some(hit) = map.ray_cast(&Ray { origin: centre, direction, length: 20.0 }, UnknownAs::Blocked) else { return Ok(()) };
        ended.set(ended.get() + 1);
        let norm = direction.iter().map(|c| c * c).sum::<f64>().sqrt();
        let along = |t: f64| -> [f64; 3] { std::array::from_fn(|k| centre[k] + t * direction[k] / norm) };
        let steps = (hit.distance / 0.02) as usize;
        prop_assert!((0..steps).all(|i| map.state(along(0.02 * i as f64 + 0.005)) == State::Free), "a blocking voxel was skipped");
        Ok(())
    };
    runner.run(&(place, direction), check).unwrap_or_else(|e| panic!("{e}"));
    assert!(free.get() > 20 && ended.get() > 1000, "{} free, {} rays ended", free.get(), ended.get());
}

#[test]
fn threads_change_no_cube_of_a_resampled_map() {
    let settings =
        Settings { voxel_size: VOXEL, max_range: 10.0, lambda_odom: 20.0, min_overlap: 1.0, sensor: "os0-64".to_owned(), ..Settings::default() };
    let Some(atlas) = hall::map(settings, 10) else { return };
    let map = atlas.query().unwrap();
    let [one, three] = [1, 3].map(|n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap_or_else(|e| panic!("{e}"));
        pool.install(|| (map.resample(&Resampling { voxel: 0.15, states_only: false }), map.frontier(2)))
    });
    assert!(one.0.len() > 10_000 && one == three);
}

#[test]
fn a_field_that_is_not_there_is_an_error() {
    let empty = Atlas::new(VOXEL);
    assert!(empty.query().is_ok_and(|query| query.is_empty()) && empty.distances().is_ok_and(|query| query.is_empty()));
    let room = Simulation::new(SimOptions { scans: Some(1), columns: Some(128), ..SimOptions::of("room") }).unwrap();
    let map = |field| {
        let mut mapper = Mapper::new(Settings { voxel_size: VOXEL, field, ..Settings::default() }).unwrap();
        for scan in room.scans(PoseSource::Truth) {
            mapper.handle(Event::Scan(scan)).unwrap();
        }
        mapper.into_atlas()
    };
    for (field, space, surfaces) in [
        (FieldKind::Both, None, None),
        (FieldKind::Tsdf, Some(MissingField::Occupancy), None),
        (FieldKind::Occupancy, None, Some(MissingField::Surfaces)),
    ] {
        let atlas = map(field);
        assert_eq!((atlas.query().err(), atlas.distances().err()), (space, surfaces), "{field:?}");
    }
}
