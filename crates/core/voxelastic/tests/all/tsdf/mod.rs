//! The TSDF integrator against a dense reference map, on random rooms.

mod colour;
mod reference;

use crate::common::room::Room;
use proptest::prelude::*;
use reference::DenseTsdf;
use std::collections::HashMap;
use voxelastic::field::tsdf::{DISTANCE_STEPS, TsdfField};
use voxelastic::geometry::Rigid;
use voxelastic::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
use voxelastic::octree::{BLOCK_EDGE, block_coords, voxel_coords};
use voxelastic::surface::{MeshOptions, extract};

/// Scans of a room: pose of the sensor, points and normals in its frame.
struct Scans {
    scans: Vec<(Rigid, Vec<[f32; 3]>, Vec<[f32; 3]>)>,
    smallest_angle: f32,
}

fn scans_of(room: &Room, count: usize, rows: usize, columns: usize, noise: f32, with_normals: bool) -> Scans {
    let smallest_angle = std::f32::consts::TAU / columns as f32;
    let scans = (0..count)
        .map(|i| {
            let (pose, points, normals) = room.scan(i, rows, columns, noise);
            let normals = if with_normals { normals } else { vec![[0.0; 3]; points.len()] };
            (pose, points, normals)
        })
        .collect();
    Scans { scans, smallest_angle }
}

fn integrate(scans: &Scans, settings: &TsdfSettings) -> TsdfField {
    let mut field = TsdfField::default();
    let mut integrator = TsdfIntegrator::new(settings.clone());
    for (pose, points, normals) in &scans.scans {
        let returns = ReturnsView::of_points(points, normals, scans.smallest_angle);
        integrator.integrate(&mut field, pose, &returns);
    }
    field
}

/// Every observed voxel at its coordinates (finest voxels; only for single-resolution fields).
fn observed(field: &TsdfField) -> impl Iterator<Item = ([i32; 3], f32, u16)> + '_ {
    field.ids().flat_map(move |id| {
        let block = field.block(id);
        assert_eq!(block.scale, 0);
        let corner = block_coords(block.key).map(|c| c * BLOCK_EDGE as i32);
        field.current(block).into_iter().enumerate().filter(|(_, v)| v.is_observed()).map(move |(i, v)| {
            let c = voxel_coords(i, 0);
            (std::array::from_fn(|k| corner[k] + c[k] as i32), f32::from(v.distance) / DISTANCE_STEPS, v.weight)
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn at_one_scale_equals_the_dense_reference(
        seed in any::<u64>(),
        with_normals in any::<bool>(),
        voxel in 0.05f32..0.3,
        truncation_behind in prop_oneof![Just(1.5f32), Just(2.0), Just(3.0)],
        truncation_front in prop_oneof![Just(1.5f32), Just(2.0), Just(3.0)],
    ) {
        let room = Room::random(seed);
        let scans = scans_of(&room, 3, 24, 180, 0.02, with_normals);
        let settings = TsdfSettings { voxel_size: voxel, truncation_behind, truncation_front, max_scale: 0, bundle_width: 0.0, ..TsdfSettings::default() };
        let field = integrate(&scans, &settings);
        let mut dense = DenseTsdf::new(settings);
        scans.scans.iter().for_each(|(pose, points, normals)| dense.integrate(pose, points, normals));
        let (mut both, mut only_one) = (0usize, 0usize);
        for (c, distance, weight) in observed(&field) {
            let Some(&(slow_distance, slow_weight)) = dense.voxels.get(&c) else { only_one += 1; continue };
            both += 1;
            // A ray along a voxel's edge may be counted in one map only: then weights differ, and distances are not compared.
            if (slow_weight - f32::from(weight)).abs() < 0.5 {
                prop_assert!((distance - slow_distance).abs() < 0.004, "{c:?}: {distance} against {slow_distance}");
            } else {
                only_one += 1;
            }
        }
        let missed = dense.voxels.len() - both;
        prop_assert!(both > 1000);
        prop_assert!((only_one + missed) * 200 <= both, "{only_one} + {missed} of {both} voxels differ in their rays");
    }

    #[test]
    fn bundled_rays_give_the_map_of_single_rays(seed in any::<u64>()) {
        let scans = scans_of(&Room::random(seed), 3, 48, 720, 0.02, true);
        let fields = [0.0, TsdfSettings::default().bundle_width].map(|bundle_width| {
            integrate(&scans, &TsdfSettings { voxel_size: 0.1, max_scale: 0, bundle_width, ..TsdfSettings::default() })
        });
        let [single, bundled] = fields.each_ref().map(|field| observed(field).map(|(c, distance, weight)| (c, (distance, weight))).collect::<HashMap<_, _>>());
        let sum = |voxels: &HashMap<[i32; 3], (f32, u16)>| voxels.values().map(|v| f64::from(v.1)).sum::<f64>();
        let both: Vec<f32> = bundled.iter().filter_map(|(c, a)| single.get(c).map(|b| (a.0 - b.0).abs())).collect();
        let off = both.iter().sum::<f32>() / both.len() as f32;
        prop_assert!(bundled.len() * 10 > single.len() * 9 && both.len() * 100 > bundled.len() * 99);
        prop_assert!(off < 0.03, "{off} voxels");
        prop_assert!((sum(&bundled) / sum(&single) - 1.0).abs() < 0.05);
    }

    #[test]
    fn across_scales_the_surface_stays_within_half_the_local_voxel(seed in any::<u64>()) {
        let room = Room::random(seed);
        // Coarse angles, so that several scales occur inside a room.
        let scans = scans_of(&room, 4, 64, 190, 0.0, true);
        let settings = TsdfSettings { voxel_size: 0.04, scale_hysteresis: 1.0, ..TsdfSettings::default() };
        let mesh = extract(&integrate(&scans, &settings), settings.voxel_size, &MeshOptions::default());
        prop_assert!(mesh.scales.contains(&0) && mesh.scales.contains(&1));
        let mut off = [0usize; 4];
        for (p, &scale) in mesh.positions.iter().zip(&mesh.scales) {
            // A vertex may be between a voxel and a coarser neighbour: the larger of the two counts.
            let local = settings.voxel_size * (2 << scale) as f32;
            off[usize::from(room.distance(*p).abs() > 0.5 * local)] += 1;
        }
        // Only at edges of the room the local plane is not the surface.
        prop_assert!(off[1] * 100 <= off[0] * 2, "{off:?}");
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_bit() {
    let room = Room::random(7);
    let scans = scans_of(&room, 6, 64, 512, 0.02, true);
    let settings = TsdfSettings { voxel_size: 0.05, ..TsdfSettings::default() };
    let fields: Vec<TsdfField> = [1, 2, 5]
        .map(|threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads").install(|| integrate(&scans, &settings)))
        .into();
    for other in &fields[1..] {
        assert_eq!(fields[0].len(), other.len());
        for id in fields[0].ids() {
            assert_eq!(fields[0].head(id), other.head(id));
            assert!(fields[0].stored_voxels(id) == other.stored_voxels(id) && fields[0].stored_intensities(id) == other.stored_intensities(id));
        }
    }
    let meshes: Vec<_> = fields.iter().map(|f| extract(f, settings.voxel_size, &MeshOptions::default())).collect();
    assert!(meshes[0] == meshes[1] && meshes[0] == meshes[2]);
}

#[test]
fn a_block_observed_from_far_and_then_from_near_keeps_its_detail() {
    let wall = |at: f32| -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let half = 200;
        let points: Vec<[f32; 3]> = (-half..half)
            .flat_map(|i| (-half..half).map(move |j| (i, j)))
            .map(|(i, j)| [1.0, i as f32 / 400.0, j as f32 / 400.0].map(|c| c * at))
            .collect();
        let normals = vec![[-1.0, 0.0, 0.0]; points.len()];
        (points, normals)
    };
    let settings = TsdfSettings { voxel_size: 0.05, scale_hysteresis: 1.0, ..TsdfSettings::default() };
    let mut integrator = TsdfIntegrator::new(settings.clone());
    let mut field = TsdfField::default();
    let mut scales = Vec::new();
    // The wall stands at x = 8; the sensor backs away from it and comes back.
    for x in [5.0, 0.0, -8.0, -12.0, -12.0, -8.0, 0.0, 5.0, 5.0, 5.0f32] {
        let (points, normals) = wall(8.0 - x);
        let pose = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [x, 0.0, 0.0] };
        let stats = integrator.integrate(&mut field, &pose, &ReturnsView::of_points(&points, &normals, 0.012));
        assert!(stats.blocks > 0);
        scales.push(field.block(field.find(voxelastic::octree::block_key([20, 0, 0])).expect("the wall's block")).scale);
    }
    assert_eq!(scales.first(), Some(&0));
    assert!(scales.contains(&1), "{scales:?}");
    assert_eq!(scales.last(), Some(&0), "{scales:?}");
    let mesh = extract(&field, settings.voxel_size, &MeshOptions::default());
    assert!(mesh.positions.len() > 1000);
    for p in &mesh.positions {
        assert!((p[0] - 8.0).abs() < 0.002, "{p:?}");
    }
    assert_eq!(field.arrays()[1..].iter().sum::<usize>(), field.blocks_by_scale()[1..].iter().sum::<usize>(), "coarser arrays are released");
}
