//! UDP payloads out of a network capture: pcap in either byte order, over Ethernet, Linux cooked or bare IP, fragments put together.
//!
//! Layout: the libpcap file format (draft-ietf-opsawg-pcap), IPv4 (RFC 791), UDP (RFC 768).

use crate::{Error, Position, Result};
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};

/// A record claims no more than this; jumbo frames are smaller.
const LARGEST_RECORD: u32 = 1 << 18;
/// Datagrams that wait for fragments; older ones were lost.
const MOST_WAITING: usize = 64;
const UDP: u8 = 17;
const IPV4: u16 = 0x0800;

/// What a capture begins with: magic numbers of micro- and nanosecond captures, and whether they are big-endian.
pub(crate) const MAGICS: [[u8; 4]; 4] = [[0xd4, 0xc3, 0xb2, 0xa1], [0x4d, 0x3c, 0xb2, 0xa1], [0xa1, 0xb2, 0xc3, 0xd4], [0xa1, 0xb2, 0x3c, 0x4d]];
/// What a capture in the newer pcapng format begins with.
pub(crate) const PCAPNG: [u8; 4] = [0x0a, 0x0d, 0x0d, 0x0a];

/// Kinds of frames.
#[derive(Clone, Copy, Debug)]
enum Link {
    Ethernet,
    LinuxCooked,
    Ip,
}

/// A UDP datagram.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Datagram {
    pub(crate) port: u16,
    pub(crate) payload: Vec<u8>,
    /// Offset in the file of the record that completed it.
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
    path: PathBuf,
    file: BufReader<File>,
    len: u64,
    next: u64,
    big_endian: bool,
    link: Link,
    waiting: HashMap<(u32, u32, u16), Parts>,
    order: Vec<(u32, u32, u16)>,
}

impl Pcap {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let fail = |e| Error::io(path, "read", e);
        let file = File::open(path).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        let mut file = BufReader::with_capacity(1 << 18, file);
        let mut head = [0; 24];
        let damaged = |problem: String| Error::content(path, Position::Byte(0), problem, "capture it again, or convert it: editcap -F pcap IN OUT");
        file.read_exact(&mut head).map_err(|_| damaged(format!("the file ends after {len} bytes, within its head")))?;
        if head[..4] == PCAPNG {
            return Err(damaged("a capture in the pcapng format, not pcap".into()));
        }
        let Some(kind) = MAGICS.iter().position(|m| *m == head[..4]) else { return Err(damaged("not a pcap capture by its first bytes".into())) };
        let big_endian = kind >= 2;
        let link = match number(&head, 20, big_endian) & 0x0fff_ffff {
            1 => Link::Ethernet,
            113 => Link::LinuxCooked,
            12 | 101 | 228 => Link::Ip,
            other => return Err(damaged(format!("frames of link type {other}, which is none of Ethernet, Linux cooked and IP"))),
        };
        Ok(Self { path: path.into(), file, len, next: 24, big_endian, link, waiting: HashMap::new(), order: Vec::new() })
    }

    /// The next UDP datagram; an error once if the capture is cut or damaged.
    pub(crate) fn next(&mut self) -> Option<Result<Datagram>> {
        while self.next < self.len {
            let at = self.next;
            match self.record() {
                Ok(frame) => {
                    if let Some((port, payload)) = self.datagram(&frame) {
                        return Some(Ok(Datagram { port, payload, at }));
                    }
                }
                Err(problem) => {
                    self.next = self.len;
                    let remedy = "the capture is cut or damaged here: what comes before is used";
                    return Some(Err(Error::content(&self.path, Position::Byte(at), problem, remedy)));
                }
            }
        }
        None
    }

    fn record(&mut self) -> std::result::Result<Vec<u8>, String> {
        let mut head = [0; 16];
        self.file.read_exact(&mut head).map_err(|_| "the file ends within the head of a record".to_owned())?;
        let size = number(&head, 8, self.big_endian);
        if size > LARGEST_RECORD {
            return Err(format!("a record of {size} bytes"));
        }
        let mut frame = vec![0; size as usize];
        self.file.read_exact(&mut frame).map_err(|_| format!("a record of {size} bytes, but the file ends within it"))?;
        self.next += 16 + u64::from(size);
        Ok(frame)
    }

    /// Port and payload of a frame that completes a UDP datagram.
    fn datagram(&mut self, frame: &[u8]) -> Option<(u16, Vec<u8>)> {
        let big = |bytes: &[u8], at: usize| Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]));
        let packet = match self.link {
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
        if offset == 0 && !more {
            return udp(body);
        }
        let address = |at: usize| Some(u32::from_be_bytes(*packet.get(at..)?.first_chunk::<4>()?));
        let whole = self.collect((address(12)?, address(16)?, big(packet, 4)?), offset, more, body)?;
        udp(&whole)
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

fn number(bytes: &[u8], at: usize, big_endian: bool) -> u32 {
    let b = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
    if big_endian { u32::from_be_bytes(b) } else { u32::from_le_bytes(b) }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
