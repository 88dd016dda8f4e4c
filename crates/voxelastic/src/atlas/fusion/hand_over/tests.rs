use super::*;
use crate::atlas::fusion::FusionSettings;
use crate::atlas::fusion::OneField;
use crate::atlas::{Atlas, HandedOver, Submap, SubmapId};
use crate::field::tsdf::TsdfField;
use crate::geometry::{Pose, Rigid};
use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
use crate::meshing::FusedSurface;
use crate::octree::{block_key, voxel_index};
use crate::surface::MeshOptions;
use hashbrown::HashSet;
use nalgebra::{Point3, Vector3};

const VOXEL: f32 = 0.1;
const SETTINGS: FusionSettings = FusionSettings { max_weight: 100.0, min_log_odds: -2.0, max_log_odds: 3.5 };

/// A submap at `t_map_submap` of a wavy floor, seen `times` times from 3 m above `x` metres, out to 8 m.
fn floor(id: SubmapId, t_map_submap: Pose, x: f64, times: usize) -> Submap {
    let t_submap_map = t_map_submap.inverse();
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    let sensor = Point3::new(x, 0.0, 3.0);
    let t_submap_lidar = t_submap_map * Pose::translation(sensor.x, sensor.y, sensor.z);
    for i in 0..320 * 320 {
        let at = [f64::from(i % 320 - 160) * 0.05 + x, f64::from(i / 320 - 160) * 0.05];
        let height = |x: f64, y: f64| 0.4 * (0.7 * x).sin() * (0.5 * y).cos();
        let slope = [0.28 * (0.7 * at[0]).cos() * (0.5 * at[1]).cos(), -0.2 * (0.7 * at[0]).sin() * (0.5 * at[1]).sin()];
        let point = Point3::new(at[0], at[1], height(at[0], at[1])) - sensor.coords;
        points.push(<[f32; 3]>::from(point.coords.map(|c| c as f32)));
        normals.push(<[f32; 3]>::from(Vector3::new(-slope[0], -slope[1], 1.0).normalize().map(|c| c as f32)));
    }
    let returns = ReturnsView::of_points(&points, &normals, 0.01);
    let mut submap = Submap::new(id, VOXEL, t_map_submap);
    let mut integrator = TsdfIntegrator::new(TsdfSettings { voxel_size: VOXEL, ..TsdfSettings::default() });
    for _ in 0..times {
        integrator.integrate(&mut submap.tsdf, &Rigid::from(&t_submap_lidar), &returns);
        submap.revision += 1;
    }
    submap.tsdf.compact_all();
    submap
}

fn turned() -> Pose {
    Pose::new(Vector3::new(0.33, -1.21, 0.47), Vector3::new(0.2, -0.3, 0.7))
}

/// Two submaps that both see the middle of a floor, the second one better.
fn two() -> Atlas {
    Atlas::from_submaps(VOXEL, vec![floor(0, Pose::identity(), -3.0, 1), floor(1, turned(), 3.0, 4)])
}

/// Every voxel next to a surface of a field, by its place, finest scale only.
fn near_voxels(field: &TsdfField) -> Vec<([i32; 3], f32)> {
    let mut all = Vec::new();
    for id in field.ids_in_morton_order() {
        let (block, corner) = (field.block(id), crate::octree::block_coords(field.block(id).key).map(|c| 8 * c));
        for (i, voxel) in field.current(block).iter().enumerate().filter(|_| block.scale == 0) {
            let c = crate::octree::voxel_coords(i, 0);
            if voxel.is_observed() && voxel.distance_in_voxels().abs() < 0.6 {
                all.push((std::array::from_fn(|k| corner[k] + c[k] as i32), voxel.distance_in_voxels()));
            }
        }
    }
    all
}

fn distance_at(field: &TsdfField, c: [i32; 3]) -> Option<f32> {
    let block = field.block(field.find(block_key(c.map(|v| v >> 3)))?);
    let scale = usize::from(block.scale);
    let voxel = field.voxel(block, voxel_index(c.map(|v| (v & 7) as usize >> scale), scale));
    voxel.is_observed().then(|| voxel.distance_in_voxels() * (1 << scale) as f32)
}

/// Share of the surface of `one` that is missing in `other`, and the mean and the largest difference of the others, finest voxels.
fn differences(one: &TsdfField, other: &TsdfField) -> (f64, f64, f32) {
    differences_but_of(&HashSet::new(), one, other)
}

/// The same without some blocks.
fn differences_but_of(keys: &HashSet<u64>, one: &TsdfField, other: &TsdfField) -> (f64, f64, f32) {
    let (mut missing, mut sum, mut most, mut all) = (0, 0.0, 0f32, near_voxels(one));
    all.retain(|(at, _)| !keys.contains(&block_key(at.map(|v| v >> 3))));
    for (at, distance) in &all {
        match distance_at(other, *at) {
            None => missing += 1,
            Some(there) => {
                sum += f64::from((there - distance).abs());
                most = most.max((there - distance).abs());
            }
        }
    }
    assert!(all.len() > 20_000, "{} voxels", all.len());
    (f64::from(missing) / all.len() as f64, sum / all.len() as f64, most)
}

/// Fails unless two atlases have the same surface.
fn assert_same_surface(one: &Atlas, other: &Atlas) {
    let (one, other) = (OneField::new(one).field, OneField::new(other).field);
    for (a, b) in [(&one, &other), (&other, &one)] {
        let (missing, mean, most) = differences(a, b);
        println!("missing {missing:.5}, mean {mean:.4}, most {most:.3}");
        assert!(missing < 0.004 && mean < 0.03 && most < 0.5, "missing {missing}, mean {mean}, most {most}");
    }
}

fn image(atlas: &Atlas) -> Vec<(u64, Vec<crate::field::tsdf::Voxel>)> {
    let of = |submap: &Submap| {
        let field = submap.tsdf.clone();
        field.ids_in_morton_order().into_iter().map(move |id| (field.block(id).key, field.current(field.block(id)))).collect::<Vec<_>>()
    };
    atlas.submaps().iter().flat_map(of).collect()
}

#[test]
fn what_both_know_is_stored_once_and_the_surface_stays() {
    let (all, mut once) = (two(), two());
    let bytes = once.bytes();
    let count = hand_over(&mut once, None, &SETTINGS);
    let [first, second] = once.submaps() else { panic!() };
    first.tsdf.assert_invariants();
    second.tsdf.assert_invariants();
    // Half of the first is seen better by the second, and hardly anything the other way round.
    let from = |submap: &Submap| submap.handed_over.iter().map(|record| record.keys.len()).sum::<usize>();
    assert!(
        from(first) > all.submaps()[0].tsdf.len() / 4 && from(first) + from(second) == count,
        "{} of {}",
        from(first),
        all.submaps()[0].tsdf.len()
    );
    assert!(first.handed_over.iter().all(|record| record.to == 1 && record.keys.iter().all(|key| first.tsdf.find(*key).is_none())));
    assert!(once.bytes() * 10 < bytes * 9, "{} of {bytes} bytes", once.bytes());
    assert_same_surface(&all, &once);
    // Nothing is merged twice: no voxel has more observations than before in sum.
    let most = |atlas: &Atlas| image(atlas).into_iter().flat_map(|(_, voxels)| voxels).map(|voxel| voxel.weight).max();
    assert!(most(&once) <= most(&Atlas::from_submaps(VOXEL, vec![floor(0, Pose::identity(), 3.0, 5)])).map(|weight| weight + 2));
}

#[test]
fn a_correction_that_moves_submaps_apart_loses_nothing() {
    for moved in
        [Pose::translation(0.0, 0.0, 0.35), Pose::new(Vector3::new(0.3, 0.1, -0.2), Vector3::new(0.02, 0.0, 0.05)), Pose::translation(1.5, 40.0, 0.0)]
    {
        let (mut all, mut once) = (two(), two());
        let count = hand_over(&mut once, None, &SETTINGS);
        for atlas in [&mut all, &mut once] {
            atlas.submaps_mut()[1].t_map_submap = moved * turned();
        }
        let taken = take_back(&mut once, TakeBack::Moved);
        assert!(taken * 10 >= count * 9, "{taken} of {count}");
        // Each submap by itself has all that it had, at its place.
        for (before, now) in all.submaps().iter().zip(once.submaps()) {
            now.tsdf.assert_invariants();
            // What another submap still has lies within a voxel of where it was.
            let mut elsewhere: HashSet<u64> = HashSet::new();
            for HandedOver { to, t_to_submap, keys } in now.handed_over() {
                let t_now = now.t_map_submap.inv_mul(&(once.submap(*to).unwrap().t_map_submap * t_to_submap));
                for key in keys.iter() {
                    let middle = Point3::from(crate::octree::block_coords(*key).map(|c| (f64::from(c) + 0.5) * 0.8));
                    assert!((t_now * middle - middle).norm() < 1.01 * f64::from(VOXEL), "block {key}");
                }
                elsewhere.extend(keys.iter());
            }
            let (missing, mean, most) = differences_but_of(&elsewhere, &before.tsdf, &now.tsdf);
            println!("submap {}: missing {missing:.5}, mean {mean:.4}, most {most:.3}", now.id);
            assert!(missing < 0.004 && mean < 0.05 && most < 0.8, "submap {}: missing {missing}, mean {mean}, most {most}", now.id);
        }
    }
}

#[test]
fn small_corrections_take_nothing_back_and_all_can_be_taken_back() {
    let mut once = two();
    let count = hand_over(&mut once, None, &SETTINGS);
    once.submaps_mut()[1].t_map_submap = Pose::translation(0.0, 0.0, 0.04) * turned();
    let before = image(&once);
    assert_eq!(take_back(&mut once, TakeBack::Moved), 0);
    assert!(image(&once) == before && once.submaps()[0].handed_over.iter().any(|record| record.to == 1));
    assert_eq!(take_back(&mut once, TakeBack::All), count);
    assert!(once.submaps().iter().all(|submap| submap.handed_over.is_empty()));
    once.submaps_mut()[1].t_map_submap = turned();
    assert_same_surface(&two(), &once);
    // It can be handed over again.
    assert!(hand_over(&mut once, None, &SETTINGS) * 10 > count * 8);
}

#[test]
fn submaps_that_disagree_or_are_not_there_keep_what_they_have() {
    let apart = |t: Pose| {
        let mut atlas = two();
        atlas.submaps_mut()[1].t_map_submap = t * turned();
        let count = hand_over(&mut atlas, None, &SETTINGS);
        (count, atlas)
    };
    let (count, _) = apart(Pose::identity());
    let (above, _) = apart(Pose::translation(0.0, 0.0, 0.12));
    assert!(above * 20 < count, "{above} of {count}");
    for t in [Pose::translation(200.0, 0.0, 0.0), Pose::translation(f64::NAN, 0.0, 0.0)] {
        assert_eq!(apart(t).0, 0);
    }
    let mut kept = two();
    let before = image(&kept);
    hand_over(&mut kept, Some(0), &SETTINGS);
    assert!(kept.submaps()[0].handed_over.is_empty() && image(&kept) != before);
    // A submap whose other half is not there keeps its notes.
    let (_, whole) = apart(Pose::identity());
    let mut alone = Atlas::from_submaps(VOXEL, vec![whole.submaps()[0].clone()]);
    assert_eq!(take_back(&mut alone, TakeBack::All), 0);
    assert_eq!(alone.submaps()[0].handed_over, whole.submaps()[0].handed_over);
}

#[test]
fn corrections_of_scans_count() {
    let corrected = |by: f64| {
        let mut atlas = two();
        let submap = &mut atlas.submaps_mut()[0];
        submap.add_scan(7, &Pose::translation(-3.0, 0.0, 3.0));
        submap.corrected = vec![Pose::translation(-3.0, 0.0, 3.0 + by)];
        let count = hand_over(&mut atlas, None, &SETTINGS);
        (count, atlas)
    };
    let (as_it_is, mut atlas) = corrected(0.0);
    assert!(as_it_is > 0 && corrected(0.03).0 == as_it_is && corrected(0.08).0 == 0);
    atlas.submaps_mut()[0].corrected = vec![Pose::translation(-3.0, 0.0, 3.2)];
    assert_eq!(take_back(&mut atlas, TakeBack::Moved), as_it_is);
}

#[test]
fn the_result_does_not_depend_on_threads_and_surfaces_that_are_kept_follow() {
    let with_threads = |n: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| {
            let (mut atlas, mut kept) = (two(), FusedSurface::new(MeshOptions::default()));
            kept.update(&atlas);
            hand_over(&mut atlas, None, &SETTINGS);
            let handed = image(&atlas);
            kept.update(&atlas);
            let mesh = atlas.mesh(&MeshOptions::default());
            assert!(kept.mesh() == mesh && !mesh.triangles.is_empty());
            take_back(&mut atlas, TakeBack::All);
            kept.update(&atlas);
            assert!(kept.mesh() == atlas.mesh(&MeshOptions::default()));
            (handed, image(&atlas))
        })
    };
    assert!(with_threads(1) == with_threads(3));
}
