//! Where messages go: each topic to all networks.

use super::grid::GridNews;
use super::topics::{MAP_FRAME, Output};
use crate::link::Link;
use crate::ros::messages::{self, Header};
use crate::ros::middleware::Sink;
use std::cell::OnceCell;
use std::collections::HashMap;
use std::sync::Arc;

/// The topics of all networks. Each topic has those of the networks in the same order.
#[derive(Default)]
pub struct Sinks {
    /// What messages travel over; none where nothing limits that.
    link: Option<Arc<Link>>,
    of_topics: HashMap<Output, Vec<Box<dyn Sink>>>,
    /// Time stamp of what is published, seconds.
    pub stamp: f64,
    /// Messages that could not be handed over.
    pub lost: usize,
}

impl Sinks {
    /// None yet, over a link if there is one.
    pub fn over(link: Option<Arc<Link>>) -> Self {
        Self { link, ..Self::default() }
    }

    /// Adds a topic of one more network.
    pub fn add(&mut self, output: Output, sink: Box<dyn Sink>) {
        self.of_topics.entry(output).or_default().push(sink);
    }

    /// The header of a message.
    pub fn header(&self) -> Header<'static> {
        Header { stamp: self.stamp, frame: MAP_FRAME }
    }

    /// How many listen to a topic.
    pub fn subscribers(&self, output: Output) -> usize {
        self.of_topics.get(&output).into_iter().flatten().map(|sink| sink.subscribers()).sum()
    }

    /// Whether another message of each would be sent soon.
    pub fn has_room(&self, outputs: &[Output]) -> bool {
        let is_free = |output: &Output| self.link.as_ref().is_none_or(|link| link.may_send(output.urgency()));
        outputs.iter().all(is_free) && outputs.iter().filter_map(|output| self.of_topics.get(output)).flatten().all(|sink| sink.has_room())
    }

    /// Publishes a message, which is made only if the topic is there.
    pub fn publish(&mut self, output: Output, message: impl FnOnce(Header<'_>) -> Vec<u8>) {
        self.publish_if(output, |header| Some(message(header)));
    }

    /// Publishes a message if there is one.
    pub fn publish_if(&mut self, output: Output, message: impl FnOnce(Header<'_>) -> Option<Vec<u8>>) {
        let header = self.header();
        let Some(sinks) = self.of_topics.get_mut(&output) else { return };
        let Some(message) = message(header) else { return };
        sinks.iter_mut().for_each(|sink| send(sink.as_mut(), &message, (self.link.as_deref(), &mut self.lost)));
    }

    /// Publishes a grid on its topic and on that of its updates: what has changed where all who listen to the grid also listen to its updates, and else all of it.
    pub fn publish_grid(&mut self, [grid, updates]: [Output; 2], news: &GridNews<'_>) {
        let header = self.header();
        let (whole, parts, link) = (OnceCell::new(), OnceCell::new(), self.link.as_deref());
        let [of_grid, of_updates] = self.of_topics.get_disjoint_mut([&grid, &updates]);
        let (Some(of_grid), Some(of_updates)) = (of_grid, of_updates) else { return };
        for (grid, updates) in of_grid.iter_mut().zip(of_updates) {
            match &news.parts {
                Some(changed) if updates.subscribers() >= grid.subscribers() => {
                    let make = || changed.iter().map(|part| messages::occupancy_grid_update(header, &part.as_message())).collect::<Vec<_>>();
                    parts.get_or_init(make).iter().for_each(|part| send(updates.as_mut(), part, (link, &mut self.lost)));
                }
                _ => send(grid.as_mut(), whole.get_or_init(|| messages::occupancy_grid(header, &news.whole.as_message())), (link, &mut self.lost)),
            }
        }
    }
}

fn send(sink: &mut dyn Sink, message: &[u8], (link, lost): (Option<&Link>, &mut usize)) {
    if let Some(link) = link.filter(|_| sink.is_remote()) {
        link.send(message.len(), sink.subscribers());
    }
    if let Err(problem) = sink.publish(message) {
        *lost += 1;
        tracing::debug!("{problem}");
    }
}
