//! What DDS and Zenoh have in common.

use std::any::Any;
use std::fmt;

/// How messages of a topic are delivered: the profiles that ROS 2 has names for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// Late messages are worth nothing: best effort, the last few (`rmw_qos_profile_sensor_data`). A subscriber asks for lost messages again where the
    /// publisher can give them.
    SensorData,
    /// Every message arrives while there is room for it.
    Reliable,
    /// Offered as reliable, but the next message comes soon, so one that finds a connection congested may be dropped.
    Periodic,
    /// As reliable, and who comes late gets the last messages that were published before (transient-local).
    Latched,
}

/// A topic, and how its messages are delivered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicProfile {
    /// Such as `/points`.
    pub name: String,
    /// Such as `sensor_msgs/msg/PointCloud2`.
    pub kind: String,
    /// How messages are delivered.
    pub delivery: Delivery,
    /// How many messages are kept for those who are slow or late.
    pub depth: usize,
}

/// What is done with each message that comes.
pub type Deliver = Box<dyn Fn(Vec<u8>) + Send + Sync>;
/// What a service answers to a request; none if the request makes no sense. It may take its time.
pub type Answer = Box<dyn Fn(&[u8]) -> Option<Vec<u8>> + Send + Sync>;

/// A subscription or a service; it ends when this is dropped.
pub struct Handle(#[expect(dead_code, reason = "kept for what happens when it is dropped")] Box<dyn Any + Send>);

impl Handle {
    /// Of whatever ends it when it is dropped.
    pub fn new(held: impl Send + 'static) -> Self {
        Self(Box::new(held))
    }
}

impl fmt::Debug for Handle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Handle")
    }
}

/// A way to send messages of a topic. Nothing in it waits.
pub trait Sink: Send {
    /// Sends a message.
    ///
    /// # Errors
    /// When the message could not be handed over; it is lost.
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError>;

    /// Whether another message would be sent soon. Where it is false, earlier ones wait for slow listeners; what can be made later had better be.
    fn has_room(&self) -> bool {
        true
    }

    /// How many listen, as far as known.
    fn subscribers(&self) -> usize;

    /// Whether messages travel over a network, and not into a file.
    fn is_remote(&self) -> bool {
        true
    }
}

/// A node in a network of ROS 2.
pub trait Middleware: Send {
    /// Its name, for messages.
    fn name(&self) -> &'static str;

    /// The topics that others publish, and their types.
    fn published(&self) -> Vec<(String, String)>;

    /// Has the messages of a topic delivered, from another thread.
    ///
    /// # Errors
    /// When the network refuses.
    fn subscribe(&mut self, topic: &TopicProfile, deliver: Deliver) -> Result<Handle, MiddlewareError>;

    /// Announces a topic.
    ///
    /// # Errors
    /// When the network refuses.
    fn advertise(&mut self, topic: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError>;

    /// Offers a service of type `kind`, such as `std_srvs/srv/Trigger`.
    ///
    /// # Errors
    /// When the network refuses.
    fn serve(&mut self, name: &str, kind: &str, answer: Answer) -> Result<Handle, MiddlewareError>;
}

/// A problem with the network.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{what}: {problem}")]
pub struct MiddlewareError {
    /// What was tried.
    pub what: String,
    /// What went wrong.
    pub problem: String,
}

impl MiddlewareError {
    /// A problem with what was tried.
    pub fn new(what: impl Into<String>, problem: impl fmt::Display) -> Self {
        Self { what: what.into(), problem: problem.to_string() }
    }
}

/// How a node joins a network.
#[derive(Clone, Debug, Default)]
pub struct NodeOptions {
    /// Name of the node, without its namespace.
    pub name: String,
    /// Its namespace, such as `/robot1`; empty for none.
    pub namespace: String,
    /// The domain: nodes of other domains are not seen.
    pub domain: u16,
    /// Whether only programs on this machine are talked to.
    pub local_only: bool,
    /// Whether services are for clients on Cyclone DDS, else for those on Fast DDS: the two mark requests in different ways. Of no importance over Zenoh.
    pub for_cyclone: bool,
    /// Parameters of the node, to be read by others.
    pub parameters: Vec<(String, Parameter)>,
}

/// The value of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum Parameter {
    /// A truth value.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Number(f64),
    /// A word or a path.
    Text(String),
}
