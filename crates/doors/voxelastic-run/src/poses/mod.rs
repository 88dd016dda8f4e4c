//! Where the poses of scans come from: they are given, the odometry finds them, or a map of before does.

mod jumps;
mod odometry_log;
mod odometry_stage;
mod pose_watch;
mod relocalisation;
mod stream_position;

pub use jumps::Jumps;
pub use odometry_log::{OdometryLog, OdometrySummary};
pub use odometry_stage::{Motions, OdometrySetup, OdometryStage, StageState};
pub use pose_watch::PoseWatch;
pub use relocalisation::{MapFrame, Outcome, Relocalisation, numbered, placed};
pub use stream_position::{Came, StreamPosition};

use crate::input::Input;
use crate::warning::Warnings;
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId};
use voxelastic_io::Origin;

/// Where the poses of scans come from.
pub enum Poses {
    /// The first scan decides.
    Undecided(Box<dyn Fn() -> crate::Result<OdometryStage> + Send + Sync>),
    /// They are given.
    Given,
    /// They are estimated.
    Estimated(Box<OdometryStage>),
}

/// Gives scans their poses, and takes the origin of the map off all poses.
pub struct PoseStage {
    poses: Poses,
    /// Of the map; none before the first scan.
    origin: Option<Origin>,
    /// Whether others know the frame of the poses, so that the map has no origin of its own.
    keeps_frame: bool,
    /// What is added to the numbers of nodes.
    first_node: NodeId,
    /// The last pose of the odometry: node, time and pose in its own frame.
    odometry_pose: Option<(NodeId, f64, Pose)>,
}

/// What became of an input: events with poses that count from the origin, or why it cannot be used.
pub type Posed = Result<Vec<Event>, String>;

impl PoseStage {
    /// Before the first scan; of a run that goes on, with the origin of its map.
    pub fn new(poses: Poses, origin: Option<Origin>) -> Self {
        Self { poses, origin, keeps_frame: false, first_node: 0, odometry_pose: None }
    }

    /// Leaves coordinates as they are, because others know their frame.
    pub fn keep_frame(&mut self) {
        self.keeps_frame = true;
    }

    /// Whether poses are estimated; none before the first scan has decided.
    pub fn is_raw(&self) -> Option<bool> {
        match self.poses {
            Poses::Undecided(_) => None,
            Poses::Given => Some(false),
            Poses::Estimated(_) => Some(true),
        }
    }

    /// The odometry, if there is one.
    pub fn odometry(&self) -> Option<&OdometryStage> {
        if let Poses::Estimated(stage) = &self.poses { Some(stage) } else { None }
    }

    /// The last pose of the odometry: node, time and pose in its own frame.
    pub fn odometry_pose(&self) -> Option<(NodeId, f64, Pose)> {
        self.odometry_pose
    }

    /// The origin of the map.
    pub fn origin(&self) -> Origin {
        self.origin.unwrap_or_default()
    }

    /// What is added to the numbers of nodes.
    pub fn first_node(&self) -> NodeId {
        self.first_node
    }

    /// Whether as many scans were taken as may be.
    pub fn is_full(&self) -> bool {
        self.odometry().is_some_and(OdometryStage::is_full)
    }

    /// Goes on in another map: nodes are numbered from `first_node` on, and the map has this origin.
    pub fn go_on(&mut self, first_node: NodeId, origin: Option<Origin>) {
        (self.first_node, self.origin, self.odometry_pose) = (first_node, origin, None);
    }

    /// The events of an input.
    ///
    /// # Errors
    /// Why it cannot be used.
    pub fn take(&mut self, input: Input, warnings: &mut Warnings) -> Posed {
        self.decide(&input)?;
        let events = match (input, &mut self.poses) {
            (Input::Unusable(problem) | Input::BadPose(problem), _) => return Err(problem),
            (Input::Event(Event::Scan(_)), Poses::Estimated(_)) => return Err(mixed("without poses", "has one")),
            (Input::Event(event), _) => vec![numbered(event, self.first_node)],
            (Input::RawScan(mut scan, name), Poses::Estimated(stage)) => {
                scan.node += self.first_node;
                stage.take(scan, &name, warnings)?
            }
            (Input::RawScan(..), _) => return Err(mixed("with poses", "has none")),
        };
        Ok(self.finished(events))
    }

    /// The last scans of further sensors, after all scans have come.
    pub fn finish(&mut self, warnings: &mut Warnings) -> Vec<Event> {
        let events = match &mut self.poses {
            Poses::Estimated(stage) if !stage.is_full() => stage.finish(warnings),
            _ => Vec::new(),
        };
        self.finished(events)
    }

    /// The first scan decides where poses come from, if that is not known.
    fn decide(&mut self, input: &Input) -> Result<(), String> {
        if let Poses::Undecided(stage) = &self.poses {
            match input {
                Input::RawScan(..) => self.poses = Poses::Estimated(Box::new(stage().map_err(|problem| problem.one_line())?)),
                Input::Event(_) => self.poses = Poses::Given,
                Input::Unusable(_) | Input::BadPose(_) => {}
            }
        }
        Ok(())
    }

    fn finished(&mut self, mut events: Vec<Event>) -> Vec<Event> {
        if let Poses::Estimated(_) = &self.poses {
            // Of the odometry, some are tied to scans that came before this map was loaded.
            events.retain(|event| !matches!(event, Event::OdometryEdge(edge) if edge.from < self.first_node));
            let last = events.iter().rev().find_map(|event| if let Event::Scan(scan) = event { Some(scan) } else { None });
            self.odometry_pose = last.map(|scan| (scan.node, scan.time, scan.t_map_lidar)).or(self.odometry_pose);
        }
        events.into_iter().map(|event| self.localised(event)).collect()
    }

    /// The event with the origin of the map taken off its poses. The first scan decides where that is.
    fn localised(&mut self, event: Event) -> Event {
        if self.keeps_frame {
            return event;
        }
        if let (None, Event::Scan(scan)) = (self.origin, &event) {
            let origin = Origin::near(&scan.t_map_lidar);
            if !origin.is_zero() {
                tracing::info!(
                    "the map is made around {origin} m, as single precision is too coarse so far from zero; what is written has that added"
                );
            }
            self.origin = Some(origin);
        }
        self.origin().event_to_local(event)
    }
}

fn mixed(so_far: &str, this: &str) -> String {
    format!("the scans so far came {so_far}, and this one {this}: their frames may differ; map them apart")
}
