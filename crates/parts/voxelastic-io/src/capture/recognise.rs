//! Which sensor a capture is of, by its packets.

use super::datagrams::{Datagram, Pcap};
use super::files::find_angles;
use super::hesai::{self, HesaiPackets};
use super::robosense::{self, RoboSensePackets};
use super::spinning::SpinningPackets;
use super::velodyne::{self, Product, VelodynePackets};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};

/// So many datagrams are looked at: more than a second of the sensors with the most.
const DATAGRAMS: usize = 20_000;

/// A sensor that is read from its packets.
#[derive(Clone, Debug)]
pub(crate) struct SpinningSensor {
    make: Make,
    /// IPv4 address of the sensor, as a number.
    pub(super) source: u32,
    /// Port that its packets go to.
    pub(super) port: u16,
}

#[derive(Clone, Debug)]
enum Make {
    Velodyne(&'static velodyne::Model),
    Hesai(&'static hesai::Model, Option<PathBuf>),
    RoboSense(&'static robosense::Model, robosense::Piece),
}

impl SpinningSensor {
    /// What reads its packets.
    pub(super) fn packets(&self) -> Result<Box<dyn SpinningPackets>> {
        Ok(match &self.make {
            Make::Velodyne(model) => Box::new(VelodynePackets::new(model)),
            Make::Hesai(model, angles) => Box::new(HesaiPackets::new(model, angles.as_deref())?),
            Make::RoboSense(model, piece) => Box::new(RoboSensePackets::new(model, piece.clone())),
        })
    }

    /// The name that drivers give its frame.
    pub(super) fn frame(&self) -> &'static str {
        match self.make {
            Make::Velodyne(_) => "velodyne",
            Make::Hesai(..) => "hesai_lidar",
            Make::RoboSense(..) => "rslidar",
        }
    }
}

/// What was found in a capture.
pub(super) enum Recognised {
    /// A sensor that can be read, and remarks.
    Sensor(SpinningSensor, Vec<String>),
    /// A sensor that cannot: its name, and what to do.
    Unreadable(String, String),
    Nothing,
}

/// What a datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Velodyne(Product),
    Hesai(hesai::ModelId),
    RoboSense(robosense::Kind),
}

impl Kind {
    /// Of a datagram with returns; none if it is of no sensor that is known.
    pub(super) fn of(packet: &[u8]) -> Option<Self> {
        let hesai = || hesai::ModelId::of(packet).map(Self::Hesai);
        Product::of(packet).map(Self::Velodyne).or_else(hesai).or_else(|| robosense::Kind::of(packet).map(Self::RoboSense))
    }

    /// Its name.
    pub(super) fn name(self) -> String {
        match self {
            Self::Velodyne(product) => format!("Velodyne {}", product.name()),
            Self::Hesai(id) => format!("Hesai {}", id.model().name),
            Self::RoboSense(kind) => format!("RoboSense {}", kind.name()),
        }
    }
}

/// Why nothing reads the packets of a sensor.
enum UnsupportedSensor {
    /// It is not known, or something is missing: what to do instead.
    Remedy(String),
    /// The file with the angles cannot be used.
    File(Error),
}

/// What is known of a piece of a sensor: the file with the angles of its beams, and a packet about the device.
#[derive(Clone, Debug, Default)]
struct Particulars {
    angles: Option<PathBuf>,
    device: Option<Vec<u8>>,
}

impl Kind {
    /// What reads its packets, and a remark.
    fn make(self, particulars: Particulars) -> std::result::Result<(Make, Option<String>), UnsupportedSensor> {
        let Particulars { angles, device } = particulars;
        let drivers = |names: Vec<&str>| format!("those of {} are; have the sensor's driver make clouds of it, and record those", names.join(", "));
        let of_a_file = |file: &PathBuf| format!("the angles of its beams are those of {}", file.display());
        match self {
            Self::Velodyne(product) => {
                let model = if let Product::Known(number) = product { velodyne::Model::of(number) } else { None };
                Ok((Make::Velodyne(model.ok_or_else(|| UnsupportedSensor::Remedy(drivers(velodyne::Model::names())))?), None))
            }
            Self::Hesai(id) => {
                let usual =
                    "the angles of its beams are those of its kind, not of the piece: give the sensor's angle correction (.csv) with --metadata";
                let note = angles.as_ref().map_or_else(|| usual.into(), of_a_file);
                Ok((Make::Hesai(id.model(), angles), Some(note)))
            }
            Self::RoboSense(kind) => {
                let model = kind.model().ok_or_else(|| UnsupportedSensor::Remedy(drivers(robosense::Model::names())))?;
                let piece = robosense::Piece::new(model, angles.as_deref(), device.as_deref()).map_err(UnsupportedSensor::File)?;
                let remedy = "each piece has its own angles: record its packets about the device, too (DIFOP, usually to port 7788), or give a table (.csv with Channel,Elevation,Azimuth) with --metadata";
                let piece = piece.ok_or_else(|| UnsupportedSensor::Remedy(remedy.into()))?;
                let note = match (&angles, robosense::Piece::of(model, device.as_deref())) {
                    (Some(file), _) => of_a_file(file),
                    (None, (Some(_), _)) => "the angles of its beams are in its packets about the device (usually to port 7788)".into(),
                    (None, (None, _)) => {
                        "the angles of its beams are those of its kind, not of the piece: record its packets to port 7788, too".into()
                    }
                };
                Ok((Make::RoboSense(model, piece), Some(note)))
            }
        }
    }
}

/// A sensor that a packet has shown.
pub(super) struct DetectedSensor {
    /// What reads its packets.
    pub(super) packets: Box<dyn SpinningPackets>,
    /// The name that drivers give its frame.
    pub(super) frame: &'static str,
    /// What it is, in words.
    pub(super) words: String,
}

/// Whether a packet is about a device, and not one with returns.
pub(super) fn is_about_device(packet: &[u8]) -> bool {
    robosense::is_about_device(packet)
}

/// The sensor whose packets are of a kind. Its beams have the `angles` of a file, if there is one, or what a packet about the `device`
/// says.
///
/// # Errors
/// [`Error::Dataset`] for sensors whose packets are not read; [`Error::Content`] if the file with the angles is damaged; [`Error::Io`].
pub(super) fn sensor_of(kind: Kind, angles: Option<&Path>, device: Option<Vec<u8>>, origin: &Path) -> Result<DetectedSensor> {
    let (make, note) = kind.make(Particulars { angles: angles.map(Path::to_owned), device }).map_err(|unsupported| match unsupported {
        UnsupportedSensor::Remedy(remedy) => Error::dataset(origin, format!("packets of a {}, which are not read", kind.name()), remedy),
        UnsupportedSensor::File(error) => error,
    })?;
    let sensor = SpinningSensor { make, source: 0, port: 0 };
    let words = note.map_or_else(|| kind.name(), |note| format!("{}; {note}", kind.name()));
    Ok(DetectedSensor { packets: sensor.packets()?, frame: sensor.frame(), words })
}

/// The sensors that are read from their packets.
pub(super) fn known() -> Vec<String> {
    let velodyne = velodyne::Model::names().into_iter().map(|name| format!("Velodyne {name}"));
    let hesai = hesai::Model::names().into_iter().map(|name| format!("Hesai {name}"));
    velodyne.chain(hesai).chain(robosense::Model::names().into_iter().map(|name| format!("RoboSense {name}"))).collect()
}

/// Looks at the beginning of a capture. `angles` is the file with the angles of the sensor's beams, if the user names one.
///
/// # Errors
/// Those of opening the files.
pub(super) fn recognise(path: &Path, angles: Option<&Path>) -> Result<Recognised> {
    let mut pcap = Pcap::open(path)?;
    // What is damaged is reported when the capture is played.
    recognise_in(std::iter::from_fn(|| pcap.next()).take(DATAGRAMS).flatten(), path, angles, || find_angles(path))
}

/// Looks at datagrams, which are of no known sender if they come from a topic. Where the user names no file with `angles`, the one that `beside` finds is used.
///
/// # Errors
/// A file that cannot be used, or is not needed.
pub(super) fn recognise_in(
    datagrams: impl Iterator<Item = Datagram>,
    path: &Path,
    angles: Option<&Path>,
    beside: impl FnOnce() -> Option<PathBuf>,
) -> Result<Recognised> {
    let mut found: BTreeMap<(Kind, u32, u16), usize> = BTreeMap::new();
    let mut devices: BTreeMap<u32, Vec<u8>> = BTreeMap::new();
    for datagram in datagrams {
        if let Some(kind) = Kind::of(&datagram.payload) {
            *found.entry((kind, datagram.source, datagram.port)).or_default() += 1;
        } else if is_about_device(&datagram.payload) {
            devices.entry(datagram.source).or_insert(datagram.payload);
        }
    }
    // The one with the most packets; of several, the first.
    let Some((&(kind, source, port), _)) = found.iter().max_by(|a, b| a.1.cmp(b.1).then(b.0.cmp(a.0))) else { return Ok(Recognised::Nothing) };
    let words = |kind: Kind, source: u32, port: u16| match port {
        0 => kind.name(),
        _ => format!("{}, at {}, port {port}", kind.name(), Ipv4Addr::from(source)),
    };
    let mut notes = vec![format!("sensor: {}", words(kind, source, port))];
    let particulars = Particulars { angles: angles.map(Path::to_owned).or_else(beside), device: devices.remove(&source) };
    let make = match kind.make(particulars) {
        Ok((make, note)) => {
            notes.extend(note);
            make
        }
        Err(UnsupportedSensor::Remedy(remedy)) => return Ok(Recognised::Unreadable(kind.name(), remedy)),
        Err(UnsupportedSensor::File(error)) => return Err(error),
    };
    let sensor = SpinningSensor { make, source, port };
    // So that a damaged file is reported now.
    sensor.packets()?;
    let others = found.keys().filter(|key| **key != (kind, source, port));
    notes.extend(others.map(|(kind, source, port)| format!("not read: {}", words(*kind, *source, *port))));
    if angles.is_some() && matches!(sensor.make, Make::Velodyne(_)) {
        return Err(Error::dataset(path, format!("a {} needs no file with angles", kind.name()), "do without --metadata"));
    }
    Ok(Recognised::Sensor(sensor, notes))
}
