//! A folder of clouds with their poses as one registered cloud list: found without flags, read as a stream of events.
//!
//! ```text
//! drive/
//!   scans/ | Scans/ | velodyne/ | clouds/   clouds (.pcd, .ply, .bin), or in the folder itself
//!   poses.tum                               a trajectory, recognised by its content: TUM, KITTI rows, Newer College CSV
//!   graph.g2o                               nodes, odometry edges and loop edges
//!   times.txt                               the time of each cloud (or of each pose)
//!   groundtruth.txt                         a trajectory whose name says so, kept apart
//!   poses@000123.txt                        corrected poses, known after the scan of node 123
//! ```
//!
//! What other SLAM systems and data sets leave in layouts of their own (hdl_graph_slam, GLIM, BALM and HBA, KITTI odometry, MulRan) is
//! recognised as well.
//!
//! [`open`] lists and matches, which is cheap; [`Dataset::events`] decodes clouds as they are needed.

mod choose;
mod describe;
mod edges;
mod events;
mod every;
mod folder;
mod matching;
mod names;
mod onward;
pub(crate) use names::{natural, stamp};
mod snapshot;

pub use describe::{Description, Used};
pub use events::Events;
pub use every::Every;
pub use matching::MatchedBy;

use crate::dumps::{self, Dump};
use crate::survey::e57;
use crate::{Error, PoseFormat, PoseGraph, Position, Result, StampedCloud, Trajectory, clouds, g2o, poses};
pub(crate) use edges::Edges;
pub(crate) use events::in_scan_time;
pub(crate) use every::Picker;
pub(crate) use folder::holds_clouds;
pub(crate) use onward::Onward;

use crate::playback::Track;
use folder::{Folder, PoseFile, Snapshot, name_of};
use matching::{Clouds, Matched, match_poses};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::event::NodeId;
use voxelastic::{Cloud, Pose};

/// How to open a dataset. The default fits most folders.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The pose file: a path, a file name in the folder, or a part of one that no other pose file has (`groundtruth`).
    pub poses: Option<PathBuf>,
    /// The g2o graph to take edges from, named like `poses`. Beside a recording also a folder of corrected trajectories as they were known
    /// at times of the recording, seconds: `poses@1600000000.5.tum`.
    pub graph: Option<PathBuf>,
    /// Pose of the lidar frame in the base frame. If given, the poses and edges in the files are those of the base:
    /// `t_map_lidar = t_map_base * t_base_lidar` (paper Sec. IV).
    pub t_base_lidar: Option<Pose>,
    /// Whether a cloud without a pose, or a graph that cannot be tied to the clouds, is an error and not a counted skip.
    pub strict: bool,
    /// Which scans to take; by default all of a folder, and of a recording one every 2 m.
    pub every: Option<Every>,
    /// The topic of a recording that holds the clouds.
    pub cloud_topic: Option<String>,
    /// The topic of a recording that holds the poses.
    pub pose_topic: Option<String>,
    /// The sensor's metadata beside a capture of its packets, where it is not found by its name.
    pub metadata: Option<PathBuf>,
    /// Whether clouds whose points have times are told how the lidar moved, so that they are set right for the motion during the sweep.
    pub deskew: bool,
    /// How far in time the nearest pose may be from a cloud when they are matched by time, seconds.
    pub time_tolerance_s: f64,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            poses: None,
            graph: None,
            t_base_lidar: None,
            strict: false,
            every: None,
            cloud_topic: None,
            pose_topic: None,
            metadata: None,
            deskew: true,
            time_tolerance_s: 0.01,
        }
    }
}

/// A scan that has not been decoded yet. Of a file that holds several (E57) it is the one numbered `index`.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanEntry {
    /// The cloud's file.
    pub path: PathBuf,
    /// Position among all clouds of the folder, 0-based.
    pub index: usize,
    /// The node of the pose graph: as the graph numbers it, else the number in the file's name, else `index`.
    pub node: NodeId,
    /// Time in seconds; `index` where the dataset has no times.
    pub time: f64,
    /// Pose of the lidar frame in the map frame.
    pub t_map_lidar: Pose,
}

impl ScanEntry {
    /// Decodes the cloud as its file has it.
    pub(crate) fn read(&self) -> Result<StampedCloud> {
        if clouds::CloudFormat::of(&self.path) != Some(clouds::CloudFormat::E57) {
            return clouds::read(&self.path);
        }
        let survey = e57::read_one(&self.path, self.index)?.survey;
        if survey.offset != [0.0; 3] {
            let problem = format!("the points of scan {} are {:?} m from the scanner", self.index, survey.offset);
            return Err(Error::content(&self.path, Position::File, problem, "export the scans in the scanner's own frame, with their poses"));
        }
        Ok(StampedCloud { cloud: survey.cloud, stamp: None })
    }
}

/// The ground truth that lies beside a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// Its file.
    pub path: PathBuf,
    /// Pose of the lidar frame at each of [`Dataset::scans`], where the file has one.
    pub t_map_lidar: Vec<Option<Pose>>,
}

/// A dataset whose clouds and poses are matched. No cloud has been decoded.
#[derive(Clone, Debug)]
pub struct Dataset {
    path: PathBuf,
    scans: Arc<[ScanEntry]>,
    edges: Arc<Edges>,
    snapshots: Arc<[Snapshot]>,
    context: Arc<snapshot::Context>,
    ground_truth: Option<GroundTruth>,
    description: Description,
}

/// Opens a dataset.
///
/// # Errors
/// [`Error::Ambiguous`] if several files could hold the poses or the graph; [`Error::Dataset`] if there are no clouds, no poses,
/// or no way to tell which belong together; [`Error::Content`] if a pose, graph or time file is damaged; with
/// [`OpenOptions::strict`], also if a cloud has no pose.
pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Dataset> {
    let path = path.as_ref();
    let is_e57 = clouds::CloudFormat::of(path) == Some(clouds::CloudFormat::E57);
    if path.is_file() && !is_e57 {
        return Err(Error::dataset(path, "a file, not a folder", "name the folder that holds the clouds and their poses"));
    }
    if options.cloud_topic.is_some() || options.pose_topic.is_some() || options.metadata.is_some() {
        let remedy = "do without --cloud-topic, --pose-topic and --metadata, or name a recording";
        return Err(Error::dataset(path, "a folder of clouds has no topics and no packets", remedy));
    }
    if is_e57 && options.poses.is_some() {
        return Err(Error::dataset(path, "a file of laser scans has its own poses", "do without --poses"));
    }
    if options.poses.is_none()
        && let Some(dump) = dumps::find(path)?
    {
        return from_dump(path, dump, options);
    }
    let folder = folder::scan(path)?;
    let mut description = Description::of(&folder);
    let pose_file = choose::poses(&folder, options.poses.as_deref())?;
    let graph_file = choose::graph(&folder, options.graph.as_deref(), &pose_file)?;
    let graph = graph_file.map(|file| g2o::read(&file.path).map(|graph| (file, graph))).transpose()?;
    let trajectory = in_lidar_frame(poses::read(&pose_file.path)?, options.t_base_lidar.as_ref());

    let times = times(&folder, &trajectory, &mut description)?;
    let trajectory = Trajectory { times: trajectory.times.or(times.of_poses), ..trajectory };
    let clouds = Clouds { files: &folder.clouds, times: times.of_clouds.as_deref(), tolerance_s: options.time_tolerance_s };
    let matched = match_poses(clouds, &trajectory, &pose_file.path)?;
    description.matched(&pose_file, trajectory.len(), &matched, &folder);
    check_complete(path, options, &description)?;

    let (nodes, graph) = tie(clouds, graph, options, &mut description)?;
    let all = entries(clouds, &matched, &nodes);
    let with_pose = all.len();
    let all_stamped: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let scans = options.every.unwrap_or_default().select(all);
    description.thinned = with_pose - scans.len();
    let truth = ground_truth(&folder, &pose_file, clouds, options, &mut description);
    let ground_truth = truth.map(|(path, poses)| GroundTruth { path, t_map_lidar: scans.iter().map(|s| poses[s.index]).collect() });
    let edges = Edges::of(graph.as_ref().map(|(_, g)| g), &scans, options.t_base_lidar.as_ref());
    if let Some((file, graph)) = &graph {
        description.graph(file, graph, &edges);
    }
    let has_times = times.of_clouds.is_some() || trajectory.times.is_some();
    let track = (options.deskew && has_times).then(|| track(&trajectory, &all_stamped));
    let context = snapshot::Context { t_base_lidar: options.t_base_lidar, nodes, times: times.of_clouds, track };
    // Corrections of an estimate must not move what the truth has put in its place.
    let snapshots = if pose_file.is_ground_truth() { description.leave_snapshots() } else { folder.snapshots };
    Ok(Dataset {
        path: path.into(),
        scans: scans.into(),
        edges: Arc::new(edges),
        snapshots: snapshots.into(),
        context: Arc::new(context),
        ground_truth,
        description,
    })
}

/// Opens a dataset for the sake of its true poses: those in the file `poses`, named as in [`OpenOptions`], or in the only file that calls
/// itself ground truth. Whatever other pose files are there does not matter. `None` if no file was named and none calls itself so.
///
/// # Errors
/// [`Error::Ambiguous`] if several files call themselves ground truth, and as [`open`].
pub fn open_truth(path: impl AsRef<Path>, poses: Option<&Path>) -> Result<Option<(PathBuf, Dataset)>> {
    let path = path.as_ref();
    let Some(file) = choose::truth(&folder::scan(path)?, poses)? else { return Ok(None) };
    let data = open(path, &OpenOptions { poses: Some(file.path.clone()), ..OpenOptions::default() })?;
    Ok(Some((file.path, data)))
}

/// A folder that a SLAM system or a data set left in a layout of its own.
fn from_dump(path: &Path, dump: Dump, options: &OpenOptions) -> Result<Dataset> {
    let mut description = Description::of_dump(path, &dump)?;
    check_complete(path, options, &description)?;
    let graph = match &options.graph {
        Some(asked) => Some((asked.clone(), g2o::read(asked)?)),
        None => dump.graph,
    };
    let mut all = dump.scans;
    if let Some(t_base_lidar) = &options.t_base_lidar {
        all.iter_mut().for_each(|scan| scan.t_map_lidar *= t_base_lidar);
    }
    let nodes = all.iter().map(|s| s.node).collect();
    let stamped: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let with_pose = all.len();
    let scans = options.every.unwrap_or_default().select(all);
    description.thinned = with_pose - scans.len();
    let edges = Edges::of(graph.as_ref().map(|(_, g)| g), &scans, options.t_base_lidar.as_ref());
    if let Some((file, graph)) = &graph {
        description.graph(&PoseFile { path: file.clone(), format: PoseFormat::G2o }, graph, &edges);
    }
    let track = options.deskew.then(|| track(&Trajectory::default(), &stamped));
    let times = Some(stamped.iter().map(|(time, _)| *time).collect());
    let context = snapshot::Context { t_base_lidar: options.t_base_lidar, nodes, times, track };
    Ok(Dataset {
        path: path.into(),
        scans: scans.into(),
        edges: Arc::new(edges),
        snapshots: Vec::new().into(),
        context: Arc::new(context),
        ground_truth: None,
        description,
    })
}

/// Refuses clouds without poses if asked to.
fn check_complete(path: &Path, options: &OpenOptions, description: &Description) -> Result<()> {
    match description.without_pose.first() {
        Some(first) if options.strict => {
            let problem = format!("{} clouds have no pose, the first is {}", description.without_pose.len(), first.display());
            Err(Error::dataset(path, problem, "add the poses, remove the clouds, or do without --strict"))
        }
        _ => Ok(()),
    }
}

impl Dataset {
    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The scans that have a pose, in the order of time.
    pub fn scans(&self) -> &[ScanEntry] {
        &self.scans
    }

    /// What was found in the folder, and what was left aside; to be shown to the user.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// The ground truth, if a file of the folder calls itself that. It is never used unless chosen as the poses.
    pub fn ground_truth(&self) -> Option<&GroundTruth> {
        self.ground_truth.as_ref()
    }

    /// Loop edges between scans of the dataset, in lidar frames, in the order of the graph's file.
    pub fn loop_edges(&self) -> &[voxelastic::event::Edge] {
        &self.edges.loops
    }

    /// Reads the cloud of one of the scans, with all that [`events`](Self::events) would tell of it.
    ///
    /// # Errors
    /// As [`clouds::read`].
    pub fn cloud(&self, scan: &ScanEntry) -> Result<Cloud> {
        let decoded = scan.read()?;
        Ok(self.context.in_motion(in_scan_time(decoded, scan.time), scan))
    }

    /// Keeps only some of the scans, for instance to hold others out. Loop edges of dropped scans go with them.
    pub fn retain(&mut self, mut keep: impl FnMut(&ScanEntry) -> bool) {
        let kept: Vec<bool> = self.scans.iter().map(&mut keep).collect();
        let mut flags = kept.iter();
        if let Some(truth) = &mut self.ground_truth {
            truth.t_map_lidar.retain(|_| flags.next().copied().unwrap_or(false));
        }
        self.scans = self.scans.iter().zip(&kept).filter(|(_, k)| **k).map(|(s, _)| s.clone()).collect();
        let edges = Arc::make_mut(&mut self.edges);
        self.description.loop_edges_without_scan += edges.retain(&self.scans);
    }

    /// Keeps the first `most` scans and what was known by then: snapshots of the poses that were taken after a later scan go.
    pub fn truncate(&mut self, most: usize) {
        let Some(first_left_out) = self.scans.get(most).map(|scan| scan.node) else { return };
        let mut place = 0..;
        self.retain(|_| place.next().is_some_and(|place| place < most));
        self.snapshots = self.snapshots.iter().filter(|s| s.after < first_left_out).cloned().collect();
    }

    /// The registered cloud list: each scan when its turn comes, an odometry edge from the scan before it (measured if the
    /// graph has it, else the relative pose), loop edges once both ends have been seen, pose updates from snapshots at
    /// their scan. Scans that come after a snapshot go on from the corrected poses, unless the pose file has the corrections in it.
    ///
    /// Clouds are decoded on a thread of their own, at most two ahead, so memory does not grow with the dataset. A cloud that
    /// cannot be read is an `Err` item, and the iteration goes on with the next.
    pub fn events(&self) -> Events {
        Events::new(self)
    }
}

/// All poses of the lidar that have a time: those of the trajectory, and those that belong to a cloud.
fn track(trajectory: &Trajectory, scans: &[(f64, Pose)]) -> Track {
    let mut track = Track::default();
    let of_poses = trajectory.times.iter().flatten().copied().zip(trajectory.poses.iter().copied());
    of_poses.chain(scans.iter().copied()).for_each(|(time, pose)| track.add(time, pose));
    track
}

type NamedGraph = (PoseFile, PoseGraph);

/// Times that the folder knows besides those of the trajectory.
struct Times {
    of_clouds: Option<Vec<f64>>,
    of_poses: Option<Vec<f64>>,
}

/// Times from `times.txt`, else from the clouds' names.
fn times(folder: &Folder, trajectory: &Trajectory, description: &mut Description) -> Result<Times> {
    let from_names: Option<Vec<f64>> = folder.clouds.iter().map(|c| c.stamp).collect();
    let clouds = folder.clouds.len();
    let [file] = folder.times.as_slice() else {
        if !folder.times.is_empty() {
            let names: Vec<String> = folder.times.iter().map(|f| name_of(f)).collect();
            return Err(Error::dataset(
                &folder.path,
                format!("several files hold times: {}", names.join(", ")),
                "leave the one with the clouds' times",
            ));
        }
        return Ok(Times { of_clouds: from_names, of_poses: None });
    };
    let times = poses::read_times(file)?;
    if times.len() == clouds {
        description.times = Some(name_of(file));
        return Ok(Times { of_clouds: Some(times), of_poses: None });
    }
    if times.len() == trajectory.len() && trajectory.times.is_none() {
        description.times = Some(name_of(file));
        return Ok(Times { of_clouds: from_names, of_poses: Some(times) });
    }
    let problem = format!("{} times for {clouds} clouds and {} poses", times.len(), trajectory.len());
    Err(Error::dataset(file, problem, "write the time of each cloud on a line of its own, or remove the file"))
}

fn in_lidar_frame(trajectory: Trajectory, t_base_lidar: Option<&Pose>) -> Trajectory {
    let Some(t_base_lidar) = t_base_lidar else { return trajectory };
    Trajectory { poses: trajectory.poses.iter().map(|t_map_base| t_map_base * t_base_lidar).collect(), ..trajectory }
}

/// The node of every cloud: as the graph numbers them, else the numbers in the clouds' names, else their order.
/// A graph whose nodes are none of the clouds' is left aside, or refused if asked to.
fn tie(
    clouds: Clouds<'_>,
    graph: Option<NamedGraph>,
    options: &OpenOptions,
    description: &mut Description,
) -> Result<(Vec<NodeId>, Option<NamedGraph>)> {
    let count = clouds.files.len();
    let numbers = clouds.numbers();
    if let Some((file, graph)) = graph {
        let ids = graph.sorted_ids();
        if ids.len() == count {
            return Ok((ids, Some((file, graph))));
        }
        if let Some(numbers) = numbers.clone().filter(|n| n.iter().any(|n| ids.binary_search(n).is_ok())) {
            return Ok((numbers, Some((file, graph))));
        }
        let problem = format!("its {} nodes cannot be tied to the {count} clouds", ids.len());
        if options.strict {
            return Err(Error::dataset(&file.path, problem, "number the clouds like the nodes, or do without --strict"));
        }
        description.notes.push(format!("{}: {problem}: its edges are left out", file.name()));
    }
    Ok((numbers.unwrap_or_else(|| (0..count as NodeId).collect()), None))
}

fn entries(clouds: Clouds<'_>, matched: &Matched, nodes: &[NodeId]) -> Vec<ScanEntry> {
    let entry = |index: usize| {
        let time = clouds.times.map(|t| t[index]).or(matched.times[index]).unwrap_or(index as f64);
        let path = clouds.files[index].path.clone();
        matched.poses[index].map(|t_map_lidar| ScanEntry { path, index, node: nodes[index], time, t_map_lidar })
    };
    (0..clouds.files.len()).filter_map(entry).collect()
}

/// The pose of every cloud by the ground truth, if there is exactly one such file. One that cannot be used is only noted.
fn ground_truth(
    folder: &Folder,
    chosen: &PoseFile,
    clouds: Clouds<'_>,
    options: &OpenOptions,
    description: &mut Description,
) -> Option<(PathBuf, Vec<Option<Pose>>)> {
    let mut files = folder.poses.iter().filter(|p| p.is_ground_truth());
    let (file, None) = (files.next()?, files.next()) else {
        description.notes.push("several files call themselves ground truth: none is taken as such".into());
        return None;
    };
    let read = poses::read(&file.path).map(|t| in_lidar_frame(t, options.t_base_lidar.as_ref()));
    match read.and_then(|trajectory| match_poses(clouds, &trajectory, &file.path)) {
        Ok(matched) => {
            description.ground_truth = Some(name_of(&file.path)).filter(|_| file.path != chosen.path);
            Some((file.path.clone(), matched.poses))
        }
        Err(error) => {
            description.notes.push(format!("the ground truth is left aside: {error}"));
            None
        }
    }
}
