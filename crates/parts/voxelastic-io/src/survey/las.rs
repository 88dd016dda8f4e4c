//! LAS 1.0 to 1.4 and LAZ, through the `las` and `laz` crates.
//!
//! The decoder of LAZ makes room for whatever a file claims; what can be seen from outside is checked before.

use super::laz::exaggerates;
use super::{CHUNK, Gather, SurveyCloud, check};
use crate::file::{self, write_atomically};
use crate::{Error, Position, Result, unpacking};
use las::point::Format;
use las::{Builder, Color, Point, Reader, Transform, Vector, Writer};
use std::io::{Cursor, Write};
use std::path::Path;
use voxelastic::Cloud;

/// Points are decoded in parts of this size at most, or of [`CHUNK`] points.
const CHUNK_BYTES: u64 = 1 << 24;
/// Coordinates are written in steps of this, metres.
const STEP: f64 = 1e-4;

/// Reads a LAS or LAZ cloud.
///
/// # Errors
/// [`Error::Content`] if it is damaged or none, [`Error::NoReturn`] if it has no point, [`Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<SurveyCloud> {
    parse(file::read(path.as_ref())?, path.as_ref())
}

/// Decodes a LAS or LAZ cloud; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(bytes: Vec<u8>, path: &Path) -> Result<SurveyCloud> {
    // The decoder of LAZ panics on some damaged headers.
    std::panic::catch_unwind(|| decode(bytes, path)).unwrap_or_else(|_| {
        Err(Error::content(path, Position::File, "not readable as LAS or LAZ: its header contradicts itself", "copy it again or write it anew"))
    })
}

fn decode(bytes: Vec<u8>, path: &Path) -> Result<SurveyCloud> {
    let fail = |e: las::Error| Error::content(path, Position::File, format!("not readable as LAS or LAZ: {e}"), "copy it again or write it anew");
    if let Some(problem) = exaggerates(&bytes) {
        return Err(Error::content(path, Position::File, problem, "copy it again or write it anew"));
    }
    let size = bytes.len() as u64;
    let mut reader = Reader::new(Cursor::new(bytes)).map_err(fail)?;
    let (claimed, format) = (reader.header().number_of_points(), *reader.header().point_format());
    let length = u64::from(format.len()).max(1);
    let most = if format.is_compressed { unpacking::most_points(size) } else { size / length };
    if claimed > most {
        let problem = format!("{claimed} points are claimed by a file that cannot hold more than {most}");
        return Err(Error::content(path, Position::File, problem, "copy it again or write it anew"));
    }
    let has_colour = reader.header().point_format().has_color;
    let wkt = reader.header().get_wkt_crs_bytes().map(|bytes| String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned());
    let mut gather = Gather { crs_wkt: wkt.filter(|wkt| !wkt.is_empty()), ..Gather::default() };
    // Sixteen bits are the rule for colours, but some programs write eight.
    let mut colours: Vec<[u16; 3]> = Vec::new();
    loop {
        let read = reader.read_points((CHUNK_BYTES / length).clamp(1, CHUNK as u64)).map_err(fail)?;
        if read.is_empty() {
            break;
        }
        for point in read.points() {
            let p = point.map_err(fail)?;
            gather.add([p.x, p.y, p.z]);
            gather.intensity.push(p.intensity.into());
            colours.extend(p.color.filter(|_| has_colour).map(|c| [c.red, c.green, c.blue]));
        }
    }
    let shift = if colours.iter().flatten().any(|c| *c > 255) { 8 } else { 0 };
    gather.colours = colours.into_iter().map(|c| c.map(|v| (v >> shift) as u8)).collect();
    if gather.intensity.iter().all(|i| *i == 0.0) {
        gather.intensity.clear();
    }
    gather.finish(path)
}

/// The offset of the coordinates in the file, metres: that of the survey, and if 32 bits do not reach from it to the points, their centre.
fn offset(path: &Path, survey: &SurveyCloud) -> Result<[f64; 3]> {
    const REACH: f64 = i32::MAX as f64 * STEP;
    let mut offset = survey.offset;
    for (k, offset) in offset.iter_mut().enumerate() {
        let mut returns = survey.cloud.points.iter().filter(|p| Cloud::is_return(p)).map(|p| f64::from(p[k]));
        let Some(first) = returns.next() else { continue };
        let (low, high) = returns.fold((first, first), |(low, high), c| (low.min(c), high.max(c)));
        if low > -REACH && high < REACH {
            continue;
        }
        let centre = (0.5 * (low + high)).round();
        if high - centre >= REACH || !(*offset + centre).is_finite() {
            return Err(Error::unwritable(path, format!("its points are {:.0} m apart, and LAS reaches {:.0} m", high - low, 2.0 * REACH)));
        }
        *offset += centre;
    }
    Ok(offset)
}

/// Writes a cloud as LAS 1.4, packed as LAZ if the name says so, atomically. Points without a return are left out; intensities are rounded
/// to whole numbers from 0 to 65535; coordinates to a tenth of a millimetre. With the coordinate system, if the cloud has one.
///
/// # Errors
/// [`Error::Unwritable`] if channels differ in length or coordinates are too large; [`Error::Io`].
pub fn write(path: impl AsRef<Path>, survey: &SurveyCloud) -> Result<()> {
    let path = path.as_ref();
    check(path, survey)?;
    let fail = |e: las::Error| Error::unwritable(path, e.to_string());
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(if survey.cloud.colours.is_some() { 7 } else { 6 }).map_err(fail)?;
    builder.point_format.is_compressed = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("laz"));
    let offset = offset(path, survey)?;
    let transform = |k: usize| Transform { scale: STEP, offset: offset[k] };
    builder.transforms = Vector { x: transform(0), y: transform(1), z: transform(2) };
    builder.generating_software = "voxelastic".into();
    let mut header = builder.into_header().map_err(fail)?;
    if let Some(wkt) = &survey.crs_wkt {
        // The specification wants a zero at its end.
        header.set_wkt_crs([wkt.as_bytes(), &[0]].concat()).map_err(fail)?;
    }
    let mut writer = Writer::new(Cursor::new(Vec::new()), header).map_err(fail)?;
    for (i, p) in survey.cloud.points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p)) {
        let [x, y, z] = std::array::from_fn(|k| f64::from(p[k]) + survey.offset[k]);
        let intensity = survey.cloud.intensity.as_ref().map_or(0.0, |v| v[i]).round().clamp(0.0, 65535.0) as u16;
        let color = survey.cloud.colours.as_ref().map(|c| c[i].map(|v| u16::from(v) * 257)).map(|[red, green, blue]| Color { red, green, blue });
        let gps_time = Some(0.0);
        writer
            .write_point(Point { x, y, z, intensity, color, gps_time, return_number: 1, number_of_returns: 1, ..Point::default() })
            .map_err(fail)?;
    }
    let bytes = writer.into_inner().map_err(fail)?.into_inner();
    write_atomically(path, |w| w.write_all(&bytes))
}
