//! Requests to the node: what others may ask of it, and what it answers.

use super::lifecycle::State;
use super::messages::{Grid, Header, occupancy_grid, write_path};
use super::middleware::{Answer, Handle, Middleware, MiddlewareError};
use super::names::Names;
use super::output::MAP_FRAME;
use nalgebra::{Quaternion, UnitQuaternion};
use std::path::PathBuf;
use std::sync::mpsc::{Sender, SyncSender, sync_channel};
use std::time::Duration;
use voxelastic::Pose;
use voxelastic_io::ros::{MessageReader, MessageWriter};
use voxelastic_run::precision::LARGEST;

/// A request is answered within this time, or not at all.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(120);

/// What can be asked of a node.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Request {
    /// Write the map to disk.
    Save,
    /// Begin a new map.
    Reset,
    /// Ignore scans, or take them again.
    Pause(bool),
    /// Write the surface to disk.
    Mesh,
    /// Find a path between two places; the end may be `tolerance` metres from the goal.
    Plan {
        /// Where it begins.
        start: Place,
        /// Where it ends.
        goal: Place,
        /// Metres.
        tolerance: f32,
    },
    /// Open a saved map, and go on mapping in it.
    Load(PathBuf),
    /// Distances to the nearest surfaces at points, metres, map frame.
    Distances(Vec<[f64; 3]>),
    /// Explore, or stay where the robot is.
    Explore(bool),
    /// Go home, for a robot that explores.
    ReturnHome,
    /// The grid as it is.
    Grid,
    /// About where the robot is, for scans that are looked for in a map.
    InitialPose {
        /// The pose of its base.
        place: Place,
        /// Standard deviation of its position, metres: the larger one of x and y; 0 if none was given.
        sigma: f64,
    },
    /// The state of a managed node.
    State,
    /// A transition to another state, by its number or its label.
    ChangeState(u8, String),
}

/// A pose in any frame of the robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// The frame; empty for that of the map.
    pub frame: String,
    /// Time at which the frame is meant, seconds; none for now.
    pub stamp: Option<f64>,
    /// The pose in that frame.
    pub pose: Pose,
}

/// The distance at a point to the nearest surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// Metres.
    pub distance: f32,
    /// Where it grows: away from the surface, in the map frame, about of unit length; zero where that is not known.
    pub gradient: [f32; 3],
}

/// Why a map was not loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotLoaded {
    /// There is none.
    NotThere,
    /// It is damaged.
    Damaged,
    /// Mapping cannot go on in it: its settings are others.
    Differs,
    /// Something else.
    Other,
}

/// What a node answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Response {
    /// Whether it was done, and more about it.
    Done(Result<String, String>),
    /// Positions in the map frame; none if there is no way.
    Path(Vec<Pose>),
    /// Whether the map was loaded, and more about it.
    Loaded(Result<String, (NotLoaded, String)>),
    /// The grid, as the message of its topic.
    Grid(Vec<u8>),
    /// The state of a managed node.
    State(State),
    /// Distances, none where nothing is known; or why there are none.
    Distances(Result<Vec<Option<Distance>>, String>),
}

/// A request that waits for its answer.
#[derive(Debug)]
pub struct Pending {
    /// What is asked.
    pub request: Request,
    answer: SyncSender<Response>,
}

impl Pending {
    /// Answers it.
    pub fn answer(self, response: Response) {
        // Who asked may have gone.
        let _ = self.answer.try_send(response);
    }
}

/// Asks a node, and waits for its answer.
#[derive(Clone, Debug)]
pub struct RequestSender(Sender<Pending>);

impl RequestSender {
    /// One whose requests are sent to `requests`.
    pub fn new(requests: Sender<Pending>) -> Self {
        Self(requests)
    }

    /// Asks; none if the node does not answer.
    pub fn ask(&self, request: Request) -> Option<Response> {
        let (answer, response) = sync_channel(1);
        self.0.send(Pending { request, answer }).ok()?;
        response.recv_timeout(ANSWER_TIMEOUT).ok()
    }

    /// Asks without waiting for an answer.
    pub fn tell(&self, request: Request) {
        let (answer, _) = sync_channel(1);
        // It may have ended.
        let _ = self.0.send(Pending { request, answer });
    }
}

/// Points that can be asked for at a time: mapping waits meanwhile.
const MOST_POINTS: usize = 100_000;

/// Offers the services of a node: `~/save`, `~/reset`, `~/mesh` (`std_srvs/Trigger`), `~/return_home` (`std_srvs/Trigger`), `~/pause`, `~/explore` (`std_srvs/SetBool`), `~/plan` (`nav_msgs/GetPlan`), `~/map` (`nav_msgs/GetMap`), `~/load`
/// (`nav_msgs/LoadMap`), `~/distances` (`voxelastic_msgs/GetDistances`, defined in the folder `ros` of this crate).
///
/// # Errors
/// When the network refuses.
pub fn offer(middleware: &mut dyn Middleware, names: &Names, requests: &RequestSender) -> Result<Vec<Handle>, MiddlewareError> {
    let trigger = |request: Request| {
        let requests = requests.clone();
        let answer: Answer = Box::new(move |_| Some(done(requests.ask(request.clone())?)));
        ("std_srvs/srv/Trigger", answer)
    };
    let switch = |request: fn(bool) -> Request| {
        let requests = requests.clone();
        let answer: Answer = Box::new(move |message| Some(done(requests.ask(request(MessageReader::new(message)?.bool()?))?)));
        ("std_srvs/srv/SetBool", answer)
    };
    let planning = requests.clone();
    let plan: Answer = Box::new(move |message| {
        let Response::Path(poses) = planning.ask(plan_request(message)?)? else { return None };
        let poses: Vec<(f64, Pose)> = poses.into_iter().map(|pose| (0.0, pose)).collect();
        Some(write_path(&mut MessageWriter::new(), Header { stamp: 0.0, frame: MAP_FRAME }, &poses).finish())
    });
    let loading = requests.clone();
    let load: Answer = Box::new(move |message| {
        let response = loading.ask(Request::Load(load_request(message)?))?;
        let grid = if matches!(response, Response::Loaded(Ok(_))) { loading.ask(Request::Grid) } else { None };
        Some(loaded(&response, grid))
    });
    let measuring = requests.clone();
    let distances: Answer = Box::new(move |message| {
        let answer = match distances_request(message)? {
            Ok(points) => measuring.ask(Request::Distances(points))?,
            Err(problem) => Response::Distances(Err(problem)),
        };
        Some(measured(answer))
    });
    let looking = requests.clone();
    // The answer has nothing but the grid.
    let map: Answer = Box::new(move |_| if let Response::Grid(message) = looking.ask(Request::Grid)? { Some(message) } else { None });
    let services = [
        ("map", ("nav_msgs/srv/GetMap", map)),
        ("save", trigger(Request::Save)),
        ("reset", trigger(Request::Reset)),
        ("mesh", trigger(Request::Mesh)),
        ("pause", switch(Request::Pause)),
        ("explore", switch(Request::Explore)),
        ("return_home", trigger(Request::ReturnHome)),
        ("plan", ("nav_msgs/srv/GetPlan", plan)),
        ("load", ("nav_msgs/srv/LoadMap", load)),
        ("distances", ("voxelastic_msgs/srv/GetDistances", distances)),
    ];
    services.into_iter().map(|(name, (kind, answer))| middleware.serve(&names.resolve(&format!("~/{name}")), kind, answer)).collect()
}

/// `std_srvs/Trigger` and `SetBool` answer alike.
fn done(response: Response) -> Vec<u8> {
    let (is_done, words) = match response {
        Response::Done(Ok(words)) => (true, words),
        Response::Done(Err(words)) | Response::Loaded(Err((_, words))) | Response::Distances(Err(words)) => (false, words),
        Response::Loaded(Ok(words)) => (true, words),
        Response::Path(_) | Response::Grid(_) | Response::State(_) | Response::Distances(Ok(_)) => (true, String::new()),
    };
    MessageWriter::new().bool(is_done).text(&words).finish()
}

/// The request of `nav_msgs/GetPlan`.
fn plan_request(message: &[u8]) -> Option<Request> {
    let mut reader = MessageReader::new(message)?;
    let (start, goal) = (place(&mut reader)?, place(&mut reader)?);
    let tolerance = reader.f32().filter(|t| t.is_finite())?.max(0.0);
    Some(Request::Plan { start, goal, tolerance })
}

/// A header and a pose.
pub(super) fn place(reader: &mut MessageReader<'_>) -> Option<Place> {
    let stamp = f64::from(reader.u32()?) + 1e-9 * f64::from(reader.u32()?);
    let frame = reader.text()?;
    let mut numbers = [0.0; 7];
    for number in &mut numbers {
        *number = reader.f64().filter(|v| v.abs() <= LARGEST)?;
    }
    let [x, y, z, qx, qy, qz, qw] = numbers;
    // Whoever does not care about the direction sends zeros.
    let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6).unwrap_or_default();
    let frame = frame.trim_start_matches('/').to_owned();
    Some(Place { frame, stamp: Some(stamp).filter(|stamp| *stamp > 0.0), pose: Pose::from_parts([x, y, z].into(), rotation) })
}

/// The map that a request of `nav_msgs/LoadMap` names: a path, or a URL of a file.
fn load_request(message: &[u8]) -> Option<PathBuf> {
    let url = MessageReader::new(message)?.text()?;
    Some(PathBuf::from(url.strip_prefix("file://").unwrap_or(&url)))
}

/// The answer of `nav_msgs/LoadMap`: the grid of what was loaded, without cells where there is none, and the result.
fn loaded(response: &Response, grid: Option<Response>) -> Vec<u8> {
    let result = match response {
        Response::Loaded(Ok(_)) => 0,
        Response::Loaded(Err((NotLoaded::NotThere, _))) => 1,
        Response::Loaded(Err((NotLoaded::Damaged, _))) => 2,
        Response::Loaded(Err((NotLoaded::Differs, _))) => 3,
        _ => 255,
    };
    let mut message = match grid {
        Some(Response::Grid(message)) => message,
        _ => {
            let none = Grid { resolution: 0.0, width: 0, origin: [0.0; 3], cells: &[] };
            occupancy_grid(Header { stamp: 0.0, frame: MAP_FRAME }, &none)
        }
    };
    // The grid ends with bytes, so that nothing is between.
    message.push(result);
    message
}

/// The points of `voxelastic_msgs/GetDistances`; in words if there are too many.
fn distances_request(message: &[u8]) -> Option<Result<Vec<[f64; 3]>, String>> {
    let mut reader = MessageReader::new(message)?;
    let count = reader.u32()? as usize;
    if count > MOST_POINTS {
        return Some(Err(format!("{count} points: at most {MOST_POINTS} can be asked for at a time")));
    }
    let point = |reader: &mut MessageReader<'_>| Some([reader.f64()?, reader.f64()?, reader.f64()?]);
    (0..count).map(|_| point(&mut reader)).collect::<Option<Vec<_>>>().map(Ok)
}

/// The answer of `voxelastic_msgs/GetDistances`.
fn measured(response: Response) -> Vec<u8> {
    let (samples, words) = match response {
        Response::Distances(Ok(samples)) => (samples, None),
        Response::Distances(Err(words)) | Response::Done(Err(words)) => (Vec::new(), Some(words)),
        _ => (Vec::new(), Some("the node does not answer".to_owned())),
    };
    let mut message = MessageWriter::with_capacity(samples.len() * 33 + 64);
    message.bool(words.is_none()).text(&words.unwrap_or_default()).u32(samples.len() as u32);
    for sample in &samples {
        message.bool(sample.is_some());
    }
    message.u32(samples.len() as u32);
    for sample in &samples {
        message.f64s(&[sample.map_or(f64::NAN, |sample| sample.distance.into())]);
    }
    message.u32(samples.len() as u32);
    for sample in &samples {
        message.f64s(&sample.map_or([0.0; 3], |sample| sample.gradient.map(f64::from)));
    }
    message.finish()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::ros::middleware::{Deliver, Sink, TopicProfile};
    use std::collections::HashMap;
    use std::sync::mpsc::channel;

    /// Keeps the services that are offered to it.
    #[derive(Default)]
    pub(in crate::ros) struct Switchboard(pub HashMap<String, (String, Answer)>);

    impl Middleware for Switchboard {
        fn name(&self) -> &'static str {
            "test"
        }
        fn published(&self) -> Vec<(String, String)> {
            Vec::new()
        }
        fn subscribe(&mut self, _: &TopicProfile, _: Deliver) -> Result<Handle, MiddlewareError> {
            Ok(Handle::new(()))
        }
        fn advertise(&mut self, topic: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
            Err(MiddlewareError::new("cannot publish", &topic.name))
        }
        fn serve(&mut self, name: &str, kind: &str, answer: Answer) -> Result<Handle, MiddlewareError> {
            self.0.insert(name.to_owned(), (kind.to_owned(), answer));
            Ok(Handle::new(()))
        }
    }

    #[test]
    fn requests_reach_the_node_and_answers_come_back() {
        let (sender, requests) = channel();
        let mut board = Switchboard::default();
        offer(&mut board, &Names::default(), &RequestSender::new(sender)).unwrap();
        let node = std::thread::spawn(move || {
            let mut seen = Vec::new();
            while let Ok(pending) = requests.recv() {
                seen.push(pending.request.clone());
                let response = match &pending.request {
                    Request::Save => Response::Done(Ok("map.vox".into())),
                    Request::Plan { start, goal, .. } => Response::Path(vec![start.pose, goal.pose]),
                    Request::Load(path) if path.ends_with("a.vox") => Response::Loaded(Ok("3 scans".into())),
                    Request::Load(_) => Response::Loaded(Err((NotLoaded::Differs, "other voxels".into()))),
                    Request::Distances(_) => Response::Distances(Ok(vec![Some(Distance { distance: 0.5, gradient: [0.0, 0.0, 1.0] }), None])),
                    _ => Response::Done(Err("no".into())),
                };
                pending.answer(response);
            }
            seen
        });
        let ask = |name: &str, request: &[u8]| board.0[&format!("/voxelastic/{name}")].1(request);
        let saved = ask("save", &MessageWriter::new().u8(0).finish()).unwrap();
        let mut reader = MessageReader::new(&saved).unwrap();
        assert_eq!((reader.bool(), reader.text().as_deref()), (Some(true), Some("map.vox")));
        for name in ["pause", "explore", "return_home"] {
            assert_eq!(MessageReader::new(&ask(name, &MessageWriter::new().bool(true).finish()).unwrap()).unwrap().bool(), Some(false));
        }
        let mut request = MessageWriter::new();
        for x in [1.0, 2.0] {
            request.u32(5).u32(0).text("map").f64s(&[x, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        let path = ask("plan", &request.f32s(&[0.5]).finish()).unwrap();
        assert!(path.len() > 100);
        // Garbage gets no answer and does no harm.
        for garbage in [&[][..], &[0, 1, 0, 0], &[9, 9, 9, 9, 9], &path[..40]] {
            assert_eq!(ask("plan", garbage), None);
        }
        assert_eq!(ask("pause", &[]), None);
        let answers = ["/maps/a.vox", "file:///maps/b.vox"].map(|url| ask("load", &MessageWriter::new().text(url).finish()).unwrap());
        // The result is the last byte.
        assert_eq!(answers.map(|answer| *answer.last().unwrap()), [0, 3]);
        let [p, q] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
        let answer = ask("distances", &MessageWriter::new().u32(2).f64s(&p).f64s(&q).finish()).unwrap();
        let mut reader = MessageReader::new(&answer).unwrap();
        assert_eq!((reader.bool(), reader.text().as_deref()), (Some(true), Some("")));
        assert_eq!((reader.u32(), reader.bool(), reader.bool()), (Some(2), Some(true), Some(false)));
        assert_eq!((reader.u32(), reader.f64(), reader.f64().map(f64::is_nan)), (Some(2), Some(0.5), Some(true)));
        let gradients = (reader.u32(), [(); 6].map(|()| reader.f64().unwrap()), reader.f64());
        assert_eq!(gradients, (Some(2), [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], None));
        // More than the message has, and more than is answered at a time.
        assert_eq!(ask("distances", &MessageWriter::new().u32(3).f64s(&p).finish()), None);
        let many = ask("distances", &MessageWriter::new().u32(u32::MAX).finish()).unwrap();
        assert_eq!(MessageReader::new(&many).unwrap().bool(), Some(false));
        drop(board);
        let seen = node.join().unwrap();
        assert_eq!(seen.len(), 9);
        assert_eq!(seen[..4], [Request::Save, Request::Pause(true), Request::Explore(true), Request::ReturnHome]);
        let [a, b] = ["/maps/a.vox", "/maps/b.vox"].map(|path| Request::Load(path.into()));
        assert_eq!(seen[5..], [a, Request::Grid, b, Request::Distances(vec![p, q])]);
    }
}
