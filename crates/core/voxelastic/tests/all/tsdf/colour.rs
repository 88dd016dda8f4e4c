//! Colours: the mesh of a room that is coloured by position has the same colours.

use crate::common::room::Room;
use crate::tsdf::{Scans, scans_of};
use proptest::prelude::*;
use voxelastic::atlas::fusion::{FusionSettings, fuse};
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::geometry::{Pose, Rigid};
use voxelastic::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings, colour_voxels};
use voxelastic::surface::{Mesh, MeshOptions, extract};

/// The colour at a position: it changes by at most 44 of 255 per metre and is nowhere grey.
fn colour_at([x, y, z]: [f32; 3]) -> [u8; 3] {
    let wave = |c: f32| (0.4 * c).sin();
    [128.0 + 110.0 * wave(x), 128.0 + 110.0 * wave(y), 60.0 + 50.0 * wave(z)].map(|v| v as u8)
}

fn settings(voxel: f32) -> TsdfSettings {
    TsdfSettings { voxel_size: voxel, scale_hysteresis: 1.0, ..TsdfSettings::default() }
}

/// Integrates all scans with colours into a field whose frame is at `t_map_field`.
fn colour_field(scans: &Scans, settings: &TsdfSettings, t_map_field: &Pose) -> TsdfField {
    let mut field = TsdfField::default();
    let mut integrator = TsdfIntegrator::new(settings.clone());
    let to_field = Rigid::from(&t_map_field.inverse());
    for (pose, points, normals) in &scans.scans {
        let returns = ReturnsView::of_points(points, normals, scans.smallest_angle);
        let rotation = std::array::from_fn(|i| std::array::from_fn(|k| (0..3).map(|j| to_field.rotation[i][j] * pose.rotation[j][k]).sum()));
        let pose_in_field = Rigid { rotation, translation: to_field.apply(pose.translation) };
        integrator.integrate(&mut field, &pose_in_field, &returns);
        let colours: Vec<[u8; 3]> = points.iter().map(|p| colour_at(pose.apply(*p))).collect();
        colour_voxels(&mut field, &pose_in_field, &returns, &colours, settings.voxel_size, settings.max_range);
    }
    field
}

/// The number of vertices whose colour is wrong by more than its change between neighbouring voxels, and the number of all.
fn wrong(mesh: &Mesh, t_map_mesh: &Rigid, voxel: f32) -> (usize, usize) {
    assert_eq!(mesh.colours.len(), mesh.positions.len());
    let off = mesh.positions.iter().zip(&mesh.colours).zip(&mesh.scales).filter(|((p, colour), scale)| {
        let expected = colour_at(t_map_mesh.apply(**p));
        let step = 44.0 * voxel * (2 << **scale) as f32;
        colour.iter().zip(expected).any(|(a, b)| f32::from(a.abs_diff(b)) > 10.0 + 1.5 * step)
    });
    (off.count(), mesh.positions.len())
}

const STILL: Rigid = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };

/// A submap with a TSDF and without occupancy.
fn submap(id: u32, tsdf: TsdfField, voxel_size: f32, t_map_submap: Pose) -> Submap {
    Submap::new(id, voxel_size, t_map_submap).with_fields(tsdf, voxelastic::field::occupancy::OccupancyField::default())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(5))]
    #[test]
    fn the_mesh_has_the_colours_of_the_room(seed in any::<u64>(), voxel in 0.04f32..0.15, lod in 0usize..3) {
        let room = Room::random(seed);
        let scans = scans_of(&room, 4, 64, 300, 0.005, true);
        let field = colour_field(&scans, &settings(voxel), &Pose::identity());
        let mesh = extract(&field, voxel, &MeshOptions { lod, ..MeshOptions::default() });
        let (wrong, all) = wrong(&mesh, &STILL, voxel);
        prop_assert!(all > 300 && wrong * 100 <= all, "{wrong} of {all}");
        let grey: Vec<usize> = (0..all).filter(|&v| mesh.colours[v] == [128; 3]).collect();
        // Faces where two bands end are no surface and have no points near them; on the surface nearly all vertices have a colour.
        let on_surface = grey.iter().filter(|&&v| room.distance(mesh.positions[v]).abs() < voxel * (1 << mesh.scales[v]) as f32).count();
        prop_assert!(on_surface * 1000 <= all && grey.len() * 500 <= all, "{} of {all} unknown, {on_surface} of them on the surface", grey.len());
    }

    #[test]
    fn fused_submaps_keep_their_colours(seed in any::<u64>(), angle in -3.0f64..3.0, shift in -2.0f64..2.0) {
        let (mut first, mut second) = (scans_of(&Room::random(seed), 6, 48, 300, 0.005, true), scans_of(&Room::random(seed), 6, 48, 300, 0.005, true));
        first.scans.truncate(3);
        second.scans.drain(..3);
        let voxel = 0.08;
        let t_map_second = Pose::new(nalgebra::Vector3::new(shift, 1.3, -0.4), nalgebra::Vector3::new(0.1, -0.2, angle));
        let mut target = submap(0, colour_field(&first, &settings(voxel), &Pose::identity()), voxel, Pose::identity());
        let source = submap(1, colour_field(&second, &settings(voxel), &t_map_second), voxel, t_map_second);
        let fusion = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };
        let bytes_of_two = target.bytes() + source.bytes();
        fuse(&mut target, &source, &t_map_second, &fusion);
        let (wrong, all) = wrong(&extract(target.tsdf(), voxel, &MeshOptions::default()), &STILL, voxel);
        prop_assert!(all > 1000 && wrong * 50 <= all, "{wrong} of {all}");
        prop_assert!(target.bytes() < bytes_of_two);
        // Colours are fused into a map without colours, too.
        let mut bare = submap(2, crate::tsdf::integrate(&first, &settings(voxel)), voxel, Pose::identity());
        fuse(&mut bare, &source, &t_map_second, &fusion);
        prop_assert!(!bare.tsdf().colours().is_empty());
    }
}

#[test]
fn a_map_without_colours_has_no_layer_and_one_with_them_the_same_distances() {
    let scans = scans_of(&Room::random(3), 3, 48, 300, 0.01, true);
    let (bare, coloured) = (crate::tsdf::integrate(&scans, &settings(0.06)), colour_field(&scans, &settings(0.06), &Pose::identity()));
    assert!(bare.colours().is_empty() && bare.colours().bytes() == 0 && bare.bytes() < coloured.bytes());
    assert!(extract(&bare, 0.06, &MeshOptions::default()).colours.is_empty());
    for id in bare.ids() {
        assert_eq!(bare.head(id), coloured.head(id));
        assert!(bare.stored_voxels(id) == coloured.stored_voxels(id));
    }
    let (a, b) = (extract(&bare, 0.06, &MeshOptions::default()), extract(&coloured, 0.06, &MeshOptions::default()));
    assert!(a.positions == b.positions && a.triangles == b.triangles);
    // Submaps without colours beside one with them are grey in the mesh of the whole map.
    let mut all = Mesh::default();
    all.append(&a, &STILL);
    all.append(&b, &STILL);
    assert!(all.colours.len() == all.positions.len() && all.colours[0] == [128; 3] && all.colours[a.positions.len()..] == b.colours);
    let atlas = Atlas::from_submaps(0.06, vec![submap(0, coloured, 0.06, Pose::identity())]);
    assert!(atlas.bytes() > bare.bytes());
}

#[test]
fn points_without_colour_leave_colours_unchanged() {
    let scans = scans_of(&Room::random(5), 1, 48, 300, 0.0, true);
    let mut field = colour_field(&scans, &settings(0.08), &Pose::identity());
    let before = extract(&field, 0.08, &MeshOptions::default());
    let (pose, points, normals) = &scans.scans[0];
    let returns = ReturnsView::of_points(points, normals, scans.smallest_angle);
    colour_voxels(&mut field, pose, &returns, &vec![[0; 3]; points.len()], 0.08, 60.0);
    colour_voxels(&mut field, pose, &returns, &vec![[9; 3]; points.len()], 0.08, 0.01);
    assert!(extract(&field, 0.08, &MeshOptions::default()) == before, "black is no colour, and returns beyond the range are skipped");
}

#[test]
fn intensities_do_not_darken_where_a_block_becomes_coarser() {
    let settings = settings(0.05);
    let (mut field, mut integrator) = (TsdfField::default(), TsdfIntegrator::new(settings.clone()));
    // A wall at x = 8 of uniform intensity, from which the sensor moves away.
    for x in [5.0, 0.0, -8.0, -12.0] {
        let at = 8.0 - x;
        let points: Vec<[f32; 3]> =
            (0..200 * 200).map(|i| [1.0, (i % 200) as f32 / 200.0 - 0.5, (i / 200) as f32 / 200.0 - 0.5].map(|c| c * at)).collect();
        let (normals, intensities) = (vec![[-1.0, 0.0, 0.0]; points.len()], vec![200; points.len()]);
        let returns = ReturnsView { intensities: &intensities, ..ReturnsView::of_points(&points, &normals, 0.01) };
        integrator.integrate(&mut field, &Rigid { translation: [x, 0.0, 0.0], ..STILL }, &returns);
        let seen = extract(&field, 0.05, &MeshOptions { lod: 3, ..MeshOptions::default() }).intensities;
        assert!(!seen.is_empty() && seen.iter().all(|s| s.abs_diff(200) <= 1), "{:?} from {at} m", seen.iter().min());
    }
    assert!(field.blocks_by_scale()[1..].iter().sum::<usize>() > 10, "blocks must become coarser");
}
