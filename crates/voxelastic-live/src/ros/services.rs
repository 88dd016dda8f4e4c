//! Requests to the node: what others may ask of it, and what it answers.

use super::cdr::{Reader, Writer};
use super::messages::{Header, write_path};
use super::middleware::{Answer, Handle, Middleware, MiddlewareError};
use nalgebra::{Quaternion, UnitQuaternion};
use std::sync::mpsc::{Sender, SyncSender, sync_channel};
use std::time::Duration;
use voxelastic::Pose;

/// A request is answered within this time, or not at all.
const PATIENCE: Duration = Duration::from_secs(120);

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
    /// Find a path between two places in the map frame; the end may be `tolerance` metres from the goal.
    Plan {
        /// Where it begins.
        start: Pose,
        /// Where it ends.
        goal: Pose,
        /// Metres.
        tolerance: f32,
    },
}

/// What a node answers.
#[derive(Clone, Debug, PartialEq)]
pub enum Response {
    /// Whether it was done, and more about it.
    Done(Result<String, String>),
    /// Positions in the map frame; none if there is no way.
    Path(Vec<Pose>),
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
pub struct Desk(Sender<Pending>);

impl Desk {
    /// One whose requests are sent to `requests`.
    pub fn new(requests: Sender<Pending>) -> Self {
        Self(requests)
    }

    /// Asks; none if the node does not answer.
    pub fn ask(&self, request: Request) -> Option<Response> {
        let (answer, response) = sync_channel(1);
        self.0.send(Pending { request, answer }).ok()?;
        response.recv_timeout(PATIENCE).ok()
    }
}

/// Offers the services of a node: `~/save`, `~/reset`, `~/mesh` (`std_srvs/Trigger`), `~/pause` (`std_srvs/SetBool`), `~/plan` (`nav_msgs/GetPlan`).
///
/// # Errors
/// When the network refuses.
pub fn offer(middleware: &mut dyn Middleware, node: &str, desk: &Desk) -> Result<Vec<Handle>, MiddlewareError> {
    let trigger = |request: Request| {
        let desk = desk.clone();
        let answer: Answer = Box::new(move |_| Some(done(desk.ask(request.clone())?)));
        ("std_srvs/srv/Trigger", answer)
    };
    let pausing = desk.clone();
    let pause: Answer = Box::new(move |message| Some(done(pausing.ask(Request::Pause(Reader::new(message)?.bool()?))?)));
    let planning = desk.clone();
    let plan: Answer = Box::new(move |message| {
        let (request, frame) = plan_request(message)?;
        let Response::Path(poses) = planning.ask(request)? else { return None };
        let poses: Vec<(f64, Pose)> = poses.into_iter().map(|pose| (0.0, pose)).collect();
        Some(write_path(&mut Writer::new(), Header { stamp: 0.0, frame: &frame }, &poses).finish())
    });
    let services = [
        ("save", trigger(Request::Save)),
        ("reset", trigger(Request::Reset)),
        ("mesh", trigger(Request::Mesh)),
        ("pause", ("std_srvs/srv/SetBool", pause)),
        ("plan", ("nav_msgs/srv/GetPlan", plan)),
    ];
    services.into_iter().map(|(name, (kind, answer))| middleware.serve(&format!("/{node}/{name}"), kind, answer)).collect()
}

/// `std_srvs/Trigger` and `SetBool` answer alike.
fn done(response: Response) -> Vec<u8> {
    let (is_done, words) = match response {
        Response::Done(Ok(words)) => (true, words),
        Response::Done(Err(words)) => (false, words),
        Response::Path(_) => (true, String::new()),
    };
    Writer::new().bool(is_done).text(&words).finish()
}

/// The request of `nav_msgs/GetPlan`, and the frame of its start.
fn plan_request(message: &[u8]) -> Option<(Request, String)> {
    let mut reader = Reader::new(message)?;
    let mut stamped = || {
        reader.u32()?;
        reader.u32()?;
        let frame = reader.text()?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = reader.f64().filter(|v| v.is_finite())?;
        }
        let [x, y, z, qx, qy, qz, qw] = numbers;
        // Whoever does not care about the direction sends zeros.
        let rotation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6).unwrap_or_default();
        Some((frame, Pose::from_parts([x, y, z].into(), rotation)))
    };
    let ((frame, start), (_, goal)) = (stamped()?, stamped()?);
    let tolerance = reader.f32().filter(|t| t.is_finite())?.max(0.0);
    Some((Request::Plan { start, goal, tolerance }, frame))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::middleware::{Deliver, Sink, TopicProfile};
    use std::collections::HashMap;
    use std::sync::mpsc::channel;

    /// Keeps the services that are offered to it.
    #[derive(Default)]
    struct Switchboard(HashMap<String, (String, Answer)>);

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
        offer(&mut board, "voxelastic", &Desk::new(sender)).unwrap();
        let node = std::thread::spawn(move || {
            let mut seen = Vec::new();
            while let Ok(pending) = requests.recv() {
                seen.push(pending.request.clone());
                let response = match pending.request {
                    Request::Save => Response::Done(Ok("map.vox".into())),
                    Request::Plan { start, goal, .. } => Response::Path(vec![start, goal]),
                    _ => Response::Done(Err("no".into())),
                };
                pending.answer(response);
            }
            seen
        });
        let ask = |name: &str, request: &[u8]| board.0[&format!("/voxelastic/{name}")].1(request);
        let saved = ask("save", &Writer::new().u8(0).finish()).unwrap();
        let mut reader = Reader::new(&saved).unwrap();
        assert_eq!((reader.bool(), reader.text().as_deref()), (Some(true), Some("map.vox")));
        assert_eq!(Reader::new(&ask("pause", &Writer::new().bool(true).finish()).unwrap()).unwrap().bool(), Some(false));
        let mut request = Writer::new();
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
        drop(board);
        let seen = node.join().unwrap();
        assert_eq!((seen.len(), &seen[0], &seen[1]), (3, &Request::Save, &Request::Pause(true)));
    }
}
