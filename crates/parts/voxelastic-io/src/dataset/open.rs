//! Opening a dataset: listing its files and matching clouds, poses, times and graph.

use super::choose_poses::{self, ChosenPoses};
use super::cloud_times;
use super::description::Description;
use super::folder;
use super::ground_truth::{self, GroundTruth};
use super::matching::{Clouds, Matched, match_poses};
use super::pose_file::PoseFile;
use super::registered::Dataset;
use super::snapshot::SnapshotContext;
use super::tie_graph::{Nodes, tie};
use super::together::together;
use crate::clouds::CloudFormat;
use crate::dumps::{self, Dump};
use crate::folders::name_of;
use crate::motion::PoseTrack;
use crate::scan_list::{ScanEdges, ScanEntry, select};
use crate::stamped_cloud::{ASSUMED_PERIOD_S, Interval, SweepTime};
use crate::{Error, OpenOptions, PointTimes, PoseFormat, Result, Trajectory, g2o, poses};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseChange;

/// Where poses of other times are asked for, they are interpolated over gaps up to this, seconds: those between keyframes.
const LONGEST_GAP_SHIFTED_S: f64 = 2.5;

/// Opens a dataset.
///
/// # Errors
/// [`Error::NoPoses`] if there are no poses; [`Error::Ambiguous`] if several files could hold the poses or the graph; [`Error::Dataset`] if
/// there are no clouds or it is unclear which poses belong to them; [`Error::Content`] if a pose, graph or time file is damaged; with
/// [`OpenOptions::strict`], also if a cloud has no pose.
pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Dataset> {
    let first = open_one(path.as_ref(), options)?;
    together(first, options, open_one)
}

/// Opens the folder of one sensor.
fn open_one(path: &Path, options: &OpenOptions) -> Result<Dataset> {
    check_options(path, options)?;
    if options.poses.is_none()
        && let Some(dump) = dumps::find(path)?
    {
        return open_dump(path, dump, options);
    }
    if options.poses.is_none() {
        dumps::refuse_incomplete(path)?;
    }
    open_folder(path, options)
}

/// Opens a dataset with its true poses: those in the file `poses`, named as in [`OpenOptions`], or in the only file named ground truth,
/// whatever other pose files there are. `None` if no file is given and none is named ground truth.
///
/// # Errors
/// [`Error::Ambiguous`] if several files are named ground truth, and as [`open`].
pub fn open_truth(path: impl AsRef<Path>, poses: Option<&Path>) -> Result<Option<(PathBuf, Dataset)>> {
    let path = path.as_ref();
    let Some(file) = ground_truth::find(path, poses)? else { return Ok(None) };
    let data = open(path, &OpenOptions { poses: Some(file.clone()), ..OpenOptions::default() })?;
    Ok(Some((file, data)))
}

/// Refuses paths and options that do not fit a dataset.
fn check_options(path: &Path, options: &OpenOptions) -> Result<()> {
    let is_e57 = CloudFormat::of(path) == Some(CloudFormat::E57);
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
    Ok(())
}

/// Opens a folder whose layout is described in [`super`].
fn open_folder(path: &Path, options: &OpenOptions) -> Result<Dataset> {
    let folder = folder::scan(path)?;
    let mut description = Description::of(&folder);
    let ChosenPoses { file: pose_file, note } = choose_poses::poses(&folder, options.poses.as_deref(), options.pose_kind)?;
    description.notes.extend(note);
    let graph_file = choose_poses::graph(&folder, options.graph.as_deref(), &pose_file)?;
    let graph = graph_file.map(|file| g2o::read(&file.path).map(|graph| (file, graph))).transpose()?;
    let trajectory = poses::read(&pose_file.path)?.changed(&options.pose_change).in_lidar_frame(options.t_base_lidar.as_ref());

    let times = cloud_times::read(&folder, &trajectory)?;
    description.times = times.file;
    let trajectory = Trajectory { times: trajectory.times.or(times.of_poses), ..trajectory };
    let clouds = Clouds { files: &folder.clouds.clouds, times: times.of_clouds.as_deref(), tolerance_s: options.time_tolerance_s };
    let matched = match_poses(clouds, &trajectory, &pose_file.path)?;
    description.matched(&pose_file, trajectory.len(), &matched, &folder);
    check_complete(path, options, &description)?;

    let Nodes { nodes, graph, note } = tie(clouds, graph, options)?;
    description.notes.extend(note);
    let (truth, note) = ground_truth::read(&folder, clouds, options);
    description.notes.extend(note);
    description.ground_truth = truth.as_ref().filter(|truth| truth.path != pose_file.path).map(|truth| name_of(&truth.path));

    let mut all = entries(clouds, &matched, &nodes);
    let has_times = times.of_clouds.is_some() || trajectory.times.is_some();
    // Where nothing says when clouds were taken, they can be those of one sweep after the other.
    let follow = !has_times && options.point_times == PointTimes::OverInterval;
    if follow {
        all.iter_mut().for_each(|scan| scan.time *= ASSUMED_PERIOD_S);
        description.notes.push("clouds are taken to be those of one sweep after the other, ten a second".to_owned());
    }
    let as_matched: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let all = shifted(all, &pose_track(&trajectory, &as_matched), &options.pose_change);
    let stamped: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let scans = select(all, options.keyframing.unwrap_or_default());
    description.not_keyframes = stamped.len() - scans.len();
    let ground_truth = truth.map(|truth| GroundTruth { t_map_lidar: scans.iter().map(|s| truth.t_map_lidar[s.index]).collect(), ..truth });
    let edges = ScanEdges::of(graph.as_ref().map(|(_, g)| g), &scans, options.t_base_lidar.as_ref());
    if let Some((file, graph)) = &graph {
        description.graph(file, graph, &edges);
    }
    let has_times = has_times || follow;
    let track = (options.point_times != PointTimes::Undistorted && has_times)
        .then(|| Arc::new(pose_track(&trajectory.earlier(options.pose_change.seconds), &stamped)));
    let (t_base_lidar, pose_change) = (options.t_base_lidar, options.pose_change);
    let of_poses: Option<Vec<f64>> = (trajectory.times.is_some() || follow).then(|| stamped.iter().map(|(time, _)| *time).collect());
    let sweeps = sweep_time(times.of_clouds.as_deref().or(of_poses.as_deref()), options);
    let context = SnapshotContext { t_base_lidar, pose_change, nodes, times: times.of_clouds, sweeps, has_times, track, further: Vec::new() };
    // Snapshots correct an estimate. The ground truth needs no corrections.
    let snapshots = if pose_file.is_ground_truth() { description.drop_snapshots() } else { folder.snapshots };
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

/// How long a sweep takes by the times of the clouds.
fn sweep_time(times: Option<&[f64]>, options: &OpenOptions) -> SweepTime {
    SweepTime { interval_s: times.and_then(Interval::of), is_stretched: options.point_times == PointTimes::OverInterval }
}

/// Opens a folder in the layout of another SLAM system or data set.
fn open_dump(path: &Path, dump: Dump, options: &OpenOptions) -> Result<Dataset> {
    let mut description = Description::of_dump(path, &dump)?;
    check_complete(path, options, &description)?;
    let graph = match &options.graph {
        Some(requested) => Some((requested.clone(), g2o::read(requested)?)),
        None => dump.graph,
    };
    let mut all = dump.scans;
    let t_base_lidar = options.t_base_lidar.unwrap_or_default();
    all.iter_mut().for_each(|scan| scan.t_map_lidar = options.pose_change.apply(&scan.t_map_lidar) * t_base_lidar);
    let as_stored: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let all = shifted(all, &pose_track(&Trajectory::default(), &as_stored), &options.pose_change);
    let nodes = all.iter().map(|s| s.node).collect();
    let stamped: Vec<(f64, Pose)> = all.iter().map(|s| (s.time, s.t_map_lidar)).collect();
    let scans = select(all, options.keyframing.unwrap_or_default());
    description.not_keyframes = stamped.len() - scans.len();
    let edges = ScanEdges::of(graph.as_ref().map(|(_, g)| g), &scans, options.t_base_lidar.as_ref());
    if let Some((file, graph)) = &graph {
        description.graph(&PoseFile { path: file.clone(), format: PoseFormat::G2o }, graph, &edges);
    }
    let track = (options.point_times != PointTimes::Undistorted).then(|| Arc::new(pose_track(&Trajectory::default(), &stamped)));
    let times: Option<Vec<f64>> = Some(stamped.iter().map(|(time, _)| *time).collect());
    let sweeps = sweep_time(times.as_deref(), options);
    let (t_base_lidar, pose_change) = (options.t_base_lidar, options.pose_change);
    let context = SnapshotContext { t_base_lidar, pose_change, nodes, times, sweeps, has_times: true, track, further: Vec::new() };
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

/// Refuses clouds without poses if `options` are strict.
fn check_complete(path: &Path, options: &OpenOptions, description: &Description) -> Result<()> {
    match description.without_pose.first() {
        Some(first) if options.strict => {
            let problem = format!("{} clouds have no pose, the first is {}", description.without_pose.len(), first.display());
            Err(Error::dataset(path, problem, "add the poses, remove the clouds, or do without --strict"))
        }
        _ => Ok(()),
    }
}

/// The clouds that have a pose.
fn entries(clouds: Clouds<'_>, matched: &Matched, nodes: &[NodeId]) -> Vec<ScanEntry> {
    let entry = |index: usize| {
        let time = clouds.times.map(|t| t[index]).or(matched.times[index]).unwrap_or(index as f64);
        let path = clouds.files[index].path.clone();
        matched.poses[index].map(|t_map_lidar| ScanEntry { path, index, node: nodes[index], time, t_map_lidar, sensor: 0 })
    };
    (0..clouds.files.len()).filter_map(entry).collect()
}

/// The scans with poses of other rows, or of other times, as was asked for; those for which there is none are left out.
fn shifted(mut all: Vec<ScanEntry>, track: &PoseTrack, change: &PoseChange) -> Vec<ScanEntry> {
    if change.rows != 0 {
        let poses: Vec<Pose> = all.iter().map(|scan| scan.t_map_lidar).collect();
        let pose = |k: usize| poses.get(usize::try_from(i64::try_from(k).ok()? + change.rows).ok()?).copied();
        let kept = all.into_iter().enumerate().filter_map(|(k, scan)| Some(ScanEntry { t_map_lidar: pose(k)?, ..scan }));
        all = kept.collect();
    }
    if change.seconds != 0.0 {
        let pose = |time: f64| track.at(time + change.seconds, LONGEST_GAP_SHIFTED_S, 0.0);
        all = all.into_iter().filter_map(|scan| Some(ScanEntry { t_map_lidar: pose(scan.time)?, ..scan })).collect();
    }
    all
}

/// All poses of the lidar that have a time: those of the trajectory and those of the scans.
fn pose_track(trajectory: &Trajectory, scans: &[(f64, Pose)]) -> PoseTrack {
    let mut track = PoseTrack::default();
    let of_poses = trajectory.times.iter().flatten().copied().zip(trajectory.poses.iter().copied());
    of_poses.chain(scans.iter().copied()).for_each(|(time, pose)| track.add(time, pose));
    track
}
