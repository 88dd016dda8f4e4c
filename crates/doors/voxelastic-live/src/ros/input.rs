//! The messages of topics as a transport.

use super::heard::Heard;
use super::middleware::{Delivery, Handle, Middleware, MiddlewareError, TopicProfile};
use crate::transport::Transport;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{TrySendError, sync_channel};
use voxelastic_io::OpenOptions;
use voxelastic_io::bag::live::{LiveEvents, LiveFrames, LiveScans, LiveTopic, LiveTopics, Polled};
use voxelastic_run::Input;
use voxelastic_slam::slam::RawScan;

/// Messages that may wait to be looked at: seconds of an inertial measurement unit.
const WAITING: usize = 4096;
/// Messages of a topic that a network keeps for us.
const DEPTH: usize = 100;
/// Clouds that a network keeps for us.
const CLOUDS: usize = 5;
/// Counts of what a subscription could not take.
#[derive(Clone, Debug, Default)]
pub struct Lost(Arc<AtomicUsize>);

impl Lost {
    /// Of a counter.
    pub fn of(counter: Arc<AtomicUsize>) -> Self {
        Self(counter)
    }

    /// Messages that came and were not looked at, because those before them took too long.
    pub fn count(&self) -> usize {
        self.0.load(Ordering::Relaxed)
    }
}

/// Scans from topics.
pub struct TopicInput {
    player: Player,
    subscriptions: Vec<Handle>,
    lost: Lost,
    heard: Heard,
}

enum Player {
    Events(Box<LiveEvents>),
    Scans(Box<LiveScans>),
}

impl TopicInput {
    /// Subscribes to the topics. With `is_raw` scans come without poses. What `tap` makes of a topic gets its messages, too.
    ///
    /// # Errors
    /// When the network refuses.
    pub fn subscribe(
        middleware: &mut dyn Middleware,
        topics: LiveTopics,
        is_raw: bool,
        options: &OpenOptions,
        tap: Tap<'_>,
    ) -> Result<Self, MiddlewareError> {
        let (sender, messages) = sync_channel(WAITING);
        let lost = Lost::default();
        let mut subscriptions = Vec::new();
        let heard = Heard::new(topics.subscriptions().iter().map(|topic| (topic.name.clone(), topic.is_steady)));
        for (number, topic) in topics.subscriptions().iter().enumerate() {
            let (tapped, sender, lost, heard) = (tap(topic)?, sender.clone(), lost.clone(), heard.clone());
            let deliver = move |message: Vec<u8>| {
                heard.note(number);
                tapped.iter().for_each(|record| record(&message));
                if let Err(TrySendError::Full(_)) = sender.try_send((number, message)) {
                    lost.0.fetch_add(1, Ordering::Relaxed);
                }
            };
            subscriptions.push(middleware.subscribe(&profile(topic), Box::new(deliver))?);
        }
        drop(sender);
        let player = if is_raw {
            Player::Scans(Box::new(LiveScans::new(topics, messages)))
        } else {
            Player::Events(Box::new(LiveEvents::new(topics, messages, options)))
        };
        Ok(Self { player, subscriptions, lost, heard })
    }

    /// The frames of what comes.
    pub fn frames(&self) -> LiveFrames {
        match &self.player {
            Player::Events(events) => events.frames(),
            Player::Scans(scans) => scans.frames(),
        }
    }

    /// What came on which topic, and when.
    pub fn heard(&self) -> Heard {
        self.heard.clone()
    }

    /// Counts of what could not be taken.
    pub fn lost(&self) -> Lost {
        self.lost.clone()
    }
}

/// How messages of a topic are delivered.
fn profile(topic: &LiveTopic) -> TopicProfile {
    let delivery = match topic {
        LiveTopic { is_latched: true, .. } => Delivery::Latched,
        LiveTopic { is_sensor_data: true, .. } => Delivery::SensorData,
        _ => Delivery::Reliable,
    };
    let depth = if topic.kind.ends_with("PointCloud2") { CLOUDS } else { DEPTH };
    TopicProfile { name: topic.name.clone(), kind: topic.kind.clone(), delivery, depth }
}

/// What gets the messages of a topic, too; none for a topic that nobody wants.
pub type Tap<'a> = &'a dyn Fn(&LiveTopic) -> Result<Option<Box<dyn Fn(&[u8]) + Send + Sync>>, MiddlewareError>;

impl Transport for TopicInput {
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
        let unusable = Input::from;
        while !is_stopped() {
            let incoming = match &mut self.player {
                Player::Events(events) => match events.poll() {
                    Polled::Item(event) => event.map_or_else(unusable, Input::Event),
                    Polled::Nothing => continue,
                    Polled::End => break,
                },
                Player::Scans(scans) => match scans.poll() {
                    Polled::Item(Ok(scan)) => {
                        Input::RawScan(RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: scan.imu }, scan.name)
                    }
                    Polled::Item(Err(error)) => unusable(error),
                    Polled::Nothing => continue,
                    Polled::End => break,
                },
            };
            return Some(incoming);
        }
        self.subscriptions.clear();
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::middleware::{Answer, Deliver, Sink};

    /// A network that keeps what it is asked for.
    #[derive(Default)]
    struct Asked(Vec<(TopicProfile, Deliver)>);

    impl Middleware for Asked {
        fn name(&self) -> &'static str {
            "test"
        }
        fn published(&self) -> Vec<(String, String)> {
            let topics = [
                ("/points", "sensor_msgs/msg/PointCloud2"),
                ("/odom", "nav_msgs/msg/Odometry"),
                ("/tf", "tf2_msgs/msg/TFMessage"),
                ("/tf_static", "tf2_msgs/msg/TFMessage"),
            ];
            topics.map(|(name, kind)| (name.to_owned(), kind.to_owned())).into()
        }
        fn subscribe(&mut self, topic: &TopicProfile, deliver: Deliver) -> Result<Handle, MiddlewareError> {
            self.0.push((topic.clone(), deliver));
            Ok(Handle::new(()))
        }
        fn advertise(&mut self, _: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
            Err(MiddlewareError::new("advertise", "not here"))
        }
        fn serve(&mut self, _: &str, _: &str, _: Answer) -> Result<Handle, MiddlewareError> {
            Ok(Handle::new(()))
        }
    }

    #[test]
    fn messages_that_nobody_takes_are_counted_and_keep_nobody_waiting() {
        let (mut network, options) = (Asked::default(), OpenOptions::default());
        let topics = LiveTopics::choose("test", &network.published(), false, &options).unwrap();
        let input = TopicInput::subscribe(&mut network, topics, false, &options, &|_| Ok(None)).unwrap();
        let asked = |name: &str| network.0.iter().find(|(topic, _)| topic.name == name).unwrap();
        // As REP 2003 says: sensors' data are not sent again, and what is published once is kept for those who come late.
        assert_eq!((asked("/points").0.delivery, asked("/points").0.depth), (Delivery::SensorData, CLOUDS));
        assert_eq!([asked("/odom").0.delivery, asked("/tf_static").0.delivery], [Delivery::Reliable, Delivery::Latched]);
        let deliver = &asked("/points").1;
        (0..WAITING + 10).for_each(|_| deliver(Vec::new()));
        assert_eq!(input.lost().count(), 10);
    }
}
