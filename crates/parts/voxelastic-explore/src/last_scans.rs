//! The last scans of a robot, and how long they count.

use crate::near_returns::{NearReturns, REACH, THINNED};
use hashbrown::HashSet;
use nalgebra::Point3;
use std::collections::VecDeque;
use voxelastic::event::NodeId;
use voxelastic::{Cloud, Pose};
use voxelastic_plan::{Point, distance};

/// Scans since which the robot's path is no longer than this count, metres: a ceiling above a robot is seen from some way off only, and an odometry drifts little over it.
const TRAVEL: f64 = 2.0;
/// One that goes to and fro under something must not forget it: of scans since which the path is no longer than this, metres ...
const MOST_TRAVEL: f64 = 4.0;
/// ... that were taken within this distance of the last one, metres, those returns count that are too steeply above or below the robot to be seen from where it is.
const NEAR: f64 = 2.0;
/// None that is older than so many scans counts, or what a robot that stands saw leave would be in its way for ever.
const MOST_AGE: usize = 30;
/// A scan from within this distance of the one before takes its place, metres.
const STANDING: f64 = 0.2;

/// The last scans of a robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct LastScans {
    /// The last one at the end.
    scans: VecDeque<LastScan>,
}

/// Returns of a scan near its sensor.
#[derive(Clone, Debug)]
struct LastScan {
    /// Its node in the map; none if the map does not have it.
    node: Option<NodeId>,
    t_map_lidar: Pose,
    /// Scans since then.
    age: usize,
    /// Length of the robot's path since then, metres.
    travelled: f64,
    /// Lidar frame.
    near: Vec<[f32; 3]>,
}

impl LastScans {
    /// Adds a scan, and forgets those that count no more.
    pub fn push(&mut self, t_map_lidar: &Pose, cloud: &Cloud) {
        let is_near = |p: &[f32; 3]| p.iter().all(|c| f64::from(c.abs()) <= REACH * 3f64.sqrt());
        let mut taken = HashSet::new();
        let is_first = |p: &[f32; 3]| taken.insert(p.map(|c| (f64::from(c) / THINNED).floor() as i32));
        let near = cloud.points.iter().filter(|p| Cloud::is_return(p) && is_near(p)).copied().filter(is_first).collect();
        let place = |pose: &Pose| Point::from(pose.translation.vector);
        self.scans.pop_back_if(|last| distance(place(&last.t_map_lidar), place(t_map_lidar)) < STANDING);
        self.scans.push_back(LastScan { node: None, t_map_lidar: *t_map_lidar, age: 0, travelled: 0.0, near });
        let last = place(t_map_lidar);
        let (mut next, mut travelled) = (last, 0.0);
        let counts = |scan: &mut LastScan| {
            scan.age += 1;
            let here = place(&scan.t_map_lidar);
            travelled += distance(std::mem::replace(&mut next, here), here);
            scan.travelled = travelled;
            (travelled <= TRAVEL || travelled <= MOST_TRAVEL && distance(here, last) <= NEAR) && scan.age <= MOST_AGE
        };
        let counting = self.scans.iter_mut().rev().map(counts).take_while(|counts| *counts).count();
        self.scans.drain(..self.scans.len() - counting);
    }

    /// The last scan is that of `node`.
    pub fn set_node(&mut self, node: NodeId) {
        if let Some(last) = self.scans.back_mut() {
            last.node = Some(node);
        }
    }

    /// Moves the scans to where a corrected map has them; forgets those that it does not have, but the last one, which was given where it is.
    pub fn follow(&mut self, pose: impl Fn(NodeId) -> Option<Pose>) {
        let last = self.scans.pop_back();
        self.scans.retain_mut(|scan| {
            let moved = scan.node.and_then(&pose);
            scan.t_map_lidar = moved.unwrap_or(scan.t_map_lidar);
            moved.is_some()
        });
        self.scans.extend(last);
    }

    /// Their returns near the robot, whose sensor sees slopes, height over distance, up to `steepest`.
    pub fn returns(&self, steepest: f64) -> NearReturns {
        let Some(last) = self.scans.back() else { return NearReturns::default() };
        let robot: Point = last.t_map_lidar.translation.vector.into();
        let is_unseen = |p: &Point| (p[2] - robot[2]).abs() > steepest * (p[0] - robot[0]).hypot(p[1] - robot[1]);
        let of = |scan: &LastScan| {
            let t_map_lidar = scan.t_map_lidar;
            move |p: &[f32; 3]| -> Point { (t_map_lidar * Point3::from(p.map(f64::from))).coords.into() }
        };
        let counting = self.scans.iter().flat_map(|scan| scan.near.iter().map(of(scan)).filter(move |p| scan.travelled <= TRAVEL || is_unseen(p)));
        NearReturns::of(robot, counting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEEPEST: f64 = 0.4;

    #[test]
    fn the_scans_of_the_last_two_metres_count_and_follow_corrections() {
        // A robot goes along x under a ceiling that it sees a metre and a half ahead.
        let ahead = Cloud::from_points(vec![[1.5, 0.0, 0.5]]);
        let mut scans = LastScans::default();
        let above = |scans: &LastScans, x: f64| !scans.returns(STEEPEST).are_clear_of([x, 0.0, 0.0], [x, 0.0, 0.0], 0.6);
        for node in 0..4 {
            scans.push(&Pose::translation(0.75 * node as f64, 0.0, 0.0), &ahead);
            scans.set_node(node);
        }
        assert_eq!([0.75, 1.5, 2.25, 3.0, 3.75].map(|x| above(&scans, x)), [false, false, true, true, true]);
        // A correction lifts them; one is not in the map any more.
        scans.follow(|node| (node != 2).then(|| Pose::translation(0.75 * node as f64, 0.0, 1.0)));
        let lifted = |scans: &LastScans, x: f64| !scans.returns(STEEPEST).are_clear_of([x, 0.0, 1.0], [x, 0.0, 1.0], 0.6);
        assert_eq!(([2.25, 3.0].map(|x| lifted(&scans, x)), above(&scans, 3.75)), ([true, false], true), "the last one was given where it is");
        // A robot that stands keeps what it saw before, but not for ever.
        let stand = |scans: &mut LastScans| scans.push(&Pose::translation(2.25, 0.0, 0.1), &Cloud::default());
        (0..MOST_AGE - 4).for_each(|_| stand(&mut scans));
        assert!(lifted(&scans, 2.25));
        (0..3).for_each(|_| stand(&mut scans));
        assert!(scans.returns(STEEPEST).is_empty() && LastScans::default().returns(STEEPEST).is_empty());
    }

    #[test]
    fn a_robot_that_goes_to_and_fro_keeps_what_it_cannot_see_again() {
        // Above the robot, and ahead of it.
        let [steep, level] = [[0.2, 0.0, 0.5], [3.0, 0.0, 0.5]];
        let mut scans = LastScans::default();
        scans.push(&Pose::identity(), &Cloud::from_points(vec![steep, level]));
        let kept = |scans: &LastScans| [steep, level].map(|p| scans.returns(STEEPEST).nearest(p.map(f64::from)) < 0.01);
        let mut history = Vec::new();
        for place in [0.5, 0.0].into_iter().cycle().take(9) {
            scans.push(&Pose::translation(place, 0.0, 0.0), &Cloud::default());
            history.push(kept(&scans));
        }
        assert_eq!(history, [[[true, true]; 4].as_slice(), &[[true, false]; 4], &[[false; 2]]].concat(), "half a metre each time");
        // One that has been farther away does not.
        scans.push(&Pose::identity(), &Cloud::from_points(vec![steep]));
        scans.push(&Pose::translation(2.1, 0.0, 0.0), &Cloud::default());
        assert!(scans.returns(STEEPEST).is_empty());
    }
}
