//! ROS 2 over Zenoh, as `rmw_zenoh` speaks it: keys, liveliness tokens and attachments as in its design document.

use super::interfaces;
use super::middleware::{Answer, Deliver, Delivery, Handle, Middleware, MiddlewareError, NodeOptions, Sink, TopicProfile};
use super::outbox::{Outbox, OutboxTopic};
use super::parameters;
use std::collections::HashMap;
use std::fmt::Display;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::SampleKind;
use zenoh::{Config, Session, Wait};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriberBuilderExt, CacheConfig, HistoryConfig, MissDetectionConfig, RecoveryConfig,
};

/// How often a publisher tells late messages apart from lost ones.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Messages of a topic that may wait while there is room for more to be made.
const ROOM: usize = 2;
/// The file with the configuration of a session, as for `rmw_zenoh`.
const CONFIG_FILE: &str = "ZENOH_SESSION_CONFIG_URI";
/// Changes of the configuration, as for `rmw_zenoh`: `key=value;key=value`.
const CONFIG_CHANGES: &str = "ZENOH_CONFIG_OVERRIDE";

/// A node.
pub struct Zenoh {
    session: Session,
    namespace: String,
    node: String,
    domain: u16,
    next_entity: AtomicU64,
    graph: Arc<Mutex<Graph>>,
    outbox: Outbox,
    /// What follows who is there, what says that this node is, and its parameters.
    held: Vec<Handle>,
}

impl Zenoh {
    /// Joins the network: that of the router at `localhost:7447` if there is one, and of those who come to this session. The variables that configure
    /// `rmw_zenoh` configure it, too.
    ///
    /// # Errors
    /// When the configuration is wrong, or no port can be opened.
    pub fn open(options: &NodeOptions) -> Result<Self, MiddlewareError> {
        Self::join(config()?, options)
    }

    fn join(config: Config, options: &NodeOptions) -> Result<Self, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new("cannot join the Zenoh network", problem);
        let session = zenoh::open(config).wait().map_err(|e| failed(&e))?;
        let graph = Arc::<Mutex<Graph>>::default();
        let changed = Arc::clone(&graph);
        let own = session.zid().to_string();
        let subscriber = session.liveliness().declare_subscriber(format!("@ros2_lv/{}/**", options.domain)).history(true);
        let subscriber = subscriber.callback(move |sample| {
            let key = sample.key_expr().as_str();
            if let Some(entity) = Entity::of(key).filter(|entity| entity.session != own) {
                let mut graph = changed.lock().unwrap_or_else(PoisonError::into_inner);
                match sample.kind() {
                    SampleKind::Put => drop(graph.entities.insert(key.to_owned(), entity)),
                    SampleKind::Delete => drop(graph.entities.remove(key)),
                }
            }
        });
        let subscriber = subscriber.wait().map_err(|e| failed(&e))?;
        let namespace = format!("%{}", options.namespace.trim_start_matches('/').replace('/', "%"));
        let key = format!("@ros2_lv/{}/{}/0/0/NN/%/{namespace}/{}", options.domain, session.zid(), options.name);
        let token = session.liveliness().declare_token(key).wait().map_err(|e| failed(&e))?;
        let held = vec![Handle::new(subscriber), Handle::new(token)];
        let outbox = Outbox::start("zenoh-outbox").map_err(|e| failed(&e))?;
        let (name, domain, next_entity) = (options.name.clone(), options.domain, AtomicU64::new(1));
        let mut node = Self { session, namespace, node: name, domain, next_entity, graph, outbox, held };
        let parameters = parameters::offer(&mut node, options)?;
        node.held.extend(parameters);
        Ok(node)
    }

    /// Addresses at which others can connect to this session.
    pub fn locators(&self) -> Vec<String> {
        self.session.info().locators().wait().iter().map(ToString::to_string).collect()
    }

    /// The key of the messages of a topic or service; any hash if there is none.
    fn key(&self, name: &str, kind: &str, hash: Option<&str>) -> Option<String> {
        Some(format!("{}/{}/{}/{}", self.domain, name.trim_matches('/'), interfaces::to_dds(kind)?, hash.unwrap_or("*")))
    }

    /// Tells others about a publisher, subscriber or server; also returns what identifies it.
    fn announce(&self, entity: &str, name: &str, kind: &str, qos: &str) -> zenoh::Result<(LivelinessToken, [u8; 16])> {
        let (number, dds) = (self.next_entity.fetch_add(1, Ordering::Relaxed), interfaces::to_dds(kind).unwrap_or_default());
        let (zid, mangled, hash) = (self.session.zid(), name.replace('/', "%"), interfaces::hash(kind));
        let key = format!("@ros2_lv/{}/{zid}/0/{number}/{entity}/%/{}/{}/{mangled}/{dds}/{hash}/{qos}", self.domain, self.namespace, self.node);
        let gid = xxhash_rust::xxh3::xxh3_128(key.as_bytes()).to_le_bytes();
        Ok((self.session.liveliness().declare_token(key).wait()?, gid))
    }
}

impl Middleware for Zenoh {
    fn name(&self) -> &'static str {
        "Zenoh"
    }

    fn published(&self) -> Vec<(String, String)> {
        let graph = self.graph.lock().unwrap_or_else(PoisonError::into_inner);
        let publishers = graph.entities.values().filter(|entity| entity.role == "MP");
        let mut topics: Vec<_> = publishers.map(|entity| (entity.name.clone(), entity.kind.clone())).collect();
        topics.sort();
        topics.dedup();
        topics
    }

    fn subscribe(&mut self, topic: &TopicProfile, deliver: Deliver) -> Result<Handle, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot subscribe to {}", topic.name), problem);
        let key = self.key(&topic.name, &topic.kind, None).ok_or_else(|| failed(&"no type of a message"))?;
        let subscriber = self.session.declare_subscriber(key).callback(move |sample| deliver(sample.payload().to_bytes().into_owned()));
        let held = if topic.delivery == Delivery::Latched {
            let history = HistoryConfig::default().detect_late_publishers().max_samples(topic.depth);
            let recovery = RecoveryConfig::default().heartbeat();
            Handle::new(subscriber.advanced().history(history).recovery(recovery).subscriber_detection().wait().map_err(|e| failed(&e))?)
        } else {
            Handle::new(subscriber.wait().map_err(|e| failed(&e))?)
        };
        let token = self.announce("MS", &topic.name, &topic.kind, &qos(topic)).map_err(|e| failed(&e))?;
        Ok(Handle::new((held, token)))
    }

    fn advertise(&mut self, topic: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot publish {}", topic.name), problem);
        let hash = interfaces::hash(&topic.kind);
        let key = self.key(&topic.name, &topic.kind, Some(&hash)).ok_or_else(|| failed(&"no type of a message"))?;
        // What comes again soon is dropped where a connection is congested, and what is sent on change only waits for it, on a thread. While that one waits, so
        // does everybody who sends with the same priority.
        let (congestion, priority, outbox) = match topic.delivery {
            Delivery::SensorData | Delivery::Periodic => (CongestionControl::Drop, Priority::DataHigh, None),
            Delivery::Reliable | Delivery::Latched => (CongestionControl::Block, Priority::Data, Some(self.outbox.topic(topic.depth))),
        };
        let mut publisher = self.session.declare_publisher(key).congestion_control(congestion).priority(priority).advanced();
        if topic.delivery == Delivery::Latched {
            let detection = MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT);
            publisher = publisher.cache(CacheConfig::default().max_samples(topic.depth)).sample_miss_detection(detection).publisher_detection();
        }
        let publisher = publisher.wait().map_err(|e| failed(&e))?;
        let (token, gid) = self.announce("MP", &topic.name, &topic.kind, &qos(topic)).map_err(|e| failed(&e))?;
        let (name, graph, is_newest_enough) = (topic.name.clone(), Arc::clone(&self.graph), topic.delivery == Delivery::Latched);
        Ok(Box::new(ZenohSink { outbox, publisher: Arc::new(publisher), gid, sequence: 0, name, is_newest_enough, graph, _token: token }))
    }

    fn serve(&mut self, name: &str, kind: &str, answer: Answer) -> Result<Handle, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot offer the service {name}"), problem);
        let hash = interfaces::hash(kind);
        let key = self.key(name, kind, Some(&hash)).ok_or_else(|| failed(&"no type of a service"))?;
        let (answer, name_of_service) = (Arc::new(answer), name.to_owned());
        let server = self.session.declare_queryable(key).complete(true).callback(move |query| {
            let (answer, name) = (Arc::clone(&answer), name_of_service.clone());
            // The session's thread must not wait for an answer.
            let task = move || {
                let Some(response) = query.payload().and_then(|request| answer(&request.to_bytes())) else { return };
                // An answer carries what the request carried, with its own time.
                let attachment = query.attachment().map(|sent| stamped(&sent.to_bytes()));
                let mut reply = query.reply(query.key_expr().clone(), response);
                if let Some(attachment) = attachment {
                    reply = reply.attachment(attachment);
                }
                if let Err(problem) = reply.wait() {
                    tracing::warn!("Zenoh: the answer of {name} is lost: {problem}");
                }
            };
            if let Err(problem) = std::thread::Builder::new().name("zenoh-service".to_owned()).spawn(task) {
                tracing::warn!("Zenoh: a request cannot be answered: {problem}");
            }
        });
        let server = server.wait().map_err(|e| failed(&e))?;
        let token = self.announce("SS", name, kind, "::,10:,:,:,,").map_err(|e| failed(&e))?;
        Ok(Handle::new((server, token)))
    }
}

struct ZenohSink {
    /// Dropped first: it waits for what is still to be sent.
    outbox: Option<OutboxTopic>,
    publisher: Arc<AdvancedPublisher<'static>>,
    gid: [u8; 16],
    sequence: i64,
    name: String,
    /// Whether nothing is lost with a message that gives way to a newer one.
    is_newest_enough: bool,
    graph: Arc<Mutex<Graph>>,
    _token: LivelinessToken,
}

impl Sink for ZenohSink {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.sequence += 1;
        let lost = |problem: &dyn Display| MiddlewareError::new(format!("a message of {} is lost", self.name), problem);
        let attachment = attachment(self.sequence, &self.gid);
        let Some(outbox) = &self.outbox else {
            return self.publisher.put(message).attachment(attachment).wait().map_err(|e| lost(&e));
        };
        let (publisher, message, name) = (Arc::clone(&self.publisher), message.to_vec(), self.name.clone());
        let has_room = outbox.push(Box::new(move || {
            if let Err(problem) = publisher.put(message).attachment(attachment).wait() {
                tracing::warn!("Zenoh: a message of {name} is lost: {problem}");
            }
        }));
        if has_room || self.is_newest_enough { Ok(()) } else { Err(lost(&"who listens is too slow")) }
    }

    fn has_room(&self) -> bool {
        self.outbox.as_ref().is_none_or(|outbox| outbox.waiting() < ROOM)
    }

    fn subscribers(&self) -> usize {
        let graph = self.graph.lock().unwrap_or_else(PoisonError::into_inner);
        let known = graph.entities.values().filter(|entity| entity.role == "MS" && entity.name == self.name).count();
        // Programs that are no nodes of ROS do not say that they are there.
        let listens = || self.publisher.matching_status().wait().is_ok_and(|status| status.matching());
        if known > 0 { known } else { usize::from(listens()) }
    }
}

/// Who is there.
#[derive(Debug, Default)]
struct Graph {
    /// By liveliness token.
    entities: HashMap<String, Entity>,
}

/// A publisher, a subscriber or a server of somebody else.
#[derive(Debug)]
struct Entity {
    session: String,
    /// `MP` publisher, `MS` subscriber, `SS` server, `SC` client.
    role: String,
    name: String,
    kind: String,
}

impl Entity {
    /// What a liveliness token says; nodes are left out.
    fn of(key: &str) -> Option<Self> {
        // @ros2_lv / domain / session / node / entity / role / enclave / namespace / node's name / name / type / hash / qos
        let parts: Vec<&str> = key.split('/').collect();
        let [_, _, session, _, _, role, _, _, _, name, kind, ..] = parts[..] else { return None };
        Some(Self { session: session.into(), role: role.into(), name: name.replace('%', "/"), kind: interfaces::of_dds(kind)? })
    }
}

/// Reliability, durability, history and depth, where they are not usual; then deadline, lifespan, liveliness.
fn qos(topic: &TopicProfile) -> String {
    let [reliability, durability] = match topic.delivery {
        Delivery::SensorData => ["2", ""],
        Delivery::Reliable | Delivery::Periodic => ["", ""],
        Delivery::Latched => ["", "1"],
    };
    format!("{reliability}:{durability}:,{}:,:,:,,", topic.depth)
}

/// Sequence number, time and sender of a message.
fn attachment(sequence: i64, gid: &[u8; 16]) -> Vec<u8> {
    let mut bytes = sequence.to_le_bytes().to_vec();
    bytes.extend(now().to_le_bytes());
    bytes.push(gid.len() as u8);
    bytes.extend(gid);
    bytes
}

/// An attachment with the time of now.
fn stamped(attachment: &[u8]) -> Vec<u8> {
    let mut bytes = attachment.to_vec();
    if let Some(time) = bytes.get_mut(8..16) {
        time.copy_from_slice(&now().to_le_bytes());
    }
    bytes
}

/// Nanoseconds since 1970.
fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

/// The configuration: as the variables say, else as `rmw_zenoh` has it.
fn config() -> Result<Config, MiddlewareError> {
    let wrong = |what: &str, problem: &dyn Display| MiddlewareError::new(format!("the configuration of Zenoh is wrong: {what}"), problem);
    let file = std::env::var(CONFIG_FILE).unwrap_or_default();
    let mut config = if file.trim().is_empty() {
        let mut config = Config::default();
        let usual = [
            ("mode", "\"peer\""),
            ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]"),
            ("connect/endpoints", "[\"tcp/127.0.0.1:7447\"]"),
            ("scouting/multicast/enabled", "false"),
            ("timestamping/enabled", "true"),
        ];
        for (key, value) in usual {
            config.insert_json5(key, value).map_err(|e| wrong(key, &e))?;
        }
        config
    } else {
        Config::from_file(file.trim()).map_err(|e| wrong(&format!("{CONFIG_FILE}={file}"), &e))?
    };
    for change in std::env::var(CONFIG_CHANGES).unwrap_or_default().split(';').map(str::trim).filter(|change| !change.is_empty()) {
        let (key, value) = change.split_once('=').ok_or_else(|| wrong(CONFIG_CHANGES, &format!("`{change}` is not key=value")))?;
        config.insert_json5(key.trim(), value.trim()).map_err(|e| wrong(&format!("{CONFIG_CHANGES}: {change}"), &e))?;
    }
    Ok(config)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;
    use std::time::Instant;
    use voxelastic_testing::PATIENCE;

    #[test]
    fn tokens_say_who_is_there() {
        let key = "@ros2_lv/0/aa/3/7/MP/%/%/driver/%lidar%points/sensor_msgs::msg::dds_::PointCloud2_/RIHS01_0/::,7:,:,:,,";
        let entity = Entity::of(key).unwrap();
        assert_eq!([&entity.session, &entity.role, &entity.name, &entity.kind], ["aa", "MP", "/lidar/points", "sensor_msgs/msg/PointCloud2"]);
        assert!(Entity::of("@ros2_lv/0/aa/3/3/NN/%/%/driver").is_none() && Entity::of("").is_none());
    }

    /// A node that connects to those at `locators`.
    fn node(locators: &[String]) -> Zenoh {
        let mut config = config().unwrap();
        config.insert_json5("connect/endpoints", &format!("{locators:?}")).unwrap();
        Zenoh::join(config, &NodeOptions { name: "test".into(), local_only: true, ..NodeOptions::default() }).unwrap()
    }

    fn topic(name: &str, delivery: Delivery) -> TopicProfile {
        TopicProfile { name: name.into(), kind: "sensor_msgs/msg/PointCloud2".into(), delivery, depth: 20 }
    }

    fn wait_until(is_so: impl Fn() -> bool) {
        let begin = Instant::now();
        while !is_so() {
            assert!(begin.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    #[test]
    fn large_messages_reach_a_slow_listener_and_nobody_waits_for_it() {
        let mut robot = node(&[]);
        let mut listener = node(&robot.locators());
        let ((sender, taken), (open, gate)) = (channel(), channel());
        let gate = Mutex::new(gate);
        let slow = Box::new(move |message: Vec<u8>| {
            gate.lock().unwrap().recv().unwrap();
            sender.send((message.len(), message[0])).unwrap();
        });
        let _subscription = listener.subscribe(&topic("/surface", Delivery::Reliable), slow).unwrap();
        let mut surface = robot.advertise(&topic("/surface", Delivery::Reliable)).unwrap();
        let mut frames = robot.advertise(&topic("/tf", Delivery::Periodic)).unwrap();
        wait_until(|| surface.subscribers() == 1);
        let sizes = [8 << 20, 1 << 10].into_iter().cycle().take(20);
        for (k, size) in sizes.clone().enumerate() {
            surface.publish(&vec![k as u8; size]).unwrap();
            frames.publish(&[0; 100]).unwrap();
        }
        // The listener has not taken one yet.
        assert!(!surface.has_room());
        sizes.clone().for_each(|_| open.send(()).unwrap());
        let taken: Vec<_> = sizes.clone().map(|_| taken.recv_timeout(PATIENCE).expect("every message comes")).collect();
        assert_eq!(taken, sizes.zip(0..).collect::<Vec<(usize, u8)>>());
        assert!(surface.has_room());
    }

    #[test]
    fn a_listener_that_is_stuck_keeps_nothing_from_others() {
        let mut robot = node(&[]);
        let [mut stuck, mut listener] = [node(&robot.locators()), node(&robot.locators())];
        let (release, held) = channel::<()>();
        let held = Mutex::new(held);
        let never = Box::new(move |_| assert!(held.lock().unwrap().recv().is_err()));
        let (sender, taken) = channel();
        let usual = Box::new(move |message: Vec<u8>| sender.send(message[0]).unwrap());
        let _stuck = stuck.subscribe(&topic("/surface", Delivery::Reliable), never).unwrap();
        let _subscription = listener.subscribe(&topic("/surface", Delivery::Reliable), usual).unwrap();
        let mut surface = robot.advertise(&topic("/surface", Delivery::Reliable)).unwrap();
        wait_until(|| surface.subscribers() == 2);
        for k in 0..10 {
            surface.publish(&vec![k; 8 << 20]).unwrap();
        }
        let taken: Vec<u8> = (0..10).map(|_| taken.recv_timeout(Duration::from_secs(60)).expect("every message comes")).collect();
        assert_eq!(taken, (0..10).collect::<Vec<u8>>());
        drop(release);
    }

    #[test]
    fn attachments_are_those_of_zenohs_serialiser() {
        let bytes = attachment(7, &[0xab; 16]);
        assert_eq!((bytes.len(), bytes[..8] == 7i64.to_le_bytes(), bytes[16], &bytes[17..]), (33, true, 16, &[0xab; 16][..]));
        assert_eq!(stamped(&bytes)[16..], bytes[16..]);
        assert_eq!(stamped(&[1, 2]), [1, 2]);
    }
}
