//! `voxelastic bench`: time, memory and error at the paper's settings, beside other systems, and how they grow.

use crate::failure::{self, Failure};
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic_bench::peers::{self, Peer};
use voxelastic_bench::suite::{self, Options};
use voxelastic_bench::{Workshop, growth, plots, table};

/// Names the folder with real scans, as for the tests.
const DATA_VARIABLE: &str = "VOXELASTIC_DATA";
/// Where it is when nothing is said.
const DATA_FOLDER: &str = "../shared/data";
/// Names the Python that has the packages of peers.
const PYTHON_VARIABLE: &str = "VOXELASTIC_PYTHON";

/// Measure speed, memory and error, beside other systems on the same scans
///
/// The paper's three settings, both fields, one thread and two, on a simulated campus and on real scans where they are found ($VOXELASTIC_DATA,
/// by default ../shared/data). Each configuration is mapped by a process of its own, so that its peak of memory is its own, and the map is
/// measured against the world or against scans that were held out. What is printed ends with the project's goals; the folder then holds
/// bench.json (or growth.json) and plots. Ten minutes and a quiet machine are needed; with --quick a minute.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic bench --quick                                the hardest setting on 60 scans, to see what a change does
  voxelastic bench --peers -o bench                       all of it, with OctoMap and VDBFusion on the same scans
  voxelastic bench --growth                               how cost grows with rings, range, voxels and submaps
  voxelastic bench --peer \"Bonxai=python3 bonxai.py\"      another system, through an adapter of yours

They are run through Python: `pip install pyoctomap vdbfusion` (VDBFusion has packages up to Python 3.10), and VOXELASTIC_PYTHON names
the Python that has them [default: python3].
What an adapter is told and must answer is written in crates/voxelastic-bench/src/peers/mod.rs.")]
pub struct BenchArgs {
    /// The folder for results and simulated scans; scans that are there are used again
    #[arg(short, long, value_name = "DIR", default_value = "voxelastic-bench")]
    output: PathBuf,
    /// The hardest setting only, on 60 scans of the campus, without errors
    #[arg(long, conflicts_with = "growth")]
    quick: bool,
    /// How cost grows, instead: tables with fitted exponents, and what new road costs
    #[arg(long, conflicts_with_all = ["peers", "peer", "repeat"])]
    growth: bool,
    /// Run OctoMap and VDBFusion on the same scans, in between
    #[arg(long)]
    peers: bool,
    /// Run another system in between, through an adapter
    #[arg(long, value_name = "NAME=COMMAND", value_parser = peer)]
    peer: Vec<Peer>,
    /// Seconds that a peer has for one configuration; how many scans it did is told
    #[arg(long, value_name = "S", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    peer_limit: u64,
    /// Run each configuration so often; the middle one counts
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=99))]
    repeat: u64,
    /// A folder that `voxelastic simulate campus -o DIR` made, so that it is not made again
    #[arg(long, value_name = "DIR")]
    campus: Option<PathBuf>,
    /// Print the results as one JSON object on stdout, instead of the tables
    #[arg(long)]
    json: bool,
}

fn peer(text: &str) -> Result<Peer, String> {
    Peer::parse(text).ok_or_else(|| "must be a name, =, and a command".to_owned())
}

/// Measures.
pub fn run(args: &BenchArgs) -> anyhow::Result<u8> {
    let program = std::env::current_exe().context("cannot find this program, which is to be measured")?;
    let data = std::env::var_os(DATA_VARIABLE).map_or_else(|| PathBuf::from(DATA_FOLDER), PathBuf::from);
    let shop = Workshop::open(program, args.output.clone())?;
    if args.growth {
        let found = growth::run(&shop, &data, args.campus.as_deref())?;
        return finish(args, "growth.json", &found, &table::growth(&found));
    }
    let options = Options {
        quick: args.quick,
        peers: peers(args, &shop)?,
        peer_limit: Duration::from_secs(args.peer_limit),
        repeat: args.repeat as usize,
        real_data: data,
        campus: args.campus.clone(),
    };
    let found = suite::run(&shop, &options)?;
    for file in plots::write(&found, shop.folder())? {
        tracing::info!("wrote {}", file.display());
    }
    finish(args, "bench.json", &found, &table::suite(&found))
}

fn peers(args: &BenchArgs, shop: &Workshop) -> anyhow::Result<Vec<Peer>> {
    let mut all = Vec::new();
    if args.peers {
        let python = std::env::var(PYTHON_VARIABLE).unwrap_or_else(|_| "python3".to_owned());
        all.extend(peers::through_python(shop, &python)?);
    }
    all.extend(args.peer.iter().cloned());
    Ok(all)
}

/// Keeps the results and shows them.
fn finish(args: &BenchArgs, name: &str, found: &impl Serialize, text: &str) -> anyhow::Result<u8> {
    let path: &Path = &args.output.join(name);
    let json = serde_json::to_string(found).context("cannot write the results as JSON")?;
    fs::write(path, json + "\n").map_err(|e| Failure::new(format!("{}: {e}", path.display()), "choose another folder with -o"))?;
    tracing::info!("wrote {}", path.display());
    if args.json {
        output::print_json(found)?;
    } else {
        output::print(text)?;
    }
    Ok(failure::DONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peers_need_a_name_and_a_command() {
        assert_eq!(peer("Bonxai=python3 bonxai.py").unwrap().command.len(), 2);
        assert!(peer("bonxai.py").unwrap_err().contains("a name"));
    }
}
