//! UDP datagrams out of the frames of a capture: over Ethernet, Linux cooked or bare IP, fragments put together.
//!
//! Layout: IPv4 (RFC 791), UDP (RFC 768).

use super::frames::{Frame, Frames, Link};
use crate::Result;
use std::collections::HashMap;
use std::path::Path;

/// Datagrams that wait for fragments; older ones were lost.
const MOST_WAITING: usize = 64;
const UDP: u8 = 17;
const IPV4: u16 = 0x0800;

/// A UDP datagram.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Datagram {
    /// IPv4 address of the sender, as a number.
    pub(crate) source: u32,
    /// Port that it was sent to.
    pub(crate) port: u16,
    pub(crate) payload: Vec<u8>,
    /// When the frame that completed it was captured, seconds.
    pub(crate) time: f64,
    /// Offset in the file of the record of that frame.
    pub(crate) at: u64,
}

/// Parts of a datagram: offset and bytes of each, and its whole length once the last part has come.
#[derive(Debug, Default)]
struct Parts {
    parts: Vec<(usize, Vec<u8>)>,
    total: Option<usize>,
}

/// A capture that is read front to back.
#[derive(Debug)]
pub(crate) struct Pcap {
    frames: Frames,
    waiting: HashMap<(u32, u32, u16), Parts>,
    order: Vec<(u32, u32, u16)>,
}

impl Pcap {
    /// Opens a capture.
    ///
    /// # Errors
    /// [`Error::Content`](crate::Error::Content) if it is none, or of frames that cannot hold datagrams; [`Error::Io`](crate::Error::Io).
    pub(crate) fn open(path: &Path) -> Result<Self> {
        Ok(Self { frames: Frames::open(path)?, waiting: HashMap::new(), order: Vec::new() })
    }

    /// The next UDP datagram; an error once if the capture is cut or damaged.
    pub(crate) fn next(&mut self) -> Option<Result<Datagram>> {
        loop {
            match self.frames.next()? {
                Ok(frame) => {
                    if let Some((source, port, payload)) = self.datagram(&frame) {
                        return Some(Ok(Datagram { source, port, payload, time: frame.time, at: frame.at }));
                    }
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }

    /// Sender, port and payload of a frame that completes a UDP datagram.
    fn datagram(&mut self, frame: &Frame) -> Option<(u32, u16, Vec<u8>)> {
        let big = |bytes: &[u8], at: usize| Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
        let (link, frame) = (frame.link, frame.bytes.as_slice());
        let packet = match link {
            Link::Other => return None,
            Link::Ip => frame,
            Link::LinuxCooked => (big(frame, 14)? == IPV4).then(|| frame.get(16..))??,
            Link::Ethernet => {
                // A VLAN tag takes four bytes.
                let at = if big(frame, 12)? == 0x8100 { 16 } else { 12 };
                (big(frame, at)? == IPV4).then(|| frame.get(at + 2..))??
            }
        };
        let (first, total) = (*packet.first()?, usize::from(big(packet, 2)?));
        let head = usize::from(first & 15) * 4;
        if first >> 4 != 4 || head < 20 || *packet.get(9)? != UDP || total < head {
            return None;
        }
        let body = packet.get(head..total.min(packet.len()))?;
        let fragment = big(packet, 6)?;
        let (offset, more) = (usize::from(fragment & 0x1fff) * 8, fragment & 0x2000 != 0);
        let address = |at: usize| Some(u32::from_be_bytes(*packet.get(at..)?.first_chunk::<4>()?));
        if offset == 0 && !more {
            let (port, payload) = udp(body)?;
            return Some((address(12)?, port, payload));
        }
        let whole = self.collect((address(12)?, address(16)?, big(packet, 4)?), offset, more, body)?;
        let (port, payload) = udp(&whole)?;
        Some((address(12)?, port, payload))
    }

    /// Adds a fragment; the datagram if it is complete.
    fn collect(&mut self, key: (u32, u32, u16), offset: usize, more: bool, body: &[u8]) -> Option<Vec<u8>> {
        if !self.waiting.contains_key(&key) {
            if self.order.len() >= MOST_WAITING {
                let oldest = self.order.remove(0);
                self.waiting.remove(&oldest);
            }
            self.order.push(key);
        }
        let parts = self.waiting.entry(key).or_default();
        parts.parts.push((offset, body.to_vec()));
        if !more {
            parts.total = Some(offset + body.len());
        }
        let held: usize = parts.parts.iter().map(|(_, b)| b.len()).sum();
        let total = parts.total.filter(|t| held >= *t)?;
        let mut whole = vec![0; total];
        for (at, bytes) in &parts.parts {
            let end = (at + bytes.len()).min(total);
            whole.get_mut(*at..end)?.copy_from_slice(&bytes[..end - at]);
        }
        self.waiting.remove(&key);
        self.order.retain(|k| *k != key);
        Some(whole)
    }
}

fn udp(body: &[u8]) -> Option<(u16, Vec<u8>)> {
    let head = body.first_chunk::<8>()?;
    let port = u16::from_be_bytes([head[2], head[3]]);
    let size = usize::from(u16::from_be_bytes([head[4], head[5]]));
    Some((port, body.get(8..size.clamp(8, body.len()))?.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::frames::PCAPNG;

    /// An Ethernet frame with a fragment of a UDP datagram.
    fn frame(id: u16, offset: usize, more: bool, body: &[u8]) -> Vec<u8> {
        let mut f = vec![0; 12];
        f.extend([0x08, 0x00, 0x45, 0]);
        f.extend((20 + body.len() as u16).to_be_bytes());
        f.extend(id.to_be_bytes());
        f.extend(((offset as u16 / 8) | if more { 0x2000 } else { 0 }).to_be_bytes());
        f.extend([64, UDP, 0, 0, 10, 0, 0, 1, 10, 0, 0, 2]);
        f.extend(body);
        f
    }

    fn capture(frames: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = [0xa1b2_c3d4u32.to_le_bytes(), [2, 0, 4, 0], [0; 4], [0; 4], [0, 0, 1, 0], 1u32.to_le_bytes()].concat();
        for f in frames {
            bytes.extend([[0; 4], [0; 4], (f.len() as u32).to_le_bytes(), (f.len() as u32).to_le_bytes()].concat());
            bytes.extend(f);
        }
        bytes
    }

    fn read(bytes: &[u8]) -> (Vec<Datagram>, usize) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.pcap");
        std::fs::write(&path, bytes).unwrap();
        let mut pcap = Pcap::open(&path).unwrap();
        let all: Vec<Result<Datagram>> = std::iter::from_fn(|| pcap.next()).collect();
        let errors = all.iter().filter(|d| d.is_err()).count();
        (all.into_iter().flatten().collect(), errors)
    }

    #[test]
    fn fragments_make_a_datagram_in_any_order() {
        let mut udp = vec![0, 9, 0x1d, 0x4e, 0, 0, 0, 0];
        udp.extend((0..100u8).collect::<Vec<_>>());
        udp[4..6].copy_from_slice(&108u16.to_be_bytes());
        let frames = [frame(7, 48, false, &udp[48..]), frame(8, 0, false, &udp), frame(7, 0, true, &udp[..48])];
        let bytes = capture(&frames);
        let (datagrams, errors) = read(&bytes);
        assert_eq!((datagrams.len(), errors), (2, 0));
        for d in datagrams {
            assert_eq!((d.port, &d.payload[..]), (7502, &udp[8..]));
        }
        // Cut within the last record, after which nothing can be put together.
        let (datagrams, errors) = read(&bytes[..bytes.len() - 3]);
        assert_eq!((datagrams.len(), errors), (1, 1));
    }

    /// The frames as a pcapng file in either byte order, after blocks that are not known, on an interface with times in nanoseconds.
    fn next_generation(frames: &[Vec<u8>], big: bool) -> Vec<u8> {
        let word = |n: u32| if big { n.to_be_bytes() } else { n.to_le_bytes() };
        let short = |n: u16| if big { n.to_be_bytes() } else { n.to_le_bytes() };
        let block = |kind: u32, body: &[u8]| {
            let padded = body.len().next_multiple_of(4);
            let mut bytes = [word(kind), word(padded as u32 + 12)].concat();
            bytes.extend(body);
            bytes.resize(8 + padded, 0);
            bytes.extend(word(padded as u32 + 12));
            bytes
        };
        let mut bytes = PCAPNG.to_vec();
        bytes.extend([word(28), word(0x1a2b_3c4d), [0, 1, 0, 0], [0xff; 4], [0xff; 4], word(28)].concat());
        bytes.extend(block(1, &[&short(1)[..], &short(0), &word(0), &short(9), &short(1), &[9, 0, 0, 0], &word(0)].concat()));
        bytes.extend(block(0xbad, b"nothing"));
        for frame in frames {
            let ticks = 1_600_000_000_500_000_000u64;
            let head = [word(0), word((ticks >> 32) as u32), word(ticks as u32), word(frame.len() as u32), word(frame.len() as u32)].concat();
            bytes.extend(block(6, &[&head, &frame[..]].concat()));
        }
        bytes
    }

    #[test]
    fn pcapng_holds_the_same() {
        let mut udp = vec![0, 9, 0x09, 0x40, 0, 0, 0, 0];
        udp.extend((0..101u8).collect::<Vec<_>>());
        udp[4..6].copy_from_slice(&109u16.to_be_bytes());
        let frames = [frame(7, 48, false, &udp[48..]), frame(7, 0, true, &udp[..48]), frame(9, 0, false, &udp)];
        let (classic, _) = read(&capture(&frames));
        for big in [false, true] {
            let bytes = next_generation(&frames, big);
            let (next, errors) = read(&bytes);
            assert_eq!((next.len(), errors), (2, 0));
            for (a, b) in next.iter().zip(&classic) {
                assert_eq!((a.source, a.port, &a.payload), (b.source, b.port, &b.payload));
                assert!(a.source == 0x0a00_0001 && a.port == 2368 && (a.time - 1_600_000_000.5).abs() < 1e-6, "{}", a.time);
            }
            // Cut at any place: an error at most, and never more than is there.
            for end in 0..bytes.len() {
                let dir = tempfile::tempdir().unwrap();
                let path = dir.path().join("a.pcap");
                std::fs::write(&path, &bytes[..end]).unwrap();
                if let Ok(mut pcap) = Pcap::open(&path) {
                    assert!(std::iter::from_fn(|| pcap.next()).filter(std::result::Result::is_ok).count() < 2);
                }
            }
        }
    }
}
