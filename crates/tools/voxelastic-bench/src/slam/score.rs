//! How good poses and closures are, against the true poses of the scans.

use crate::error::{BenchError, Result};
use nalgebra::{Matrix3, Quaternion, Translation3, UnitQuaternion};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseExt;
use voxelastic_eval::trajectory::{Delta, Fit, ate, by_id, rpe};
use voxelastic_io::dataset;

/// A closure is wrong beyond this distance or angle from the truth: that of grids of half a metre that cover 100 m.
const WRONG: (f64, f64) = (5.0, 0.2);
/// A scan revisits a place if it was so near before, metres, with so much path in between.
const REVISIT: (f64, f64) = (5.0, 50.0);
/// And that is found if a right closure is not farther away along the path, metres: the length of the largest local map of any system.
const FOUND: f64 = 100.0;

/// Errors of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PathScore {
    /// Absolute error after the best alignment, metres: root of the mean square.
    pub rmse_m: f64,
    /// The same, mean.
    pub mean_m: f64,
    /// Relative error over 10 m of path, percent.
    pub over_10_m: Option<f64>,
    /// Relative error over 50 m of path, percent.
    pub over_50_m: Option<f64>,
}

/// Closures against the truth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ClosureScore {
    /// Within 5 m and 0.2 radians of the truth.
    pub right: usize,
    /// The others.
    pub wrong: usize,
    /// Scans where the path has been before.
    pub revisits: usize,
    /// Those with no right closure within 100 m of path.
    pub missed: usize,
}

/// A closure as a system has it: scans by their place in the recording.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claimed {
    pub from: usize,
    pub to: usize,
    pub t_from_to: Pose,
}

/// True poses of all scans, in order.
#[derive(Debug)]
pub(crate) struct Truth {
    poses: Vec<(NodeId, Pose)>,
    /// Length of the path up to each scan.
    path: Vec<f64>,
}

impl Truth {
    /// Of a folder, in the file named.
    pub fn open(folder: &Path, name: &str) -> Result<Self> {
        let found = dataset::open(folder, &dataset::OpenOptions { poses: Some(name.into()), ..Default::default() })?;
        Ok(Self::of(found.scans().iter().map(|s| s.t_map_lidar).collect()))
    }

    /// Of nothing.
    #[cfg(test)]
    pub fn none() -> Self {
        Self::of(Vec::new())
    }

    fn of(poses: Vec<Pose>) -> Self {
        let mut path = vec![0.0];
        poses.windows(2).for_each(|pair| path.push(path[path.len() - 1] + pair[0].translation_distance(&pair[1])));
        Self { poses: (0..).zip(poses).collect(), path }
    }

    pub fn scans(&self) -> usize {
        self.poses.len()
    }

    /// Errors of the poses of the first scans; none if there are too few.
    pub fn path(&self, found: &[Pose]) -> Option<PathScore> {
        let found: Vec<(NodeId, Pose)> = (0..).zip(found.iter().copied()).collect();
        let pairs = by_id(&self.poses, &found);
        let absolute = ate(&pairs, Fit::Rigid).ok()?.translation_m;
        let over = |metres: f64| rpe(&pairs, Delta::Metres(metres)).ok().and_then(|r| r.drift_percent);
        Some(PathScore { rmse_m: absolute.rmse, mean_m: absolute.mean, over_10_m: over(10.0), over_50_m: over(50.0) })
    }

    /// Which closures are right, and which revisits have none.
    pub fn closures(&self, claimed: &[Claimed]) -> ClosureScore {
        let known = claimed.iter().filter(|c| c.from.max(c.to) < self.poses.len());
        let is_right = |c: &&Claimed| {
            let true_pose = self.poses[c.from].1.inv_mul(&self.poses[c.to].1);
            true_pose.translation_distance(&c.t_from_to) <= WRONG.0 && true_pose.rotation_distance(&c.t_from_to) <= WRONG.1
        };
        let right: Vec<&Claimed> = known.filter(is_right).collect();
        let is_revisit =
            |k: usize| (0..k).any(|j| self.path[k] - self.path[j] > REVISIT.1 && self.poses[j].1.translation_distance(&self.poses[k].1) < REVISIT.0);
        let revisits: Vec<usize> = (0..self.poses.len()).filter(|k| is_revisit(*k)).collect();
        let is_found = |k: &&usize| right.iter().any(|c| (self.path[c.from.max(c.to)] - self.path[**k]).abs() <= FOUND);
        let found = revisits.iter().filter(is_found).count();
        ClosureScore { right: right.len(), wrong: claimed.len() - right.len(), revisits: revisits.len(), missed: revisits.len() - found }
    }
}

impl Claimed {
    /// One of `closures.tried` of `voxelastic map --json`.
    pub fn of_ours(closure: &Value) -> Option<Self> {
        let index = |key: &str| closure.get(key).and_then(Value::as_u64).map(|n| n as usize);
        let v = numbers(closure.get("t_from_to")?)?;
        let [x, y, z, i, j, k, w] = v[..].try_into().ok()?;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-6)?;
        Some(Self { from: index("from")?, to: index("to")?, t_from_to: Pose::from_parts(Translation3::new(x, y, z), rotation) })
    }

    /// `{"closure": [from, to], "t_from_to": rows}` of an adapter.
    pub fn of_peer(answer: &Value) -> Option<Self> {
        let nodes = numbers(answer.get("closure")?)?;
        let [from, to] = nodes[..].try_into().ok()?;
        let index = |v: f64| (v >= 0.0 && v.fract() == 0.0).then_some(v as usize);
        Some(Self { from: index(from)?, to: index(to)?, t_from_to: pose(answer.get("t_from_to")?)? })
    }
}

/// A pose of twelve numbers: three rows of rotation and position.
pub(crate) fn pose(value: &Value) -> Option<Pose> {
    of_rows(&numbers(value)?)
}

fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(|v| v.as_f64().filter(|v| v.is_finite())).collect()
}

fn of_rows(v: &[f64]) -> Option<Pose> {
    if v.len() != 12 {
        return None;
    }
    let rotation = UnitQuaternion::from_matrix(&Matrix3::from_fn(|i, j| v[4 * i + j]));
    Some(Pose::from_parts(Translation3::new(v[3], v[7], v[11]), rotation))
}

/// The poses of a file of KITTI rows.
pub(crate) fn rows(path: &Path) -> Result<Vec<Pose>> {
    let text = std::fs::read_to_string(path).map_err(BenchError::file(path))?;
    let row = |line: &str| line.split_whitespace().map(|w| w.parse().ok()).collect::<Option<Vec<f64>>>().and_then(|v| of_rows(&v));
    let problem = || BenchError::Answer { command: path.display().to_string(), problem: "not rows of twelve numbers".to_owned() };
    text.lines().map(|line| row(line).ok_or_else(problem)).collect()
}

/// The twelve numbers of a pose.
pub(crate) fn row_of(pose: &Pose) -> [f64; 12] {
    let (r, t) = (pose.rotation.to_rotation_matrix(), pose.translation.vector);
    std::array::from_fn(|k| if k % 4 == 3 { t[k / 4] } else { r[(k / 4, k % 4)] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    /// Out 100 m and back, a scan each metre.
    fn truth() -> Truth {
        Truth::of((0..200).map(|i| Pose::translation(f64::from(if i < 100 { i } else { 199 - i }), 0.0, 0.0)).collect())
    }

    #[test]
    fn closures_are_judged_by_their_poses_and_revisits_by_what_is_near() {
        let truth = truth();
        let none = truth.closures(&[]);
        assert!(none.revisits > 60 && none.missed == none.revisits && none.right + none.wrong == 0, "{none:?}");
        let claim = |from, to, x| Claimed { from, to, t_from_to: Pose::translation(x, 0.0, 0.0) };
        // Scans 20 and 179 are in the same place, scans 20 and 150 are 29 m apart.
        let both = truth.closures(&[claim(20, 179, 1.0), claim(20, 150, 0.0), claim(20, 900, 0.0)]);
        assert_eq!((both.right, both.wrong, both.missed), (1, 2, 0));
    }

    #[test]
    fn poses_are_compared_after_alignment() {
        let truth = truth();
        let turned = Pose::new(nalgebra::Vector3::new(5.0, -2.0, 1.0), nalgebra::Vector3::new(0.1, 0.2, 1.0));
        let poses: Vec<Pose> = truth.poses.iter().map(|(_, p)| turned * p).collect();
        let found = truth.path(&poses).unwrap();
        assert!(found.rmse_m < 1e-9 && found.over_50_m.unwrap() < 1e-6, "{found:?}");
        let long: Vec<Pose> = truth.poses.iter().map(|(_, p)| Pose::translation(1.01 * p.translation.x, 0.0, 0.0)).collect();
        assert!((truth.path(&long).unwrap().over_10_m.unwrap() - 1.0).abs() < 0.1);
        assert!(truth.path(&[]).is_none());
    }

    #[test]
    fn answers_that_are_no_closures_are_left_out() {
        let pose = Pose::new(nalgebra::Vector3::new(1.0, 2.0, 3.0), nalgebra::Vector3::new(0.0, 0.0, 0.5));
        let read = Claimed::of_peer(&json!({"closure": [3, 90], "t_from_to": row_of(&pose)})).unwrap();
        assert!(
            (read.from, read.to) == (3, 90) && read.t_from_to.translation_distance(&pose) < 1e-9 && read.t_from_to.rotation_distance(&pose) < 1e-6
        );
        assert!(Claimed::of_peer(&json!({"closure": [-1, 90], "t_from_to": row_of(&pose)})).is_none());
        assert!(Claimed::of_peer(&json!({"closure": [3], "t_from_to": row_of(&pose)})).is_none());
        assert!(Claimed::of_peer(&json!({"closure": [3, 4], "t_from_to": [1, 2]})).is_none());
        assert!(Claimed::of_ours(&json!({"from": 1, "to": 2, "t_from_to": [1, 2, 3, 0, 0, 0, 1]})).is_some());
        assert!(Claimed::of_ours(&json!({"from": 1, "to": 2, "t_from_to": null})).is_none());
    }
}
