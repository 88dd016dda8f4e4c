//! Instructions and allocations of small fixed cases, compared with recorded ones: a regression test without noise.
//!
//!     cargo run --release -p voxelastic-bench --example counts              # compares; fails beyond 3 %
//!     cargo run --release -p voxelastic-bench --example counts -- --record  # after an intended change
//!
//! Needs valgrind, which counts instead of timing: callgrind the instructions, dhat the allocations and the peak of memory. It does not
//! support AVX-512, so the kernels run as compiled for AVX2. Counts depend on the compiler and the build profile, which are recorded with them. The count
//! of a case is its difference to the case that it contains: `read` reads the clouds, `tsdf` maps them, `mesh` meshes that map, and so on.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use voxelastic::event::{Event, Scan};
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::surface::{MeshOptions, extract};
use voxelastic::{Mapper, Pose};
use voxelastic_io::pcd;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// The cases, each with the one that it contains.
const CASES: [(&str, Option<&str>); 6] = [
    ("read", None),
    ("tsdf", Some("read")),
    ("mesh", Some("tsdf")),
    ("occupancy", Some("read")),
    ("submaps", Some("read")),
    ("fusion", Some("submaps")),
];
/// Share by which a count may differ. Changes of the compiler and of the code are larger; hash seeds and waiting threads cause far less.
const TOLERANCE: f64 = 0.03;
const SCANS: usize = 4;
const RECORD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/counts.json");

/// Counts of a case without those of the case that it contains.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Counts {
    instructions: i64,
    allocations: i64,
    allocated_bytes: i64,
    /// Of the whole case.
    peak_bytes: i64,
}

/// The recorded counts and what they belong to.
#[derive(Debug, Serialize, Deserialize)]
struct Record {
    built_by: String,
    counts: BTreeMap<String, Counts>,
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["case", name, folder] => case(name, Path::new(folder)),
        [] => compare(&measure()?),
        ["--record"] => {
            let record = Record { built_by: built_by(), counts: measure()? };
            fs::write(RECORD, serde_json::to_string_pretty(&record)? + "\n")?;
            println!("recorded {} cases of {}", record.counts.len(), record.built_by);
            Ok(())
        }
        _ => Err("nothing, or --record".into()),
    }
}

fn built_by() -> String {
    let version = Command::new("rustc").arg("--version").output().map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
    let profile = if cfg!(debug_assertions) { "development" } else { "release" };
    format!("{}, {profile} profile, {}", version.unwrap_or_default(), std::env::consts::ARCH)
}

/// The counted work, in its own process.
fn case(name: &str, folder: &Path) -> Result<()> {
    let clouds = (0..SCANS).map(|k| Ok(pcd::read(folder.join(format!("{k}.pcd")))?.cloud)).collect::<Result<Vec<_>>>()?;
    if name == "read" {
        return Ok(());
    }
    let field = if name == "occupancy" { FieldKind::Occupancy } else { FieldKind::Tsdf };
    let is_split = matches!(name, "submaps" | "fusion");
    let settings =
        Settings { voxel_size: 0.1, max_range: 30.0, lambda_odom: if is_split { 1.5 } else { 1e3 }, min_overlap: 1.0, field, ..Settings::default() };
    let pool = rayon_of_one()?;
    pool.install(|| -> Result<()> {
        let voxel = settings.voxel_size;
        let mut mapper = Mapper::new(settings)?;
        for (node, cloud) in (0..).zip(clouds) {
            let t_map_lidar = Pose::translation(node as f64, 0.0, 0.0);
            mapper.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar, cloud }))?;
        }
        if name == "fusion" {
            let edge = voxelastic::event::Edge {
                from: 0,
                to: SCANS as u64 - 1,
                t_from_to: Pose::translation(SCANS as f64 - 1.0, 0.0, 0.0),
                information: None,
            };
            mapper.handle(Event::LoopEdge(edge))?;
            mapper.finish();
        }
        if name == "mesh" {
            let triangles: usize = mapper.atlas().submaps().iter().map(|s| extract(s.tsdf(), voxel, &MeshOptions::default()).triangles.len()).sum();
            assert!(triangles > 1000, "{triangles} triangles");
        }
        Ok(())
    })
}

fn rayon_of_one() -> Result<rayon::ThreadPool> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(1).build()?)
}

fn measure() -> Result<BTreeMap<String, Counts>> {
    let folder = std::env::temp_dir().join(format!("voxelastic-counts-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    let measured = write_clouds(&folder).and_then(|()| count_all(&folder));
    fs::remove_dir_all(&folder)?;
    measured
}

/// Scans of a room with 64 x 256 beams, one metre apart.
fn write_clouds(folder: &Path) -> Result<()> {
    let options = SimOptions { columns: Some(256), scans: Some(SCANS), spacing: 1.0, ..SimOptions::of("room") };
    for scan in Simulation::new(options)?.scans(PoseSource::Truth) {
        pcd::write(folder.join(format!("{}.pcd", scan.node)), &scan.cloud)?;
    }
    Ok(())
}

fn count_all(folder: &Path) -> Result<BTreeMap<String, Counts>> {
    let mut whole: BTreeMap<&str, Counts> = BTreeMap::new();
    for (name, _) in CASES {
        whole.insert(name, count(name, folder)?);
    }
    let share = |name: &str, contained: Option<&str>| {
        let (all, less) = (whole[name], contained.map_or(Counts::default(), |c| whole[c]));
        Counts {
            instructions: all.instructions - less.instructions,
            allocations: all.allocations - less.allocations,
            allocated_bytes: all.allocated_bytes - less.allocated_bytes,
            peak_bytes: all.peak_bytes,
        }
    };
    Ok(CASES.iter().map(|(name, contained)| ((*name).to_owned(), share(name, *contained))).collect())
}

fn count(name: &str, folder: &Path) -> Result<Counts> {
    let instructions = valgrind(&["--tool=callgrind".to_owned(), out("callgrind", folder)], name, folder)?;
    let memory = valgrind(&["--tool=dhat".to_owned(), out("dhat", folder)], name, folder)?;
    let [allocated_bytes, allocations] = numbers(&memory, "Total:").ok_or("no total in the output of dhat")?;
    let [peak_bytes, _] = numbers(&memory, "At t-gmax:").ok_or("no peak in the output of dhat")?;
    let [instructions] = numbers(&instructions, "Collected :").ok_or("no count in the output of callgrind")?;
    Ok(Counts { instructions, allocations, allocated_bytes, peak_bytes })
}

fn out(tool: &str, folder: &Path) -> String {
    format!("--{tool}-out-file={}", folder.join(tool).display())
}

/// Output of valgrind for a case.
fn valgrind(tool: &[String], name: &str, folder: &Path) -> Result<String> {
    let program: PathBuf = std::env::current_exe()?;
    let run = Command::new("valgrind").args(tool).arg(&program).args(["case", name]).arg(folder).output();
    let run = run.map_err(|e| format!("valgrind cannot be started: {e}; it is in the package of that name"))?;
    let output = String::from_utf8_lossy(&run.stderr).into_owned();
    if run.status.success() { Ok(output) } else { Err(format!("{name}: {}\n{output}", run.status).into()) }
}

/// The first numbers after `label`, with or without thousands separators.
fn numbers<const N: usize>(output: &str, label: &str) -> Option<[i64; N]> {
    let line = output.lines().find_map(|l| l.split_once(label))?.1.replace(',', "");
    let mut words = line.split_whitespace().filter_map(|w| w.parse::<i64>().ok());
    let found: Vec<i64> = words.by_ref().take(N).collect();
    found.try_into().ok()
}

fn compare(measured: &BTreeMap<String, Counts>) -> Result<()> {
    let text = fs::read_to_string(RECORD).map_err(|e| format!("{RECORD}: {e}; run with --record first"))?;
    let record: Record = serde_json::from_str(&text)?;
    println!("recorded with {}\nmeasured with {}\n", record.built_by, built_by());
    println!("{:<11}{:>16}{:>9}{:>13}{:>9}{:>13}{:>9}", "", "instructions", "", "allocations", "", "peak bytes", "");
    let mut far = Vec::new();
    for (name, _) in CASES {
        let (now, then) = (measured[name], record.counts.get(name).copied().unwrap_or_default());
        let columns = [
            ("instructions", now.instructions, then.instructions),
            ("allocations", now.allocations, then.allocations),
            ("peak", now.peak_bytes, then.peak_bytes),
        ];
        let change = columns.map(|(_, now, then)| now as f64 / then.max(1) as f64 - 1.0);
        far.extend(columns.iter().zip(change).filter(|(_, change)| change.abs() > TOLERANCE).map(|((what, ..), _)| format!("{name}: {what}")));
        let percent = change.map(|c| format!("{:+.2} %", c * 100.0));
        println!(
            "{name:<11}{:>16}{:>9}{:>13}{:>9}{:>13}{:>9}",
            now.instructions, percent[0], now.allocations, percent[1], now.peak_bytes, percent[2]
        );
    }
    if far.is_empty() {
        return Ok(());
    }
    Err(format!("more than {} % off the record: {}; if that is meant, run with --record and say why", TOLERANCE * 100.0, far.join(", ")).into())
}
