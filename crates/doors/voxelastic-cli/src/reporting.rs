//! Reports: from a map and the log of its run to an HTML page.

use crate::commands::measuring::eval::truth::Truth;
use crate::commands::measuring::eval::{EvalArgs, Summary, measure_against};
use crate::meshing::{Fused, LayerArgs, LeftOut, Pair, SurfaceArgs, map_mesh};
use anyhow::Context;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::event::NodeId;
use voxelastic::geometry::{PoseExt, Rigid};
use voxelastic::meshing::{SurfaceChanges, TileKey};
use voxelastic::settings::Settings;
use voxelastic::surface::Mesh;
use voxelastic_eval::colour::palette;
use voxelastic_eval::metrics::Comparison;
use voxelastic_io::store::MapDetails;
use voxelastic_report::content::{Distances, Fact, MovingPoints, Node, Table};
use voxelastic_report::surface::{RootPose, Surface};
use voxelastic_report::{MovingLog, Report, RunLog, Warning};
use voxelastic_run::surfaces::MapMesh;
use voxelastic_run::usage::megabytes;

/// Numbers of blocks from which a map is meshed one, two and three levels of detail coarser for a page, which would be decimated anyway.
const BLOCKS_PER_DETAIL: [usize; 3] = [600_000, 2_400_000, 9_600_000];
/// The page has a slider for corrections only if one moved a submap farther than this, metres.
const LEAST_MOVE: f64 = 0.02;
/// Pairs of submaps with fewer places in common say nothing; and the page shows this many pairs.
const LEAST_PLACES: u64 = 100;
const MOST_PAIRS: usize = 12;

/// A map to report on.
pub struct Subject<'a> {
    /// The submaps.
    pub atlas: &'a Atlas,
    /// Its settings.
    pub settings: &'a Settings,
    /// Its stored details.
    pub details: &'a MapDetails,
    /// The log of the run, if it is known.
    pub run: Option<RunLog>,
    /// The surface to extract.
    pub surface: &'a SurfaceArgs,
}

impl Subject<'_> {
    /// The report, without comparison with a truth, and what was found when submaps were fused for its surface.
    pub fn report(&self, title: &str) -> (Report, FusedFigures) {
        let mut report = Report::titled(title);
        report.subtitle = self.subtitle();
        report.voxel = Some(f64::from(self.settings.voxel_size));
        report.nodes = nodes(self.atlas);
        report.facts = self.facts(&report.nodes);
        let (surfaces, mesh) = self.surfaces();
        report.surface = surfaces;
        report.moving = self.moving();
        let voxel = self.settings.voxel_size;
        let figures = FusedFigures { fused: mesh.as_ref().and_then(|mesh| Fused::of(mesh, voxel)), left_out: mesh.as_ref().and_then(LeftOut::of) };
        report.tables.extend(figures.fused.as_ref().map(|fused| fused_table(fused, figures.left_out)));
        report.tables.extend(self.disagreement(mesh.as_ref()));
        report.tables.extend(self.run.as_ref().and_then(warnings_table));
        report.details = self.details.settings.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
        report.details.extend(self.details.sensor.iter().map(|(k, v)| (format!("sensor {k}"), v.clone())));
        report.details.push(("generator".to_owned(), self.details.generator.clone()));
        // The points that moved are in the page once.
        report.run = self.run.clone().map(|run| RunLog { moving: MovingLog::default(), ..run });
        (report, figures)
    }

    fn subtitle(&self) -> String {
        let Settings { voxel_size: voxel, max_range, field, .. } = self.settings;
        let field = match field.name() {
            "both" => "TSDF and occupancy",
            "tsdf" => "TSDF",
            other => other,
        };
        // The first words only: the whole text is among the details.
        let sensor = self.details.sensor.get("description").and_then(|s| s.split([',', ';']).next()).map_or_else(String::new, |s| format!(", {s}"));
        format!("{field}, voxels of {} cm, range to {max_range} m{sensor}", (f64::from(*voxel) * 1e4).round() / 100.0)
    }

    fn facts(&self, nodes: &[Node]) -> Vec<Fact> {
        let fact = |label: &str, value: String, unit: &str, note: String| Fact { label: label.into(), value, unit: unit.into(), note };
        let path: f64 = nodes.windows(2).map(|w| (0..3).map(|k| (w[1].position[k] - w[0].position[k]).powi(2)).sum::<f64>().sqrt()).sum();
        let skipped = self.run.as_ref().map_or(0, |r| r.scans_skipped);
        let note = if skipped > 0 { format!("{skipped} skipped") } else { String::new() };
        let mut facts = vec![fact("Scans", nodes.len().to_string(), "", note), fact("Trajectory", format!("{path:.0}"), "m", String::new())];
        let fused = self.run.as_ref().map_or(0, |r| r.fusions);
        let note = if fused > 0 { format!("after {fused} fusions") } else { String::new() };
        facts.push(fact("Submaps", self.atlas.submaps().len().to_string(), "", note));
        if let Some(times) = self.run.as_ref().map(|r| &r.scans.wall_ms).filter(|t| !t.is_empty()) {
            let spread = voxelastic_eval::SeriesStats::new(times);
            let note = format!("95 % within {:.0} ms", spread.p95.unwrap_or(0.0));
            facts.push(fact("Time of a scan", format!("{:.0}", spread.median.unwrap_or(0.0)), "ms", note));
        }
        facts.push(fact("Map in memory", format!("{:.0}", megabytes(self.atlas.bytes() as u64)), "MB", String::new()));
        facts
    }

    /// Submaps, and the one surface of the map, each place of which moves with the submap that has most of the surface there; with the mesh, which has given its arrays away. Without
    /// such a surface, those of the submaps.
    fn surfaces(&self) -> (Vec<Surface>, Option<MapMesh>) {
        let blocks: usize = self.atlas.submaps().iter().map(|s| s.tsdf().len()).sum();
        let detail = BLOCKS_PER_DETAIL.iter().filter(|&&limit| blocks >= limit).count() as u8;
        let how = self.surface.coarser(detail);
        let first_poses = self.first_poses();
        let of = |submap: &Submap, mesh: Mesh| Surface {
            submap: submap.id(),
            colour: palette(submap.id() as usize),
            pose: root_pose(&submap.t_map_submap()),
            first_pose: first_poses.get(&submap.id()).map(root_pose),
            ..surface_of(mesh)
        };
        let options = how.options(LayerArgs::default());
        let Ok(mut mesh) = map_mesh(self.atlas, &how, LayerArgs::default()) else {
            return (self.atlas.submaps().iter().map(|submap| of(submap, options.extract(submap))).collect(), None);
        };
        let mut surfaces: Vec<Surface> = self.atlas.submaps().iter().map(|submap| of(submap, Mesh::default())).collect();
        let carriers = if mesh.submaps.is_empty() { carriers(self.atlas, &mesh.mesh) } else { mesh.submaps.clone() };
        surfaces.push(Surface { carriers, ..surface_of(std::mem::take(&mut mesh.mesh)) });
        (surfaces, Some(mesh))
    }

    /// The points on things that moved that the log of the run has, where their scans are now.
    fn moving(&self) -> Vec<MovingPoints> {
        let Some(run) = &self.run else { return Vec::new() };
        let of_submap = |submap: &Submap| {
            let id = submap.id();
            submap.scans().iter().map(move |scan| (scan.node, (id, Rigid::from(&scan.t_submap_lidar)))).collect::<Vec<_>>()
        };
        let known: HashMap<NodeId, (SubmapId, Rigid)> = self.atlas.submaps().iter().flat_map(of_submap).collect();
        let to_submap = |(node, points): (NodeId, &[[f32; 3]])| {
            let (submap, t_submap_lidar) = known.get(&node)?;
            Some(MovingPoints { node, submap: *submap, points: points.iter().map(|p| t_submap_lidar.apply(*p)).collect() })
        };
        run.moving.scans().filter_map(to_submap).collect()
    }

    /// Where submaps disagree, the worst pairs first; none if no two have a surface in the same place.
    fn disagreement(&self, mesh: Option<&MapMesh>) -> Option<Table> {
        let found = mesh.filter(|mesh| mesh.agreement.is_some()).map_or_else(|| self.atlas.pair_agreement(), |mesh| mesh.pairs.clone());
        let mut pairs = Pair::all(&found, self.settings.voxel_size);
        pairs.retain(|pair| pair.places >= LEAST_PLACES);
        pairs.sort_by_key(|pair| (pair.matched * 1000 / pair.places, pair.submaps));
        pairs.truncate(MOST_PAIRS);
        let row = |pair: &Pair| {
            let [a, b] = pair.submaps;
            let same = 100.0 * pair.matched as f64 / pair.places as f64;
            vec![
                format!("{a} and {b}"),
                pair.places.to_string(),
                format!("{same:.0}"),
                format!("{:.0}", pair.apart_mm),
                format!("{:.0}", pair.left_mm),
            ]
        };
        let columns = ["submaps", "places in common cells", "the same surface, %", "apart, mm", "after bending, mm"].map(str::to_owned).into();
        let note = "Places on surfaces are at most one for each block, in cells of 64 voxels in which both submaps have a surface. Shares are low where submaps see things from different sides, or where poses are wrong by more than five voxels.";
        let rows: Vec<Vec<String>> = pairs.iter().map(row).collect();
        (!rows.is_empty()).then(|| Table { title: "Where submaps disagree".to_owned(), note: note.to_owned(), columns, rows })
    }

    /// Poses of the submaps without corrections, from the poses of the scans at their integration. Empty if they are those of the map.
    fn first_poses(&self) -> BTreeMap<SubmapId, Pose> {
        let Some(run) = &self.run else { return BTreeMap::new() };
        let initial: BTreeMap<NodeId, Pose> =
            run.scans.node.iter().zip(run.scans.position.iter().zip(&run.scans.orientation)).map(|(n, p)| (*n, pose(p))).collect();
        let firsts = self.atlas.submaps().iter().filter_map(|submap| {
            let root = submap.scans().first()?;
            Some((submap.id(), *initial.get(&root.node)? * root.t_submap_lidar.inverse()))
        });
        let firsts: BTreeMap<SubmapId, Pose> = firsts.collect();
        let moved = |s: &Submap| firsts.get(&s.id()).is_some_and(|p| p.translation_distance(&s.t_map_submap()) > LEAST_MOVE);
        if self.atlas.submaps().iter().any(moved) { firsts } else { BTreeMap::new() }
    }
}

/// What was found when submaps were fused for a surface, as `--json` has it.
#[derive(Clone, Debug, Default)]
pub struct FusedFigures {
    /// None unless there are several submaps.
    pub fused: Option<Fused>,
    /// None if nothing was to be left out.
    pub left_out: Option<LeftOut>,
}

/// What was merged, refused and left out, as a table.
fn fused_table(fused: &Fused, left_out: Option<LeftOut>) -> Table {
    let row = |what: &str, count: u64, apart: Option<f64>| {
        vec![what.to_owned(), count.to_string(), apart.map_or_else(String::new, |mm| format!("{mm:.0}"))]
    };
    let mut rows = vec![
        row("voxels that one submap alone knows", fused.alone, None),
        row("voxels merged: submaps agree", fused.merged, Some(fused.merged_apart_mm)),
        row("voxels refused: submaps contradict, the better known one counts", fused.refused, Some(fused.refused_apart_mm)),
    ];
    rows.extend(left_out.map(|left_out| row("pieces of the surface left out, with too little evidence", left_out.pieces, None)));
    let columns = ["near surfaces", "number", "apart, mm"].map(str::to_owned).into();
    let note = "Overlapping submaps are fused into one surface. Where they lie a little apart, it is between them; where they contradict, the submap counts that observed the place better.";
    Table { title: "One surface of several submaps".to_owned(), note: note.to_owned(), columns, rows }
}

/// What the run had to say; none if that was nothing.
fn warnings_table(run: &RunLog) -> Option<Table> {
    let row = |w: &Warning| vec![w.code.clone(), w.count.to_string(), w.text.clone(), w.remedy.clone()];
    let columns = ["what", "times", "the first time", "what helps"].map(str::to_owned).into();
    let rows: Vec<Vec<String>> = run.warnings.iter().map(row).collect();
    (!rows.is_empty()).then(|| Table { title: "Warnings of the run".to_owned(), note: String::new(), columns, rows })
}

/// By vertex of the one surface, the submap that has most of the surface around it.
fn carriers(atlas: &Atlas, mesh: &Mesh) -> Vec<SubmapId> {
    let mut changes = SurfaceChanges::default();
    changes.note(atlas);
    let first = atlas.submaps().first().map_or(0, Submap::id);
    let is_kept = |id: &SubmapId| atlas.submap(*id).is_some();
    let mut known: HashMap<Option<TileKey>, SubmapId> = HashMap::new();
    let carrier = |p: &[f32; 3]| {
        let tile = changes.tile_at(*p);
        *known.entry(tile).or_insert_with(|| tile.and_then(|tile| changes.carrier(tile)).filter(is_kept).unwrap_or(first))
    };
    mesh.positions.iter().map(carrier).collect()
}

fn surface_of(mesh: Mesh) -> Surface {
    let Mesh { positions, normals, intensities, colours, scales, triangles } = mesh;
    Surface { positions, normals, intensities, colours, scales, triangles, ..Surface::default() }
}

fn pose((position, orientation): (&[f64; 3], &[f64; 4])) -> Pose {
    let [x, y, z, w] = *orientation;
    let rotation = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    Pose::from_parts(nalgebra::Translation3::from(nalgebra::Vector3::from(*position)), rotation)
}

fn root_pose(pose: &Pose) -> RootPose {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    RootPose([t.x, t.y, t.z, q.x, q.y, q.z, q.w])
}

/// Positions of the scans of a map, by node.
fn nodes(atlas: &Atlas) -> Vec<Node> {
    let of_submap = |s: &Submap| {
        let (submap, t_map_submap) = (s.id(), s.t_map_submap());
        let position = move |t: &Pose| (t_map_submap * t).translation.vector.into();
        s.scans().iter().map(move |scan| Node { node: scan.node, position: position(&scan.t_submap_lidar), submap }).collect::<Vec<_>>()
    };
    let mut nodes: Vec<Node> = atlas.submaps().iter().flat_map(of_submap).collect();
    nodes.sort_by_key(|n| n.node);
    nodes
}

/// Measures the map at `map` against a truth and adds the errors to the report.
pub fn add_comparison(report: &mut Report, map: &Path, truth_path: &Path, truth: &Truth) -> anyhow::Result<Summary> {
    let summary = measure_against(&EvalArgs::of(map, truth_path), truth)?;
    if let Some(found) = &summary.surface {
        add_distances(report, found);
        add_fact(report, found);
        add_errors(report, truth, &summary.t_truth_map)?;
    }
    Ok(summary)
}

/// Adds the histograms of a comparison.
fn add_distances(report: &mut Report, found: &Comparison) {
    let stats = found.accuracy_exact.as_ref().unwrap_or(&found.accuracy);
    report.distances.push(Distances { name: "Accuracy: from the map to the truth".to_owned(), stats: stats.clone() });
    report.distances.push(Distances { name: "Completeness: from the truth to the map".to_owned(), stats: found.completeness.clone() });
}

fn add_fact(report: &mut Report, found: &Comparison) {
    let stats = found.accuracy_exact.as_ref().unwrap_or(&found.accuracy);
    if let (Some(mean), Some(p90)) = (stats.mean, stats.p90) {
        let note = format!("90 % within {:.1} cm", p90 * 100.0);
        report.facts.push(Fact { label: "Error, mean".into(), value: format!("{:.1}", mean * 1e3), unit: "mm".into(), note });
    }
}

/// Sets the error of each vertex of the report: its distance from the truth.
pub fn add_errors(report: &mut Report, truth: &Truth, t_truth_map: &Pose) -> anyhow::Result<()> {
    for surface in report.surface.iter_mut().filter(|s| !s.positions.is_empty()) {
        let to_map = Rigid::from(&pose_of(&surface.pose));
        let points: Vec<[f32; 3]> = surface.positions.iter().map(|&p| to_map.apply(p)).collect();
        surface.errors = truth.errors(&points, t_truth_map)?.unwrap_or_default();
    }
    Ok(())
}

fn pose_of(RootPose([x, y, z, qx, qy, qz, qw]): &RootPose) -> Pose {
    pose((&[*x, *y, *z], &[*qx, *qy, *qz, *qw]))
}

/// Writes the page and returns its size, bytes.
pub fn write(report: &Report, path: &Path) -> anyhow::Result<u64> {
    let html = report.html().with_context(|| format!("cannot make the report {}", path.display()))?;
    voxelastic_files::write(path, |out| out.write_all(html.as_bytes())).with_context(|| format!("cannot write the report to {}", path.display()))?;
    tracing::info!("report: {} ({:.1} MB); open it in a browser", path.display(), megabytes(html.len() as u64));
    Ok(html.len() as u64)
}
