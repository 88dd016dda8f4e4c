//! Files that are one record after the other, some of them messages: what ROS 1 bags and MCAP have in common.

use super::container::{Container, Index, Message, Topic};
use super::feed::Feed;
use crate::Result;
use std::collections::HashMap;

/// The topics of a file by the numbers that its records give them; several numbers may be of one topic.
#[derive(Debug, Default)]
pub(super) struct Topics {
    list: Vec<Topic>,
    of: HashMap<u32, usize>,
}

impl Topics {
    /// The place in [`list`](Self::list) of the topic with `number`.
    pub(super) fn get(&self, number: u32) -> Option<usize> {
        self.of.get(&number).copied()
    }

    pub(super) fn list(&self) -> &[Topic] {
        &self.list
    }

    /// Notes what `number` stands for. The first that is heard counts.
    pub(super) fn add(&mut self, number: u32, topic: Topic) {
        if self.of.contains_key(&number) {
            return;
        }
        let place = self.list.iter().position(|known| *known == topic).unwrap_or_else(|| {
            self.list.push(topic);
            self.list.len() - 1
        });
        self.of.insert(number, place);
    }
}

/// A file of records.
pub(super) trait Records: Send {
    fn feed(&mut self) -> &mut Feed;

    fn topics(&self) -> &Topics;

    fn index(&self) -> Option<&Index>;

    /// Whether no message can follow any more, although there are bytes left.
    fn has_ended(&self) -> bool {
        false
    }

    /// Reads the next record; a message if it is one that is wanted.
    fn record(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Result<Option<Message>>;
}

impl<R: Records> Container for R {
    fn topics(&self) -> &[Topic] {
        Records::topics(self).list()
    }

    fn index(&self) -> Option<Index> {
        Records::index(self).cloned()
    }

    fn next(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Option<Result<Message>> {
        while !self.has_ended() && !self.feed().at_end() {
            match self.record(wanted) {
                Ok(None) => {}
                Ok(Some(message)) => return Some(Ok(message)),
                Err(error) => {
                    self.feed().recover();
                    return Some(Err(error));
                }
            }
        }
        None
    }
}
