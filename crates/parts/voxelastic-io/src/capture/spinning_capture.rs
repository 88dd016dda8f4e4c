//! The scans of a sensor that turns, out of a capture.

use super::datagrams::Pcap;
use super::recognise::SpinningSensor;
use super::stream::CapturedScans;
use super::turn_assembler::TurnAssembler;
use crate::Result;
use crate::stamped_cloud::StampedCloud;
use std::path::{Path, PathBuf};

/// A capture that is read front to back.
#[derive(Debug)]
pub(super) struct SpinningCapture {
    path: PathBuf,
    pcap: Pcap,
    sensor: SpinningSensor,
    assembler: TurnAssembler,
    /// Datagrams to the sensor's port that another machine sent.
    of_others: usize,
    ended: bool,
}

impl SpinningCapture {
    pub(super) fn open(path: &Path, sensor: &SpinningSensor) -> Result<Self> {
        let assembler = TurnAssembler::new(sensor.packets()?);
        Ok(Self { path: path.into(), pcap: Pcap::open(path)?, sensor: sensor.clone(), assembler, of_others: 0, ended: false })
    }

    /// Says, at the end, what could not be used.
    fn report(&self) {
        if let Some(said) = self.assembler.counts().words(self.of_others) {
            tracing::warn!("{}: {said}", self.path.display());
        }
    }
}

impl CapturedScans for SpinningCapture {
    fn next_scan(&mut self) -> Option<Result<StampedCloud>> {
        loop {
            if let Some(scan) = self.assembler.take_scan() {
                return Some(Ok(scan));
            }
            match self.pcap.next() {
                Some(Ok(datagram)) if datagram.port != self.sensor.port => {}
                Some(Ok(datagram)) if datagram.source != self.sensor.source => self.of_others += 1,
                Some(Ok(datagram)) => {
                    self.assembler.add(&datagram.payload, datagram.time);
                }
                Some(Err(error)) => return Some(Err(error)),
                None if self.ended => return None,
                None => {
                    self.ended = true;
                    let last = self.assembler.take_unfinished();
                    self.report();
                    return last.map(Ok);
                }
            }
        }
    }

    fn frame(&self) -> &'static str {
        self.sensor.frame()
    }
}
