//! What came of putting a map on Earth: each fix with its residual, and figures of all.

use super::nodes::Nodes;
use super::placed::Placed;
use nalgebra::{Point3, Vector3};
use serde::Serialize;
use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_earth::{Alignment, Georeference};
use voxelastic_slam::graph::{Positioned, largest_bend};

/// What a fix was used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Use {
    /// The map is where it says.
    Used,
    /// It contradicts the others.
    Refused,
    /// Held out, to check the others by.
    Check,
}

/// A fix and where the map has it.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of a control point.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// When it was measured, by the clock of the fixes.
    pub time_s: Option<f64>,
    /// The scan that is nearest.
    pub node: NodeId,
    /// What it was used for.
    pub r#use: Use,
    /// Measured less mapped: east, north, up, metres, with the map as a rigid whole.
    pub rigid_m: [f64; 3],
    /// The same with the map as it is stored now.
    pub residual_m: [f64; 3],
}

/// Lengths of residuals, metres.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Statistics {
    /// How many there are.
    pub count: usize,
    /// Mean, root mean square, median, largest; and the mean along the ground.
    pub mean_m: f64,
    /// Root of the mean square.
    pub rms_m: f64,
    /// Median.
    pub median_m: f64,
    /// Largest.
    pub max_m: f64,
    /// Mean along the ground.
    pub ground_mean_m: f64,
}

impl Statistics {
    fn of(residuals: impl Iterator<Item = [f64; 3]>) -> Self {
        let all: Vec<Vector3<f64>> = residuals.map(Vector3::from).collect();
        let mut lengths: Vec<f64> = all.iter().map(|r| r.norm()).collect();
        lengths.sort_by(f64::total_cmp);
        let Some(max_m) = lengths.last().copied() else { return Self::default() };
        let n = lengths.len() as f64;
        Self {
            count: lengths.len(),
            mean_m: lengths.iter().sum::<f64>() / n,
            rms_m: (lengths.iter().map(|l| l * l).sum::<f64>() / n).sqrt(),
            median_m: lengths[lengths.len() / 2],
            max_m,
            ground_mean_m: all.iter().map(|r| r.xy().norm()).sum::<f64>() / n,
        }
    }
}

/// What came of it.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Where the map is.
    pub place: Georeference,
    /// The fixes, in their order.
    pub rows: Vec<Row>,
    /// Fixes of no place of the map.
    pub elsewhere: usize,
    /// What was added to times of fixes, seconds.
    pub time_offset_s: f64,
    /// Residuals of those that are used, and of those held out, with the map as a rigid whole.
    pub rigid: [Statistics; 2],
    /// The same with the map as it is now.
    pub now: [Statistics; 2],
    /// Standard deviations of the rigid alignment: turns about east, north, up, degrees; place of the middle of the fixes, metres.
    pub sigmas: [f64; 6],
    /// By how much the map was bent, at most, metres.
    pub bent_m: f64,
    /// By how much residuals are larger than the standard deviations that came with the fixes, at least 1.
    pub spread: f64,
}

pub(super) fn of(
    nodes: &Nodes,
    placed: &[Placed],
    elsewhere: usize,
    time_offset_s: f64,
    rigid: &Alignment,
    bent: Option<&Positioned>,
    place: Georeference,
) -> Outcome {
    let now: HashMap<NodeId, Pose> = bent.map_or_else(|| nodes.poses.iter().copied(), |bent| bent.solved.poses.iter().copied()).collect();
    let wrong = 4.6 * rigid.spread;
    let mut kept = bent.iter().flat_map(|bent| bent.is_used.iter().copied());
    let row = |p: &Placed| {
        let rigid_m = p.measured - (rigid.t_plane_map * Point3::from(p.in_map)).coords;
        let mapped = now.get(&p.node).map_or(p.in_map, |pose| (pose * Point3::from(p.in_node)).coords);
        let residual_m = p.measured - (place.t_plane_map * Point3::from(mapped)).coords;
        let fits = || p.covariance.try_inverse().is_some_and(|w| rigid_m.dot(&(w * rigid_m)).sqrt() <= wrong);
        let is_used = if p.is_check { true } else { kept.next().unwrap_or_else(fits) };
        let r#use = if p.is_check {
            Use::Check
        } else if is_used {
            Use::Used
        } else {
            Use::Refused
        };
        Row { name: p.fix.name.clone(), time_s: p.fix.time, node: p.node, r#use, rigid_m: rigid_m.into(), residual_m: residual_m.into() }
    };
    let rows: Vec<Row> = placed.iter().map(row).collect();
    let of = |residual: fn(&Row) -> [f64; 3]| {
        [Use::Used, Use::Check].map(|r#use| Statistics::of(rows.iter().filter(|row| row.r#use == r#use).map(residual)))
    };
    let sigmas = std::array::from_fn(|k| if k < 3 { rigid.sigmas[k].to_degrees() } else { rigid.sigmas[k] });
    let bent_m = bent.map_or(0.0, |bent| largest_bend(&nodes.poses, &bent.solved.poses));
    let spread = bent.map_or(rigid.spread, |bent| bent.spread);
    let (rigid, now) = (of(|row| row.rigid_m), of(|row| row.residual_m));
    Outcome { place, rows, elsewhere, time_offset_s, rigid, now, sigmas, bent_m, spread }
}
