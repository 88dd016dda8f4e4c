//! Alignment against known motions, and its answers to bad input.

use super::*;
use crate::EvalError;
use nalgebra::{Translation3, UnitQuaternion};
use voxelastic::geometry::PoseExt;

/// A building with an L-shaped plan, pillars and a sloping roof, about 24 x 16 x 5 m: points with 1 cm noise.
pub(crate) fn building(seed: u64, n: usize) -> Vec<[f32; 3]> {
    let mut state = seed;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32
    };
    let mut point = move || {
        let (a, b, noise) = (random(), random(), (random() + random() + random() - 1.5) * 0.02);
        match (random() * 10.0) as u32 {
            0..=2 => [a * 24.0, b * 16.0, noise],
            3 => [a * 24.0, noise, b * 5.0],
            4 => [noise, a * 16.0, b * 5.0],
            5 => [24.0 + noise, a * 9.0, b * 4.0],
            6 => [14.0 + noise, 9.0 + a * 7.0, b * 4.0],
            7 => [14.0 + a * 10.0, 9.0 + noise, b * 4.0],
            8 => [a * 24.0, b * 9.0, 4.0 + 0.12 * b * 9.0 + noise],
            _ => {
                let angle = a * std::f32::consts::TAU;
                let r = 0.4 + noise;
                [7.0 + 6.0 * (b * 3.0).floor() + r * angle.cos(), 5.0 + r * angle.sin(), (b * 3.0).fract() * 4.0]
            }
        }
    };
    (0..n).map(|_| point()).collect()
}

fn motion(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Pose {
    Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

#[test]
fn recovers_known_motions_with_a_fifth_of_outliers() {
    let target = building(1, 60_000);
    for t in [motion(0.8, -0.5, 0.3, 0.01, -0.02, 0.06), motion(-1.0, 0.9, -0.2, 0.0, 0.0, -0.08), Pose::identity()] {
        let mut source = moved(&building(2, 40_000), &t.inverse());
        source.extend((0..10_000).map(|i| [(i % 100) as f32 * 0.1 + 3.0, (i / 100) as f32 * 0.1 + 2.0, 1.5 + (i as f32 * 0.7).sin()]));
        let found = align(&source, &target, &AlignSettings::default()).unwrap();
        let (dt, dr) = (found.t_target_source.translation_distance(&t), found.t_target_source.rotation_distance(&t));
        assert!(dt < 0.008 && dr < 5e-4, "{dt} m, {dr} rad, {:?}", found.quality);
        assert!(found.quality.converged && found.quality.overlap > 0.6 && found.quality.undetermined == 0, "{:?}", found.quality);
    }
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() {
    let (source, target) = (moved(&building(3, 20_000), &motion(0.3, 0.2, 0.0, 0.0, 0.0, 0.03)), building(4, 20_000));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| align(&source, &target, &AlignSettings::default()).unwrap().t_target_source)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn undetermined_directions_keep_the_initial_guess() {
    let plane: Vec<[f32; 3]> = (0..10_000).map(|i| [(i % 100) as f32 * 0.1, (i / 100) as f32 * 0.1, 0.0]).collect();
    let found = align(&moved(&plane, &motion(0.0, 0.0, 0.3, 0.0, 0.0, 0.0)), &plane, &AlignSettings::default()).unwrap();
    assert_eq!(found.quality.undetermined, 3);
    assert!(found.t_target_source.translation_distance(&motion(0.0, 0.0, -0.3, 0.0, 0.0, 0.0)) < 1e-3);
}

#[test]
fn empty_disjoint_and_wrongly_scaled_clouds_are_rejected() {
    let cloud = building(5, 5000);
    let error = |source: &[[f32; 3]], target: &[[f32; 3]]| align(source, target, &AlignSettings::default()).unwrap_err();
    assert!(matches!(error(&[], &cloud), EvalError::Empty { what: "the source cloud", .. }));
    assert!(matches!(error(&cloud, &[[f32::NAN; 3]]), EvalError::Empty { what: "the target cloud", .. }));
    let far: Vec<[f32; 3]> = cloud.iter().map(|p| [p[0] + 500.0, p[1], p[2]]).collect();
    let disjoint = error(&far, &cloud).to_string();
    assert!(disjoint.contains("disjoint") && disjoint.contains("map frame"), "{disjoint}");
    for (factor, unit) in [(1000.0, "millimetres"), (100.0, "centimetres"), (1.0 / 0.3048, "feet")] {
        let scaled: Vec<[f32; 3]> = cloud.iter().map(|p| p.map(|c| c * factor)).collect();
        for (text, culprit) in [(error(&scaled, &cloud), "source"), (error(&cloud, &scaled), "target")] {
            let text = text.to_string();
            assert!(text.contains(unit) && text.contains(culprit), "{text}");
        }
    }
    let settings = AlignSettings { voxels: vec![1.0, -1.0], ..AlignSettings::default() };
    assert!(matches!(align(&cloud, &cloud, &settings), Err(EvalError::Setting { .. })));
    let settings = AlignSettings { t_target_source: motion(f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0), ..AlignSettings::default() };
    assert!(matches!(align(&cloud, &cloud, &settings), Err(EvalError::Setting { .. })));
}

#[test]
fn aligns_a_part_to_the_whole() {
    let whole = building(6, 60_000);
    let t = motion(0.4, 0.3, -0.1, 0.0, 0.01, 0.03);
    let part: Vec<[f32; 3]> = building(7, 60_000).into_iter().filter(|p| p[0] < 10.0 && p[1] < 10.0).collect();
    let found = align(&moved(&part, &t.inverse()), &whole, &AlignSettings::default()).unwrap();
    assert!(found.t_target_source.translation_distance(&t) < 0.02, "{:?}", found);
}
