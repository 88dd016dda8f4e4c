//! The manifest as text: JSON that people and programs can read, with a checksum of itself.
//!
//! Its first lines have a fixed form in all versions: format, version, and the CRC-32 of the whole text with eight zeros
//! in the checksum's place. What follows may gain keys that older programs can do without; any other change is a new version.

use super::manifest::{EditsMark, Manifest, SubmapEntry};
use super::piece::MapDetails;
use crate::store::FORMAT_VERSION;
use crate::store::additions::sessions::{self, SessionEntry};
use crate::store::files::SubmapName;
use crate::{Error, Result};
use crc32fast::Hasher;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

const START: &str = "{\n\"format\": \"voxelastic map\",\n\"version\": ";
const BEFORE_CRC: &str = ",\n\"crc32\": \"";
const NO_CRC: &str = "00000000";

/// The keys that the manifest's text has after the first lines.
#[derive(Deserialize)]
struct Document {
    generator: String,
    settings: BTreeMap<String, String>,
    sensor: BTreeMap<String, String>,
    #[serde(default)]
    edits: Option<EditsMark>,
    #[serde(default)]
    sessions: Vec<SessionEntry>,
    submaps: Vec<SubmapEntry>,
}

/// The text of `manifest`: one line per setting, session and submap. It is as long as the run, so there is one copy of it only.
pub(crate) fn write(manifest: &Manifest) -> std::result::Result<String, serde_json::Error> {
    let before = format!("{START}{FORMAT_VERSION}{BEFORE_CRC}");
    let mut text = format!("{before}{NO_CRC}\",\n\"generator\": {},\n", serde_json::to_string(&manifest.details.generator)?);
    text += &format!("\"settings\": {},\n", serde_json::to_string_pretty(&manifest.details.settings)?);
    text += &format!("\"sensor\": {},\n", serde_json::to_string_pretty(&manifest.details.sensor)?);
    if let Some(edits) = &manifest.edits {
        text += &format!("\"edits\": {},\n", serde_json::to_string(edits)?);
    }
    let mut text = text.into_bytes();
    if !manifest.sessions.is_empty() {
        text.extend(b"\"sessions\": [");
        write_lines(&manifest.sessions, &mut text)?;
        text.extend(b"],\n");
    }
    text.extend(b"\"submaps\": [");
    write_lines(&manifest.submaps, &mut text)?;
    text.extend(b"]\n}\n");
    let crc32 = checksum(before.as_bytes(), &text[before.len() + NO_CRC.len()..]);
    text[before.len()..before.len() + NO_CRC.len()].copy_from_slice(crc32.as_bytes());
    String::from_utf8(text).map_err(serde::ser::Error::custom)
}

/// Each in a line.
fn write_lines(items: &[impl Serialize], text: &mut Vec<u8>) -> std::result::Result<(), serde_json::Error> {
    for (number, item) in items.iter().enumerate() {
        text.extend(if number == 0 { &b"\n"[..] } else { b",\n" });
        serde_json::to_writer(&mut *text, item)?;
    }
    text.extend(items.last().map(|_| b'\n'));
    Ok(())
}

/// The checksum, in the form in which the text holds it, of a text that is `before` and `after` the checksum.
fn checksum(before: &[u8], after: &[u8]) -> String {
    let mut crc = Hasher::new();
    [before, NO_CRC.as_bytes(), after].iter().for_each(|part| crc.update(part));
    format!("{:08x}", crc.finalize())
}

/// Reads the text of the manifest at `path`.
pub(crate) fn read(path: &Path, text: &[u8]) -> Result<Manifest> {
    let other = || Error::NotAMap {
        path: path.to_owned(),
        reason: "its first lines are not those of a map's manifest; it belongs to another program, was edited, or is damaged",
    };
    let rest = text.strip_prefix(START.as_bytes()).ok_or_else(other)?;
    let digits = rest.iter().position(|b| !b.is_ascii_digit()).filter(|&n| n > 0).ok_or_else(other)?;
    let (number, rest) = rest.split_at(digits);
    let rest = rest.strip_prefix(BEFORE_CRC.as_bytes()).ok_or_else(other)?;
    let (crc32, after) = rest.split_at_checked(NO_CRC.len()).ok_or_else(other)?;
    let before = &text[..text.len() - rest.len()];
    if checksum(before, after).as_bytes() != crc32 {
        return Err(Error::damaged(path, "text", 0, format!("its {} bytes do not match their checksum", text.len())));
    }
    // The text is whole, so a number that does not fit is a version from very far ahead.
    let version = number.iter().fold(0u32, |n, d| n.saturating_mul(10).saturating_add(u32::from(d - b'0')));
    if version != FORMAT_VERSION {
        return Err(Error::OtherVersion { path: path.to_owned(), found: version, supported: FORMAT_VERSION });
    }
    let document: Document =
        serde_json::from_slice(text).map_err(|e| Error::damaged(path, "text", offset(text, e.line(), e.column()), e.to_string()))?;
    check(path, text, &document.submaps)?;
    let Document { generator, settings, sensor, edits, sessions, submaps } = document;
    sessions::check(&sessions).map_err(|what| Error::damaged(path, "sessions", 0, what))?;
    let manifest = Manifest { details: MapDetails { generator, settings, sensor }, sessions, submaps, edits };
    manifest.voxel_size().map_err(|what| Error::damaged(path, "settings", 0, what))?;
    Ok(manifest)
}

/// Byte offset of a 1-based line and column.
fn offset(text: &[u8], line: usize, column: usize) -> u64 {
    let start: usize = text.split_inclusive(|&b| b == b'\n').take(line.saturating_sub(1)).map(<[u8]>::len).sum();
    (start + column.saturating_sub(1)) as u64
}

/// Refuses submap tables that no writer makes, above all file names that lead elsewhere.
fn check(path: &Path, text: &[u8], submaps: &[SubmapEntry]) -> Result<()> {
    let mut last = None;
    for entry in submaps {
        let damaged = |what: String| {
            let line = format!("{{\"id\":{},", entry.id);
            let at = text.windows(line.len()).position(|w| w == line.as_bytes()).unwrap_or(0);
            Error::damaged(path, "submap table", at as u64, what)
        };
        if last.is_some_and(|last| last >= entry.id) {
            return Err(damaged(format!("submap {} comes twice or too late", entry.id)));
        }
        last = Some(entry.id);
        if SubmapName::parse(&entry.file).is_none_or(|name| name.id != entry.id) {
            return Err(damaged(format!("submap {} has the file name {:?}, which no map writer chooses", entry.id, entry.file)));
        }
    }
    Ok(())
}
