//! ROS 2 over DDS, by RustDDS.

use super::interfaces;
use super::middleware::{Answer, Deliver, Delivery, Handle, Middleware, MiddlewareError, NodeOptions, Parameter, Sink, TopicProfile};
use super::parameters::{self, FIXED};
use super::raw_message::RawMessage;
use futures::StreamExt;
use ros2_client::dds::rustdds::dds::result::CreateResult;
use ros2_client::dds::rustdds::no_key::DataWriter;
use ros2_client::dds::rustdds::policy::Reliability as DdsReliability;
use ros2_client::dds::rustdds::{DomainParticipantBuilder, QosPolicies, Timestamp, TopicKind};
use ros2_client::dds::{Context, Node, Publisher, Server, ServiceMapping, Subscription};
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{MessageTypeName, Name, NodeName, ParameterValue, QosProfile, ServiceTypeName};
use std::future::Future;
use std::net::{IpAddr, Ipv4Addr};
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::oneshot;

/// The least that a datagram carries anywhere, less what is written around an answer.
const LONG_ANSWER: usize = 1300;

/// Requests that may wait.
const REQUESTS: usize = 10;

/// A node.
pub struct Dds {
    context: Context,
    node: Arc<Mutex<Node>>,
    /// How a request says whose it is: that is not standardised.
    mapping: ServiceMapping,
    /// Keeps the thread alive that answers for parameters and follows who is there, or services for parameters.
    held: Vec<Handle>,
}

impl Dds {
    /// Joins the network.
    ///
    /// # Errors
    /// When there is no network, or the name of the node is none.
    pub fn open(options: &NodeOptions) -> Result<Self, MiddlewareError> {
        let failed = |problem: &dyn std::fmt::Display| MiddlewareError::new("cannot join the DDS network", problem);
        let mut participant = DomainParticipantBuilder::new(options.domain).socket_receive_buffer_size(8 << 20);
        if options.local_only {
            participant = participant.with_only_networks([IpAddr::V4(Ipv4Addr::LOCALHOST)]);
        }
        let participant = participant.build().map_err(|e| failed(&e))?;
        let context = Context::from_domain_participant(participant).map_err(|e| failed(&e))?;
        let is_started = Arc::new(AtomicBool::new(false));
        // The library's own services for parameters are for clients like those of Fast DDS.
        let declared = node_options(options, Arc::clone(&is_started)).start_parameter_services(!options.for_cyclone);
        let name = NodeName::new(if options.namespace.is_empty() { "/" } else { &options.namespace }, &options.name).map_err(|e| failed(&e))?;
        let mut node = context.new_node(name, declared).map_err(|e| failed(&format!("{e:?}")))?;
        is_started.store(true, Ordering::Relaxed);
        let spinner = node.spinner().map_err(|e| failed(&e))?;
        let spinner = run("dds", async move {
            if let Err(problem) = spinner.spin().await {
                tracing::warn!("DDS: parameters are not served: {problem}");
            }
        })?;
        let mapping = if options.for_cyclone { ServiceMapping::Cyclone } else { ServiceMapping::Enhanced };
        let mut dds = Self { context, node: Arc::new(Mutex::new(node)), mapping, held: vec![spinner] };
        if options.for_cyclone {
            let parameters = parameters::offer(&mut dds, options)?;
            dds.held.extend(parameters);
        }
        Ok(dds)
    }

    fn node(&self) -> MutexGuard<'_, Node> {
        lock(&self.node)
    }

    /// Whether somebody publishes a topic and would send lost messages again.
    fn is_reliable(&self, topic: &str) -> bool {
        let dds_name = format!("rt{topic}");
        let writers = self.context.domain_participant().discovered_writers();
        writers.iter().any(|writer| {
            let data = &writer.publication_topic_data;
            data.topic_name == dds_name && matches!(data.reliability, Some(DdsReliability::Reliable { .. }))
        })
    }

    /// Sends the answers of a service to clients like those of Cyclone DDS, which find in the message whose request it answers. The library's own answers say it beside the
    /// message as well, and RustDDS 0.15 damages such messages where they do not fit in one datagram.
    fn cyclone_answers(&self, service: &str, answer: String, qos: &QosProfile) -> CreateResult<DataWriter<RawMessage>> {
        let (participant, qos) = (self.context.domain_participant(), QosPolicies::from(qos));
        let topic = participant.create_topic(format!("rr{service}Reply"), answer, &qos, TopicKind::NoKey)?;
        participant.create_publisher(&qos)?.create_datawriter_no_key_cdr(&topic, Some(qos))
    }
}

impl Middleware for Dds {
    fn name(&self) -> &'static str {
        "DDS"
    }

    fn published(&self) -> Vec<(String, String)> {
        let writers = self.context.domain_participant().discovered_writers();
        let topic = |data: &ros2_client::dds::rustdds::discovery::DiscoveredWriterData| {
            let data = &data.publication_topic_data;
            Some((data.topic_name.strip_prefix("rt")?.to_owned(), interfaces::of_dds(&data.type_name)?))
        };
        let mut topics: Vec<_> = writers.iter().filter_map(topic).collect();
        topics.sort();
        topics.dedup();
        topics
    }

    fn subscribe(&mut self, topic: &TopicProfile, deliver: Deliver) -> Result<Handle, MiddlewareError> {
        let mut qos = profile(topic);
        if topic.delivery == Delivery::SensorData && self.is_reliable(&topic.name) {
            qos.reliability = Reliability::Reliable { when_full: WhenFull::Fail };
        }
        let failed = |problem: &dyn std::fmt::Display| MiddlewareError::new(format!("cannot subscribe to {}", topic.name), problem);
        let (name, kind) = names(topic).ok_or_else(|| failed(&"no name of a topic"))?;
        let mut node = self.node();
        let dds_topic = node.create_topic(&name, kind, &qos).map_err(|e| failed(&e))?;
        let subscription: Subscription<RawMessage> = node.create_subscription(&dds_topic, Some(qos)).map_err(|e| failed(&e))?;
        drop(node);
        let name = topic.name.clone();
        run("dds-in", async move {
            let mut messages = pin!(subscription.async_stream());
            while let Some(message) = messages.next().await {
                match message {
                    Ok((message, _)) => deliver(message.into_message()),
                    Err(problem) => tracing::debug!("DDS: a message of {name} is lost: {problem}"),
                }
            }
        })
    }

    fn advertise(&mut self, topic: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
        let qos = profile(topic);
        let failed = |problem: &dyn std::fmt::Display| MiddlewareError::new(format!("cannot publish {}", topic.name), problem);
        let (name, kind) = names(topic).ok_or_else(|| failed(&"no name of a topic"))?;
        let mut node = self.node();
        let dds_topic = node.create_topic(&name, kind, &qos).map_err(|e| failed(&e))?;
        let publisher = node.create_publisher(&dds_topic, Some(qos)).map_err(|e| failed(&e))?;
        drop(node);
        Ok(Box::new(DdsSink { publisher, node: Arc::clone(&self.node), name: topic.name.clone() }))
    }

    fn serve(&mut self, name: &str, kind: &str, answer: Answer) -> Result<Handle, MiddlewareError> {
        let failed = |problem: &dyn std::fmt::Display| MiddlewareError::new(format!("cannot offer the service {name}"), problem);
        let service = split(name).ok_or_else(|| failed(&"no name of a service"))?;
        let (package, kind) = interfaces::parts(kind).ok_or_else(|| failed(&"no type of a service"))?;
        let qos = QosProfile::publisher_default().history(History::KeepLast { depth: REQUESTS });
        let mapping = self.mapping;
        let answers = match mapping {
            ServiceMapping::Cyclone => {
                Some(self.cyclone_answers(name, format!("{package}::srv::dds_::{kind}_Response_"), &qos).map_err(|e| failed(&format!("{e:?}")))?)
            }
            _ => None,
        };
        let server: Server<RawMessage, RawMessage> =
            self.node().create_server(mapping, &service, &ServiceTypeName::new(package, kind), qos.clone(), qos).map_err(|e| failed(&e))?;
        let name = name.to_owned();
        run("dds-service", async move {
            let mut requests = pin!(server.receive_request_stream());
            while let Some(request) = requests.next().await {
                let Ok((id, request)) = request else { continue };
                let Some(response) = answer(&request.into_message()) else { continue };
                let sent = match &answers {
                    Some(answers) => {
                        let answer = RawMessage::of_answer(&id.writer_gid.to_bytes16(), id.sequence_number, &response);
                        answers.async_write(answer, Some(Timestamp::now())).await.map_err(|e| format!("{e:?}"))
                    }
                    None => {
                        if response.len() > LONG_ANSWER {
                            tracing::warn!(
                                "DDS: the answer of {name} has {} bytes: a client on Fast DDS gets it only if it fits in one datagram of its network (RustDDS 0.15)",
                                response.len()
                            );
                        }
                        server.async_send_response(id, RawMessage::of(&response)).await.map_err(|e| format!("{e:?}"))
                    }
                };
                if let Err(problem) = sent {
                    tracing::warn!("DDS: the answer of {name} is lost: {problem}");
                }
            }
        })
    }
}

struct DdsSink {
    publisher: Publisher<RawMessage>,
    node: Arc<Mutex<Node>>,
    name: String,
}

impl Sink for DdsSink {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.publisher
            .publish(RawMessage::of(message))
            .map_err(|e| MiddlewareError::new(format!("a message of {} is lost", self.name), format!("{e:?}")))
    }

    fn subscribers(&self) -> usize {
        self.publisher.get_subscription_count(&lock(&self.node))
    }
}

fn lock(node: &Mutex<Node>) -> MutexGuard<'_, Node> {
    node.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Namespace and last part of an absolute name.
fn split(name: &str) -> Option<Name> {
    let (namespace, base) = name.rsplit_once('/')?;
    Name::new(if namespace.is_empty() { "/" } else { namespace }, base).ok()
}

fn names(topic: &TopicProfile) -> Option<(Name, MessageTypeName)> {
    let (package, kind) = interfaces::parts(&topic.kind)?;
    Some((split(&topic.name)?, MessageTypeName::new(package, kind)))
}

fn profile(topic: &TopicProfile) -> QosProfile {
    let reliable = Reliability::Reliable { when_full: WhenFull::Fail };
    let (reliability, durability) = match topic.delivery {
        Delivery::SensorData => (Reliability::BestEffort, Durability::Volatile),
        Delivery::Reliable | Delivery::Periodic => (reliable, Durability::Volatile),
        Delivery::Latched => (reliable, Durability::TransientLocal),
    };
    QosProfile { reliability, durability, history: History::KeepLast { depth: topic.depth }, ..QosProfile::subscription_default() }
}

/// The parameters of the node: they can be read, and none be changed once it has started.
fn node_options(options: &NodeOptions, is_started: Arc<AtomicBool>) -> ros2_client::NodeOptions {
    let allowed = move |_: &str, _: &ParameterValue| if is_started.load(Ordering::Relaxed) { Err(FIXED.to_owned()) } else { Ok(()) };
    let usual = ros2_client::NodeOptions::new().enable_rosout(false).parameter_validator(Box::new(allowed));
    options.parameters.iter().fold(usual, |all, (name, value)| all.declare_parameter(name, parameter(value)))
}

fn parameter(value: &Parameter) -> ParameterValue {
    match value {
        Parameter::Bool(value) => ParameterValue::Boolean(*value),
        Parameter::Integer(value) => ParameterValue::Integer(*value),
        Parameter::Number(value) => ParameterValue::Double(*value),
        Parameter::Text(value) => ParameterValue::String(value.clone()),
    }
}

/// Runs a task on a thread of its own until it ends or the handle is dropped.
fn run(name: &str, task: impl Future<Output = ()> + Send + 'static) -> Result<Handle, MiddlewareError> {
    let failed = |problem: std::io::Error| MiddlewareError::new("cannot start a thread", problem);
    let runtime = tokio::runtime::Builder::new_current_thread().build().map_err(failed)?;
    let (stop, stopped) = oneshot::channel::<()>();
    let thread = move || {
        runtime.block_on(async {
            tokio::select! {
                () = task => {}
                _ = stopped => {}
            }
        });
    };
    std::thread::Builder::new().name(name.to_owned()).spawn(thread).map_err(failed)?;
    Ok(Handle::new(stop))
}
