//! The frames in a capture: pcap in either byte order and precision, and pcapng.
//!
//! Layouts: draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng.

use crate::{Error, Position, Result};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A record claims no more than this; jumbo frames are smaller.
const LARGEST_RECORD: u32 = 1 << 18;
/// Interfaces that a file may describe.
const MOST_INTERFACES: usize = 4096;

/// What a capture begins with: magic numbers of micro- and nanosecond captures, and whether they are big-endian.
pub(crate) const MAGICS: [[u8; 4]; 4] = [[0xd4, 0xc3, 0xb2, 0xa1], [0x4d, 0x3c, 0xb2, 0xa1], [0xa1, 0xb2, 0xc3, 0xd4], [0xa1, 0xb2, 0x3c, 0x4d]];
/// What a capture in the newer pcapng format begins with; also the type of the block at the beginning of each of its sections.
pub(crate) const PCAPNG: [u8; 4] = [0x0a, 0x0d, 0x0d, 0x0a];
const BYTE_ORDER: u32 = 0x1a2b_3c4d;

const INTERFACE: u32 = 1;
const OLD_PACKET: u32 = 2;
const SIMPLE_PACKET: u32 = 3;
const PACKET: u32 = 6;
/// Option of an interface: the unit of its times.
const RESOLUTION: u16 = 9;

/// Kinds of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Link {
    Ethernet,
    LinuxCooked,
    Ip,
    /// Frames that are not looked into.
    Other,
}

impl Link {
    fn of(number: u32) -> Self {
        match number {
            1 => Self::Ethernet,
            113 => Self::LinuxCooked,
            12 | 101 | 228 => Self::Ip,
            _ => Self::Other,
        }
    }
}

/// A frame as it was captured.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) link: Link,
    /// When it was captured, seconds.
    pub(super) time: f64,
    pub(super) bytes: Vec<u8>,
    /// Offset of its record in the file.
    pub(super) at: u64,
}

/// An interface of a pcapng file.
#[derive(Clone, Copy, Debug)]
struct Interface {
    link: Link,
    /// Seconds in a unit of its times.
    unit: f64,
}

#[derive(Debug)]
enum Format {
    Classic(Interface),
    Next(Vec<Interface>),
}

/// The frames of a file, front to back.
#[derive(Debug)]
pub(super) struct Frames {
    path: PathBuf,
    file: BufReader<File>,
    len: u64,
    next: u64,
    big_endian: bool,
    format: Format,
}

impl Frames {
    /// Opens a capture.
    ///
    /// # Errors
    /// [`Error::Content`] if it is none, or of frames that cannot hold datagrams; [`Error::Io`].
    pub(super) fn open(path: &Path) -> Result<Self> {
        let fail = |e| Error::io(path, "read", e);
        voxelastic_files::note_read(path);
        let file = voxelastic_files::patiently(|| File::open(path)).map_err(fail)?;
        let len = file.metadata().map_err(fail)?.len();
        let mut file = BufReader::with_capacity(1 << 18, file);
        let damaged = |problem: String| Error::content(path, Position::Byte(0), problem, "capture it again, or convert it: editcap -F pcap IN OUT");
        let ends = |_| damaged(format!("the file ends after {len} bytes, within its head"));
        let mut head = [0; 24];
        file.read_exact(&mut head[..4]).map_err(ends)?;
        if head[..4] == PCAPNG {
            file.seek(SeekFrom::Start(0)).map_err(fail)?;
            return Ok(Self { path: path.into(), file, len, next: 0, big_endian: false, format: Format::Next(Vec::new()) });
        }
        file.read_exact(&mut head[4..]).map_err(ends)?;
        let Some(kind) = MAGICS.iter().position(|m| *m == head[..4]) else { return Err(damaged("not a capture by its first bytes".into())) };
        let big_endian = kind >= 2;
        let number = number(&head, 20, big_endian).unwrap_or(0) & 0x0fff_ffff;
        let interface = Interface { link: Link::of(number), unit: if kind % 2 == 1 { 1e-9 } else { 1e-6 } };
        if interface.link == Link::Other {
            return Err(damaged(format!("frames of link type {number}, which is none of Ethernet, Linux cooked and IP")));
        }
        Ok(Self { path: path.into(), file, len, next: 24, big_endian, format: Format::Classic(interface) })
    }

    /// The next frame; an error once if the capture is cut or damaged.
    pub(super) fn next(&mut self) -> Option<Result<Frame>> {
        while self.next < self.len {
            let at = self.next;
            match self.record(at) {
                Ok(Some(frame)) => return Some(Ok(frame)),
                Ok(None) => {}
                Err(problem) => {
                    self.next = self.len;
                    let remedy = "the capture is cut or damaged here: what comes before is used";
                    return Some(Err(Error::content(&self.path, Position::Byte(at), problem, remedy)));
                }
            }
        }
        None
    }

    /// The frame of a record; none if it is of another kind.
    fn record(&mut self, at: u64) -> std::result::Result<Option<Frame>, String> {
        if let Format::Classic(interface) = self.format {
            let head: [u8; 16] = self.read_array("the head of a record")?;
            let word = |at| number(&head, at, self.big_endian).unwrap_or(0);
            let (time, size) = (f64::from(word(0)) + f64::from(word(4)) * interface.unit, word(8));
            if size > LARGEST_RECORD {
                return Err(format!("a record of {size} bytes"));
            }
            let bytes = self.read_bytes(size as usize)?;
            self.next += 16 + u64::from(size);
            return Ok(Some(Frame { link: interface.link, time, bytes, at }));
        }
        let head: [u8; 8] = self.read_array("the head of a block")?;
        if head[..4] == PCAPNG {
            // A section says in which order its bytes are, and its interfaces are its own.
            let order: [u8; 4] = self.read_array("the head of a section")?;
            self.big_endian = match (u32::from_le_bytes(order), u32::from_be_bytes(order)) {
                (BYTE_ORDER, _) => false,
                (_, BYTE_ORDER) => true,
                _ => return Err("a section without a byte order".into()),
            };
            self.format = Format::Next(Vec::new());
            let size = self.block_size(&head)?;
            self.read_bytes(size.checked_sub(12).ok_or("a section shorter than its head")?)?;
            self.next += size as u64;
            return Ok(None);
        }
        let size = self.block_size(&head)?;
        let body = self.read_bytes(size - 8)?;
        self.next += size as u64;
        let kind = number(&head, 0, self.big_endian).unwrap_or(0);
        Ok(self.block(kind, &body).map(|(interface, time, bytes)| Frame { link: interface.link, time, bytes, at }))
    }

    fn block_size(&self, head: &[u8]) -> std::result::Result<usize, String> {
        let size = number(head, 4, self.big_endian).unwrap_or(0);
        if !(12..=LARGEST_RECORD).contains(&size) || !size.is_multiple_of(4) { Err(format!("a block of {size} bytes")) } else { Ok(size as usize) }
    }

    /// What a block of a pcapng file holds: the interface, the time and the bytes of a frame.
    fn block(&mut self, kind: u32, body: &[u8]) -> Option<(Interface, f64, Vec<u8>)> {
        let big_endian = self.big_endian;
        let word = |at| number(body, at, big_endian);
        let short = |at: usize| {
            let bytes = body.get(at..at + 2)?.first_chunk()?;
            Some(if big_endian { u16::from_be_bytes(*bytes) } else { u16::from_le_bytes(*bytes) })
        };
        let Format::Next(interfaces) = &mut self.format else { return None };
        let (interface, time_at, size_at, data_at) = match kind {
            INTERFACE => {
                if interfaces.len() < MOST_INTERFACES {
                    interfaces.push(Interface { link: Link::of(short(0)?.into()), unit: time_unit(body, short) });
                }
                return None;
            }
            PACKET => (word(0)? as usize, 4, 12, 20),
            OLD_PACKET => (usize::from(short(0)?), 4, 12, 20),
            SIMPLE_PACKET => {
                let bytes = body.get(4..body.len() - 4)?;
                let interface = *interfaces.first()?;
                return Some((interface, 0.0, bytes[..bytes.len().min(word(0)? as usize)].to_vec()));
            }
            _ => return None,
        };
        let interface = *interfaces.get(interface)?;
        let ticks = u64::from(word(time_at)?) << 32 | u64::from(word(time_at + 4)?);
        let size = word(size_at)? as usize;
        Some((interface, ticks as f64 * interface.unit, body.get(data_at..)?.get(..size)?.to_vec()))
    }

    fn read_array<const N: usize>(&mut self, what: &str) -> std::result::Result<[u8; N], String> {
        let mut bytes = [0; N];
        self.file.read_exact(&mut bytes).map_err(|_| format!("the file ends within {what}"))?;
        Ok(bytes)
    }

    fn read_bytes(&mut self, size: usize) -> std::result::Result<Vec<u8>, String> {
        let mut bytes = vec![0; size];
        self.file.read_exact(&mut bytes).map_err(|_| format!("a record of {size} bytes, but the file ends within it"))?;
        Ok(bytes)
    }
}

/// Seconds in a unit of the times of an interface, by its options.
fn time_unit(body: &[u8], short: impl Fn(usize) -> Option<u16>) -> f64 {
    let mut at = 8;
    while let (Some(code), Some(size)) = (short(at), short(at + 2)) {
        match (code, body.get(at + 4)) {
            (0, _) => break,
            (RESOLUTION, Some(exponent)) if size == 1 => {
                let power = i32::from(exponent & 0x7f);
                return if exponent & 0x80 == 0 { 10f64.powi(-power) } else { 2f64.powi(-power) };
            }
            _ => at += 4 + usize::from(size).next_multiple_of(4),
        }
    }
    1e-6
}

fn number(bytes: &[u8], at: usize, big_endian: bool) -> Option<u32> {
    let bytes = *bytes.get(at..at.checked_add(4)?)?.first_chunk()?;
    Some(if big_endian { u32::from_be_bytes(bytes) } else { u32::from_le_bytes(bytes) })
}
