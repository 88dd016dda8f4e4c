//! Prints the arrows between crates and between the rooms of the crate `voxelastic`, with the number of references, and the cycles between files.

#![allow(clippy::print_stdout, clippy::print_stderr)]

use std::collections::BTreeMap;
use std::process::ExitCode;
use voxelastic_checks::checks::Workspace;
use voxelastic_checks::cycles::cycles;
use voxelastic_checks::layers::{CRATES, ROOMS};

fn main() -> ExitCode {
    match print() {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::FAILURE
        }
    }
}

fn print() -> Result<(), String> {
    let workspace = Workspace::this();
    println!("Crates, from low to high, and what they may import:");
    for (name, may) in CRATES {
        println!("  {name:<20} {}", may.join(", "));
    }
    let mut arrows: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
    for (from, to, _) in workspace.core()?.room_references() {
        *arrows.entry(from).or_default().entry(to).or_default() += 1;
    }
    println!("\nRooms of voxelastic, from low to high, and what they import (number of references):");
    for (name, _) in ROOMS {
        let imports = arrows.remove(*name).unwrap_or_default();
        println!("  {name:<20} {}", imports.iter().map(|(to, count)| format!("{to} ({count})")).collect::<Vec<_>>().join(", "));
    }
    println!("\nCycles between files:");
    let mut total = 0;
    for source in workspace.sources()? {
        for cycle in cycles(&source.references()) {
            total += 1;
            println!("  {}: {}", source.name(), cycle.join(", "));
        }
    }
    println!("  {total} in all");
    let problems = [workspace.crate_arrows()?, workspace.room_arrows()?, workspace.file_cycles()?, workspace.unsafe_files()?].concat();
    println!("\nWhat the tests of this crate fail on: {}", problems.len());
    problems.iter().for_each(|p| println!("  {p}"));
    Ok(())
}
