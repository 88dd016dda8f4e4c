//! Entrances for fuzzing: what the servers answer, without a network.

use crate::ros::services::RequestSender;
use crate::scene::{Scene, Thing};
use crate::viewer::{Control, routes};
use crate::{http, page, wire};
use axum::Router;
use std::sync::Arc;
use std::sync::mpsc::channel;

/// What controls the viewer's node.
const TOKEN: &str = "a-token-for-fuzzing";

/// A server that is asked.
pub struct Server(Router);

impl Server {
    /// The viewer's, of a node that answers nothing, with something to see.
    pub fn viewer() -> Self {
        let scene = Arc::new(Scene::default());
        scene.put([(Thing::Statistics, vec![b' '; wire::HEAD + 10])]);
        Self(routes(scene, page::html("fuzzing"), Control::new(RequestSender::new(channel().0), TOKEN)))
    }

    /// Foxglove's.
    pub fn foxglove() -> Self {
        Self(crate::ros::foxglove::fuzzed())
    }

    /// What is answered to a client that sends this and nothing more.
    pub fn answer(&self, sent: &[u8]) -> Vec<u8> {
        http::answered(self.0.clone(), sent, None)
    }

    /// What is answered to a client that sends a request, these bytes once it has an answer, and nothing more.
    pub fn answer_then(&self, request: &[u8], sent: &[u8]) -> Vec<u8> {
        http::answered(self.0.clone(), request, Some(sent))
    }
}
