//! Files that are sequences of records: what ROS 1 bags and MCAP have in common.

use super::chunk_reader::ChunkReader;
use super::container::{Container, Index, Message, Topic};
use crate::Result;
use std::collections::HashMap;

/// The topics of a file by the numbers that its records use. Several numbers may stand for one topic.
#[derive(Debug, Default)]
pub(crate) struct TopicTable {
    list: Vec<Topic>,
    by_number: HashMap<u32, usize>,
}

impl TopicTable {
    /// Index in [`list`](Self::list) of the topic with `number`.
    pub(crate) fn get(&self, number: u32) -> Option<usize> {
        self.by_number.get(&number).copied()
    }

    pub(crate) fn list(&self) -> &[Topic] {
        &self.list
    }

    /// Notes the topic of `number`. The first one counts.
    pub(crate) fn add(&mut self, number: u32, topic: Topic) {
        if self.by_number.contains_key(&number) {
            return;
        }
        let index = self.list.iter().position(|known| *known == topic).unwrap_or_else(|| {
            self.list.push(topic);
            self.list.len() - 1
        });
        self.by_number.insert(number, index);
    }
}

/// A file of records.
pub(crate) trait RecordFile: Send {
    fn reader(&mut self) -> &mut ChunkReader;

    fn topics(&self) -> &TopicTable;

    fn index(&self) -> Option<&Index>;

    /// Whether no message can follow, although there are bytes left.
    fn has_ended(&self) -> bool {
        false
    }

    /// Reads the next record; a message if it is one that is wanted.
    fn record(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Result<Option<Message>>;
}

impl<R: RecordFile> Container for R {
    fn topics(&self) -> &[Topic] {
        RecordFile::topics(self).list()
    }

    fn index(&self) -> Option<Index> {
        RecordFile::index(self).cloned()
    }

    fn next(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Option<Result<Message>> {
        while !self.has_ended() && !self.reader().at_end() {
            match self.record(wanted) {
                Ok(None) => {}
                Ok(Some(message)) => return Some(Ok(message)),
                Err(error) => {
                    self.reader().recover();
                    return Some(Err(error));
                }
            }
        }
        None
    }
}
