//! Finding where a map lies, and storing it.

use super::nodes::{Nodes, move_submap};
use super::outcome::{self, Outcome};
use super::placed::{Placed, place};
use super::request::Request;
use super::{checks, measured};
use crate::error::{Error, Result};
use crate::map_files;
use crate::warning::Warnings;
use std::collections::HashMap;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_earth::{Alignment, Crs, Georeference, Pair, align};
use voxelastic_io::store::MapWriter;
use voxelastic_slam::graph::{MeasuredPosition, Options, Positioned, Problem, optimise_with_positions};

/// Fixes less sure than this are of receivers without RTK: they stay off in the same direction for a while, metres and seconds.
const PLAIN: (f64, f64) = (0.3, 60.0);
/// Fewer fixes than this do not tell a right one from a wrong one.
const FEWEST: usize = 3;

/// Finds where a map lies, and stores that with it. The map on disk changes at the end, at once.
///
/// # Errors
/// Fixes that cannot be read, or that are not of this map; a map that cannot be written.
pub fn georeference(map: &Path, request: &Request, warnings: &mut Warnings) -> Result<Outcome> {
    let mut writer = MapWriter::open(map).map_err(Error::from)?;
    let nodes = Nodes::of(writer.store())?;
    let (fixes, frame) = measured::read(request, warnings)?;
    let (placed, lost, offset) = place(&nodes, fixes, &frame, request, warnings)?;
    let file = request.file.display().to_string();
    let pair = |p: &Placed| Pair { in_map: p.in_map, measured: p.measured, covariance: p.covariance };
    let used: Vec<Pair> = placed.iter().filter(|p| !p.is_check).map(pair).collect();
    if used.len() < FEWEST {
        let message = format!("{file}: {} fixes are of places that the map has, and {lost} of others: at least {FEWEST} are needed", used.len());
        return Err(Error::new(message, "check that fixes and scans are of one clock (--time-offset auto), and of the same drive"));
    }
    let same_place = || Error::new(format!("{file}: all fixes are at one place"), "give fixes that are metres apart");
    let rigid = align(&used).ok_or_else(same_place)?;
    checks::check(&file, &used, &rigid, frame.has_degrees, warnings)?;
    let bent = if request.is_rigid { None } else { Some(bend(&nodes, &placed, &rigid, request)?) };
    let t_plane_map = bent.as_ref().map_or(rigid.t_plane_map, |bent| bent.t_measured_map);
    let place = Georeference { anchor: frame.anchor(), t_plane_map, crs: frame.crs.as_ref().map(Crs::code), heights: frame.heights };
    let origin = map_files::origin_of(writer.store())?;
    let voxel = f64::from(map_files::settings_of(writer.store())?.voxel_size);
    let details = writer.store().manifest().details.clone().with_georeference(&place);
    let poses: HashMap<NodeId, Pose> = bent.iter().flat_map(|bent| bent.solved.poses.iter().copied()).collect();
    writer.move_submaps(|entry| move_submap(entry, &poses, origin, voxel), &details)?;
    Ok(outcome::of(&nodes, &placed, lost, offset, &rigid, bent.as_ref(), place))
}

/// Bends the map onto the fixes that are used.
fn bend(nodes: &Nodes, placed: &[Placed], rigid: &Alignment, request: &Request) -> Result<Positioned> {
    let mut times: Vec<f64> = placed.iter().filter_map(|p| p.fix.time).collect();
    times.sort_by(f64::total_cmp);
    let mut intervals: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_by(f64::total_cmp);
    let interval = intervals.get(intervals.len() / 2).copied().unwrap_or(0.0);
    let measured = |p: &Placed| {
        let is_plain = p.fix.time.is_some() && p.covariance[(0, 0)].sqrt() > PLAIN.0 && p.fix.covariance.is_some();
        let correlation = request.correlation.unwrap_or(if is_plain { PLAIN.1 } else { 0.0 });
        let covariance = checks::correlated(&p.covariance, correlation, interval);
        MeasuredPosition { node: p.node, in_node: p.in_node, measured: p.measured, covariance }
    };
    let positions: Vec<MeasuredPosition> = placed.iter().filter(|p| !p.is_check).map(measured).collect();
    let problem = Problem { nodes: &nodes.poses, edges: &nodes.edges, fixed: &[] };
    Ok(optimise_with_positions(&problem, &positions, &rigid.t_plane_map, &Options::default())?)
}
