//! Velodyne's sensors whose beams are the same in every piece: their angles and the times at which they fire.

/// A sensor.
#[derive(Debug)]
pub(in crate::capture) struct Model {
    /// Its number in packets.
    pub(in crate::capture) product: u8,
    pub(in crate::capture) name: &'static str,
    /// Elevation of each laser, degrees, in the order of a block.
    pub(super) elevations: &'static [f64],
    /// Azimuth of each laser relative to the head, degrees, clockwise.
    pub(super) azimuths: &'static [f64],
    /// All beams pass through a point so far in front of the axis, metres; distances are measured from the axis.
    pub(super) origin: f64,
    /// Metres in a unit of distance.
    pub(super) unit: f64,
    /// Time in which all lasers fire once, with the pause after that, microseconds.
    pub(super) cycle_us: f64,
    /// From one laser to the next, microseconds.
    laser_us: f64,
    /// Lasers that fire at once.
    together: usize,
}

impl Model {
    /// By its number in packets.
    pub(in crate::capture) fn of(product: u8) -> Option<&'static Self> {
        MODELS.iter().find(|model| model.product == product)
    }

    /// The names of all.
    pub(in crate::capture) fn names() -> Vec<&'static str> {
        MODELS.iter().map(|model| model.name).collect()
    }

    /// When a laser fires after the first one, microseconds.
    pub(super) fn fired_us(&self, laser: usize) -> f64 {
        (laser / self.together) as f64 * self.laser_us
    }
}

static MODELS: [Model; 4] = [
    Model {
        product: 0x21,
        name: "HDL-32E",
        elevations: &HDL_32,
        azimuths: &[0.0; 32],
        origin: 0.02895,
        unit: 0.002,
        cycle_us: 46.08,
        laser_us: 1.152,
        together: 1,
    },
    Model {
        product: 0x22,
        name: "VLP-16",
        elevations: &VLP_16,
        azimuths: &[0.0; 16],
        origin: 0.04191,
        unit: 0.002,
        cycle_us: 55.296,
        laser_us: 2.304,
        together: 1,
    },
    Model {
        product: 0x24,
        name: "Puck Hi-Res",
        elevations: &HI_RES,
        azimuths: &[0.0; 16],
        origin: 0.04191,
        unit: 0.002,
        cycle_us: 55.296,
        laser_us: 2.304,
        together: 1,
    },
    Model {
        product: 0x28,
        name: "VLP-32C",
        elevations: &VLP_32C,
        azimuths: &VLP_32C_AZIMUTHS,
        origin: 0.0424,
        unit: 0.004,
        cycle_us: 55.296,
        laser_us: 2.304,
        together: 2,
    },
];

const VLP_16: [f64; 16] = [-15.0, 1.0, -13.0, 3.0, -11.0, 5.0, -9.0, 7.0, -7.0, 9.0, -5.0, 11.0, -3.0, 13.0, -1.0, 15.0];

const HI_RES: [f64; 16] = [-10.0, 0.667, -8.667, 2.0, -7.333, 3.333, -6.0, 4.667, -4.667, 6.0, -3.333, 7.333, -2.0, 8.667, -0.667, 10.0];

#[rustfmt::skip]
const HDL_32: [f64; 32] = [
    -30.67, -9.33, -29.33, -8.0, -28.0, -6.67, -26.67, -5.33, -25.33, -4.0, -24.0, -2.67, -22.67, -1.33, -21.33, 0.0,
    -20.0, 1.33, -18.67, 2.67, -17.33, 4.0, -16.0, 5.33, -14.67, 6.67, -13.33, 8.0, -12.0, 9.33, -10.67, 10.67,
];

#[rustfmt::skip]
const VLP_32C: [f64; 32] = [
    -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667, -4.0,
    -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0, 7.0, 4.667, -2.333, -2.0, 15.0, 10.333, -1.333,
];

#[rustfmt::skip]
const VLP_32C_AZIMUTHS: [f64; 32] = [
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4,
    1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4,
];
