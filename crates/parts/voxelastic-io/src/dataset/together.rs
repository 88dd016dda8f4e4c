//! Folders of several sensors as one list of scans.

use super::registered::Dataset;
use super::snapshot::SnapshotContext;
use crate::scan_list::NODES_OF_SENSOR;
use crate::{Error, OpenOptions, Result};
use std::path::Path;
use std::sync::Arc;
use voxelastic::event::NodeId;

/// Adds the scans of the further folders of `options` to those of the first, in the order of their times. Each folder is opened by `open` as if it was alone, with
/// its own poses, and its sensor has its own place in the base frame.
///
/// # Errors
/// Those of `open`, and [`Error::Dataset`] if scans of one have no times, or if there is a graph or a corrected trajectory.
pub(super) fn together(mut first: Dataset, options: &OpenOptions, open: impl Fn(&Path, &OpenOptions) -> Result<Dataset>) -> Result<Dataset> {
    if options.more_folders.is_empty() {
        return Ok(first);
    }
    check(&first)?;
    let (mut scans, mut tracks) = (first.scans.to_vec(), Vec::new());
    for (sensor, folder) in (1u16..).zip(&options.more_folders) {
        let alone = OpenOptions { t_base_lidar: folder.t_base_lidar, more_folders: Vec::new(), ..options.clone() };
        let other = open(&folder.path, &alone)?;
        check(&other)?;
        let text = other.description.to_string();
        first.description.notes.push(format!("sensor {}: {}: {}", sensor + 1, folder.path.display(), text.lines().collect::<Vec<_>>().join("; ")));
        first.description.without_pose.extend(other.description.without_pose.iter().cloned());
        first.description.not_keyframes += other.description.not_keyframes;
        scans.extend(other.scans.iter().cloned().map(|mut scan| {
            (scan.sensor, scan.node) = (sensor, scan.node % NODES_OF_SENSOR + NodeId::from(sensor) * NODES_OF_SENSOR);
            scan
        }));
        tracks.push(other.context.track.clone());
    }
    scans.sort_by(|a, b| a.time.total_cmp(&b.time).then(a.sensor.cmp(&b.sensor)));
    first.scans = scans.into();
    first.ground_truth = None;
    first.context = Arc::new(SnapshotContext { further: tracks, ..SnapshotContext::clone(&first.context) });
    Ok(first)
}

/// Refuses what only one sensor can have.
fn check(folder: &Dataset) -> Result<()> {
    let refused = |problem: &str, remedy: &'static str| Err(Error::dataset(&folder.path, problem, remedy));
    if !folder.edges.is_empty() || !folder.snapshots.is_empty() {
        return refused(
            "a pose graph or corrected trajectories, which have one sensor",
            "move the graph and the files poses@* away, and name final poses with --poses",
        );
    }
    if !folder.context.has_times {
        return refused("scans without times: their order among those of the other sensor is not known", "add times.txt, or poses with times");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SensorFolder, pcd, poses};
    use voxelastic::{Cloud, Pose};

    #[test]
    fn data_that_are_in_use_elsewhere_keep_their_motion() {
        let dir = tempfile::tempdir().unwrap();
        let path_of = |name: &str| dir.path().join(name);
        let cloud = Cloud { time: Some(vec![0.0, 0.05]), ..Cloud::from_points(vec![[5.0, 0.0, 0.0], [0.0, 5.0, 0.0]]) };
        let stamped: Vec<(f64, Pose)> = (0..4).map(|k| (0.1 * f64::from(k), Pose::translation(0.1 * f64::from(k), 0.0, 0.0))).collect();
        for name in ["front", "rear"] {
            (0..4).for_each(|k| pcd::write(path_of(name).join(format!("{k}.pcd")), &cloud).unwrap());
            poses::write_tum(path_of(name).join("poses.tum"), &stamped).unwrap();
        }
        let options = OpenOptions { more_folders: vec![SensorFolder { path: path_of("rear"), t_base_lidar: None }], ..OpenOptions::default() };
        let opened = std::cell::RefCell::new(Vec::new());
        let open = |path: &Path, options: &OpenOptions| {
            let alone = crate::dataset::open(path, &OpenOptions { more_folders: Vec::new(), ..options.clone() })?;
            opened.borrow_mut().push(alone.clone());
            Ok(alone)
        };
        let both = together(open(&path_of("front"), &options).unwrap(), &options, open).unwrap();
        assert_eq!((both.scans().len(), opened.borrow().len()), (8, 2));
        for scan in &both.scans()[..6] {
            assert!(both.cloud(scan).unwrap().motion.is_some(), "sensor {} at {} s", scan.sensor, scan.time);
        }
    }
}
