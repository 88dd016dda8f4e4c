//! The sensor's own description, the JSON file beside a capture: beam tables and packet format.
//!
//! Keys as in the metadata files of Ouster's firmware 1 to 3, flat or in sections.

use crate::{Error, Position, Result, file};
use nalgebra::{Matrix3, UnitQuaternion};
use serde_json::Value;
use std::f64::consts::PI;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::sensor::{BeamModel, BeamTables};

/// How returns are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Profile {
    Legacy,
    /// `RNG19_RFL8_SIG16_NIR16`.
    Single,
    /// `RNG19_RFL8_SIG16_NIR16_DUAL`; the stronger return is used.
    Dual,
    /// `RNG15_RFL8_NIR8`.
    LowRate,
}

/// A sensor, as far as its packets and beams go.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorMetadata {
    pub(crate) profile: Profile,
    /// Columns of a full turn.
    pub(crate) columns: usize,
    pub(crate) columns_per_packet: usize,
    /// Elevation of each row above the horizon, radians, top to bottom as the sensor lists them.
    pub(crate) altitudes: Vec<f64>,
    /// Azimuth of each row relative to the head, radians, clockwise as the sensor counts.
    pub(crate) azimuths: Vec<f64>,
    /// From the axis to where beams begin, metres.
    pub(crate) origin_radius: f64,
    /// Height of the lidar's origin above the sensor's frame, metres.
    pub(crate) height: f64,
    /// The lidar's port.
    pub(crate) port: Option<u16>,
    /// Pose of the inertial measurement unit in the sensor's frame.
    pub(crate) t_sensor_imu: Pose,
}

/// Beam origin of the first sensors, which do not tell theirs, metres.
const OLD_ORIGIN_RADIUS: f64 = 0.012163;
/// Position of the inertial measurement unit in the sensors' frame, metres, where the file does not tell it.
const IMU_POSITION: [f64; 3] = [0.006253, -0.011775, 0.007645];
/// Height of the lidar above the base of all sensors so far, metres.
const HEIGHT: f64 = 0.03618;

impl SensorMetadata {
    /// Reads a sensor's JSON file.
    ///
    /// # Errors
    /// [`Error::Content`] if it is no JSON or lacks the beam angles; [`Error::Io`].
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&file::read(path)?, path)
    }

    /// Reads what a sensor says about itself; `path` is where that came from, for messages.
    ///
    /// # Errors
    /// [`Error::Content`] if it is no JSON or lacks the beam angles.
    pub fn parse(text: &[u8], path: &Path) -> Result<Self> {
        let bad = |at: Position, problem: String| Error::content(path, at, problem, "give the metadata that the sensor or Ouster's software wrote");
        let json: Value = serde_json::from_slice(text).map_err(|e| bad(Position::line(e.line()), format!("not JSON: {e}")))?;
        // Newer files have sections.
        let find = |key: &str| {
            let sections =
                ["beam_intrinsics", "lidar_data_format", "lidar_intrinsics", "data_format", "sensor_info", "config_params", "imu_intrinsics"];
            json.get(key).or_else(|| sections.iter().find_map(|s| json.get(s)?.get(key)))
        };
        let angles = |key: &str| -> Result<Vec<f64>> {
            let list = find(key).and_then(Value::as_array).ok_or_else(|| bad(Position::Field(key.into()), "missing".into()))?;
            let numbers: Option<Vec<f64>> = list.iter().map(|v| v.as_f64().map(f64::to_radians)).collect();
            numbers.filter(|n| (1..=256).contains(&n.len())).ok_or_else(|| bad(Position::Field(key.into()), "not a list of angles".into()))
        };
        let (altitudes, azimuths) = (angles("beam_altitude_angles")?, angles("beam_azimuth_angles")?);
        if altitudes.len() != azimuths.len() {
            return Err(bad(Position::Field("beam_azimuth_angles".into()), format!("{} angles for {} rows", azimuths.len(), altitudes.len())));
        }
        let mode = find("lidar_mode").and_then(Value::as_str).and_then(|m| m.split('x').next()?.parse().ok());
        let whole = |key: &str| find(key).and_then(Value::as_u64).and_then(|n| usize::try_from(n).ok());
        let columns = whole("columns_per_frame").or(mode).filter(|c| (16..=8192).contains(c));
        let profile = find("udp_profile_lidar").and_then(Value::as_str).unwrap_or("LEGACY");
        let length = |key: &str| find(key).and_then(Value::as_f64).map(|mm| mm * 1e-3).filter(|m| m.abs() < 1.0);
        let lifted = find("lidar_to_sensor_transform").and_then(Value::as_array).and_then(|m| m.get(11)?.as_f64()).map(|mm| mm * 1e-3);
        Ok(Self {
            profile: match profile {
                "LEGACY" => Profile::Legacy,
                "RNG19_RFL8_SIG16_NIR16" => Profile::Single,
                "RNG19_RFL8_SIG16_NIR16_DUAL" => Profile::Dual,
                "RNG15_RFL8_NIR8" => Profile::LowRate,
                other => return Err(bad(Position::Field("udp_profile_lidar".into()), format!("packets of profile {other}, which is not known"))),
            },
            columns: columns.ok_or_else(|| bad(Position::Field("lidar_mode".into()), "missing: the number of columns is not known".into()))?,
            columns_per_packet: whole("columns_per_packet").filter(|c| (1..=128).contains(c)).unwrap_or(16),
            altitudes,
            azimuths,
            origin_radius: length("lidar_origin_to_beam_origin_mm").unwrap_or(OLD_ORIGIN_RADIUS),
            height: lifted.filter(|m: &f64| m.abs() < 1.0).unwrap_or(HEIGHT),
            t_sensor_imu: find("imu_to_sensor_transform")
                .and_then(transform)
                .unwrap_or_else(|| Pose::from_parts(IMU_POSITION.into(), UnitQuaternion::identity())),
            port: whole("udp_port_lidar").and_then(|p| u16::try_from(p).ok()).filter(|p| *p > 0),
        })
    }

    /// Rows of the sensor.
    pub(crate) fn rows(&self) -> usize {
        self.altitudes.len()
    }

    /// Columns by which a row is to be moved so that its beams stand above those of the others.
    pub(crate) fn shift(&self, row: usize) -> usize {
        let columns = self.azimuths[row] / (2.0 * PI) * self.columns as f64;
        (columns.round() as i64).rem_euclid(self.columns as i64) as usize
    }

    /// The beams, in the sensor frame (x forward, away from the connector; Ouster's sensor coordinate frame).
    /// The port that the sensor sends the packets of its lidar to, if it says so.
    pub fn lidar_port(&self) -> Option<u16> {
        self.port
    }

    /// The sensor's beams, exactly as it was calibrated.
    ///
    /// # Errors
    /// Tables that no sensor has.
    pub fn model(&self) -> std::result::Result<BeamModel, voxelastic::sensor::SensorError> {
        BeamModel::from_tables(BeamTables {
            name: format!("ouster {}x{}", self.rows(), self.columns),
            elevations: self.altitudes.iter().map(|a| *a as f32).collect(),
            azimuth_offsets: self.azimuths.iter().map(|a| -*a as f32).collect(),
            columns: self.columns,
            clockwise: true,
            // The lidar looks along -x of the sensor at column 0.
            azimuth_of_first: PI as f32,
            origin_radius: self.origin_radius as f32,
            origin_height: self.height as f32,
        })
    }

    /// The unit vector that each row looks along at a column, and where its beam begins, sensor frame.
    pub(crate) fn beam(&self, row: usize, column: usize) -> ([f64; 3], [f64; 3]) {
        // The head turns clockwise; the sensor frame is the lidar frame turned by half a turn.
        let head = 2.0 * PI * (1.0 - column as f64 / self.columns as f64) + PI;
        let azimuth = head - self.azimuths[row];
        let (sin, cos) = self.altitudes[row].sin_cos();
        let origin = [self.origin_radius * head.cos(), self.origin_radius * head.sin(), self.height];
        ([azimuth.cos() * cos, azimuth.sin() * cos, sin], origin)
    }
}

/// A pose from a 4 x 4 matrix, row by row, with millimetres.
fn transform(matrix: &Value) -> Option<Pose> {
    let m: Vec<f64> = matrix.as_array()?.iter().map(Value::as_f64).collect::<Option<_>>()?;
    let [a, b, c, x, d, e, f, y, g, h, i, z, ..] = m[..] else { return None };
    let rotation = Matrix3::new(a, b, c, d, e, f, g, h, i);
    let is_rotation = (rotation.transpose() * rotation - Matrix3::identity()).amax() < 1e-2 && rotation.determinant() > 0.0;
    is_rotation.then(|| Pose::from_parts([x * 1e-3, y * 1e-3, z * 1e-3].into(), UnitQuaternion::from_matrix(&rotation)))
}
