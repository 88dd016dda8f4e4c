//! Which of those who send packets to a port is the sensor.

use std::collections::BTreeMap;
use std::net::IpAddr;

/// A source is a sensor when so many packets of one kind have come from it, one after the other ...
const CONSISTENT: usize = 8;
/// ... and is given up for another when it has sent nothing for this long, seconds.
const SILENCE: f64 = 5.0;
/// Sources that are looked at, or spoken of, at a time.
const CANDIDATES: usize = 16;

/// A datagram of a sensor.
#[derive(Clone, Debug)]
pub struct SensorPacket {
    /// Its content.
    pub payload: Vec<u8>,
    /// Who sent it.
    pub source: IpAddr,
    /// When it came, seconds since 1970.
    pub time: f64,
}

/// What becomes of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fate {
    /// It is the sensor's.
    Sensor,
    /// The sensor is another one, at this address; whether that should be said.
    Another(IpAddr, bool),
    /// There is no sensor, or it is silent: this source may be one.
    Candidate,
}

/// A source that may be a sensor, with `N` that its stream knows of it.
#[derive(Debug)]
pub(crate) struct Candidate<K, N> {
    pub(crate) note: N,
    kind: Option<K>,
    /// The last packets, all of one kind.
    packets: Vec<SensorPacket>,
}

/// The first source with some packets of a kind `K`, one after the other, is the sensor; others are ignored until it is silent.
#[derive(Debug)]
pub(crate) struct SourceChoice<K, N = ()> {
    chosen: Option<Chosen<K>>,
    candidates: BTreeMap<IpAddr, Candidate<K, N>>,
    /// Others than the sensor, of which it was said that they are ignored.
    ignored: Vec<(IpAddr, K)>,
}

#[derive(Debug)]
struct Chosen<K> {
    source: IpAddr,
    kind: K,
    /// When its last packet of that kind came, seconds.
    last: f64,
}

impl<K, N> Default for SourceChoice<K, N> {
    fn default() -> Self {
        Self { chosen: None, candidates: BTreeMap::new(), ignored: Vec::new() }
    }
}

impl<K: Copy + PartialEq, N: Default> SourceChoice<K, N> {
    /// What becomes of a packet of this kind, if it is of one.
    pub(crate) fn fate(&mut self, packet: &SensorPacket, kind: Option<K>) -> Fate {
        let Some(chosen) = &mut self.chosen else { return Fate::Candidate };
        if chosen.source == packet.source && kind.is_none_or(|kind| kind == chosen.kind) {
            if kind.is_some() {
                chosen.last = packet.time;
                self.candidates.clear();
            }
            return Fate::Sensor;
        }
        if (packet.time - chosen.last).abs() >= SILENCE {
            return Fate::Candidate;
        }
        let other = kind.map(|kind| (packet.source, kind)).filter(|other| self.ignored.len() < CANDIDATES && !self.ignored.contains(other));
        self.ignored.extend(other);
        Fate::Another(chosen.source, other.is_some())
    }

    /// A source as one that may be a sensor.
    pub(crate) fn candidate(&mut self, source: IpAddr) -> &mut Candidate<K, N> {
        if self.candidates.len() >= CANDIDATES && !self.candidates.contains_key(&source) {
            let least = self.candidates.iter().min_by_key(|(_, candidate)| candidate.packets.len()).map(|(source, _)| *source);
            least.map(|least| self.candidates.remove(&least));
        }
        self.candidates.entry(source).or_insert_with(|| Candidate { note: N::default(), kind: None, packets: Vec::new() })
    }

    /// Makes a source the sensor, whose last packet came at `last`; which one was it before.
    pub(crate) fn choose(&mut self, source: IpAddr, kind: K, last: f64) -> Option<IpAddr> {
        self.candidates.clear();
        self.ignored.clear();
        self.chosen.replace(Chosen { source, kind, last }).map(|old| old.source)
    }

    /// How many others it was said of that they are ignored.
    #[cfg(test)]
    pub(crate) fn ignored(&self) -> usize {
        self.ignored.len()
    }
}

impl<K: Copy + PartialEq, N> Candidate<K, N> {
    /// Adds a packet; all of them once they are enough.
    pub(crate) fn add(&mut self, packet: SensorPacket, kind: K) -> Option<Vec<SensorPacket>> {
        if self.kind.replace(kind) != Some(kind) {
            self.packets.clear();
        }
        self.packets.push(packet);
        (self.packets.len() >= CONSISTENT).then(|| std::mem::take(&mut self.packets))
    }
}
