//! `voxelastic optimize`: optimises a pose graph.

use crate::failure::{self, Failure};
use crate::output;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use voxelastic_io::{PoseGraph, g2o};
use voxelastic_slam::graph::{Options, Problem, optimise};

/// Optimise a pose graph
///
/// Finds the poses that minimise the residuals of all edges (Levenberg-Marquardt, from the poses in the file) and writes the graph with
/// them. A Huber kernel limits the influence of wrong loop edges.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic optimize graph.g2o -o optimized.g2o
  voxelastic optimize graph.g2o -o optimized.g2o --huber 0     plain least squares without a kernel")]
pub struct OptimizeArgs {
    /// The graph
    #[arg(value_name = "GRAPH.g2o")]
    graph: PathBuf,
    /// The graph to write
    #[arg(short, long, value_name = "OUT.g2o")]
    output: PathBuf,
    /// Residual of a loop edge from which the Huber kernel acts, standard deviations; 0 for no kernel
    #[arg(long, value_name = "K", default_value_t = 3.5, value_parser = deviations)]
    huber: f64,
    /// Largest number of iterations
    #[arg(long, value_name = "N", default_value_t = 100)]
    iterations: usize,
    /// Print the results as one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    #[serde(serialize_with = "crate::output::path")]
    output: PathBuf,
    nodes: usize,
    edges: usize,
    /// Half the sum of squared residuals in standard deviations, with the kernel if there is one.
    cost_before: f64,
    cost: f64,
    converged: bool,
    /// Edges whose information matrix is positive definite only without the terms between translation and rotation.
    uncoupled: usize,
    seconds: f64,
}

/// Runs the command.
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
        let what = "an information matrix that is not positive definite: its terms between translation and rotation were dropped";
        tracing::warn!("{} of {edges} edges have {what}", summary.uncoupled);
    }
    if !summary.converged {
        tracing::warn!("not converged after {} iterations; allow more with --iterations", args.iterations);
    }
    if args.json {
        output::print_json(&summary)?;
    }
    Ok(failure::DONE)
}

fn deviations(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|k: &f64| *k >= 0.0 && k.is_finite()).ok_or_else(|| "must be a number, 0 or more".to_owned())
}
