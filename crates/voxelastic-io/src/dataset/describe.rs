//! What was found in a folder, in words.

use super::edges::Edges;
use super::folder::{Folder, PoseFile, Snapshot, name_of};
use super::matching::{Matched, MatchedBy};
use crate::dumps::Dump;
use crate::{CloudFormat, Error, PoseFormat, PoseGraph, Result};
use std::fmt;
use std::path::{Path, PathBuf};

/// The poses that are used.
#[derive(Clone, Debug, PartialEq)]
pub struct Used {
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
    /// Whether the file calls itself ground truth.
    pub is_ground_truth: bool,
}

/// What a dataset consists of and what was left aside. [`fmt::Display`] tells it in a few lines.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Description {
    /// Where the clouds are, relative to the dataset's folder; empty for the folder itself.
    pub clouds_in: PathBuf,
    /// Their format.
    pub cloud_format: CloudFormat,
    /// How many there are.
    pub clouds: usize,
    /// The poses, but for layouts of their own: a note says then where they are from.
    pub poses: Option<Used>,
    /// File that the times are from, other than the poses and the clouds' names.
    pub times: Option<String>,
    /// Whether the clouds' names tell their times.
    pub times_in_names: bool,
    /// The pose graph that edges are from, and how many nodes, odometry edges and loop edges it has.
    pub graph: Option<(String, [usize; 3])>,
    /// Loop edges that are left out because an end of theirs has no scan.
    pub loop_edges_without_scan: usize,
    /// The file that calls itself ground truth and is not used as poses.
    pub ground_truth: Option<String>,
    /// Pose snapshots.
    pub snapshots: usize,
    /// Clouds that are skipped because they have no pose.
    pub without_pose: Vec<PathBuf>,
    /// Scans that are left out because fewer were asked for.
    pub thinned: usize,
    /// Anything else that was left aside.
    pub notes: Vec<String>,
}

impl Description {
    pub(super) fn of(folder: &Folder) -> Self {
        Self {
            clouds_in: folder.clouds_in.clone(),
            cloud_format: folder.format,
            clouds: folder.clouds.len(),
            poses: None,
            times: None,
            times_in_names: folder.clouds.iter().all(|c| c.stamp.is_some()),
            graph: None,
            loop_edges_without_scan: 0,
            ground_truth: None,
            snapshots: folder.snapshots.len(),
            without_pose: Vec::new(),
            thinned: 0,
            notes: folder.notes.clone(),
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
            thinned: 0,
            notes,
        })
    }

    pub(super) fn matched(&mut self, file: &PoseFile, poses: usize, matched: &Matched, folder: &Folder) {
        let missing = matched.poses.iter().zip(&folder.clouds).filter(|(pose, _)| pose.is_none());
        self.without_pose = missing.map(|(_, cloud)| cloud.path.clone()).collect();
        self.poses = Some(Used {
            file: file.name(),
            format: file.format,
            poses,
            unused: matched.unused,
            matched_by: matched.by,
            is_ground_truth: file.is_ground_truth(),
        });
    }

    /// The poses are the ground truth, which no snapshot corrects: none of the snapshots is used.
    pub(super) fn leave_snapshots(&mut self) -> Vec<Snapshot> {
        if self.snapshots > 0 {
            self.notes.push(format!("{} pose snapshots are left aside: the poses are the ground truth", self.snapshots));
            self.snapshots = 0;
        }
        Vec::new()
    }

    pub(super) fn graph(&mut self, file: &PoseFile, graph: &PoseGraph, edges: &Edges) {
        let (odometry, loops) = graph.split_edges();
        self.graph = Some((name_of(&file.path), [graph.nodes.len(), odometry.len(), loops.len()]));
        self.loop_edges_without_scan = edges.loops_without_scan;
    }
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = if self.clouds_in.as_os_str().is_empty() { "in the folder".into() } else { format!("in {}/", self.clouds_in.display()) };
        write!(f, "clouds: {} {} {place}", self.clouds, self.cloud_format)?;
        if self.times_in_names {
            write!(f, ", times in their names")?;
        }
        if let Some(used) = &self.poses {
            let truth = if used.is_ground_truth { " (ground truth)" } else { "" };
            write!(f, "\nposes: {}{truth}, {} {}, matched {}", used.file, used.poses, used.format, used.matched_by)?;
            if used.unused > 0 {
                write!(f, ", {} belong to no cloud", used.unused)?;
            }
        }
        if let Some(file) = &self.times {
            write!(f, "\ntimes: {file}")?;
        }
        if let Some((file, [nodes, odometry, loops])) = &self.graph {
            write!(f, "\ngraph: {file}, {nodes} nodes, {odometry} odometry edges, {loops} loop edges")?;
            if self.loop_edges_without_scan > 0 {
                write!(f, ", {} of them left out for want of a scan", self.loop_edges_without_scan)?;
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
        if self.thinned > 0 {
            write!(f, "\nleft out: {} scans, fewer were asked for", self.thinned)?;
        }
        self.notes.iter().try_for_each(|note| write!(f, "\nnote: {note}"))
    }
}
