//! `voxelastic optimize`: the poses of a graph that agree best with its edges.

use crate::failure::{self, Failure};
use crate::output;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use voxelastic_io::{PoseGraph, g2o};
use voxelastic_optimize::{Options, Problem, optimise};

/// Optimise a pose graph
///
/// Finds the node poses that agree best with all edges (Levenberg-Marquardt, starting from the poses in the file) and writes the graph with
/// them. Loop edges that contradict all others are toned down by a Huber kernel.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic optimize graph.g2o -o optimized.g2o
  voxelastic optimize graph.g2o -o optimized.g2o --huber 0     plain least squares, every edge counts fully")]
pub struct OptimizeArgs {
    /// The graph
    #[arg(value_name = "GRAPH.g2o")]
    graph: PathBuf,
    /// The graph to write
    #[arg(short, long, value_name = "OUT.g2o")]
    output: PathBuf,
    /// Standard deviations up to which a loop edge counts fully; 0 for no limit
    #[arg(long, value_name = "K", default_value_t = 3.5, value_parser = deviations)]
    huber: f64,
    /// Most iterations
    #[arg(long, value_name = "N", default_value_t = 100)]
    iterations: usize,
    /// Print one JSON object with the figures on stdout
    #[arg(long)]
    json: bool,
}

/// The figures: the keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    output: PathBuf,
    nodes: usize,
    edges: usize,
    /// Half the sum of squares of the residuals, each in standard deviations, by the kernel where there is one.
    cost_before: f64,
    cost: f64,
    converged: bool,
    /// Edges whose information matrix was not positive definite until what couples translation and rotation was left out.
    uncoupled: usize,
    seconds: f64,
}

/// Optimises the graph.
pub fn run(args: &OptimizeArgs) -> anyhow::Result<u8> {
    let mut graph: PoseGraph = g2o::read(&args.graph)?;
    let clock = Instant::now();
    let options = Options { huber: (args.huber > 0.0).then_some(args.huber), max_iterations: args.iterations };
    let problem = Problem { nodes: &graph.nodes, edges: &graph.edges, fixed: &graph.fixed };
    let solved = optimise(&problem, &options).map_err(|e| Failure::new(format!("{}: {e}", args.graph.display()), ""))?;
    let summary = Summary {
        output: args.output.clone(),
        nodes: graph.nodes.len(),
        edges: graph.edges.len(),
        cost_before: solved.cost_before,
        cost: solved.cost,
        converged: solved.is_converged,
        uncoupled: solved.uncoupled,
        seconds: clock.elapsed().as_secs_f64(),
    };
    graph.nodes = solved.poses;
    g2o::write(&args.output, &graph)?;
    let Summary { nodes, edges, cost_before, cost, seconds, .. } = summary;
    tracing::info!("{nodes} nodes, {edges} edges: cost {cost_before:.6} before, {cost:.6} after, {seconds:.2} s");
    if summary.uncoupled > 0 {
        let what = "an information matrix that is not positive definite: what couples translation and rotation in it was left out";
        tracing::warn!("{} of {edges} edges have {what}", summary.uncoupled);
    }
    if !summary.converged {
        tracing::warn!("still improving after {} iterations; allow more with --iterations", args.iterations);
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(failure::DONE)
}

fn deviations(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|k: &f64| *k >= 0.0 && k.is_finite()).ok_or_else(|| "must be a number, 0 or more".to_owned())
}
