//! Distances to the surfaces of a map against its whole mesh.

use voxelastic::atlas::{Atlas, Submap};
use voxelastic::query::UnknownAs;
use voxelastic::settings::FieldKind;
use voxelastic::surface::{MeshOptions, extract};
use voxelastic::{Pose, Settings, event::Event, mapper::Mapper};
use voxelastic_esdf::{Esdf, EsdfSettings};
use voxelastic_eval::{MeshIndex, MeshView};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

const VOXEL: f32 = 0.15;
const MAX_DISTANCE: f64 = 1.5;

/// Two submaps of a room, one of them moved a little.
fn room(field: FieldKind) -> Atlas {
    let simulation = Simulation::new(SimOptions { scans: Some(6), columns: Some(512), sensor: "os0-64".into(), ..SimOptions::of("room") }).unwrap();
    let mut mapper = Mapper::new(Settings { voxel_size: VOXEL, field, ..Settings::default() }).unwrap();
    simulation.scans(PoseSource::Truth).for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).unwrap().is_some()));
    let whole = mapper.into_atlas().submaps()[0].clone();
    let t_map_submap = Pose::new(nalgebra::Vector3::new(1.1, 0.2, 0.1), nalgebra::Vector3::new(0.0, 0.0, 0.7));
    let moved = Submap::new(1, VOXEL, t_map_submap).with_fields(whole.tsdf().clone(), whole.occupancy().clone());
    Atlas::from_submaps(VOXEL, vec![whole, moved])
}

fn points() -> Vec<[f64; 3]> {
    let lattice = |n: usize, low: f64, step: f64| (0..n).map(move |i| low + step * i as f64);
    lattice(30, -4.7, 0.31).flat_map(|x| lattice(24, -3.7, 0.29).flat_map(move |y| lattice(9, 0.3, 0.27).map(move |z| [x, y, z]))).collect()
}

fn esdf(atlas: &Atlas, unknown: UnknownAs) -> Esdf {
    let mut esdf = Esdf::new(EsdfSettings { max_distance: MAX_DISTANCE, unknown }, VOXEL).unwrap();
    esdf.update(atlas);
    esdf
}

#[test]
fn distances_to_surfaces_are_those_to_the_meshes_of_all_submaps() {
    for field in [FieldKind::Both, FieldKind::Tsdf] {
        let atlas = room(field);
        let esdf = esdf(&atlas, UnknownAs::Free);
        let (query, points) = (esdf.query(&atlas), points());
        let to_surfaces = query.sample_many_to_surfaces(&points);
        let meshes: Vec<_> = atlas.submaps().iter().map(|submap| extract(submap.tsdf(), VOXEL, &MeshOptions::default())).collect();
        let indices: Vec<_> = meshes.iter().map(|mesh| MeshIndex::new(&MeshView::new(&mesh.positions, &mesh.triangles).unwrap()).unwrap()).collect();
        let (mut surfaces, mut voxels_only) = (0, 0);
        for ((p, found), voxels) in points.iter().zip(&to_surfaces).zip(query.sample_many(&points)) {
            let distance = |(submap, index): (&Submap, &MeshIndex)| {
                let local = submap.t_map_submap().inverse() * nalgebra::Point3::from(*p);
                index.closest(local.coords.map(|c| c as f32).into(), 5.0).map_or(5.0, |closest| closest.distance)
            };
            let nearest = atlas.submaps().iter().zip(&indices).map(distance).fold(f32::INFINITY, f32::min);
            let within = (voxels.distance + VOXEL).min(MAX_DISTANCE as f32);
            if (nearest - within).abs() < 1e-4 {
                continue;
            }
            let is_surface = voxels.distance < MAX_DISTANCE as f32 && nearest < within;
            let expected = if is_surface { nearest } else { voxels.distance };
            assert!((found.distance - expected).abs() < 1e-4, "{p:?}: {} and {expected} m", found.distance);
            surfaces += usize::from(is_surface);
            voxels_only += usize::from(!is_surface && voxels.distance < MAX_DISTANCE as f32);
        }
        assert!(
            surfaces > 4000 && voxels_only > 100 && voxels_only < surfaces / 5,
            "{field:?}: {surfaces} distances to surfaces, {voxels_only} to voxels"
        );
    }
}

/// Central differences of the distance are its gradient, but where two surfaces are about as near.
#[test]
fn gradients_are_differences_of_distances() {
    const STEP: f64 = 2e-3;
    let atlas = room(FieldKind::Both);
    let esdf = esdf(&atlas, UnknownAs::Free);
    let query = esdf.query(&atlas);
    let points: Vec<[f64; 3]> = points().into_iter().step_by(3).collect();
    let moved =
        |axis: usize, by: f64| -> Vec<[f64; 3]> { points.iter().map(|p| std::array::from_fn(|k| p[k] + if k == axis { by } else { 0.0 })).collect() };
    let distances = |points: &[[f64; 3]]| -> Vec<f64> { query.sample_many_to_surfaces(points).iter().map(|s| f64::from(s.distance)).collect() };
    let (here, samples) = (distances(&points), query.sample_many_to_surfaces(&points));
    let sides: Vec<[Vec<f64>; 2]> = (0..3).map(|axis| [distances(&moved(axis, -STEP)), distances(&moved(axis, STEP))]).collect();
    let (mut smooth, mut near) = (0, 0);
    for (i, sample) in samples.iter().enumerate().filter(|(_, sample)| (0.05..1.4).contains(&sample.distance)) {
        near += 1;
        let [back, ahead] =
            [0, 1].map(|side| -> [f64; 3] { std::array::from_fn(|axis| (sides[axis][side][i] - here[i]) / if side == 0 { -STEP } else { STEP }) });
        if (0..3).any(|k| (back[k] - ahead[k]).abs() > 0.05) {
            continue;
        }
        smooth += 1;
        for k in 0..3 {
            let difference = 0.5 * (back[k] + ahead[k]);
            assert!((difference - f64::from(sample.gradient[k])).abs() < 0.03, "{:?}, axis {k}: {difference} and {:?}", points[i], sample);
        }
    }
    assert!(near > 1200 && smooth > near * 8 / 10, "{smooth} of {near} points");
}

#[test]
fn surfaces_of_an_older_map_are_forgotten_and_unknown_space_still_ends_distances() {
    let atlas = room(FieldKind::Both);
    let points = points();
    let free = esdf(&atlas, UnknownAs::Free).query(&atlas).sample_many_to_surfaces(&points);
    let blocked = esdf(&atlas, UnknownAs::Blocked);
    let (to_voxels, to_surfaces) = (blocked.query(&atlas).sample_many(&points), blocked.query(&atlas).sample_many_to_surfaces(&points));
    let mut ended = 0;
    for ((free, voxels), surfaces) in free.iter().zip(&to_voxels).zip(&to_surfaces) {
        assert!(surfaces.distance <= free.distance);
        // What is less than the distance to surfaces is that to unknown space.
        assert!(surfaces.distance == free.distance || surfaces.distance >= voxels.distance);
        ended += usize::from(surfaces.distance < free.distance);
    }
    assert!(ended > 100 && ended < points.len(), "{ended}");

    let mut esdf = esdf(&atlas, UnknownAs::Free);
    assert_eq!(esdf.query(&atlas).sample_many_to_surfaces(&points), free);
    let held = esdf.bytes();
    assert_eq!(esdf.query(&atlas).sample_many_to_surfaces(&points), free, "from what was made");
    assert_eq!(esdf.bytes(), held);
    // Another submap with the same id.
    let nothing = Atlas::from_submaps(VOXEL, vec![Submap::new(0, VOXEL, Pose::identity())]);
    esdf.update(&nothing);
    assert!(esdf.query(&nothing).sample_many_to_surfaces(&points).iter().all(|sample| f64::from(sample.distance) == MAX_DISTANCE));
    esdf.update(&atlas);
    assert_eq!(esdf.query(&atlas).sample_many_to_surfaces(&points), free);
}
