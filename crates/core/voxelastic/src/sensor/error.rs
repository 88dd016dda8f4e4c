//! Errors of describing or recognising a sensor.

/// Errors of the sensor module.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorError {
    /// A beam model needs at least one row and two columns, and at most 4096 x 65536.
    #[error("a beam model of {rows} rows x {columns} columns: rows must be 1 to 4096 and columns 2 to 65536")]
    Size {
        /// Rows given.
        rows: usize,
        /// Columns given.
        columns: usize,
    },
    /// An elevation, offset or length that is not finite, or an elevation beyond the zenith or nadir.
    #[error("row {row}: elevation and azimuth offset must be finite and the elevation within 90 degrees of the horizon")]
    Angle {
        /// Row, in the order given.
        row: usize,
    },
    /// The tables differ in length.
    #[error("{elevations} elevations but {offsets} azimuth offsets: give one offset for each row, or none")]
    TableLength {
        /// Elevations given.
        elevations: usize,
        /// Offsets given.
        offsets: usize,
    },
    /// Two rows have the same direction, so that the row of a point is ambiguous.
    #[error("rows {first} and {second} (from the top) are {gap_degrees:.5} degrees apart: merge them, or correct the beam table")]
    RowsCoincide {
        /// Upper row, counted from the top.
        first: usize,
        /// Lower row, counted from the top.
        second: usize,
        /// Angle between them, degrees.
        gap_degrees: f32,
    },
    /// The origin of the beams is not finite or not inside a sensor of plausible size.
    #[error("the beam origin is {radius} m from the axis and {height} m above the lidar origin: both must be finite and below 1 m")]
    Origin {
        /// Distance of the beam origin from the axis of rotation, metres.
        radius: f32,
        /// Height of the beam origin above the lidar origin, metres.
        height: f32,
    },
    /// No preset has this name.
    #[error("unknown sensor `{name}`: choose one of {known}")]
    UnknownPreset {
        /// Name given.
        name: String,
        /// Names that exist.
        known: String,
    },
    /// The clouds hold too few returns to recognise a sensor from.
    #[error("{returns} returns in {clouds} clouds are too few to recognise the sensor (at least {needed}): name it by the setting `sensor`")]
    TooFewReturns {
        /// Returns found.
        returns: usize,
        /// Clouds examined.
        clouds: usize,
        /// Returns needed.
        needed: usize,
    },
    /// The returns span no two directions, so that there is no grid to be found.
    #[error("the returns do not spread over any angle: the clouds hold no scan")]
    NoSpread,
}
