//! Loop closures found in a drive with true poses: which were tried, and how right they were.
//!
//! ```text
//! cargo run --release -p voxelastic-slam --example closures -- DATA ODOMETRY TRUTH [all]
//! ```
//! ODOMETRY and TRUTH name pose files in the folder DATA. Loop edges in the data are not used. `all` prints refused closures, too.
#![allow(clippy::print_stdout)]

use std::collections::HashMap;
use std::error::Error;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_eval::trajectory::{Fit as Alignment, ate, by_id};
use voxelastic_io::{OpenOptions, dataset};
use voxelastic_slam::graph::{LiveOptimiser, Options};
use voxelastic_slam::loops::{LoopFinder, LoopSettings, Verdict};

/// A closure is wrong beyond this distance or angle from the truth.
const WRONG: (f64, f64) = (2.0, 0.1);
/// Scans nearer than this are the same place, metres, if so much path lies in between.
const SAME_PLACE: (f64, f64) = (5.0, 50.0);

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [data, odometry, truth, rest @ ..] = arguments.as_slice() else { return Err("DATA ODOMETRY TRUTH".into()) };
    let open = |poses: &str| dataset::open(data, &OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() });
    let truth: HashMap<NodeId, Pose> = open(truth)?.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect();
    let drive = open(odometry)?;
    let mut finder = LoopFinder::new(LoopSettings::default());
    let mut optimiser = LiveOptimiser::new(Options::default());
    let clock = Instant::now();
    let mut reading = clock.elapsed();
    let mut events = drive.events();
    loop {
        let before = Instant::now();
        let Some(event) = events.next() else { break };
        reading += before.elapsed();
        let event = event?;
        if matches!(event, Event::LoopEdge(_) | Event::PoseUpdate(_)) {
            continue;
        }
        for edge in finder.take(&event) {
            optimiser.handle(Event::LoopEdge(edge))?;
        }
        optimiser.handle(event)?;
    }
    for edge in finder.finish() {
        optimiser.handle(Event::LoopEdge(edge))?;
    }
    optimiser.finish()?;
    let seconds = (clock.elapsed() - reading).as_secs_f64();
    let mut counts: HashMap<Verdict, (usize, usize)> = HashMap::new();
    for closure in finder.closures() {
        let Some((a, b)) = truth.get(&closure.from).zip(truth.get(&closure.to)) else { continue };
        let right = a.inv_mul(b);
        let off = closure.fit.map(|f| (f.t_first_second.translation_distance(&right), f.t_first_second.rotation_distance(&right)));
        let is_wrong = off.is_none_or(|(metres, radians)| metres > WRONG.0 || radians > WRONG.1);
        let count = counts.entry(closure.verdict).or_default();
        *(if is_wrong { &mut count.1 } else { &mut count.0 }) += 1;
        if closure.verdict == Verdict::Accepted || rest.iter().any(|r| r == "all") {
            let fit = closure.fit.map(|f| {
                format!(
                    "overlap {:.2} score {:.2} spread {:.3} contradiction {:.3}",
                    f.overlap,
                    f.score,
                    f.spread,
                    f.contradiction.unwrap_or(f64::NAN)
                )
            });
            println!(
                "{:?} {} {} apart {:.1} m, correlation {:.2}, {}, correction {:.1} m; off {}",
                closure.verdict,
                closure.from,
                closure.to,
                right.translation.vector.norm(),
                closure.correlation,
                fit.unwrap_or_default(),
                closure.correction_m,
                off.map_or("-".into(), |(m, r)| format!("{m:.2} m {:.2} degrees{}", r.to_degrees(), if is_wrong { " WRONG" } else { "" }))
            );
        }
    }
    println!("verdict: right, wrong");
    counts.iter().for_each(|(verdict, (right, wrong))| println!("  {verdict:?}: {right}, {wrong}"));
    let (revisits, closed) = recall(&drive, &truth, &finder);
    println!("scans that revisit: {revisits}, within 20 m of an end of a closure: {closed}");
    let reference: Vec<(NodeId, Pose)> = drive.scans().iter().map(|s| (s.node, truth[&s.node])).collect();
    let by_odometry: Vec<(NodeId, Pose)> = drive.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect();
    let error = |poses: &[(NodeId, Pose)]| ate(&by_id(&reference, poses), Alignment::Rigid).map(|a| (a.translation_m.rmse, a.translation_m.mean));
    println!(
        "absolute error (root mean square, mean): odometry {:.3?} m, closed {:.3?} m; {seconds:.1} s",
        error(&by_odometry)?,
        error(optimiser.poses())?
    );
    Ok(())
}

/// Scans that are where an earlier part of the drive was, and how many of them are near the later end of an accepted closure.
fn recall(drive: &voxelastic_io::Dataset, truth: &HashMap<NodeId, Pose>, finder: &LoopFinder) -> (usize, usize) {
    let poses: Vec<(NodeId, Pose)> = drive.scans().iter().map(|s| (s.node, truth[&s.node])).collect();
    let mut path = vec![0.0];
    poses.windows(2).for_each(|pair| path.push(path[path.len() - 1] + pair[0].1.translation_distance(&pair[1].1)));
    let ends: Vec<Pose> = finder.closures().iter().filter(|c| c.verdict == Verdict::Accepted).map(|c| truth[&c.to]).collect();
    let is_revisit = |k: usize| (0..k).any(|j| path[k] - path[j] > SAME_PLACE.1 && poses[j].1.translation_distance(&poses[k].1) < SAME_PLACE.0);
    let revisits: Vec<usize> = (0..poses.len()).filter(|k| is_revisit(*k)).collect();
    let closed = revisits.iter().filter(|k| ends.iter().any(|end| end.translation_distance(&poses[**k].1) < 20.0)).count();
    (revisits.len(), closed)
}
