//! Recordings of ROS 1 (`.bag`) and ROS 2 (MCAP, sqlite3), read without ROS.
//!
//! [`Recording::open`] looks at the index and the first seconds, finds out which topics hold the clouds and the poses, and
//! [`Recording::events`] plays the recording front to back as a registered cloud list. Clouds are `sensor_msgs/PointCloud2` of any layout
//! and Livox `CustomMsg`; poses are `nav_msgs/Odometry`, `nav_msgs/Path`, `geometry_msgs/PoseStamped` (also with covariance), the transform
//! tree of `/tf` and `/tf_static`, or a trajectory file with times.
//!
//! ```no_run
//! use voxelastic_io::{OpenOptions, bag::Recording};
//!
//! let recording = Recording::open("drive.mcap", &OpenOptions::default())?;
//! println!("{}", recording.description());
//! for event in recording.events() {
//!     println!("{event:?}");
//! }
//! # Ok::<(), voxelastic_io::Error>(())
//! ```
//!
//! A recording that was cut, or has no index, is read as far as it goes; what cannot be read is an `Err` item that names the place.
//! Formats: wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, the schema of rosbag2's sqlite3 storage; messages as in common_interfaces and
//! livox_ros_driver2.

mod ahead;
mod choose;
mod container;
mod files;
mod mcap;
mod messages;
mod records;
mod ros1;
mod sqlite;
mod survey;
mod tape;
mod wire;

mod feed;

pub use container::BagFormat;
pub use survey::TopicSummary;

use crate::dataset::{Edges, Every, Picker, ScanEntry};
use crate::ouster::{self, CaptureTape};
use crate::playback::{Corrections, Ledger, OpenTape, Player, PlayerOptions, Poses, Reread, Selection, Tape, Track, read_track};
use crate::read_ahead::ReadAhead;
use crate::{Error, OpenOptions, Result, g2o, poses};
use choose::Choice;
use messages::Role;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::{fmt, iter};
use survey::Survey;
use tape::{BagTape, Listen};
use voxelastic::event::Event;
use voxelastic::mapper::{Chore, ScanSource};
use voxelastic::sensor::BeamModel;

/// Keyframes of a recording if nothing else is asked for, metres of travel: the paper's (Sec. V).
pub const KEYFRAMES_M: f64 = 2.0;
/// Events that wait decoded for their turn.
const AHEAD: usize = 4;

/// What a recording consists of and which of it is used. [`fmt::Display`] tells it in a few lines.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RecordingDescription {
    /// The files, in order.
    pub files: Vec<PathBuf>,
    /// Their format.
    pub format: BagFormat,
    /// All topics, by name.
    pub topics: Vec<TopicSummary>,
    /// Times of the first and the last message, seconds, if the recording has an index or was read through.
    pub times: Option<[f64; 2]>,
    /// The topic of the clouds.
    pub cloud_topic: Option<String>,
    /// The topic or file of the poses.
    pub poses: Option<String>,
    /// Which scans are taken.
    pub every: Every,
    /// Nodes and loop edges of the graph beside the recording.
    pub graph: Option<[usize; 2]>,
    /// Why the recording cannot be mapped as it is, if so.
    pub problem: Option<String>,
    /// Anything else to know.
    pub notes: Vec<String>,
}

impl fmt::Display for RecordingDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "recording: {}", self.format)?;
        if self.files.len() > 1 {
            write!(f, " in {} files", self.files.len())?;
        }
        if let Some([first, last]) = self.times {
            write!(f, ", {:.1} s", last - first)?;
        }
        let messages = |name: &String| self.topics.iter().find(|t| t.name == *name).and_then(|t| t.messages);
        if let Some(topic) = &self.cloud_topic {
            write!(f, "\nclouds: {topic}")?;
            messages(topic).map_or(Ok(()), |n| write!(f, ", {n}"))?;
        }
        if let Some(poses) = &self.poses {
            write!(f, "\nposes: {poses}")?;
            messages(poses).map_or(Ok(()), |n| write!(f, ", {n}"))?;
        }
        if let Some([nodes, loops]) = self.graph {
            write!(f, "\ngraph: {nodes} nodes, {loops} loop edges")?;
        }
        if let Some(problem) = &self.problem {
            write!(f, "\nproblem: {problem}")?;
        } else {
            write!(f, "\nkeyframes: {}", self.every)?;
        }
        self.notes.iter().try_for_each(|note| write!(f, "\nnote: {note}"))
    }
}

/// Where scans are from.
#[derive(Clone)]
enum Kind {
    /// Topics of a bag.
    Bag(Choice),
    /// An Ouster capture with its metadata.
    Capture(PathBuf),
}

/// A recording whose topics were chosen. Nothing but its beginning has been read.
#[derive(Clone)]
pub struct Recording {
    path: PathBuf,
    description: RecordingDescription,
    kind: Kind,
    given: Option<Track>,
    nodes: Option<(Vec<ScanEntry>, Edges)>,
    corrections: Corrections,
    options: OpenOptions,
    selection: Selection,
    ledger: Arc<Ledger>,
}

impl fmt::Debug for Recording {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recording").field("description", &self.description).finish_non_exhaustive()
    }
}

/// Whether a path is a recording: a file that begins like one, or a folder that holds some.
///
/// # Errors
/// [`Error::Io`], and a folder of recordings of several kinds.
pub fn is_recording(path: &Path) -> Result<bool> {
    files::find(path).map(|found| found.is_some())
}

/// Tells what is in a recording, whether it can be mapped or not. One without an index is read through for the counts.
///
/// # Errors
/// [`Error::Content`] if it is no recording; [`Error::Io`].
pub fn describe(path: impl AsRef<Path>, options: &OpenOptions) -> Result<RecordingDescription> {
    let path = path.as_ref();
    if is_capture(path)? {
        let (_, mut description) = capture(path, options)?;
        description.problem = options.poses.is_none().then(|| no_poses(path).to_string());
        return Ok(description);
    }
    let (files, mut survey) = survey(path)?;
    if survey.counts.is_none() {
        let (counts, times) = survey::count_all(&files);
        survey.counts = Some(survey.topics.iter().map(|t| counts.get(&t.name).copied().unwrap_or(0)).collect());
        survey.times = times;
    }
    let mut description = describe_survey(files, &survey, options)?;
    match choose::choose(&survey, path, options) {
        Ok(choice) => description.choose(&choice, options),
        Err(error) => description.problem = Some(error.to_string()),
    }
    Ok(description)
}

fn is_capture(path: &Path) -> Result<bool> {
    Ok(path.is_file() && BagFormat::of(path)? == Some(BagFormat::Ouster))
}

/// Metadata and description of an Ouster capture.
fn capture(path: &Path, options: &OpenOptions) -> Result<(PathBuf, RecordingDescription)> {
    let metadata = match &options.metadata {
        Some(metadata) => metadata.clone(),
        None => ouster::find_metadata(path)?,
    };
    ouster::Capture::open(path, &metadata)?;
    let description = RecordingDescription {
        files: vec![path.to_owned()],
        format: BagFormat::Ouster,
        topics: Vec::new(),
        times: None,
        cloud_topic: None,
        poses: options.poses.as_ref().map(|p| p.display().to_string()),
        every: options.every.unwrap_or(Every::Metres(KEYFRAMES_M)),
        graph: None,
        problem: None,
        notes: vec![format!("the sensor is described by {}", metadata.display())],
    };
    Ok((metadata, description))
}

fn no_poses(path: &Path) -> Error {
    let remedy = "name a trajectory with times in the sensor's clock (TUM, Newer College) with --poses";
    Error::dataset(path, "a capture has no poses", remedy)
}

fn survey(path: &Path) -> Result<(Vec<PathBuf>, Survey)> {
    let Some(files) = files::find(path)? else {
        container::open(path)?;
        return Err(Error::dataset(path, "no recording in it", "name a .bag, .mcap or .db3 file, or the folder that holds them"));
    };
    let survey = Survey::of(&files)?;
    Ok((files, survey))
}

fn describe_survey(files: Vec<PathBuf>, survey: &Survey, options: &OpenOptions) -> Result<RecordingDescription> {
    let format = files.iter().find_map(|f| BagFormat::of(f).transpose()).transpose()?;
    let no_format =
        || Error::dataset(files.first().map_or(Path::new(""), PathBuf::as_path), "no recording by its first bytes", "copy or record it again");
    Ok(RecordingDescription {
        format: format.ok_or_else(no_format)?,
        files,
        topics: survey.summaries(),
        times: survey.times,
        cloud_topic: None,
        poses: None,
        every: options.every.unwrap_or(Every::Metres(KEYFRAMES_M)),
        graph: None,
        problem: None,
        notes: survey.notes.clone(),
    })
}

impl RecordingDescription {
    fn choose(&mut self, choice: &Choice, options: &OpenOptions) {
        self.cloud_topic = Some(choice.clouds.clone());
        let given = options.poses.as_ref().map(|p| p.display().to_string());
        self.poses = given.or_else(|| choice.poses.as_ref().map(|(name, _)| name.clone()));
    }
}

impl Recording {
    /// Opens a recording: a file, or the folder that `ros2 bag record` makes.
    ///
    /// # Errors
    /// [`Error::Ambiguous`] if several topics could hold the clouds or the poses; [`Error::Dataset`] if there are none;
    /// [`Error::Content`] if it is no recording, or a pose or graph file is damaged; [`Error::Io`].
    pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<Self> {
        let path = path.as_ref();
        let (kind, mut description) = if is_capture(path)? {
            let (metadata, description) = capture(path, options)?;
            (Kind::Capture(metadata), description)
        } else {
            let (files, survey) = survey(path)?;
            let choice = choose::choose(&survey, path, options)?;
            let mut description = describe_survey(files, &survey, options)?;
            description.choose(&choice, options);
            (Kind::Bag(choice), description)
        };
        if matches!(kind, Kind::Capture(_)) && options.poses.is_none() {
            return Err(no_poses(path));
        }
        let given = options.poses.as_deref().map(read_track).transpose()?;
        let is_folder = |graph: &&PathBuf| graph.is_dir();
        let corrections = options.graph.as_ref().filter(is_folder).map(|folder| Corrections::find(folder)).transpose()?.unwrap_or_default();
        let nodes = match (options.graph.as_ref().filter(|graph| !is_folder(graph)), &options.poses) {
            (Some(graph), Some(poses)) => Some(read_nodes(graph, poses, options)?),
            (Some(graph), None) => {
                let remedy = "give the times of its nodes with --poses: a trajectory (TUM) with one pose per node, in their order";
                return Err(Error::dataset(graph, "a graph does not say when its nodes were", remedy));
            }
            _ => None,
        };
        if let Some((entries, edges)) = &nodes {
            description.graph = Some([entries.len(), edges.loops.len()]);
            description.every = options.every.unwrap_or(Every::Scan);
        }
        if corrections.len() > 0 {
            description.notes.push(format!("poses are corrected {} times", corrections.len()));
        }
        let options = OpenOptions { every: Some(description.every), ..options.clone() };
        let (selection, ledger) = (Selection::default(), Arc::default());
        Ok(Self { path: path.into(), description, kind, given, nodes, corrections, options, selection, ledger })
    }

    /// The recording's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What is in it, and which of it is used; to be shown to the user.
    pub fn description(&self) -> &RecordingDescription {
        &self.description
    }

    /// Takes only some of the scans, by their place among those that are taken otherwise. Counts anew in each [`events`](Self::events).
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool + Send + Sync + 'static) {
        self.selection.add(keep);
    }

    /// Takes no more than the first `most` scans; playing ends with them.
    pub fn limit(&mut self, most: usize) {
        self.selection.limit(most);
    }

    /// Scans that [`retain`](Self::retain) has left out so far.
    pub fn left_out(&self) -> usize {
        self.ledger.left_out.load(Ordering::Relaxed)
    }

    /// Clouds without a pose so far.
    pub fn without_pose(&self) -> usize {
        self.ledger.without_pose.load(Ordering::Relaxed)
    }

    /// The sensor's own tables of beams, if it is a capture.
    pub fn sensor(&self) -> Option<BeamModel> {
        match &self.kind {
            Kind::Bag(_) => None,
            Kind::Capture(metadata) => ouster::Capture::open(&self.path, metadata).ok()?.model().ok(),
        }
    }

    /// How much of the recording has been played, 0 to 1; none if it is not known how long it is.
    pub fn progress(&self) -> Option<f64> {
        let [first, last] = self.description.times?;
        let now = self.ledger.now();
        (last > first && now > 0.0).then(|| ((now - first) / (last - first)).clamp(0.0, 1.0))
    }

    /// The registered cloud list, played from the beginning, a few events ahead.
    pub fn events(&self) -> RecordingEvents {
        let (open, options) = (self.tape(), self.player_options());
        let play = move || -> Box<dyn Iterator<Item = Result<Event>> + Send> {
            match open() {
                Ok(tape) => Box::new(Player::new(tape, options)),
                Err(error) => Box::new(iter::once(Err(error))),
            }
        };
        RecordingEvents(ReadAhead::new("voxelastic-play", AHEAD, iter::once_with(play).flatten()))
    }

    /// Reads clouds again that [`events`](Self::events) delivered.
    pub fn clouds(&self) -> impl ScanSource + Send + use<> {
        Reread { open: self.tape(), ledger: Arc::clone(&self.ledger), tape: None }
    }

    fn tape(&self) -> OpenTape {
        let files = self.description.files.clone();
        match &self.kind {
            Kind::Bag(choice) => {
                let poses = choice.poses.clone().filter(|(_, role)| *role != Role::Transforms).map(|(name, _)| name);
                let listen = Listen { clouds: choice.clouds.clone(), poses };
                Arc::new(move || Ok(Box::new(BagTape::new(&files, listen.clone())) as Box<dyn Tape>))
            }
            Kind::Capture(metadata) => {
                let (capture, metadata) = (self.path.clone(), metadata.clone());
                Arc::new(move || Ok(Box::new(CaptureTape::open(&capture, &metadata)?) as Box<dyn Tape>))
            }
        }
    }

    fn player_options(&self) -> PlayerOptions {
        let poses = match (&self.given, &self.kind) {
            (Some(track), _) => Poses::Given(track.clone()),
            (None, Kind::Bag(Choice { poses: Some((_, Role::Transforms)), .. })) => Poses::Tree,
            (None, _) => Poses::Heard { track: Track::default(), child: String::new() },
        };
        PlayerOptions {
            path: self.path.clone(),
            poses,
            t_base_lidar: self.options.t_base_lidar,
            picker: Picker::new(self.description.every),
            selection: self.selection.clone(),
            nodes: self.nodes.clone(),
            corrections: self.corrections.clone(),
            tolerance_s: self.options.time_tolerance_s,
            deskew: self.options.deskew,
            ledger: Arc::clone(&self.ledger),
        }
    }
}

/// The nodes of a graph with the times that a trajectory of as many poses has, in the order of time.
fn read_nodes(graph: &Path, poses_path: &Path, options: &OpenOptions) -> Result<(Vec<ScanEntry>, Edges)> {
    let (graph_read, trajectory) = (g2o::read(graph)?, poses::read(poses_path)?);
    let ids = graph_read.sorted_ids();
    let times = trajectory.times.unwrap_or_default();
    if ids.len() != times.len() {
        let problem = format!("{} nodes, but {} poses in {}", ids.len(), times.len(), poses_path.display());
        return Err(Error::dataset(graph, problem, "give a trajectory with one pose per node, in their order"));
    }
    let entry = |k: usize| ScanEntry { path: PathBuf::new(), index: k, node: ids[k], time: times[k], t_map_lidar: trajectory.poses[k] };
    let entries: Vec<ScanEntry> = (0..ids.len()).map(entry).collect();
    let edges = Edges::of(Some(&graph_read), &entries, options.t_base_lidar.as_ref());
    Ok((entries, edges))
}

/// Iterator over the events of a [`Recording`].
#[derive(Debug)]
pub struct RecordingEvents(ReadAhead<Result<Event>>);

impl RecordingEvents {
    /// Playing on to the next event, for threads with time to spare. Taken before the first event, there is no thread that plays.
    pub fn chore(&mut self) -> Chore {
        self.0.chore()
    }
}

impl Iterator for RecordingEvents {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Result<Event>> {
        self.0.next()
    }
}
