//! What a folder or a recording delivers, in order.

use crate::input::Input;
use voxelastic::mapper::IdleTask;
use voxelastic_io::raw::{TimedScan, TimedScans};
use voxelastic_io::source::Events;
use voxelastic_io::{Error, ReadPosition};
use voxelastic_slam::slam::RawScan;

/// Iterator over the inputs of a [`Source`](super::Source).
pub struct Inputs {
    items: Items,
    is_broken: bool,
}

enum Items {
    Registered(Box<Events>),
    Raw(Box<TimedScans>),
}

impl Inputs {
    pub(super) fn registered(events: Events) -> Self {
        Self { items: Items::Registered(Box::new(events)), is_broken: false }
    }

    pub(super) fn raw(scans: TimedScans) -> Self {
        Self { items: Items::Raw(Box::new(scans)), is_broken: false }
    }

    /// Work for threads that would be idle: reading one scan ahead.
    pub fn idle_task(&mut self) -> IdleTask {
        match &mut self.items {
            Items::Registered(events) => IdleTask::new(events.idle_step()),
            Items::Raw(scans) => IdleTask::new(scans.idle_step()),
        }
    }

    /// Where the reading is, for another process that goes on; none between the events of one scan.
    pub fn read_position(&self) -> Option<ReadPosition> {
        match &self.items {
            Items::Registered(events) => events.read_position(),
            Items::Raw(scans) => Some(scans.read_position()),
        }
    }

    /// Whether a decoder panicked, so that the rest of the data could not be read.
    pub fn is_broken(&self) -> bool {
        self.is_broken
    }
}

impl Iterator for Inputs {
    type Item = Input;

    fn next(&mut self) -> Option<Input> {
        let item = match &mut self.items {
            Items::Registered(events) => events.next()?.map(Input::Event),
            Items::Raw(scans) => scans.next()?.map(raw_scan),
        };
        Some(item.unwrap_or_else(|problem| {
            self.is_broken |= matches!(problem, Error::Panicked { .. });
            Input::from(problem)
        }))
    }
}

fn raw_scan(scan: TimedScan) -> Input {
    Input::RawScan(RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: scan.imu }, scan.name)
}
