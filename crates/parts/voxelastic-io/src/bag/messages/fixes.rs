//! Fixes in a recording.

use super::decoder::MessageDecoder;
use super::header::header;
use crate::bag::containers::container::{Encoding, Topic};
use crate::bag::containers::files;
use crate::bag::containers::open::open;
use crate::ros::MessageReader;
use crate::{Error, Result};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic_earth::{Fix, Fixes, Geodetic, Heights, Place, covariance_of, read_sentences};

/// Types of messages with fixes, those first that say most.
const KINDS: [&str; 3] = ["sensor_msgs/NavSatFix", "gps_common/GPSFix", "nmea_msgs/Sentence"];
/// Positions in a projected system, if the topic is named.
const ODOMETRY: &str = "nav_msgs/Odometry";

const REMEDY: &str =
    "fixes are sensor_msgs/NavSatFix, gps_common/GPSFix or nmea_msgs/Sentence; nav_msgs/Odometry in a projected system is read if its topic is named";

/// The fixes of a recording.
///
/// # Errors
/// [`Error::Ambiguous`] if several topics hold some, [`Error::Dataset`] if none does; [`Error::Content`] for a message that is none; [`Error::Io`].
pub(crate) fn fixes(path: &Path, topic: Option<&str>) -> Result<Fixes> {
    let files = files::find(path)?.unwrap_or_default();
    let topic = choose(path, &files, topic)?;
    let mut out = Fixes { heights: Heights::Ellipsoid, ..Fixes::default() };
    let mut sentences: Vec<(f64, String)> = Vec::new();
    for file in &files {
        let mut container = open(file)?;
        while let Some(message) = container.next(&|t| t.name == topic.name) {
            let message = message?;
            let found = container.topics()[message.topic].clone();
            let decoder = MessageDecoder { path: file, topic: &found, message: &message };
            match found.kind.as_str() {
                "nmea_msgs/Sentence" => sentences.push(decoder.sentence()?),
                _ => match decoder.fix()? {
                    Some(fix) => out.all.push(fix),
                    None => out.without_position += 1,
                },
            }
        }
    }
    if !sentences.is_empty() {
        return Ok(read_sentences(sentences.iter().map(|(time, text)| (Some(*time), text.as_str()))));
    }
    if topic.kind == ODOMETRY {
        out.heights = Heights::Unknown;
    }
    Ok(out)
}

/// The topic that is named, else the only one of the best kind.
fn choose(path: &Path, files: &[std::path::PathBuf], named: Option<&str>) -> Result<Topic> {
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    for file in files {
        let mut container = open(file)?;
        if container.index().is_none() {
            // Without an index, topics are known when their first message comes.
            while container.next(&|topic| is_of_fixes(topic)).is_some() {}
        }
        topics.extend(container.topics().iter().filter(|t| is_of_fixes(t)).map(|t| (t.name.clone(), t.clone())));
    }
    if let Some(named) = named {
        return topics.remove(named).ok_or_else(|| Error::dataset(path, format!("no topic {named} with fixes"), REMEDY));
    }
    for kind in KINDS {
        let mut of_kind: Vec<&Topic> = topics.values().filter(|topic| topic.kind == kind).collect();
        if of_kind.len() > 1 {
            let choices = of_kind.iter().map(|topic| topic.name.clone()).collect();
            return Err(Error::Ambiguous { path: path.to_owned(), what: "topics of fixes", flag: "--gnss-topic", choices });
        }
        if let Some(only) = of_kind.pop() {
            return Ok(only.clone());
        }
    }
    Err(Error::dataset(path, "no fixes in it", REMEDY))
}

fn is_of_fixes(topic: &Topic) -> bool {
    topic.encoding != Encoding::Other && (KINDS.contains(&topic.kind.as_str()) || topic.kind == ODOMETRY)
}

impl MessageDecoder<'_> {
    /// The fix of a message; none if it says that there is none.
    fn fix(&self) -> Result<Option<Fix>> {
        let mut cursor = self.reader()?;
        let read = match self.topic.kind.as_str() {
            "sensor_msgs/NavSatFix" => nav_sat_fix,
            "gps_common/GPSFix" => gps_fix,
            _ => odometry,
        };
        read(&mut cursor, self.topic.encoding).ok_or_else(|| self.ends_early())
    }

    fn sentence(&self) -> Result<(f64, String)> {
        let mut cursor = self.reader()?;
        let read = header(&mut cursor, self.topic.encoding).and_then(|header| Some((header.time, cursor.text()?)));
        read.ok_or_else(|| self.ends_early())
    }
}

fn numbers<const N: usize>(cursor: &mut MessageReader<'_>) -> Option<[f64; N]> {
    let mut out = [0.0; N];
    out.iter_mut().try_for_each(|slot| cursor.f64().map(|value| *slot = value))?;
    Some(out)
}

fn fix(time: f64, place: Place, covariance: Option<Matrix3<f64>>) -> Fix {
    Fix { time: Some(time), place, covariance, name: None, seen_at: None }
}

/// `None` for a message that ends early; `Some(None)` for a receiver without a position.
fn nav_sat_fix(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<Option<Fix>> {
    let time = header(cursor, encoding)?.time;
    let (status, _service) = (cursor.u8()? as i8, cursor.u16()?);
    let [latitude, longitude, height] = numbers(cursor)?;
    let covariance = Matrix3::from_row_slice(&numbers::<9>(cursor)?);
    let is_known = cursor.u8()? > 0;
    let covariance = Some(covariance).filter(|c| is_known && c.cholesky().is_some());
    Some((status >= 0).then(|| fix(time, Place::Geodetic(Geodetic { latitude, longitude, height }), covariance)))
}

fn gps_fix(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<Option<Fix>> {
    let time = header(cursor, encoding)?.time;
    // Its status: a header, the satellites used, and lists of those in view.
    header(cursor, encoding)?;
    cursor.u16()?;
    let skip = |cursor: &mut MessageReader<'_>| (0..cursor.count(4)?).try_for_each(|_| cursor.u32().map(drop));
    skip(cursor)?;
    cursor.u16()?;
    (0..4).try_for_each(|_| skip(cursor))?;
    let status = cursor.u16()? as i16;
    (0..3).try_for_each(|_| cursor.u16().map(drop))?;
    let [latitude, longitude, height] = numbers(cursor)?;
    // Track, speed, climb, pitch, roll, dip, time, five dilutions; errors: all, horizontal, vertical, and six more.
    let rest: [f64; 21] = numbers(cursor)?;
    let covariance = Matrix3::from_row_slice(&numbers::<9>(cursor)?);
    let is_known = cursor.u8()? > 0;
    // The errors are those that 95 % of the fixes do not exceed.
    let of_errors = || covariance_of([rest[13] / 2.45, rest[13] / 2.45, rest[14] / 1.96]);
    let covariance = Some(covariance).filter(|c| is_known && c.cholesky().is_some()).or_else(of_errors);
    Some((status >= 0).then(|| fix(time, Place::Geodetic(Geodetic { latitude, longitude, height }), covariance)))
}

fn odometry(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<Option<Fix>> {
    let time = header(cursor, encoding)?.time;
    cursor.text()?;
    let point: [f64; 3] = numbers(cursor)?;
    let _rotation: [f64; 4] = numbers(cursor)?;
    let all: [f64; 36] = numbers(cursor)?;
    let covariance = Matrix3::from_fn(|i, j| all[6 * i + j]);
    let place = Vector3::from(point);
    Some(place.iter().all(|c| c.is_finite()).then(|| fix(time, Place::Projected(point), Some(covariance).filter(|c| c.cholesky().is_some()))))
}
