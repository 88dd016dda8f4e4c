//! RoboSense's sensors: when their lasers fire, and where their angles are.

/// Bytes of a packet, of either kind.
pub(super) const PACKET: usize = 1248;
pub(super) const HEAD: usize = 42;
pub(super) const BLOCK: usize = 100;
pub(super) const BLOCKS: usize = 12;
const FLAG: [u8; 2] = [0xff, 0xee];
/// How packets with returns begin, up to firmware of about 2020 and after it.
const MSOP: [&[u8]; 2] = [&[0x55, 0xaa, 0x05, 0x0a, 0x5a, 0xa5, 0x50, 0xa0], &[0x55, 0xaa, 0x05, 0x5a]];
/// Place of the number of the kind of sensor in packets with returns.
const NUMBER: usize = 30;

/// A sensor.
#[derive(Debug)]
pub(in crate::capture) struct Model {
    pub(in crate::capture) name: &'static str,
    kind: Kind,
    pub(super) lasers: usize,
    /// Metres in a unit of distance.
    pub(super) unit: f64,
    /// From the axis to the lens, metres; distances are measured from the lens.
    pub(super) lens: f64,
    /// Time in which all lasers fire once, with the pause after that, and when each of them fires, microseconds.
    pub(super) cycle_us: f64,
    pub(super) fired_us: fn(usize) -> f64,
    /// Whether its clock counts seconds since 1970 and microseconds; else it has a date.
    pub(super) counts_seconds: bool,
}

/// A number of up to eight bytes.
pub(super) fn big_endian(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0, |number, byte| number << 8 | u64::from(*byte))
}

/// What a packet with returns says about its sensor: how it begins, and its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::capture) struct Kind {
    begins: &'static [u8],
    number: u8,
}

impl Kind {
    /// That of a packet, if it is one of RoboSense's with returns.
    pub(in crate::capture) fn of(packet: &[u8]) -> Option<Self> {
        let is_whole = packet.len() == PACKET && packet[HEAD..].chunks(BLOCK).take(BLOCKS).all(|block| block[..2] == FLAG);
        let begins = MSOP.into_iter().find(|begins| is_whole && packet.starts_with(begins))?;
        Some(Self { begins, number: packet[NUMBER] })
    }

    /// The model, if its packets are read.
    pub(in crate::capture) fn model(self) -> Option<&'static Model> {
        MODELS.iter().find(|model| model.kind == self)
    }

    /// Its name, whether it can be read or not.
    pub(in crate::capture) fn name(self) -> String {
        match self.number {
            3 => "RS-Bpearl".into(),
            4 => "RS-Ruby".into(),
            5 => "RS-Ruby Lite".into(),
            7 => "Helios-16P or 1615".into(),
            number => self.model().map_or_else(|| format!("sensor of kind {number}"), |model| model.name.into()),
        }
    }
}

/// Places of the angles in packets about the device: elevations and azimuths with a sign in hundredths of a degree; of an RS-16, elevations in ten-thousandths.
const ELEVATIONS: usize = 468;
const AZIMUTHS: usize = 564;
const ELEVATIONS_16: usize = 1165;

impl Model {
    /// The names of all.
    pub(in crate::capture) fn names() -> Vec<&'static str> {
        MODELS.iter().map(|model| model.name).collect()
    }

    /// The angles that all pieces have within tenths of a degree; none if each has its own.
    pub(super) fn usual_angles(&self) -> Option<Vec<[f64; 2]>> {
        (self.lasers == 16)
            .then(|| (0..16).map(|laser| [if laser < 8 { 2.0 * laser as f64 - 15.0 } else { 31.0 - 2.0 * laser as f64 }, 0.0]).collect())
    }

    /// Elevation and azimuth of each laser, degrees, in a packet about the device; none if they were not set.
    pub(super) fn angles_in(&self, device: &[u8]) -> Option<Vec<[f64; 2]>> {
        if self.lasers == 16 {
            let elevations: Vec<u64> = device[ELEVATIONS_16..].chunks(3).take(16).map(big_endian).collect();
            let is_set = elevations.iter().any(|e| *e != 0) && elevations.iter().all(|e| *e < 900_000);
            let of = |(laser, e): (usize, &u64)| [*e as f64 * 1e-4 * if laser < 8 { -1.0 } else { 1.0 }, 0.0];
            return is_set.then(|| elevations.iter().enumerate().map(of).collect());
        }
        let angle = |at: usize| {
            let degrees = big_endian(&device[at + 1..at + 3]) as f64 * 0.01;
            (device[at] != 0xff && degrees < 90.0).then_some(if device[at] == 0 { degrees } else { -degrees })
        };
        let angles: Vec<[f64; 2]> =
            (0..self.lasers).map(|laser| Some([angle(ELEVATIONS + 3 * laser)?, angle(AZIMUTHS + 3 * laser)?])).collect::<Option<_>>()?;
        angles.iter().any(|[elevation, _]| *elevation != 0.0).then_some(angles)
    }
}

static MODELS: [Model; 3] = [
    Model {
        name: "RS-LiDAR-16",
        kind: Kind { begins: MSOP[0], number: 1 },
        lasers: 16,
        unit: 0.005,
        lens: 0.03825,
        cycle_us: 55.5,
        fired_us: |laser| 2.8 * laser as f64,
        counts_seconds: false,
    },
    Model {
        name: "RS-LiDAR-32",
        kind: Kind { begins: MSOP[0], number: 2 },
        lasers: 32,
        unit: 0.005,
        lens: 0.03997,
        cycle_us: 55.52,
        fired_us: fired_32,
        counts_seconds: false,
    },
    Model {
        name: "RS-Helios",
        kind: Kind { begins: MSOP[1], number: 6 },
        lasers: 32,
        unit: 0.0025,
        lens: 0.03498,
        cycle_us: 55.56,
        fired_us: |laser| 1.73 * laser as f64,
        counts_seconds: true,
    },
];

/// Two groups of sixteen in turns; the last of each is later.
fn fired_32(laser: usize) -> f64 {
    2.88 * (laser % 16) as f64 + 1.44 * (laser / 16 + usize::from(laser % 16 == 15)) as f64
}
