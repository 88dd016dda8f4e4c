//! What a LAZ file claims, looked at from outside before its decoder believes it and asks for the memory.
//!
//! Layout from the LASzip specification: after the header's "laszip encoded" record, points begin with the place of the table of
//! chunks; a layered chunk is its first point, the number of points, the size of each layer, and the layers.

/// Layers of an item of points by its type and bytes: points, RGB, RGB with infrared, wave packets, extra bytes.
fn layers(kind: u16, bytes: u16) -> usize {
    match kind {
        10 => 9,
        11 | 13 => 1,
        12 => 2,
        14 => bytes.into(),
        _ => 0,
    }
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk::<N>().copied()
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    number(bytes, at).map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<usize> {
    number(bytes, at).map(|b| u32::from_le_bytes(b) as usize)
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    number(bytes, at).map(u64::from_le_bytes)
}

/// What a LAZ file claims that it cannot hold; nothing if it is not packed or too short to tell, which its decoder notices.
pub(super) fn exaggerates(file: &[u8]) -> Option<String> {
    // The type of points says whether they are packed.
    if file.get(104)? & 0x80 == 0 {
        return None;
    }
    // LASzip 1 packed all points in one piece, without a table.
    if laszip_record(file).and_then(|record| u16_at(record, 0)).is_some_and(|packing| packing < 2) {
        return Some("packed by LASzip 1, before 2011, which its decoder does not read: unpack it with laszip or PDAL first".to_owned());
    }
    let points = u32_at(file, 96)?;
    // The place of the table; if the writer could not go back to note it, it is the last number of the file.
    let table = match u64_at(file, points)? as i64 {
        at if at <= points as i64 => u64_at(file, file.len().checked_sub(8)?)?,
        at => at as u64,
    };
    let chunks = u32_at(file, usize::try_from(table).ok()?.checked_add(4)?).unwrap_or(0);
    if chunks > file.len() {
        return Some(format!("a table of {chunks} chunks in {} bytes", file.len()));
    }
    let packing = Packing::read(laszip_record(file)?)?;
    // The header says it too, and the decoder believes both.
    let point = packing.point.max(u16_at(file, 105)?.into());
    if point > LARGEST_POINT {
        return Some(format!("points of {point} bytes"));
    }
    packing.beyond(file, points + 8, chunks, usize::try_from(table).ok()?)
}

/// What the decoder keeps for each byte of a point takes thousands of bytes, and nobody has points as large as this.
const LARGEST_POINT: usize = 4096;

/// How points are packed.
struct Packing {
    /// Bytes of a point.
    point: usize,
    /// Layers of a chunk; 0 if chunks are not layered.
    layers: usize,
    /// Points in a chunk, if that is always the same.
    chunk_size: Option<u64>,
}

impl Packing {
    /// From the "laszip encoded" record.
    fn read(record: &[u8]) -> Option<Self> {
        let (mut point, mut count) = (0, 0);
        for k in 0..usize::from(u16_at(record, 32)?) {
            let (kind, bytes) = (u16_at(record, 34 + 6 * k)?, u16_at(record, 36 + 6 * k)?);
            point += usize::from(bytes);
            count += layers(kind, bytes);
        }
        let chunk_size = match number(record, 12).map(u32::from_le_bytes)? {
            u32::MAX => None,
            0 => Some(u64::MAX),
            size => Some(size.into()),
        };
        Some(Self { point, layers: count, chunk_size })
    }

    /// The first layers that reach beyond the end of the file. The decoder would make room for them before it reads, and it goes from one
    /// chunk to the next, whatever lies there, until it has all points that are claimed. Files of COPC note a last chunk that is empty: it begins at the table.
    fn beyond(&self, file: &[u8], mut at: usize, chunks: usize, table: usize) -> Option<String> {
        if self.layers == 0 {
            return None;
        }
        let (claimed, mut seen, mut chunk) = (points_claimed(file), 0u64, 0);
        while seen < claimed || (self.chunk_size.is_none() && chunk < chunks && at != table) {
            let sizes = at.checked_add(self.point + 4)?;
            let begin = sizes.checked_add(4 * self.layers)?;
            let mut end = begin;
            for k in 0..self.layers {
                end = end.checked_add(u32_at(file, sizes + 4 * k)?)?;
                if end > file.len() {
                    return Some(format!("layers of {} bytes at byte {begin}, where {} are left", end - begin, file.len().saturating_sub(begin)));
                }
            }
            let counted = u32_at(file, sizes - 4)? as u64;
            seen = seen.saturating_add(self.chunk_size.unwrap_or(counted));
            (at, chunk) = (end, chunk + 1);
        }
        None
    }
}

/// Points that the header claims; it has one number for old readers and a larger one in LAS 1.4.
fn points_claimed(file: &[u8]) -> u64 {
    let old = u32_at(file, 107).unwrap_or(0) as u64;
    let is_new = file.get(25).is_some_and(|minor| *minor >= 4);
    if is_new { old.max(u64_at(file, 247).unwrap_or(0)) } else { old }
}

/// The content of the record that says how points are packed.
fn laszip_record(file: &[u8]) -> Option<&[u8]> {
    const HEAD: usize = 54;
    let (mut at, count) = (usize::from(u16_at(file, 94)?), u32_at(file, 100)?);
    for _ in 0..count {
        let length = usize::from(u16_at(file, at + 20)?);
        let content = file.get(at + HEAD..)?.get(..length)?;
        if file[at + 2..].starts_with(b"laszip encoded") {
            return Some(content);
        }
        at += HEAD + length;
    }
    None
}
