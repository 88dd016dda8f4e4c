//! Description of a map.

use super::rows::{Bounds, row};
use crate::args::LoadArgs;
use nalgebra::Point3;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::field::occupancy::Volumes;
use voxelastic::geometry::Aabb;
use voxelastic::octree::{BLOCK_EDGE, SCALES, block_coords};
use voxelastic_io::store::{MapStore, SessionEntry, SubmapEntry};
use voxelastic_io::{Error, Origin};
use voxelastic_run::joining;
use voxelastic_run::map_files::{self, Loading, damaged_part, settings_of};
use voxelastic_run::usage::megabytes;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct MapInfo {
    kind: &'static str,
    generator: String,
    settings: BTreeMap<String, String>,
    sensor: BTreeMap<String, String>,
    scans: usize,
    /// Submaps whose files are missing or damaged; without `--check` by their sizes only.
    submaps_damaged: usize,
    blocks: u64,
    /// Blocks integrated at scales 0 to 3.
    blocks_by_scale: [u64; SCALES],
    /// Size on disk, megabytes.
    file_mb: f64,
    /// Where the coordinates in the submaps' files are counted from, map frame; zero in most maps.
    origin_m: [f64; 3],
    /// Where it lies on Earth, in words; `null` of a map that was not georeferenced: `georeference --show --json` has numbers.
    place: Option<String>,
    /// Box around the positions of the scans in the map frame.
    path_bounds_m: Option<Bounds>,
    /// Box around all blocks of the TSDF and all free or occupied space, map frame; only with `--check`.
    bounds_m: Option<Bounds>,
    /// Known space of all submaps; only with `--check`, and for maps with occupancy.
    known_m3: Option<KnownSpace>,
    /// Edits that the map is shown with: `voxelastic edit MAP --list` lists them.
    edits: usize,
    /// What the map was made of; a map that was made at once is one session.
    sessions: Vec<SessionInfo>,
    submaps: Vec<SubmapInfo>,
}

#[derive(Debug, Serialize)]
struct SessionInfo {
    number: u32,
    /// The data that it was mapped from, as it was named; `null` where nobody knows.
    input: Option<String>,
    /// When it was added, UTC; `null` for the session that the map began with.
    added: Option<String>,
    /// Scans and submaps that the map has of it.
    scans: usize,
    submaps: usize,
    first_submap: SubmapId,
    last_submap: SubmapId,
    /// What was added to the numbers of its nodes.
    node_offset: u64,
    /// Where its own frame lies in the map: x y z qx qy qz qw; `null` for the session that the map began with.
    t_map_session: Option<[f64; 7]>,
    /// Loop edges to earlier sessions.
    loop_edges: usize,
}

/// Cubic metres, overlaps of submaps counted each time.
#[derive(Debug, Serialize)]
struct KnownSpace {
    /// Free space by log2 of the edge of its cubes, in finest voxels.
    free_by_edge_log2: Vec<f64>,
    occupied: f64,
}

#[derive(Debug, Serialize)]
struct SubmapInfo {
    id: SubmapId,
    file: String,
    bytes: u64,
    scans: usize,
    first_node: Option<u64>,
    last_node: Option<u64>,
    travelled_m: f64,
    /// Position of the root pose in the map frame.
    root_m: [f64; 3],
    blocks_by_scale: [u64; SCALES],
}

impl fmt::Display for KnownSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let free: f64 = self.free_by_edge_log2.iter().sum();
        let percentages: Vec<String> = self.free_by_edge_log2.iter().map(|m3| format!("{:.1}", 100.0 * m3 / free)).collect();
        write!(f, "{:.0} m3 occupied, {free:.0} m3 free; of that in cubes of 1, 2, 4, .. voxels {} %", self.occupied, percentages.join(", "))
    }
}

/// Describes a map; `check` reads and verifies all of it.
pub fn describe(path: &Path, check: bool, args: LoadArgs) -> anyhow::Result<MapInfo> {
    Loading::from(args).limit_memory()?;
    let store = map_files::open(path)?;
    let mut damaged = 0;
    let mut count = |error| {
        if !args.skip_damaged {
            return Err(damaged_part(path, error).into());
        }
        tracing::warn!("damaged: {error}");
        damaged += 1;
        Ok(())
    };
    let (bounds, known_m3) = if check {
        verify(&store, &mut count)?
    } else {
        store.check_sizes().into_iter().try_for_each(&mut count)?;
        Default::default()
    };
    map_files::warn_of(&store, damaged);
    let (manifest, origin) = (store.manifest(), map_files::origin_of(&store)?);
    let mut blocks_by_scale = [0; SCALES];
    let mut path_bounds = Aabb::default();
    for entry in &manifest.submaps {
        (0..SCALES).for_each(|s| blocks_by_scale[s] += entry.tsdf.as_ref().map_or(0, |t| t.blocks_by_scale[s]));
        for scan in &entry.scans {
            path_bounds.add((entry.t_map_submap * scan.t_submap_lidar).translation.vector.map(|c| c as f32).into());
        }
    }
    Ok(MapInfo {
        kind: "map",
        edits: manifest.edits.map_or(0, |edits| edits.count),
        generator: manifest.details.generator.clone(),
        settings: manifest.details.settings.clone(),
        sensor: manifest.details.sensor.clone(),
        scans: manifest.submaps.iter().map(|s| s.scans.len()).sum(),
        submaps_damaged: damaged,
        blocks: blocks_by_scale.iter().sum(),
        blocks_by_scale,
        file_mb: megabytes(store.bytes()),
        origin_m: origin.coordinates(),
        place: map_files::place_of(&store)?.map(|place| place.to_string()),
        path_bounds_m: Bounds::around(&path_bounds, origin),
        bounds_m: Bounds::around(&bounds, origin),
        known_m3,
        sessions: joining::listed_sessions(&store).iter().map(|session| session_info(session, &manifest.submaps)).collect(),
        submaps: manifest.submaps.iter().map(|entry| submap_info(entry, origin)).collect(),
    })
}

fn session_info(session: &SessionEntry, submaps: &[SubmapEntry]) -> SessionInfo {
    let own = || submaps.iter().filter(|entry| session.has(entry.id));
    SessionInfo {
        number: session.number,
        input: session.input.clone(),
        added: session.added.clone(),
        scans: own().map(|entry| entry.scans.len()).sum(),
        submaps: own().count(),
        first_submap: session.first_submap,
        last_submap: session.last_submap,
        node_offset: session.node_offset,
        t_map_session: session.t_map_session.map(|frame| joining::numbers(&frame.0)),
        loop_edges: session.loop_edges.len(),
    }
}

fn submap_info(entry: &SubmapEntry, origin: Origin) -> SubmapInfo {
    SubmapInfo {
        id: entry.id,
        file: entry.file.clone(),
        bytes: entry.bytes,
        scans: entry.scans.len(),
        first_node: entry.scans.first().map(|s| s.node),
        last_node: entry.scans.last().map(|s| s.node),
        travelled_m: entry.travelled,
        root_m: origin.to_map(entry.t_map_submap).translation.vector.into(),
        blocks_by_scale: entry.tsdf.as_ref().map_or([0; SCALES], |t| t.blocks_by_scale),
    }
}

/// Box around everything, map frame, and the known space. Reads and verifies one submap after the other; those that are damaged go to `count`.
fn verify(store: &MapStore, mut count: impl FnMut(Error) -> anyhow::Result<()>) -> anyhow::Result<(Aabb, Option<KnownSpace>)> {
    let voxel = settings_of(store)?.voxel_size;
    let mut all = Aabb::default();
    let mut volumes: Option<Volumes> = None;
    for entry in &store.manifest().submaps {
        let submap = match store.load_submap(entry.id) {
            Ok(submap) => submap,
            Err(error) => {
                count(error)?;
                continue;
            }
        };
        add_blocks(&mut all, &submap, voxel);
        if !submap.occupancy().is_empty() {
            let known = submap.query().bounds_in(&submap.t_map_submap());
            if !known.is_empty() {
                all.add(known.min);
                all.add(known.max);
            }
            volumes.get_or_insert_default().add(&submap.occupancy().volumes());
        }
    }
    let cubic_metres = |voxels: u64| voxels as f64 * f64::from(voxel).powi(3);
    let known = volumes.map(|v| KnownSpace {
        free_by_edge_log2: v.free.iter().copied().map(cubic_metres).collect(),
        occupied: cubic_metres(v.occupied.iter().sum()),
    });
    Ok((all, known))
}

fn add_blocks(all: &mut Aabb, submap: &Submap, voxel: f32) {
    let edge = BLOCK_EDGE as f64 * f64::from(voxel);
    for id in submap.tsdf().ids() {
        let c = block_coords(submap.tsdf().block(id).key);
        for corner in 0..8 {
            let p = Point3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(c[k] + (corner >> k & 1)) * edge));
            all.add((submap.t_map_submap() * p).coords.map(|c| c as f32).into());
        }
    }
}

/// The description as rows of a table.
pub fn table(info: &MapInfo) -> Vec<(String, String)> {
    let mut rows = vec![
        row("map by", &info.generator),
        row("scans", info.scans),
        row("submaps", info.submaps.len()),
        row("blocks", format!("{} ({} at scales 0 to 3)", info.blocks, info.blocks_by_scale.map(|n| n.to_string()).join(" + "))),
        row("on disk", format!("{:.1} MB", info.file_mb)),
    ];
    if info.origin_m != [0.0; 3] {
        let [x, y, z] = info.origin_m;
        rows.push(row("origin", format!("{x} {y} {z} m: what is written has it added")));
    }
    if info.edits > 0 {
        rows.push(row("edits", format!("{}: `voxelastic edit MAP --list` lists them", info.edits)));
    }
    rows.extend(info.place.iter().map(|place| row("on Earth", place)));
    rows.extend(info.path_bounds_m.map(|b| row("path of the sensor", b)));
    rows.extend(info.bounds_m.map(|b| row("extent", b)));
    rows.extend(info.known_m3.iter().map(|known| row("known space", known)));
    rows.extend(info.sensor.values().map(|words| row("sensor", words)));
    let settings: Vec<String> = info.settings.iter().filter(|(key, _)| *key != "earth").map(|(key, value)| format!("{key} = {value}")).collect();
    rows.push(row("settings", settings.join(", ")));
    for s in &info.sessions {
        let input = s.input.as_deref().unwrap_or("from data that is not known");
        let added = s.added.as_ref().map_or_else(String::new, |when| format!(", added {when} with {} loop edges", s.loop_edges));
        let text = format!("{input}: {} scans, submaps {} to {}{added}", s.scans, s.first_submap, s.last_submap);
        rows.push(row(&format!("session {}", s.number), text));
    }
    for s in &info.submaps {
        let [x, y, z] = s.root_m;
        let nodes = s.first_node.zip(s.last_node).map_or_else(String::new, |(a, b)| format!(" (nodes {a} to {b})"));
        let blocks: u64 = s.blocks_by_scale.iter().sum();
        let text = format!(
            "{} scans{nodes}, {:.1} m, root at ({x:.2}, {y:.2}, {z:.2}), {blocks} blocks, {:.1} MB",
            s.scans,
            s.travelled_m,
            megabytes(s.bytes)
        );
        rows.push(row(&format!("submap {}", s.id), text));
    }
    rows
}
