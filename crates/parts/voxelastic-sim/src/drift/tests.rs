//! Magnitude of drift, and accuracy of loop edges and corrections.

use super::gaussian::information;
use super::odometry::path_lengths;
use super::*;
use crate::random::Stream;
use crate::{Scene, SimError};
use nalgebra::Vector3;
use voxelastic::Pose;
use voxelastic::geometry::PoseExt;

fn truth(name: &str, scans: usize) -> Result<(Scene, Vec<Pose>), SimError> {
    let scene = Scene::named(name, 1)?;
    let step = 2.0 / scene.trajectory.carrier.speed;
    let poses = (0..scans).map(|k| scene.trajectory.pose(k as f64 * step)).collect();
    Ok((scene, poses))
}

#[test]
fn odometry_has_the_requested_drift_on_every_route_and_seed() -> Result<(), SimError> {
    for name in ["campus", "mine", "street"] {
        let (_, truth) = truth(name, 210)?;
        let mut ends = 0.0;
        let mut worst = [0.0f64; 3];
        for seed in 0..20 {
            for rate in [1.0, 0.3, 3.0] {
                let odometry = drifting_odometry(&truth, rate, &Stream::new(seed, &[]));
                let drift = mean_drift(&truth, &odometry).unwrap_or(0.0);
                assert!((drift - rate).abs() < 0.02 * rate, "{name} {seed}: {drift} for {rate}");
                assert_eq!(odometry[0], truth[0]);
                // Gravity holds roll and pitch; neighbours agree.
                for k in 1..truth.len() {
                    let up = odometry[k].rotation.inverse() * Vector3::z();
                    let true_up = truth[k].rotation.inverse() * Vector3::z();
                    let (a, b) = (truth[k - 1].inv_mul(&truth[k]), odometry[k - 1].inv_mul(&odometry[k]));
                    worst = [
                        worst[0].max(a.translation_distance(&b) / rate),
                        worst[1].max(a.rotation_distance(&b) / rate),
                        worst[2].max(up.angle(&true_up)),
                    ];
                }
                ends += if rate == 1.0 { odometry[209].translation_distance(&truth[209]) / 20.0 } else { 0.0 };
            }
        }
        assert!(ends > 0.5 && worst[0] < 0.08 && worst[1] < 0.004 && worst[2] < 0.002, "{name}: {worst:?}");
    }
    Ok(())
}

#[test]
fn zero_drift_is_the_truth_and_short_paths_do_not_panic() -> Result<(), SimError> {
    let (_, truth) = truth("campus", 50)?;
    assert_eq!(drifting_odometry(&truth, 0.0, &Stream::new(1, &[])), truth);
    for count in [0, 1, 2, 3] {
        assert_eq!(drifting_odometry(&truth[..count], 1.0, &Stream::new(1, &[])).len(), count);
        assert_eq!(odometry_edges(&truth[..count], 1.0).len(), count.saturating_sub(1));
    }
    let still = vec![truth[0]; 5];
    assert_eq!(drifting_odometry(&still, 1.0, &Stream::new(1, &[])).len(), 5);
    assert_eq!(mean_drift(&still, &still), None);
    Ok(())
}

#[test]
fn odometry_edges_chain_to_the_odometry() -> Result<(), SimError> {
    let (_, truth) = truth("campus", 60)?;
    let odometry = drifting_odometry(&truth, 1.0, &Stream::new(1, &[]));
    let end = odometry_edges(&odometry, 1.0).iter().fold(odometry[0], |pose, edge| pose * edge.t_from_to);
    assert!(end.translation_distance(&odometry[59]) < 1e-9);
    Ok(())
}

#[test]
fn loop_edges_and_corrections_are_accurate() -> Result<(), SimError> {
    for (name, scans, least) in [("campus", 210, 3), ("mine", 210, 6), ("street", 400, 25)] {
        let (scene, truth) = truth(name, scans)?;
        let settings = LoopSettings::default();
        let loops = find_loops(&scene.world, &truth, &settings, &Stream::new(2, &[]));
        let travelled = path_lengths(&truth);
        assert!(loops.len() >= least, "{name}: {}", loops.len());
        for edge in &loops {
            let (i, j) = (edge.from as usize, edge.to as usize);
            assert!(travelled[j] - travelled[i] >= settings.least_path && truth[i].translation_distance(&truth[j]) <= settings.radius);
            let measured = truth[i] * edge.t_from_to;
            assert!(measured.translation_distance(&truth[j]) < 0.2 && measured.rotation_distance(&truth[j]) < 0.01);
        }
        assert!(loops.windows(2).all(|w| travelled[w[1].to as usize] - travelled[w[0].to as usize] >= settings.spacing));
        for c in corrections(&truth, &loops, &Stream::new(3, &[])) {
            assert_eq!(c.poses.len() as u64, c.node + 1);
            let worst = c.poses.iter().zip(&truth).map(|(a, b)| a.translation_distance(b)).fold(0.0, f64::max);
            assert!((0.01..0.2).contains(&worst), "{worst}");
            assert!(c.poses.iter().zip(&truth).all(|(a, b)| a.rotation_distance(b) < 0.004));
        }
        assert!(find_loops(&scene.world, &truth, &LoopSettings { radius: 0.0, ..settings }, &Stream::new(2, &[])).is_empty());
    }
    Ok(())
}

#[test]
fn information_is_the_inverse_variance_on_the_diagonal() {
    let upper = information([0.1, 0.2, 0.5, 1.0, 2.0, 4.0]);
    let diagonal = [0, 6, 11, 15, 18, 20].map(|k| upper[k]);
    assert!(diagonal.iter().zip([100.0, 25.0, 4.0, 1.0, 0.25, 0.0625]).all(|(a, b)| (a - b).abs() < 1e-9));
    assert_eq!(upper.iter().filter(|&&v| v != 0.0).count(), 6);
}
