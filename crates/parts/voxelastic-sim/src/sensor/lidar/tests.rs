//! Scans against the world they were taken in.

use super::*;
use crate::Scene;
use voxelastic::sensor::{preset, preset_with_columns};

type Outcome = Result<(), Box<dyn std::error::Error>>;

fn lidar(settings: LidarSettings) -> Result<Lidar, Box<dyn std::error::Error>> {
    Ok(Lidar::new(preset("os1-64")?, settings)?)
}

#[test]
fn points_without_noise_lie_on_the_surface_also_in_motion() -> Outcome {
    for moving in [false, true] {
        let lidar = lidar(LidarSettings { moving, noise: Noise::none(), ..LidarSettings::default() })?;
        for name in ["campus", "mine"] {
            let scene = Scene::named(name, 1)?;
            let pose_at = |t: f64| scene.trajectory.pose(40.0 + t);
            let cloud = lidar.scan(&scene.world, pose_at, &Stream::new(1, &[]));
            assert!(cloud.is_organised() && (cloud.height, cloud.width) == (64, 1024));
            let times = cloud.time.unwrap_or_default();
            let mut returns = 0;
            for (p, t) in cloud.points.iter().zip(times).filter(|(p, _)| Cloud::is_return(p)) {
                let q = pose_at(f64::from(t)) * nalgebra::Point3::from(p.map(f64::from));
                // The points are single precision: 1e-5 m at 120 m.
                assert!(scene.world.distance(q.coords.into()).abs() < 5e-5);
                assert!((0.0..0.1).contains(&t) && (moving || t == 0.0));
                returns += 1;
            }
            assert!(returns > 30_000, "{name}: {returns}");
        }
    }
    Ok(())
}

#[test]
fn result_does_not_depend_on_the_number_of_threads() -> Outcome {
    let lidar = lidar(LidarSettings { moving: true, ..LidarSettings::default() })?;
    let scene = Scene::named("campus", 1)?;
    let take = || lidar.scan(&scene.world, |t| scene.trajectory.pose(10.0 + t), &Stream::new(3, &[4])).points;
    let bits = |points: Vec<[f32; 3]>| points.into_iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build()?.install(take);
    let many = rayon::ThreadPoolBuilder::new().num_threads(5).build()?.install(take);
    assert_eq!(bits(alone), bits(many));
    Ok(())
}

#[test]
fn noise_has_the_requested_sigma() -> Outcome {
    let noise = Noise { range_sigma: 0.02, range_sigma_per_metre: 0.0, grazing: 0.0, mixed: 0.0, dropout: 0.1, ..Noise::none() };
    let lidar = lidar(LidarSettings { noise, ..LidarSettings::default() })?;
    let scene = Scene::named("room", 1)?;
    let pose = scene.trajectory.pose(0.0);
    let samples = lidar.sample(&scene.world, |_| pose);
    let cloud = lidar.scan(&scene.world, |_| pose, &Stream::new(3, &[4]));
    let (mut n, mut sum, mut squares) = (0.0f64, 0.0f64, 0.0f64);
    for row in 0..64 {
        for column in 0..1024 {
            let p = cloud.points[row * 1024 + column];
            if Cloud::is_return(&p) {
                let from_origin = Vec3::from(p.map(f64::from)) - lidar.beams[column * 64 + row].0;
                let error = from_origin.norm() - samples[column * 64 + row].range;
                (n, sum, squares) = (n + 1.0, sum + error, squares + error * error);
            }
        }
    }
    assert!((n / 65_536.0 - 0.9f64).abs() < 0.01, "{n} returns");
    assert!((sum / n).abs() < 3e-4 && ((squares / n).sqrt() - 0.02f64).abs() < 3e-4);
    Ok(())
}

#[test]
fn weak_returns_are_lost_and_edges_have_mixed_pixels() -> Outcome {
    let noise = Noise::default();
    let sample = |range, cosine, albedo| Sample { range, cosine, albedo, label: Label::Static };
    assert!(noise.detection_probability(&sample(100.0, 1.0, 0.8)) > 0.98 && noise.detection_probability(&sample(120.0, 1.0, 0.8)) < 0.51);
    assert!(noise.detection_probability(&sample(60.0, 1.0, 0.1)) < 0.01 && noise.detection_probability(&sample(20.0, 0.2, 0.1)) > 0.98);
    // There are some points between surfaces, but few.
    let scene = Scene::named("room", 1)?;
    let mixing = Noise { mixed: 0.5, mixed_depth: 3.0, ..Noise::none() };
    let mixed_pixels = |noise| -> Result<usize, Box<dyn std::error::Error>> {
        let cloud =
            lidar(LidarSettings { noise, ..LidarSettings::default() })?.scan(&scene.world, |_| scene.trajectory.pose(0.0), &Stream::new(1, &[]));
        let far = |p: &&[f32; 3]| {
            Cloud::is_return(p)
                && scene.world.distance((scene.trajectory.pose(0.0) * nalgebra::Point3::from(p.map(f64::from))).coords.into()).abs() > 0.03
        };
        Ok(cloud.points.iter().filter(far).count())
    };
    let count = mixed_pixels(mixing)?;
    assert!((100..2000).contains(&count), "{count}");
    assert_eq!(mixed_pixels(Noise::none())?, 0);
    Ok(())
}

#[test]
fn every_preset_scans_and_bad_settings_are_rejected() -> Outcome {
    let scene = Scene::named("room", 1)?;
    for name in voxelastic::sensor::preset_names() {
        let lidar = Lidar::new(preset_with_columns(name, 128)?, LidarSettings::default())?;
        let cloud = lidar.scan(&scene.world, |_| scene.trajectory.pose(1.0), &Stream::new(1, &[]));
        assert!(cloud.points.iter().filter(|p| Cloud::is_return(p)).count() > 9 * cloud.len() / 10, "{name}");
    }
    for settings in [
        LidarSettings { max_range: f64::NAN, ..LidarSettings::default() },
        LidarSettings { min_range: 5.0, max_range: 4.0, ..LidarSettings::default() },
        LidarSettings { period: 0.0, ..LidarSettings::default() },
        LidarSettings { noise: Noise { dropout: 1.5, ..Noise::default() }, ..LidarSettings::default() },
        LidarSettings { noise: Noise { range_sigma: -1.0, ..Noise::default() }, ..LidarSettings::default() },
        LidarSettings { noise: Noise { reach: f64::NAN, ..Noise::default() }, ..LidarSettings::default() },
    ] {
        assert!(matches!(lidar(settings), Err(e) if e.to_string().contains("must be")));
    }
    Ok(())
}
