//! Ouster captures: the sensor's UDP packets in a `.pcap`, with its metadata in a `.json` beside it.
//!
//! [`Capture`] turns packets into organised clouds in the sensor frame (Ouster's sensor coordinate frame), destaggered: a row of the cloud is
//! a beam, a column stands upright, and each point has the time of its firing. Packet profiles are legacy, single and dual return, and low
//! data rate. `voxelastic map CAPTURE.pcap --poses slam.tum` maps it, with poses in the sensor's clock.
//!
//! The geometry is that of the firmware user manual (section "Lidar range to XYZ"), the packets those of the section "Lidar data packet
//! format"; both are held to `ouster-sdk` in the tests.

mod meta;
mod packet;
mod pcap;
mod tape;

pub(crate) use pcap::MAGICS;
pub(crate) use tape::CaptureTape;

use crate::{Error, Result, StampedCloud};
use meta::Meta;
use pcap::Pcap;
use std::path::{Path, PathBuf};
use voxelastic::Cloud;
use voxelastic::sensor::BeamModel;

/// Turns less complete than this are the end or the beginning of a capture in the middle of a turn: they are scans all the same.
const NO_COLUMN: u64 = u64::MAX;

/// A capture that is read front to back.
#[derive(Debug)]
pub struct Capture {
    pcap: Pcap,
    meta: Meta,
    /// Columns of the turn that is being collected.
    turn: Option<Turn>,
    /// A column of the next turn has come.
    ready: Option<Turn>,
    skipped: usize,
}

/// The returns of one turn, in the place where they were fired.
#[derive(Debug)]
struct Turn {
    frame: u16,
    /// Time of each column, nanoseconds; [`NO_COLUMN`] where it is missing.
    times: Vec<u64>,
    /// Metres, `row * columns + column`, staggered.
    ranges: Vec<f32>,
    reflectivity: Vec<f32>,
}

impl Turn {
    fn new(meta: &Meta, frame: u16) -> Self {
        let pixels = meta.rows() * meta.columns;
        Self { frame, times: vec![NO_COLUMN; meta.columns], ranges: vec![0.0; pixels], reflectivity: vec![0.0; pixels] }
    }
}

/// The metadata file of a capture: the only `.json` beside it, or the one whose name begins most like the capture's.
///
/// # Errors
/// [`Error::Dataset`] if there is none, or no one is the most alike.
pub fn find_metadata(capture: &Path) -> Result<PathBuf> {
    let folder = capture.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let stem = |path: &Path| path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let name = stem(capture);
    let alike = |path: &Path| stem(path).bytes().zip(name.bytes()).take_while(|(a, b)| a == b).count();
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))?;
    let mut found: Vec<(usize, PathBuf)> = entries
        .flatten()
        .map(|e| e.path())
        .filter(|p| p.extension().is_some_and(|x| x.eq_ignore_ascii_case("json")))
        .map(|p| (alike(&p), p))
        .collect();
    found.sort_by(|a, b| b.cmp(a));
    match found.as_slice() {
        [(_, only)] => Ok(only.clone()),
        [(most, best), (second, _), ..] if most > second => Ok(best.clone()),
        _ => Err(Error::dataset(capture, "no metadata of the sensor beside it", "put the sensor's .json there under the same name")),
    }
}

impl Capture {
    /// Opens a capture with the sensor's metadata.
    ///
    /// # Errors
    /// [`Error::Content`] if either file is damaged or of an unknown kind; [`Error::Io`].
    pub fn open(capture: impl AsRef<Path>, metadata: impl AsRef<Path>) -> Result<Self> {
        Ok(Self { meta: Meta::read(metadata.as_ref())?, pcap: Pcap::open(capture.as_ref())?, turn: None, ready: None, skipped: 0 })
    }

    /// The sensor's beams, exactly as it was calibrated.
    ///
    /// # Errors
    /// Tables that no sensor has.
    pub fn model(&self) -> std::result::Result<BeamModel, voxelastic::sensor::SensorError> {
        self.meta.model()
    }

    /// Datagrams so far that were no lidar packets of this sensor.
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// The next scan: its cloud, with times relative to the stamp, which is that of its first column in the sensor's clock, seconds.
    /// An error says once where a capture is cut.
    pub fn next_scan(&mut self) -> Option<Result<StampedCloud>> {
        loop {
            if let Some(turn) = self.ready.take() {
                return Some(Ok(self.cloud(&turn)));
            }
            match self.pcap.next() {
                Some(Ok(datagram)) => self.add(&datagram.payload),
                Some(Err(error)) => return Some(Err(error)),
                None => return self.turn.take().map(|turn| Ok(self.cloud(&turn))),
            }
        }
    }

    fn add(&mut self, payload: &[u8]) {
        let columns = packet::columns(&self.meta, payload);
        self.skipped += usize::from(columns.is_empty());
        for column in columns {
            if self.turn.as_ref().is_some_and(|turn| turn.frame != column.frame) {
                self.ready = self.turn.take();
            }
            let turn = self.turn.get_or_insert_with(|| Turn::new(&self.meta, column.frame));
            turn.times[column.number] = column.time_ns;
            for row in 0..self.meta.rows() {
                let seen = column.at(row);
                let pixel = row * self.meta.columns + column.number;
                turn.ranges[pixel] = seen.range as f32;
                turn.reflectivity[pixel] = seen.reflectivity.into();
            }
        }
    }

    /// Points of a turn, destaggered.
    fn cloud(&self, turn: &Turn) -> StampedCloud {
        let (rows, columns) = (self.meta.rows(), self.meta.columns);
        let first = turn.times.iter().copied().filter(|t| *t != NO_COLUMN).min().unwrap_or(0);
        let mut cloud = Cloud {
            points: vec![[f32::NAN; 3]; rows * columns],
            width: columns,
            height: rows,
            intensity: Some(vec![0.0; rows * columns]),
            ring: Some((0..rows * columns).map(|k| (k / columns) as u16).collect()),
            time: Some(vec![0.0; rows * columns]),
            colours: None,
            motion: None,
        };
        let (Some(intensity), Some(times)) = (&mut cloud.intensity, &mut cloud.time) else {
            return StampedCloud { cloud, stamp: None };
        };
        for row in 0..rows {
            let shift = self.meta.shift(row);
            for column in 0..columns {
                let (from, to) = (row * columns + column, row * columns + (column + shift) % columns);
                let (range, time) = (f64::from(turn.ranges[from]), turn.times[column]);
                if time != NO_COLUMN {
                    times[to] = (time.saturating_sub(first)) as f32 * 1e-9;
                }
                if range > 0.0 {
                    let (direction, origin) = self.meta.beam(row, column);
                    // Ranges count from the lidar's origin; beams begin before it.
                    let along = range - self.meta.origin_radius;
                    cloud.points[to] = std::array::from_fn(|k| (origin[k] + direction[k] * along) as f32);
                    intensity[to] = turn.reflectivity[from];
                }
            }
        }
        StampedCloud { cloud, stamp: Some(first as f64 * 1e-9) }
    }
}
