//! How long a loop closure takes on a graph that has grown: the optimiser in the stream beside one that solves the whole graph anew.
//!
//! ```text
//! cargo run --release -p voxelastic-slam --example closure_time -- [NODES] [EVERY]
//! ```
//! A drive over a grid of streets, closures at every EVERYth node where it was before; the last closures are timed both ways.
#![allow(clippy::print_stdout)]

#[path = "../tests/all/common/drive.rs"]
mod drive;
#[path = "../tests/all/common/numbers.rs"]
mod numbers;

use std::error::Error;
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_slam::graph::{LiveOptimiser, Options, Problem, optimise};

/// Closures that are solved as a batch, too.
const COMPARED: usize = 8;

fn main() -> Result<(), Box<dyn Error>> {
    let numbers: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let (nodes, every) = (numbers.first().copied().unwrap_or(5000), numbers.get(1).copied().unwrap_or(10));
    let drive = drive::drive(nodes, every, 1);
    println!("{nodes} nodes, {} closures", drive.closures.len());
    let mut live = LiveOptimiser::new(Options::default());
    let mut times = Vec::new();
    let mut edges: Vec<Edge> = Vec::new();
    for node in 0..nodes {
        for event in drive.events(node) {
            if let Event::OdometryEdge(edge) | Event::LoopEdge(edge) = &event {
                edges.push(edge.clone());
            }
            let before: Vec<(NodeId, Pose)> = if node + 200 > nodes { live.poses().to_vec() } else { Vec::new() };
            let (runs, clock) = (live.runs(), Instant::now());
            live.handle(event)?;
            let took = 1e3 * clock.elapsed().as_secs_f64();
            if live.runs() == runs {
                continue;
            }
            times.push((node, took));
            if let Some(done) = live.last().filter(|_| times.len().is_multiple_of(20) || !before.is_empty()) {
                println!("node {node}: {took:.1} ms, {done:?}");
            }
            if !before.is_empty() && times.iter().filter(|t| t.0 + 200 > nodes).count() <= COMPARED {
                let clock = Instant::now();
                let edges: Vec<Edge> = edges.iter().filter(|e| (e.from.max(e.to) as usize) < before.len()).cloned().collect();
                let solved = optimise(&Problem { nodes: &before, edges: &edges, fixed: &[] }, &Options::default())?;
                let batch = 1e3 * clock.elapsed().as_secs_f64();
                let off = solved.poses.iter().zip(live.poses()).map(|(a, b)| a.1.translation_distance(&b.1)).fold(0.0, f64::max);
                println!("  as a batch {batch:.1} ms, cost {:.9}; farthest node {:.2} mm apart", solved.cost, 1e3 * off);
            }
        }
    }
    let mut late: Vec<f64> = times.iter().filter(|t| 10 * t.0 >= 9 * nodes).map(|t| t.1).collect();
    late.sort_by(f64::total_cmp);
    println!("{} optimisations; in the last tenth: median {:.1} ms, most {:.1} ms", times.len(), late[late.len() / 2], late[late.len() - 1]);
    let error = |poses: &[Pose]| poses.iter().zip(&drive.truth).map(|(a, b)| a.translation_distance(b)).sum::<f64>() / nodes as f64;
    let poses: Vec<Pose> = live.poses().iter().map(|p| p.1).collect();
    println!("mean error: odometry {:.2} m, optimised {:.3} m", error(&drive.odometry), error(&poses));
    Ok(())
}
