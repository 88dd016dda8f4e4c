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
    let points = u32_at(file, 96)?;
    // The place of the table; if the writer could not go back to note it, it is the last number of the file.
    let table = match u64_at(file, points)? as i64 {
        at if at <= points as i64 => u64_at(file, file.len().checked_sub(8)?)?,
        at => at as u64,
    };
    let table = usize::try_from(table).ok()?;
    let chunks = u32_at(file, table.checked_add(4)?);
    if let Some(chunks) = chunks.filter(|chunks| *chunks > file.len()) {
        return Some(format!("a table of {chunks} chunks in {} bytes", file.len()));
    }
    layers_beyond(file, points + 8, table)
}

/// The first layers that reach beyond the end of the file, in chunks from `at` to `table`. The decoder would make room for them before it
/// reads.
fn layers_beyond(file: &[u8], mut at: usize, table: usize) -> Option<String> {
    let record = laszip_record(file)?;
    let items = u16_at(record, 32)?.into();
    let item = |k: usize| Some((u16_at(record, 34 + 6 * k)?, u16_at(record, 36 + 6 * k)?));
    let (mut point, mut count) = (0usize, 0);
    for k in 0..items {
        let (kind, bytes) = item(k)?;
        point += usize::from(bytes);
        count += layers(kind, bytes);
    }
    if count == 0 {
        return None; // not layered
    }
    while at < table {
        let sizes = at.checked_add(point + 4)?;
        let begin = sizes.checked_add(4 * count)?;
        let mut end = begin;
        for k in 0..count {
            end = end.checked_add(u32_at(file, sizes + 4 * k)?)?;
            if end > file.len() {
                return Some(format!("layers of {} bytes at byte {begin}, where {} are left", end - begin, file.len().saturating_sub(begin)));
            }
        }
        at = end;
    }
    None
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
