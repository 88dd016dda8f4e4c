//! Hesai's sensors: how their packets are laid out, and the angles of their kinds.

/// A sensor.
#[derive(Debug)]
pub(in crate::capture) struct Model {
    pub(in crate::capture) name: &'static str,
    pub(super) channels: usize,
    pub(super) blocks: usize,
    /// Bytes before the blocks, before the returns of a block, and of a return.
    pub(super) head: usize,
    pub(super) block_head: usize,
    pub(super) unit: usize,
    /// Places of the return mode, the date and the microseconds behind the blocks, and bytes of all that is there: without and with the number of the packet.
    pub(super) mode: usize,
    pub(super) date: usize,
    pub(super) microseconds: usize,
    tails: &'static [usize],
    /// From one block to the next, and from one channel to the next, microseconds.
    pub(super) block_us: f64,
    pub(super) channel_us: f64,
    /// Place in the head of the unit of distances, millimetres; 4 mm where there is none.
    distance_unit: Option<usize>,
    angles: fn(usize) -> [f64; 2],
}

/// A model by its place in the list.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::capture) struct ModelId(usize);

impl ModelId {
    /// The model of a packet, if it is one of these.
    pub(in crate::capture) fn of(packet: &[u8]) -> Option<Self> {
        MODELS.iter().position(|model| model.is_of(packet)).map(Self)
    }

    /// The model.
    pub(in crate::capture) fn model(self) -> &'static Model {
        &MODELS[self.0]
    }
}

impl Model {
    /// The names of all.
    pub(in crate::capture) fn names() -> Vec<&'static str> {
        MODELS.iter().map(|model| model.name).collect()
    }

    pub(super) fn block_bytes(&self) -> usize {
        self.block_head + self.unit * self.channels
    }

    /// Angles of its kind: elevation and azimuth of each channel, degrees.
    pub(super) fn angles(&self) -> Vec<[f64; 2]> {
        (0..self.channels).map(self.angles).collect()
    }

    /// Metres in a unit of distance.
    pub(super) fn distance_unit(&self, packet: &[u8]) -> f64 {
        let millimetres = self.distance_unit.and_then(|at| packet.get(at)).copied().filter(|mm| *mm > 0);
        f64::from(millimetres.unwrap_or(4)) * 1e-3
    }

    fn is_of(&self, packet: &[u8]) -> bool {
        let body = self.head + self.blocks * self.block_bytes();
        if !self.tails.iter().any(|tail| packet.len() == body + tail) {
            return false;
        }
        match self.head {
            0 => packet.chunks(self.block_bytes()).take(self.blocks).all(|block| block[..2] == [0xff, 0xee]),
            8 => packet[..2] == [0xee, 0xff] && packet[2..4] == [self.channels as u8, self.blocks as u8],
            _ => packet[..2] == [0xee, 0xff] && packet[6..8] == [self.channels as u8, self.blocks as u8],
        }
    }
}

/// How packets end: after reserved bytes and the speed of the motor, the time, the return mode, and the date; or the other way round.
const OLD_TAIL: Model = Model {
    name: "",
    channels: 0,
    blocks: 0,
    head: 0,
    block_head: 4,
    unit: 3,
    mode: 14,
    date: 16,
    microseconds: 10,
    tails: &[22, 26],
    block_us: 55.56,
    channel_us: 0.0,
    distance_unit: None,
    angles: even_32,
};
const NEW_TAIL: Model = Model {
    head: 12,
    block_head: 2,
    unit: 4,
    mode: 10,
    date: 13,
    microseconds: 19,
    tails: &[28],
    block_us: 50.0,
    channel_us: 1.512,
    distance_unit: Some(9),
    ..OLD_TAIL
};

static MODELS: [Model; 3] = [
    Model { name: "Pandar40P", channels: 40, blocks: 10, angles: pandar40p, ..OLD_TAIL },
    Model { name: "PandarXT-32", channels: 32, blocks: 8, ..NEW_TAIL },
    Model { name: "PandarXT-16", channels: 16, blocks: 8, angles: even_16, ..NEW_TAIL },
];

fn even_32(channel: usize) -> [f64; 2] {
    [15.0 - channel as f64, 0.0]
}

fn even_16(channel: usize) -> [f64; 2] {
    [15.0 - 2.0 * channel as f64, 0.0]
}

fn pandar40p(channel: usize) -> [f64; 2] {
    // From the sixth channel to the thirtieth they are a third of a degree apart.
    const ABOVE: [f64; 5] = [15.0, 11.0, 8.0, 5.0, 3.0];
    const BELOW: [f64; 10] = [-7.0, -8.0, -9.0, -10.0, -11.0, -12.0, -13.0, -14.0, -19.0, -25.0];
    let elevation = match channel {
        0..5 => ABOVE[channel],
        5..30 => 2.0 - (channel - 5) as f64 / 3.0,
        _ => BELOW[channel - 30],
    };
    let azimuth = match channel {
        6..30 => [3.125, -5.208, -1.042][channel % 3],
        _ => -1.042,
    };
    [elevation, azimuth]
}
