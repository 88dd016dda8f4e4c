//! What a dataset consists of, for people.

use super::folder::Folder;
use super::matching::{Matched, MatchedBy};
use super::pose_file::{PoseFile, Snapshot};
use crate::dumps::Dump;
use crate::folders::name_of;
use crate::scan_list::ScanEdges;
use crate::{CloudFormat, Error, PoseFormat, PoseGraph, Result};
use std::fmt;
use std::path::{Path, PathBuf};

/// The poses of a dataset.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PosesDescription {
    /// Name of the file.
    pub file: String,
    /// Its format.
    pub format: PoseFormat,
    /// Poses in it.
    pub poses: usize,
    /// Poses in it that belong to no cloud.
    pub unused: usize,
    /// How they were matched to the clouds.
    pub matched_by: MatchedBy,
    /// Whether the file's name says that it is ground truth.
    pub is_ground_truth: bool,
}

/// What a dataset consists of and what is ignored. [`fmt::Display`] says it in a few lines.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Description {
    /// Where the clouds are, relative to the dataset's folder; empty for the folder itself.
    pub clouds_in: PathBuf,
    /// Their format.
    pub cloud_format: CloudFormat,
    /// How many there are.
    pub clouds: usize,
    /// The poses; `None` for the layouts of SLAM systems and data sets, where a note says where the poses come from.
    pub poses: Option<PosesDescription>,
    /// The file of the times, if they come neither from the poses nor from the clouds' names.
    pub times: Option<String>,
    /// Whether the clouds' names contain their times.
    pub times_in_names: bool,
    /// The pose graph that the edges come from, and its number of nodes, odometry edges and loop edges.
    pub graph: Option<(String, [usize; 3])>,
    /// Loop edges that are not used because one of their nodes has no scan.
    pub loop_edges_without_scan: usize,
    /// The file that is named ground truth, if it is not used as poses.
    pub ground_truth: Option<String>,
    /// Pose snapshots.
    pub snapshots: usize,
    /// Clouds that are skipped because they have no pose.
    pub without_pose: Vec<PathBuf>,
    /// Scans that are not taken because of the keyframing.
    pub not_keyframes: usize,
    /// Further remarks.
    pub notes: Vec<String>,
}

impl Description {
    pub(super) fn of(folder: &Folder) -> Self {
        Self {
            clouds_in: folder.clouds.relative.clone(),
            cloud_format: folder.clouds.format,
            clouds: folder.clouds.clouds.len(),
            poses: None,
            times: None,
            times_in_names: folder.clouds.clouds.iter().all(|c| c.stamp.is_some()),
            graph: None,
            loop_edges_without_scan: 0,
            ground_truth: None,
            snapshots: folder.snapshots.len(),
            without_pose: Vec::new(),
            not_keyframes: 0,
            notes: folder.clouds.notes.clone(),
        }
    }

    pub(super) fn of_dump(path: &Path, dump: &Dump) -> Result<Self> {
        let first = dump.scans.first().map(|s| &s.path).or(dump.without_pose.first());
        let Some(format) = first.and_then(|p| CloudFormat::of(p)) else {
            return Err(Error::dataset(path, format!("a {} without clouds", dump.system), "write it again"));
        };
        let mut notes = vec![format!("a {}: poses from {}", dump.system, dump.poses)];
        notes.extend(dump.notes.iter().cloned());
        Ok(Self {
            clouds_in: first.and_then(|p| p.parent()?.strip_prefix(path).ok()).map(Path::to_owned).unwrap_or_default(),
            cloud_format: format,
            clouds: dump.scans.len() + dump.without_pose.len(),
            poses: None,
            times: None,
            times_in_names: false,
            graph: None,
            loop_edges_without_scan: 0,
            ground_truth: None,
            snapshots: 0,
            without_pose: dump.without_pose.clone(),
            not_keyframes: 0,
            notes,
        })
    }

    pub(super) fn matched(&mut self, file: &PoseFile, poses: usize, matched: &Matched, folder: &Folder) {
        let missing = matched.poses.iter().zip(&folder.clouds.clouds).filter(|(pose, _)| pose.is_none());
        self.without_pose = missing.map(|(_, cloud)| cloud.path.clone()).collect();
        self.poses = Some(PosesDescription {
            file: file.name(),
            format: file.format,
            poses,
            unused: matched.unused,
            matched_by: matched.by,
            is_ground_truth: file.is_ground_truth(),
        });
    }

    /// Notes that snapshots are not used because the poses are the ground truth, which needs no corrections.
    pub(super) fn drop_snapshots(&mut self) -> Vec<Snapshot> {
        if self.snapshots > 0 {
            self.notes.push(format!("{} pose snapshots are ignored: the poses are the ground truth", self.snapshots));
            self.snapshots = 0;
        }
        Vec::new()
    }

    pub(super) fn graph(&mut self, file: &PoseFile, graph: &PoseGraph, edges: &ScanEdges) {
        let (odometry, loops) = graph.split_edges();
        self.graph = Some((name_of(&file.path), [graph.nodes.len(), odometry.len(), loops.len()]));
        self.loop_edges_without_scan = edges.loops_without_scan;
    }
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let location = if self.clouds_in.as_os_str().is_empty() { "in the folder".into() } else { format!("in {}/", self.clouds_in.display()) };
        write!(f, "clouds: {} {} {location}", self.clouds, self.cloud_format)?;
        if self.times_in_names {
            write!(f, ", times in their names")?;
        }
        if let Some(poses) = &self.poses {
            let truth = if poses.is_ground_truth { " (ground truth)" } else { "" };
            write!(f, "\nposes: {}{truth}, {} {}, matched {}", poses.file, poses.poses, poses.format, poses.matched_by)?;
            if poses.unused > 0 {
                write!(f, ", {} belong to no cloud", poses.unused)?;
            }
        }
        if let Some(file) = &self.times {
            write!(f, "\ntimes: {file}")?;
        }
        if let Some((file, [nodes, odometry, loops])) = &self.graph {
            write!(f, "\ngraph: {file}, {nodes} nodes, {odometry} odometry edges, {loops} loop edges")?;
            if self.loop_edges_without_scan > 0 {
                write!(f, ", {} of them without a scan at both ends are not used", self.loop_edges_without_scan)?;
            }
        }
        if let Some(file) = &self.ground_truth {
            write!(f, "\nground truth: {file}, not used as poses")?;
        }
        if self.snapshots > 0 {
            write!(f, "\npose snapshots: {}", self.snapshots)?;
        }
        if let Some(first) = self.without_pose.first() {
            write!(f, "\nskipped: {} clouds without a pose, the first is {}", self.without_pose.len(), name_of(first))?;
        }
        if self.not_keyframes > 0 {
            write!(f, "\nnot taken: {} scans between keyframes", self.not_keyframes)?;
        }
        self.notes.iter().try_for_each(|note| write!(f, "\nnote: {note}"))
    }
}
