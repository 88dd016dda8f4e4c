//! Fixes with their places in the plane and in the map.

use super::checks;
use super::measured::{Frame, of_earth};
use super::nodes::Nodes;
use super::request::{Clock, Request};
use crate::error::{Error, Result};
use crate::warning::{Code, Warnings};
use nalgebra::{Matrix3, Point3, Vector3};
use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_earth::{Fix, Fixes, Place, Track, time_offset};

/// Standard deviation of a fix that comes without, metres.
const ASSUMED_M: f64 = 0.5;

/// A fix with its place in plane and map.
pub(super) struct Placed {
    pub(super) fix: Fix,
    pub(super) measured: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
    /// The node that is nearest in time, and the antenna in its frame.
    pub(super) node: NodeId,
    pub(super) in_node: Vector3<f64>,
    pub(super) in_map: Vector3<f64>,
    pub(super) is_check: bool,
}

/// Where the fixes are in plane and map; how many are of no place of the map, and by how much clocks differ.
pub(super) fn place(nodes: &Nodes, fixes: Fixes, frame: &Frame, request: &Request, warnings: &mut Warnings) -> Result<(Vec<Placed>, usize, f64)> {
    let fail = of_earth(&request.file);
    let stamped: Vec<(NodeId, f64, Pose)> = nodes.poses.iter().filter_map(|(node, pose)| Some((*node, *nodes.times.get(node)?, *pose))).collect();
    let track = Track::new(stamped.iter().map(|(_, time, pose)| (*time, *pose)));
    let node_at: HashMap<u64, NodeId> = stamped.iter().map(|(node, time, _)| (time.to_bits(), *node)).collect();
    let sigma = request.sigma.unwrap_or(ASSUMED_M);
    let without = fixes.all.iter().filter(|fix| fix.covariance.is_none()).count();
    if without > 0 && request.sigma.is_none() {
        let text = format!("{without} fixes come without standard deviations: {ASSUMED_M} m is assumed");
        warnings.add(Code::AssumedDeviations, text, "--sigma says what they are");
    }
    let mut all = Vec::with_capacity(fixes.all.len());
    for fix in fixes.all {
        let covariance = fix.covariance.unwrap_or_else(|| Matrix3::identity() * (sigma * sigma));
        let (measured, covariance) = match (fix.place.geodetic(frame.crs.as_ref()).map_err(&fail)?, frame.plane) {
            (Some(place), Some(plane)) => (plane.of_geodetic(&place), plane.turned(&place, &covariance)),
            _ => match fix.place {
                Place::Projected(point) => (Vector3::from(point), covariance),
                Place::Geodetic(_) => continue,
            },
        };
        all.push((fix, measured, covariance));
    }
    let times: Vec<(f64, Vector3<f64>)> =
        all.iter().filter(|(fix, ..)| fix.seen_at.is_none()).filter_map(|(fix, measured, _)| Some((fix.time?, *measured))).collect();
    if track.times().is_empty() && !times.is_empty() {
        let message = "the map does not know when its scans were taken: the log of its run is not with it";
        return Err(Error::new(message, "map the data again, or give control points with the columns map_x, map_y and map_z"));
    }
    let offset = match request.clock {
        Clock::Offset(seconds) => seconds,
        Clock::Same | Clock::Find => {
            let found = time_offset(&track, &times, &request.lever);
            checks::offset(&request.file.display().to_string(), found.as_ref(), request.clock, warnings)?
        }
    };
    let (mut placed, mut lost) = (Vec::with_capacity(all.len()), 0);
    for (k, (fix, measured, covariance)) in all.into_iter().enumerate() {
        let is_check = request.check_every.is_some_and(|n| k % n == n - 1);
        let seen = match (fix.seen_at, fix.time) {
            (Some(point), _) => {
                nearest(&nodes.poses, &point).map(|(node, pose)| (node, pose.inverse() * Point3::from(point), point, Matrix3::zeros()))
            }
            (None, Some(time)) => track.at(time + offset).and_then(|moment| {
                let node = *node_at.get(&track.times()[moment.nearest].to_bits())?;
                let lever = Point3::from(request.lever);
                Some((node, moment.t_nearest_sensor * lever, (moment.t_map_sensor * lever).coords, moment.covariance))
            }),
            (None, None) => None,
        };
        let Some((node, in_node, in_map, unsure)) = seen else {
            lost += 1;
            continue;
        };
        // What is not known along the motion in the map is not known along it in the plane: without the turn between the two, in all directions of the ground.
        let along = unsure.trace();
        let unsure = Matrix3::from_diagonal(&Vector3::new(along, along, 0.1 * along));
        placed.push(Placed { fix, measured, covariance: covariance + unsure, node, in_node: in_node.coords, in_map, is_check });
    }
    Ok((placed, lost, offset))
}

/// The node nearest to a point of the map.
fn nearest(poses: &[(NodeId, Pose)], point: &Vector3<f64>) -> Option<(NodeId, Pose)> {
    let distance = |pose: &Pose| (pose.translation.vector - point).norm_squared();
    poses.iter().min_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1))).copied()
}
