//! Refinement of poses against the truth, round by round.
//!
//! ```text
//! cargo run --release -p voxelastic-slam --example refine -- DATA POSES [TRUTH] [key=value ..]
//! ```
//! POSES and TRUTH name pose files in the folder DATA. Keys: `cell`, `every`, `most`, `noise` (metres of white noise on the poses).
#![allow(clippy::print_stdout)]

use std::collections::HashMap;
use std::error::Error;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId};
use voxelastic_eval::trajectory::{Fit, ate, by_id};
use voxelastic_io::{OpenOptions, dataset};
use voxelastic_slam::refine::{RefineSettings, ScanSurface, refine};

fn main() -> Result<(), Box<dyn Error>> {
    let (keys, names): (Vec<String>, Vec<String>) = std::env::args().skip(1).partition(|a| a.contains('='));
    let [data, given, rest @ ..] = names.as_slice() else { return Err("DATA POSES [TRUTH]".into()) };
    let value = |key: &str| keys.iter().find_map(|k| k.strip_prefix(&format!("{key}=")).and_then(|v| v.parse::<f64>().ok()));
    let open = |poses: &str| dataset::open(data, &OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() });
    let drive = open(given)?;
    let truth: Option<HashMap<NodeId, Pose>> =
        rest.first().map(|truth| Ok::<_, Box<dyn Error>>(open(truth)?.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect())).transpose()?;
    let cell = value("cell").unwrap_or(0.2);
    let clock = Instant::now();
    let (mut nodes, mut times, mut poses, mut scans) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for event in drive.events() {
        if let Event::Scan(scan) = event? {
            nodes.push(scan.node);
            times.push(scan.time);
            poses.push(scan.t_map_lidar);
            let far = value("range").unwrap_or(1e9) as f32;
            let points: Vec<[f32; 3]> =
                scan.cloud.points.iter().filter(|p| voxelastic::Cloud::is_return(p) && p[0].hypot(p[1]).hypot(p[2]) < far).copied().collect();
            scans.push(ScanSurface::of(&points, cell as f32));
        }
        if value("most").is_some_and(|most| scans.len() as f64 >= most) {
            break;
        }
    }
    let noise = value("noise").unwrap_or(0.0);
    for (k, pose) in poses.iter_mut().enumerate() {
        let random = |i: usize| ((k * 6 + i) as f64 * 12.9898).sin() * 43758.5453 % 1.0;
        let turn = nalgebra::Vector3::new(random(0), random(1), random(2)) * noise * 0.1;
        let step = nalgebra::Vector3::new(random(3), random(4), random(5)) * noise * 1.7;
        *pose *= Pose::new(step, turn);
    }
    let surfels: usize = scans.iter().map(ScanSurface::len).sum();
    let planarity = scans.iter().map(ScanSurface::planarity).sum::<f64>() / scans.len() as f64;
    println!(
        "{} scans, {} surfels a scan, {planarity:.2} planar, read in {:.1} s",
        scans.len(),
        surfels / scans.len(),
        clock.elapsed().as_secs_f64()
    );
    let error = |poses: &[Pose]| {
        let reference: Vec<(NodeId, Pose)> = nodes.iter().filter_map(|n| Some((*n, *truth.as_ref()?.get(n)?))).collect();
        let poses: Vec<(NodeId, Pose)> = nodes.iter().copied().zip(poses.iter().copied()).collect();
        ate(&by_id(&reference, &poses), Fit::Rigid).map_or(f64::NAN, |a| 100.0 * a.translation_m.rmse)
    };
    let mut settings = RefineSettings::default();
    if let Some(v) = value("cube") {
        settings.cube = v;
    }
    if let Some(v) = value("halvings") {
        settings.halvings = v as u32;
    }
    if let Some(v) = value("points") {
        settings.most_points = v;
    }
    if let Some(v) = value("sigma") {
        settings.sigma = v;
    }
    if let Some(v) = value("held") {
        settings.held = [0.1 * v, v];
    }
    if let Some(v) = value("rough") {
        settings.roughness = v;
    }
    if let Some(v) = value("steps") {
        settings.steps = v as usize;
    }
    if let Some(v) = value("gain") {
        settings.least_gain = v;
    }
    let show = |what: &str, j: &voxelastic_slam::refine::Judgement, poses: &[Pose], time: f64| {
        println!(
            "{what:18} planes {:6} thick {:.2} / {:.2} cm, near {:.3} at {:.3} cm, score {:.4}; truth {:.2} cm; {time:.1} s",
            j.planes,
            100.0 * j.thickness_m,
            100.0 * j.thickness_90_m,
            j.near,
            100.0 * j.distance_m,
            j.score,
            error(poses)
        );
    };
    let clock = Instant::now();
    let refined = refine(&poses, &scans, &[], cell, &settings)?;
    show("before", &refined.before, &poses, 0.0);
    for round in &refined.rounds {
        show(&format!("gate {:.2} {} {}", round.gate_m, round.planes, if round.is_kept { "kept" } else { "not" }), &round.judgement, &poses, 0.0);
    }
    let now = refined.poses;
    if let Some(file) = keys.iter().find_map(|k| k.strip_prefix("out=")) {
        voxelastic_io::poses::write_tum(file, &times.iter().copied().zip(now.iter().copied()).collect::<Vec<_>>())?;
    }
    show("after", &refined.after, &now, clock.elapsed().as_secs_f64());
    if let Some(truth) = &truth {
        let truth: Vec<Pose> = nodes.iter().map(|n| truth[n]).collect();
        // Each pose against the truth after the best rigid alignment of positions, by axes.
        let shift: Vec<Pose> = now.iter().zip(&truth).map(|(p, t)| t.inv_mul(p)).collect();
        let mean_q = shift.iter().map(|s| s.rotation.scaled_axis()).sum::<nalgebra::Vector3<f64>>() / shift.len() as f64;
        let spread = shift.iter().map(|s| (s.rotation.scaled_axis() - mean_q).map(|v| v * v)).sum::<nalgebra::Vector3<f64>>() / shift.len() as f64;
        println!(
            "angles off, degrees: mean {:.4} {:.4} {:.4}, spread {:.4} {:.4} {:.4}",
            mean_q.x.to_degrees(),
            mean_q.y.to_degrees(),
            mean_q.z.to_degrees(),
            spread.x.sqrt().to_degrees(),
            spread.y.sqrt().to_degrees(),
            spread.z.sqrt().to_degrees()
        );
        let (a, b): (Vec<_>, Vec<_>) = now.iter().zip(&truth).map(|(p, t)| (p.translation.vector, t.translation.vector)).unzip();
        let n = a.len() as f64;
        let (ca, cb) = (a.iter().sum::<nalgebra::Vector3<f64>>() / n, b.iter().sum::<nalgebra::Vector3<f64>>() / n);
        let cross = a.iter().zip(&b).map(|(a, b)| (b - cb) * (a - ca).transpose()).sum::<nalgebra::Matrix3<f64>>();
        let svd = cross.svd(true, true);
        let r = svd.u.unwrap() * svd.v_t.unwrap();
        let off: Vec<nalgebra::Vector3<f64>> = a.iter().zip(&b).map(|(a, b)| r * (a - ca) - (b - cb)).collect();
        let rms = off.iter().map(|o| o.component_mul(o)).sum::<nalgebra::Vector3<f64>>() / n;
        println!("off, cm: {:.3} {:.3} {:.3}", 100.0 * rms.x.sqrt(), 100.0 * rms.y.sqrt(), 100.0 * rms.z.sqrt());
        if keys.iter().any(|k| k == "each=1") {
            off.iter().enumerate().step_by(6).for_each(|(k, o)| println!("{k} {:.2} {:.2} {:.2}", 100.0 * o.x, 100.0 * o.y, 100.0 * o.z));
        }
    }
    if let Some(truth) = &truth {
        settings.gates = Vec::new();
        let truth: Vec<Pose> = nodes.iter().map(|n| truth[n]).collect();
        show("truth", &refine(&truth, &scans, &[], cell, &settings)?.before, &truth, 0.0);
    }
    Ok(())
}
