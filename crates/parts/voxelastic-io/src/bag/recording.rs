//! A recording that can be played as a registered cloud list.

use super::describe::{capture_without_poses, describe_bag, describe_capture, is_capture, summarise};
use super::description::RecordingDescription;
use super::graph_nodes::read_nodes;
use super::messages::topic_role::TopicRole;
use super::stream::{BagStream, StreamTopics};
use super::topics::{ChosenTopics, choose};
use crate::capture::CaptureKind;
use crate::fingerprint::Fingerprint;
use crate::motion::PoseTrack;
use crate::playback::{
    CloudRereader, Corrections, MessageStream, OpenStream, PlaybackLog, Player, PlayerOptions, PoseSource, Selection, SensorMounts, read_track,
};
use crate::read_ahead::{IdleStep, ReadAhead};
use crate::scan_list::{KeyframeFilter, Keyframing, ScanEdges, ScanEntry};
use crate::stamped_cloud::Interval;
use crate::{Error, OpenOptions, PointTimes, Result};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::{fmt, iter};
use voxelastic::event::Event;
use voxelastic::geometry::PoseChange;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;

/// Number of events that are decoded ahead.
const AHEAD: usize = 4;

/// Where the scans come from.
#[derive(Clone)]
enum Input {
    /// Topics of a bag.
    Bag(ChosenTopics),
    /// Packets of a sensor.
    Capture(CaptureKind),
}

/// A recording whose topics have been chosen. Only its beginning has been read.
#[derive(Clone)]
pub struct Recording {
    path: PathBuf,
    description: RecordingDescription,
    input: Input,
    /// Poses from a file.
    given: Option<PoseTrack>,
    nodes: Option<(Vec<ScanEntry>, ScanEdges)>,
    corrections: Corrections,
    options: OpenOptions,
    selection: Selection,
    log: Arc<PlaybackLog>,
    /// Whether it was said where the lidar is taken to be.
    has_said_mount: Arc<AtomicBool>,
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("description", &self.description).finish_non_exhaustive()
    }
}

impl Recording {
    /// Opens a recording: a file, or the folder that `ros2 bag record` makes.
    ///
    /// # Errors
    /// [`Error::Ambiguous`] if several topics could hold the clouds or the poses; [`Error::Dataset`] if there are none;
    /// [`Error::Content`] if it is not a recording, or a pose or graph file is damaged; [`Error::Io`].
    pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Self> {
        let path = path.as_ref();
        let (input, mut description) = if is_capture(path)? {
            let (kind, description) = describe_capture(path, options)?;
            if options.poses.is_none() {
                return Err(capture_without_poses(path));
            }
            (Input::Capture(kind), description)
        } else {
            let (files, summary) = summarise(path)?;
            let chosen = choose(&summary, path, options)?;
            let mut description = describe_bag(files, &summary, options)?;
            description.set_topics(&chosen, &summary);
            (Input::Bag(chosen), description)
        };
        if let (Input::Bag(ChosenTopics { clouds, frames, .. }), Some(graph)) = (&input, &options.graph)
            && clouds.len() + frames.len() > 1
            && graph.is_file()
        {
            let of_sensors: Vec<String> = clouds.iter().cloned().chain(frames.iter().map(|[topic, frame]| format!("{topic} in {frame}"))).collect();
            let remedy = "map one of them with the graph (--cloud-topic), or give the corrected trajectory with --poses instead of the graph";
            return Err(Error::dataset(graph, format!("a graph has nodes of one sensor, but {} are mapped", of_sensors.join(" and ")), remedy));
        }
        check_change(path, &input, options)?;
        let given = options.poses.as_deref().map(|file| read_track(file, &options.pose_change)).transpose()?;
        let (corrections_folder, graph) = match &options.graph {
            Some(folder) if folder.is_dir() => (Some(folder), None),
            graph => (None, graph.as_ref()),
        };
        let corrections = match (corrections_folder, &options.correction_topic) {
            (Some(folder), _) => Corrections::find(folder)?,
            (None, Some(_)) => Corrections::by_message(),
            (None, None) => Corrections::default(),
        };
        let nodes = match (graph, &options.poses) {
            (Some(graph), Some(poses)) => Some(read_nodes(graph, poses, options)?),
            (Some(graph), None) => {
                let remedy = "give the times of its nodes with --poses: a trajectory (TUM) with one pose per node, in their order";
                return Err(Error::dataset(graph, "a graph does not say when its nodes were", remedy));
            }
            (None, _) => None,
        };
        if let Some((entries, edges)) = &nodes {
            description.graph = Some([entries.len(), edges.loops.len()]);
            description.keyframing = options.keyframing.unwrap_or(Keyframing::All);
        }
        if corrections.len() > 0 {
            description.notes.push(format!("poses are corrected {} times", corrections.len()));
        }
        let (options, selection, log, has_said_mount) = (options.clone(), Selection::default(), Arc::default(), Arc::default());
        Ok(Self { path: path.into(), description, input, given, nodes, corrections, options, selection, log, has_said_mount })
    }

    /// The recording's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is in it, and which of it is used; to be shown to the user.
    pub fn description(&self) -> &RecordingDescription {
        &self.description
    }

    /// The usual time between the clouds of the first sensor in the beginning, seconds, if a sweep can take that long.
    pub fn interval_s(&self) -> Option<f64> {
        match &self.input {
            Input::Bag(chosen) => chosen.intervals.first().and_then(Interval::usual),
            Input::Capture(_) => None,
        }
    }

    /// What speaks for clouds that are undistorted already, although their points have times.
    pub fn undistorted_sign(&self) -> Option<String> {
        match &self.input {
            Input::Bag(chosen) => chosen.undistorted_sign.clone(),
            Input::Capture(_) => None,
        }
    }

    /// Keeps only the scans for which `keep` holds, by their index among those taken so far. Indices start anew in each call of
    /// [`events`](Self::events).
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool + Send + Sync + 'static) {
        self.selection.add(keep);
    }

    /// Takes no more than the first `most` scans; playback ends with them.
    pub fn limit(&mut self, most: usize) {
        self.selection.limit(most);
    }

    /// Scans that [`retain`](Self::retain) has excluded so far.
    pub fn left_out(&self) -> usize {
        self.log.left_out.load(Ordering::Relaxed)
    }

    /// Clouds without a pose so far.
    pub fn without_pose(&self) -> usize {
        self.log.without_pose.load(Ordering::Relaxed)
    }

    /// The sensor's own tables of beams, if its packets were recorded with them.
    pub fn sensor(&self) -> Option<BeamModel> {
        match &self.input {
            Input::Bag(chosen) => chosen.packets.model(&chosen.clouds),
            Input::Capture(kind) => kind.model(&self.path),
        }
    }

    /// How much of the recording has been played, 0 to 1; `None` if its length is unknown.
    pub fn progress(&self) -> Option<f64> {
        let [first, last] = self.description.times?;
        let now = self.log.now();
        (last > first && now > 0.0).then(|| ((now - first) / (last - first)).clamp(0.0, 1.0))
    }

    /// The registered cloud list, played from the beginning, a few events ahead.
    pub fn events(&self) -> RecordingEvents {
        let (open, options) = (self.open_stream(), self.player_options());
        let play = move || -> Box<dyn Iterator<Item = Result<Event>> + Send> {
            match open() {
                Ok(stream) => Box::new(Player::new(stream, options)),
                Err(error) => Box::new(iter::once(Err(error))),
            }
        };
        let events = ReadAhead::new("voxelastic-play", AHEAD, iter::once_with(play).flatten(), |what| Err(Error::Panicked { what }));
        RecordingEvents { events, taken: 0 }
    }

    /// The same for a look at the beginning: what is counted, and noted for reading again, is that of [`events`](Self::events) only.
    pub(crate) fn preview(&self) -> RecordingEvents {
        Self { log: Arc::default(), ..self.clone() }.events()
    }

    /// As [`Source::fingerprint`](crate::source::Source::fingerprint).
    pub(crate) fn fingerprint(&self) -> u64 {
        let mut print = Fingerprint::default();
        print.file(&self.path);
        let OpenOptions { poses, graph, metadata, .. } = &self.options;
        [poses, graph, metadata].into_iter().flatten().for_each(|path| print.file(path));
        print.digest()
    }

    /// Reads clouds again that [`events`](Self::events) delivered.
    pub fn clouds(&self) -> impl ScanSource + Send + use<> {
        CloudRereader::new(self.open_stream(), Arc::clone(&self.log))
    }

    fn open_stream(&self) -> OpenStream {
        let files = self.description.files.clone();
        match &self.input {
            Input::Bag(chosen) => {
                let poses = chosen.poses.clone().filter(|(_, role)| *role != TopicRole::Transforms).map(|(name, _)| name);
                let (clouds, packets, intervals) = (chosen.clouds.clone(), chosen.packets.sensors.clone(), chosen.intervals.clone());
                let (corrections, without_stamps, frames) =
                    (self.options.correction_topic.clone(), chosen.without_stamps.clone(), chosen.frames.clone());
                let stretches_times = self.options.point_times == PointTimes::OverInterval;
                let topics = StreamTopics {
                    clouds,
                    frames,
                    poses,
                    corrections,
                    imu: None,
                    packets,
                    intervals,
                    stretches_times,
                    are_unexamined: false,
                    without_stamps,
                };
                Arc::new(move || Ok(Box::new(BagStream::new(&files, topics.clone())) as Box<dyn MessageStream>))
            }
            Input::Capture(kind) => {
                let (capture, kind) = (self.path.clone(), kind.clone());
                Arc::new(move || kind.stream(&capture))
            }
        }
    }

    fn player_options(&self) -> PlayerOptions {
        let poses = match (&self.given, &self.input) {
            (Some(track), _) => PoseSource::File(track.clone()),
            (None, Input::Bag(ChosenTopics { poses: Some((_, TopicRole::Transforms)), .. })) => PoseSource::Transforms,
            (None, _) => PoseSource::of_topic(),
        };
        let mounts = match &self.input {
            Input::Bag(chosen) => chosen.mounts(&self.options),
            Input::Capture(_) => SensorMounts::one(self.options.t_base_lidar),
        };
        let mounts = SensorMounts { has_said: Arc::clone(&self.has_said_mount), ..mounts };
        PlayerOptions {
            path: self.path.clone(),
            poses,
            mounts,
            keyframes: KeyframeFilter::new(self.description.keyframing),
            selection: self.selection.clone(),
            nodes: self.nodes.clone(),
            corrections: self.corrections.clone(),
            pose_change: self.options.pose_change,
            tolerance_s: self.options.time_tolerance_s,
            deskew: self.options.point_times != PointTimes::Undistorted,
            log: Arc::clone(&self.log),
            mount_timeout_s: None,
        }
    }
}

/// Refuses changes of poses that a recording's poses cannot have.
fn check_change(path: &Path, input: &Input, options: &OpenOptions) -> Result<()> {
    let change = &options.pose_change;
    let is_tree = options.poses.is_none() && matches!(input, Input::Bag(ChosenTopics { poses: Some((_, TopicRole::Transforms)), .. }));
    let only_seconds = PoseChange { seconds: change.seconds, ..PoseChange::default() };
    if change.rows != 0 {
        return Err(Error::dataset(path, "the poses of a recording have times, and no rows", "give seconds=S in --pose-change instead of rows=N"));
    }
    if is_tree && *change != only_seconds {
        let problem = "its poses are a tree of transforms, which cannot be inverse, w-first or scaled";
        return Err(Error::dataset(path, problem, "give --pose-change with seconds=S only, or name other poses"));
    }
    Ok(())
}

/// Iterator over the events of a [`Recording`].
#[derive(Debug)]
pub struct RecordingEvents {
    events: ReadAhead<Result<Event>>,
    taken: usize,
}

impl RecordingEvents {
    /// A function that reads on to the next event in the time of the calling thread, see [`IdleStep`].
    pub fn idle_step(&mut self) -> IdleStep {
        self.events.idle_step()
    }

    /// Items that were taken.
    pub(crate) fn taken(&self) -> usize {
        self.taken
    }
}

impl Iterator for RecordingEvents {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Result<Event>> {
        self.events.next().inspect(|_| self.taken += 1)
    }
}
