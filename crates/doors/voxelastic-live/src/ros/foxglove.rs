//! Foxglove: what is published, over its [WebSocket protocol](https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md). The messages are those of ROS 2, with
//! their definitions. Clients can read, and change nothing.
//!
//! What was published lately is there once, for all clients; each takes it at its own pace. One that is too slow misses what is not there any more, so clients cost
//! no memory, however many there are and whatever they do.

use super::middleware::{Delivery, MiddlewareError, Sink, TopicProfile};
use crate::http::{HttpServer, Place};
use crate::viewer::send;
use axum::body::Bytes;
use axum::extract::State;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Extension, Router};
use serde::Deserialize;
use serde_json::json;
use std::collections::{BTreeMap, VecDeque};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::sync::{Semaphore, watch};
use voxelastic_io::ros::definition;

/// Foxglove's own page, which may read unless others are named.
pub const APP: &str = "https://app.foxglove.dev";
/// The protocol, by its present name.
const PROTOCOL: &str = "foxglove.sdk.v1";
/// What was published lately, for those who are slower than the node: bytes of all topics.
const RECENT: usize = 64 << 20;
/// What is on its way to all clients, kilobytes; messages up to a size do not count.
const ON_THE_WAY: usize = 64 << 10;
const SMALL: usize = 64 << 10;
/// Subscriptions of a client, and bytes of a message of it.
const SUBSCRIPTIONS: usize = 256;
const LARGEST_REQUEST: usize = 64 << 10;

/// A server for Foxglove.
pub struct FoxgloveServer {
    hub: Arc<Hub>,
    server: HttpServer,
}

/// What all clients are served from.
struct Hub {
    name: String,
    session: String,
    board: Mutex<Board>,
    changes: watch::Sender<()>,
    on_the_way: Semaphore,
}

#[derive(Default)]
struct Board {
    topics: Vec<Topic>,
    /// Numbered in their order; the first one has this number.
    recent: VecDeque<Published>,
    first: u64,
    bytes: usize,
}

struct Topic {
    profile: TopicProfile,
    schema: &'static str,
    subscribers: usize,
    /// The last message, for those who come late, if it is a topic of that kind.
    last: Option<Published>,
}

/// A message of a topic, and when it was published, nanoseconds.
#[derive(Clone)]
struct Published {
    topic: usize,
    time: u64,
    message: Bytes,
}

impl Hub {
    fn new(name: &str) -> Arc<Self> {
        let session = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis()).to_string();
        let (board, changes) = (Mutex::default(), watch::Sender::new(()));
        Arc::new(Self { name: name.to_owned(), session, board, changes, on_the_way: Semaphore::new(ON_THE_WAY) })
    }

    fn routes(self: Arc<Self>) -> Router {
        Router::new().route("/", get(socket)).with_state(self)
    }

    fn add(&self, profile: &TopicProfile) -> Option<usize> {
        let schema = definition(&profile.kind)?;
        let mut board = self.board();
        board.topics.push(Topic { profile: profile.clone(), schema, subscribers: 0, last: None });
        let topic = board.topics.len() - 1;
        drop(board);
        self.changes.send_replace(());
        Some(topic)
    }

    fn board(&self) -> MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Board {
    /// The number of the next message.
    fn next(&self) -> u64 {
        self.first + self.recent.len() as u64
    }

    fn publish(&mut self, topic: usize, message: &[u8]) {
        let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        let Some(of) = self.topics.get_mut(topic) else { return };
        let is_latched = of.profile.delivery == Delivery::Latched;
        if of.subscribers == 0 && !is_latched {
            return;
        }
        let published = Published { topic, time, message: Bytes::copy_from_slice(message) };
        of.last = is_latched.then(|| published.clone());
        if of.subscribers > 0 {
            self.bytes += message.len();
            self.recent.push_back(published);
        }
        while self.bytes > RECENT && self.recent.len() > 1 {
            self.bytes -= self.recent.pop_front().map_or(0, |oldest| oldest.message.len());
            self.first += 1;
        }
    }
}

impl FoxgloveServer {
    /// Serves at `address`, with port 0 at one that is free, also to pages of `origins`.
    ///
    /// # Errors
    /// When the address is taken or not of this machine.
    pub fn start(name: &str, address: SocketAddr, origins: Vec<String>) -> Result<Self, MiddlewareError> {
        let hub = Hub::new(name);
        let server = HttpServer::start("foxglove", address, origins, Arc::clone(&hub).routes());
        let server = server.map_err(|e| MiddlewareError::new(format!("cannot serve Foxglove at {address}"), e))?;
        Ok(Self { hub, server })
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.server.address()
    }

    /// Announces a topic.
    ///
    /// # Errors
    /// When its type is not one of those that are published.
    pub fn advertise(&self, profile: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
        let failed = || MiddlewareError::new(format!("cannot publish {} for Foxglove", profile.name), format!("{} is not known", profile.kind));
        let topic = self.hub.add(profile).ok_or_else(failed)?;
        Ok(Box::new(ServerSink { hub: Arc::clone(&self.hub), topic }))
    }
}

/// The server's answers, with two topics and a message, for fuzzing.
#[cfg(feature = "fuzzing")]
pub(crate) fn fuzzed() -> Router {
    let hub = Hub::new("fuzzed");
    for (name, delivery) in [("/path", Delivery::Latched), ("/grid", Delivery::Reliable)] {
        let topic = hub.add(&TopicProfile { name: name.into(), kind: "nav_msgs/msg/Path".into(), delivery, depth: 1 });
        topic.into_iter().for_each(|topic| hub.board().publish(topic, &[7; 100]));
    }
    hub.routes()
}

struct ServerSink {
    hub: Arc<Hub>,
    topic: usize,
}

impl Sink for ServerSink {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.hub.board().publish(self.topic, message);
        self.hub.changes.send_replace(());
        Ok(())
    }

    fn subscribers(&self) -> usize {
        self.hub.board().topics.get(self.topic).map_or(0, |topic| topic.subscribers)
    }
}

async fn socket(State(hub): State<Arc<Hub>>, Extension(place): Extension<Place>, upgrade: WebSocketUpgrade) -> Response {
    let upgrade = upgrade.protocols([PROTOCOL]).max_message_size(LARGEST_REQUEST).max_frame_size(LARGEST_REQUEST);
    if upgrade.selected_protocol().is_none() {
        return (StatusCode::BAD_REQUEST, format!("this server speaks {PROTOCOL}\n")).into_response();
    }
    upgrade.on_upgrade(move |mut socket| async move {
        let at = hub.board().next();
        let mut client = Client { at, hub, announced: 0, subscriptions: BTreeMap::new(), first: VecDeque::new() };
        // An error is a client that has gone.
        let _ = client.serve(&mut socket).await;
        drop(place);
    })
}

/// What a client asks for.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Asked {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// A client, and where it is in what was published.
struct Client {
    hub: Arc<Hub>,
    announced: usize,
    /// By its own numbers: the topic, and the number of the first message that it gets.
    subscriptions: BTreeMap<u32, (usize, u64)>,
    /// What it gets first, each for a subscription.
    first: VecDeque<(u32, Published)>,
    at: u64,
}

impl Client {
    async fn serve(&mut self, socket: &mut WebSocket) -> Result<(), axum::Error> {
        let mut changes = self.hub.changes.subscribe();
        let hello = json!({ "op": "serverInfo", "name": self.hub.name, "capabilities": [], "supportedEncodings": [], "metadata": {}, "sessionId": self.hub.session });
        send(socket, Message::text(hello.to_string())).await?;
        loop {
            changes.borrow_and_update();
            if let Some(announcement) = self.announcement() {
                send(socket, Message::text(announcement)).await?;
            }
            let next = self.next();
            tokio::select! {
                biased;
                said = socket.recv() => match said {
                    None | Some(Err(_) | Ok(Message::Close(_))) => return Ok(()),
                    Some(Ok(Message::Text(text))) if !self.take(&text) => return Ok(()),
                    Some(Ok(_)) => {}
                },
                () = std::future::ready(()), if next.is_some() => {}
                changed = changes.changed(), if next.is_none() => if changed.is_err() { return Ok(()) },
            }
            if let Some((id, Published { time, message, .. })) = next {
                // Those who take nothing keep others waiting until they are dropped, and memory is what it is.
                let kilobytes = if message.len() <= SMALL { 0 } else { (message.len() >> 10).min(ON_THE_WAY) };
                let _permit = self.hub.on_the_way.acquire_many(kilobytes as u32).await;
                send(socket, Message::binary([&[1][..], &id.to_le_bytes(), &time.to_le_bytes(), &message].concat())).await?;
            }
        }
    }

    /// The topics that it does not know of.
    fn announcement(&mut self) -> Option<String> {
        let board = self.hub.board();
        let channel = |(k, topic): (usize, &Topic)| {
            let TopicProfile { name, kind, .. } = &topic.profile;
            json!({ "id": k + 1, "topic": name, "encoding": "cdr", "schemaName": kind, "schema": topic.schema, "schemaEncoding": "ros2msg" })
        };
        let channels: Vec<_> = board.topics.iter().enumerate().skip(self.announced).map(channel).collect();
        self.announced = board.topics.len();
        (!channels.is_empty()).then(|| json!({ "op": "advertise", "channels": channels }).to_string())
    }

    /// The next message that it gets, and for which subscription.
    fn next(&mut self) -> Option<(u32, Published)> {
        let board = self.hub.board();
        self.at = self.at.max(board.first);
        while self.first.is_empty()
            && let Some(published) = board.recent.get((self.at - board.first) as usize)
        {
            let is_for = |(topic, since): (usize, u64)| topic == published.topic && since <= self.at;
            self.first.extend(self.subscriptions.iter().filter(|(_, of)| is_for(**of)).map(|(id, _)| (*id, published.clone())));
            self.at += 1;
        }
        self.first.pop_front()
    }

    /// Does what it asks for; false if that is too much. What is not understood has no effect.
    fn take(&mut self, text: &str) -> bool {
        let hub = Arc::clone(&self.hub);
        let mut board = hub.board();
        match serde_json::from_str(text) {
            Ok(Asked::Subscribe { subscriptions }) => {
                for Subscription { id, channel_id } in subscriptions {
                    let (since, number) = (board.next(), channel_id.wrapping_sub(1));
                    let Some(topic) = board.topics.get_mut(number).filter(|_| !self.subscriptions.contains_key(&id)) else { continue };
                    if self.subscriptions.len() >= SUBSCRIPTIONS {
                        tracing::warn!("a client of Foxglove's port asked for more than {SUBSCRIPTIONS} subscriptions: its connection is closed");
                        return false;
                    }
                    topic.subscribers += 1;
                    self.subscriptions.insert(id, (number, since));
                    self.first.extend(topic.last.clone().map(|last| (id, last)));
                }
            }
            Ok(Asked::Unsubscribe { subscription_ids }) => {
                for id in subscription_ids {
                    if let Some((topic, _)) = self.subscriptions.remove(&id) {
                        board.leave(topic);
                    }
                }
                self.first.retain(|(id, _)| self.subscriptions.contains_key(id));
            }
            Ok(Asked::Other) | Err(_) => {}
        }
        true
    }
}

impl Board {
    fn leave(&mut self, topic: usize) {
        if let Some(topic) = self.topics.get_mut(topic) {
            topic.subscribers -= 1;
        }
        if self.topics.iter().all(|topic| topic.subscribers == 0) {
            (self.first, self.bytes) = (self.next(), 0);
            self.recent = VecDeque::new();
        }
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        let mut board = self.hub.board();
        self.subscriptions.values().for_each(|(topic, _)| board.leave(*topic));
    }
}

#[cfg(test)]
mod tests;
