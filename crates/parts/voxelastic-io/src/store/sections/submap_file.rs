//! A submap file: a head, then one section per field.
//!
//! The head: magic (8 bytes), format version (u32), submap id (u32), number of sections (u32); for each section its tag
//! (4 bytes), CRC-32 (u32), offset in the file (u64) and length (u64); CRC-32 of all this (u32). Sections follow each
//! other without gaps up to the file's end. All numbers little endian. The head keeps this form in all versions.
//!
//! Where the submap lies is the manifest's knowledge: a pose correction rewrites no submap file. The file has a copy of that
//! knowledge, as it was when the file was written, to rebuild a manifest from.

use super::bytes::Bytes;
use super::frames::Section;
use super::origin_section::{self, Origin};
use super::{colour_section, occupancy_section, tsdf_section};
use crate::store::description::piece::{MapDetails, Piece};
use crate::store::{FORMAT_VERSION, files};
use crate::{Error, Result};
use crc32fast::Hasher;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::field::occupancy::OccupancyField;
use voxelastic::field::tsdf::TsdfField;
use xxhash_rust::xxh3::xxh3_64;

/// As in PNG, a byte that is no text and a line end that text tools would change.
const MAGIC: [u8; 8] = *b"\x89VXSUB\r\n";
/// More sections than there will ever be fields.
const MAX_SECTIONS: usize = 64;
/// Bytes of the head before the section table, of one section in it, and of the checksum after it.
const HEAD: usize = 20;
const TABLE_ROW: usize = 24;
const HEAD_CRC: usize = 4;

const fn head_length(sections: usize) -> usize {
    HEAD + sections * TABLE_ROW + HEAD_CRC
}

/// What a submap file holds: the fields of a submap.
#[derive(Debug, Default)]
pub(crate) struct Fields {
    pub tsdf: TsdfField,
    pub occupancy: OccupancyField,
}

/// The sections that this program can store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Tsdf,
    /// Of the TSDF before it.
    Colour,
    Occupancy,
    /// Not a field: where the submap lies and what it was made from.
    Origin,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Tsdf, Self::Colour, Self::Occupancy, Self::Origin];

    fn tag(self) -> [u8; 4] {
        match self {
            Self::Tsdf => *b"tsdf",
            Self::Colour => *b"colr",
            Self::Occupancy => *b"occu",
            Self::Origin => *b"orig",
        }
    }

    /// The section in words.
    fn name(self) -> &'static str {
        match self {
            Self::Tsdf => "tsdf section",
            Self::Colour => "colour section",
            Self::Occupancy => "occupancy section",
            Self::Origin => "origin section",
        }
    }

    /// The damage in a section of this kind whose checksum is wrong.
    fn find_damage(self, section: &Section<'_>) -> Error {
        match self {
            Self::Tsdf => section.find_damage(tsdf_section::HEAD),
            Self::Colour => section.find_damage(colour_section::HEAD),
            Self::Occupancy => section.find_damage(occupancy_section::HEAD),
            Self::Origin => section.damaged(0, "the section does not match its checksum"),
        }
    }

    fn is_in(self, submap: &Submap) -> bool {
        match self {
            Self::Tsdf => !submap.tsdf().is_empty(),
            Self::Colour => !submap.tsdf().colours().is_empty(),
            Self::Occupancy => !submap.occupancy().is_empty(),
            Self::Origin => true,
        }
    }

    fn digest(self, submap: &Submap) -> u64 {
        match self {
            Self::Tsdf => tsdf_section::digest(submap.tsdf()),
            Self::Colour => colour_section::digest(submap.tsdf()),
            Self::Occupancy => occupancy_section::digest(submap.occupancy()),
            Self::Origin => origin_section::digest(submap),
        }
    }

    /// Writes the section and returns its [`digest`](Self::digest).
    fn write(self, piece: &Piece<'_>, details: &MapDetails, out: &mut (impl Write + Send)) -> io::Result<u64> {
        let submap = piece.submap;
        match self {
            Self::Tsdf => tsdf_section::write(submap.tsdf(), out),
            Self::Colour => colour_section::write(submap.tsdf(), out),
            Self::Occupancy => occupancy_section::write(submap.occupancy(), out),
            Self::Origin => origin_section::write(piece, details, out).map(|()| origin_section::digest(submap)),
        }
    }

    fn read(self, section: &Section<'_>, fields: &mut Fields) -> Result<()> {
        match self {
            Self::Tsdf => fields.tsdf = tsdf_section::read(section)?,
            Self::Colour => colour_section::read(section, &mut fields.tsdf)?,
            Self::Occupancy => fields.occupancy = occupancy_section::read(section)?,
            // The manifest knows better.
            Self::Origin => {}
        }
        Ok(())
    }
}

/// The sections that `submap` has anything in.
fn kinds(submap: &Submap) -> impl Iterator<Item = Kind> {
    Kind::ALL.into_iter().filter(|kind| kind.is_in(submap))
}

/// A hash of everything that the file of `submap` would hold, but for its root pose and the details of the map.
pub(crate) fn digest(submap: &Submap) -> u64 {
    digest_of(kinds(submap).map(|kind| (kind, kind.digest(submap))))
}

/// The hash of a file from those of its sections.
fn digest_of(sections: impl Iterator<Item = (Kind, u64)>) -> u64 {
    let mut all = Vec::new();
    for (kind, digest) in sections {
        all.extend(kind.tag());
        all.extend(digest.to_le_bytes());
    }
    xxh3_64(&all)
}

/// Size and checksum of a file that was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Written {
    pub bytes: u64,
    pub crc32: u32,
}

/// One row of the section table, and the running checksum of the section.
struct Row {
    kind: Kind,
    offset: u64,
    length: u64,
    crc: Hasher,
}

/// Passes bytes on and keeps their count and checksum.
struct Tally<W> {
    inner: W,
    row: Row,
}

impl<W: Write> Write for Tally<W> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let count = self.inner.write(buffer)?;
        self.row.crc.update(&buffer[..count]);
        self.row.length += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

/// Writes a submap of a map with `details` to a new file and returns its [`digest`], too. Sections stream; the head is put before them at the end.
pub(crate) fn write(file: &mut (impl Write + Seek + Send), piece: &Piece<'_>, details: &MapDetails) -> io::Result<(Written, u64)> {
    let submap = piece.submap;
    let mut offset = head_length(kinds(submap).count()) as u64;
    file.write_all(&vec![0; offset as usize])?;
    let mut body = BufWriter::with_capacity(1 << 18, &mut *file);
    let (mut rows, mut digests) = (Vec::new(), Vec::new());
    for kind in kinds(submap) {
        let mut tally = Tally { inner: &mut body, row: Row { kind, offset, length: 0, crc: Hasher::new() } };
        digests.push((kind, kind.write(piece, details, &mut tally)?));
        offset += tally.row.length;
        rows.push(tally.row);
    }
    body.flush()?;
    drop(body);
    let head = head(submap.id(), &rows);
    file.seek(SeekFrom::Start(0))?;
    file.write_all(&head)?;
    let mut crc = Hasher::new();
    crc.update(&head);
    rows.iter().for_each(|row| crc.combine(&row.crc));
    Ok((Written { bytes: offset, crc32: crc.finalize() }, digest_of(digests.into_iter())))
}

fn head(id: SubmapId, rows: &[Row]) -> Vec<u8> {
    let mut head = MAGIC.to_vec();
    for number in [FORMAT_VERSION, id, rows.len() as u32] {
        head.extend(number.to_le_bytes());
    }
    for row in rows {
        head.extend(row.kind.tag());
        head.extend(row.crc.clone().finalize().to_le_bytes());
        head.extend(row.offset.to_le_bytes());
        head.extend(row.length.to_le_bytes());
    }
    let crc32 = crc32fast::hash(&head);
    head.extend(crc32.to_le_bytes());
    head
}

/// What the manifest says about a file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expected {
    pub id: SubmapId,
    pub bytes: u64,
    pub crc32: u32,
}

/// Reads the submap file at `path`; for surfaces without the occupancy of a submap that has a TSDF.
pub(crate) fn read(path: &Path, expected: &Expected, is_for_surfaces: bool) -> Result<Fields> {
    let bytes = files::read(path, Some(expected.bytes))?;
    let mut fields = Fields::default();
    let sections = verified(path, &bytes, expected)?;
    for (kind, section) in sections.iter().filter(|(kind, _)| *kind != Kind::Occupancy) {
        kind.read(section, &mut fields)?;
    }
    if !is_for_surfaces || fields.tsdf.is_empty() {
        for (kind, section) in sections.iter().filter(|(kind, _)| *kind == Kind::Occupancy) {
            kind.read(section, &mut fields)?;
        }
    }
    Ok(fields)
}

/// What a whole file holds, whatever a manifest says.
#[derive(Debug)]
pub(crate) struct Found {
    pub id: SubmapId,
    pub written: Written,
    pub fields: Fields,
    pub origin: Origin,
}

/// Reads the submap file at `path` without a manifest.
pub(crate) fn read_alone(path: &Path) -> Result<Found> {
    let bytes = files::read(path, None)?;
    let (id, sections) = parse(path, &bytes)?;
    let (mut fields, mut origin) = (Fields::default(), None);
    for (kind, section) in sections {
        kind.read(&section, &mut fields)?;
        if kind == Kind::Origin {
            origin = Some(origin_section::read(&section)?);
        }
    }
    let origin = origin.ok_or_else(|| Error::damaged(path, "section table", HEAD as u64, "it does not say where the submap lies"))?;
    let written = Written { bytes: bytes.len() as u64, crc32: crc32fast::hash(&bytes) };
    Ok(Found { id, written, fields, origin })
}

/// Checks the file at `path` against all of its checksums, without unpacking it.
pub(crate) fn check(path: &Path, expected: &Expected) -> Result<()> {
    let bytes = files::read(path, Some(expected.bytes))?;
    verified(path, &bytes, expected).map(drop)
}

/// The sections of a file in which every byte is what was written.
fn verified<'a>(path: &'a Path, bytes: &'a [u8], expected: &Expected) -> Result<Vec<(Kind, Section<'a>)>> {
    let (id, sections) = parse(path, bytes)?;
    if id != expected.id {
        return Err(Error::damaged(path, "header", 12, format!("it is submap {id}, the manifest says {}", expected.id)));
    }
    if crc32fast::hash(bytes) != expected.crc32 {
        let what = "the checksum differs from the manifest's: another file of the same length is in its place";
        return Err(Error::damaged(path, "content", 0, what));
    }
    Ok(sections)
}

/// Takes a file apart and checks the checksums of its head and sections.
fn parse<'a>(path: &'a Path, bytes: &'a [u8]) -> Result<(SubmapId, Vec<(Kind, Section<'a>)>)> {
    let damaged = |offset: usize, what: String| Error::damaged(path, "header", offset as u64, what);
    let mut head = Bytes::new(bytes);
    if head.take(MAGIC.len()) != Ok(&MAGIC[..]) {
        return Err(damaged(0, "it does not start like a submap file".to_owned()));
    }
    let mut number = || head.u32().map_err(|e| damaged(8, e));
    let (version, id, count) = (number()?, number()?, number()? as usize);
    if count > MAX_SECTIONS {
        return Err(damaged(16, format!("it claims {count} sections")));
    }
    let table = head.take(count * TABLE_ROW).map_err(|e| damaged(HEAD, e))?;
    let crc32 = head.u32().map_err(|e| damaged(HEAD + table.len(), e))?;
    if crc32fast::hash(&bytes[..HEAD + table.len()]) != crc32 {
        return Err(damaged(0, "the header does not match its checksum".to_owned()));
    }
    if version != FORMAT_VERSION {
        return Err(Error::OtherVersion { path: path.to_owned(), found: version, supported: FORMAT_VERSION });
    }
    let mut rows = Bytes::new(table);
    let mut sections: Vec<(Kind, Section<'_>)> = Vec::new();
    let mut end = head_length(count) as u64;
    for _ in 0..count {
        let (kind, section) = row(path, bytes, &mut rows, end)?;
        if sections.iter().any(|(other, _)| *other == kind) {
            return Err(damaged(HEAD, format!("it has two {}s", kind.name())));
        }
        end += section.bytes.len() as u64;
        sections.push((kind, section));
    }
    if end != bytes.len() as u64 {
        return Err(Error::damaged(path, "length", end, format!("{} bytes follow the last section", bytes.len() as u64 - end)));
    }
    Ok((id, sections))
}

/// Reads the next row of the section table and checks its section, which starts where the one before ended.
fn row<'a>(path: &'a Path, bytes: &'a [u8], rows: &mut Bytes<'_>, start: u64) -> Result<(Kind, Section<'a>)> {
    let damaged = |what: String| Error::damaged(path, "section table", HEAD as u64, what);
    let mut fields = || Ok((rows.u32()?.to_le_bytes(), rows.u32()?, rows.u64()?, rows.u64()?));
    let (tag, crc32, offset, length) = fields().map_err(damaged)?;
    let place = usize::try_from(offset).ok().zip(usize::try_from(length).ok()).filter(|_| offset == start);
    let content = place.and_then(|(offset, length)| bytes.get(offset..)?.get(..length));
    let content = content.ok_or_else(|| damaged(format!("a section of {length} bytes at byte {offset} does not fit the file")))?;
    let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.tag() == tag) else {
        return Err(Error::UnknownSection { path: path.to_owned(), tag: tag.escape_ascii().to_string(), offset });
    };
    let section = Section { path, name: kind.name(), offset, bytes: content };
    if crc32fast::hash(content) == crc32 { Ok((kind, section)) } else { Err(kind.find_damage(&section)) }
}
