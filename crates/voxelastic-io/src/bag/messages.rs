//! The messages that matter: clouds, poses, transforms.

use super::container::{Encoding, Message, Topic};
use super::wire::Wire;
use crate::channels::{Raw, Roles};
use crate::record::{Column, Field, Scalar};
use crate::{Error, Position, Result, StampedCloud};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::borrow::Cow;
use std::path::Path;
use voxelastic::Pose;

/// What a topic is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// `sensor_msgs/PointCloud2`.
    PointCloud2,
    /// `livox_ros_driver/CustomMsg` and its successor's.
    Livox,
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `geometry_msgs/PoseStamped`, with or without covariance.
    PoseStamped,
    /// `nav_msgs/Path`.
    Path,
    /// `tf2_msgs/TFMessage`, `tf/tfMessage`.
    Transforms,
}

impl Role {
    pub(super) fn of(topic: &Topic) -> Option<Self> {
        if topic.encoding == Encoding::Other {
            return None;
        }
        match topic.kind.as_str() {
            "sensor_msgs/PointCloud2" => Some(Self::PointCloud2),
            "livox_ros_driver/CustomMsg" | "livox_ros_driver2/CustomMsg" => Some(Self::Livox),
            "nav_msgs/Odometry" => Some(Self::Odometry),
            "geometry_msgs/PoseStamped" | "geometry_msgs/PoseWithCovarianceStamped" => Some(Self::PoseStamped),
            "nav_msgs/Path" => Some(Self::Path),
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Some(Self::Transforms),
            _ => None,
        }
    }

    pub(super) fn is_cloud(self) -> bool {
        matches!(self, Self::PointCloud2 | Self::Livox)
    }

    pub(super) fn is_poses(self) -> bool {
        matches!(self, Self::Odometry | Self::PoseStamped | Self::Path)
    }
}

/// When and in which frame a message was made.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    /// Seconds.
    pub(super) time: f64,
    pub(super) frame: String,
}

/// A pose of frame `child` in frame `parent`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StampedPose {
    pub(super) time: f64,
    pub(super) parent: String,
    /// Empty where the message does not say.
    pub(super) child: String,
    pub(super) t_parent_child: Pose,
}

/// A message with what is needed to read it and to say what is wrong with it.
#[derive(Clone, Copy)]
pub(super) struct Letter<'a> {
    pub(super) path: &'a Path,
    pub(super) topic: &'a Topic,
    pub(super) message: &'a Message,
}

impl<'a> Letter<'a> {
    fn wire(&self) -> Result<Wire<'a>> {
        Wire::of(&self.message.data, self.topic.encoding).ok_or_else(|| self.error("it does not begin like a CDR message"))
    }

    fn error(&self, problem: impl Into<Cow<'static, str>>) -> Error {
        let problem = format!("message of {} at {:.3} s: {}", self.topic.name, self.message.time_ns as f64 * 1e-9, problem.into());
        Error::content(self.path, Position::Byte(self.message.at), problem, "the recording is damaged, or the topic is not of the type it claims")
    }

    fn ended(&self) -> Error {
        self.error("it ends early")
    }

    /// Time and frame of a message that begins with a header.
    pub(super) fn header(&self) -> Result<Header> {
        header(&mut self.wire()?, self.topic.encoding).ok_or_else(|| self.ended())
    }

    /// The poses of a message of poses.
    pub(super) fn poses(&self, role: Role) -> Result<Vec<StampedPose>> {
        let mut wire = self.wire()?;
        let poses = match role {
            Role::Odometry => odometry(&mut wire, self.topic.encoding).map(|p| vec![p]),
            Role::PoseStamped => pose_stamped(&mut wire, self.topic.encoding).map(|p| vec![p]),
            Role::Path => list(&mut wire, self.topic.encoding, true, pose_stamped),
            Role::Transforms => list(&mut wire, self.topic.encoding, false, transform),
            Role::PointCloud2 | Role::Livox => Some(Vec::new()),
        };
        poses.ok_or_else(|| self.error("it ends early, or holds a pose that is none"))
    }

    /// Names of the fields of a cloud.
    pub(super) fn cloud_fields(&self, role: Role) -> Result<Vec<String>> {
        let mut wire = self.wire()?;
        header(&mut wire, self.topic.encoding).ok_or_else(|| self.ended())?;
        if role == Role::Livox {
            return Ok(["offset_time", "x", "y", "z", "reflectivity", "tag", "line"].map(String::from).to_vec());
        }
        let layout = Layout2::read(&mut wire).ok_or_else(|| self.ended())?;
        Ok(layout.fields.into_iter().map(|f| f.name).collect())
    }

    /// The cloud, in its own frame; times of points are relative to the returned stamp, or to the header's where there is none.
    pub(super) fn cloud(&self, role: Role) -> Result<StampedCloud> {
        let mut wire = self.wire()?;
        header(&mut wire, self.topic.encoding).ok_or_else(|| self.ended())?;
        let raw = if role == Role::Livox { self.livox(&mut wire)? } else { self.point_cloud2(&mut wire)? };
        raw.finish(self.path).map_err(|e| match e {
            // Errors of the cloud's content do not know the message.
            Error::NoReturn { points, .. } => self.error(format!("no return among its {points} points")),
            Error::Content { problem, .. } => self.error(problem),
            other => other,
        })
    }

    fn point_cloud2(&self, wire: &mut Wire<'a>) -> Result<Raw> {
        let layout = Layout2::read(wire).ok_or_else(|| self.ended())?;
        let (width, height, step) = (layout.width, layout.height, layout.point_step);
        let points = width.checked_mul(height).filter(|n| *n <= layout.data.len());
        let row = width.checked_mul(step);
        let needed = row.and_then(|row| layout.row_step.checked_mul(height.saturating_sub(1))?.checked_add(row));
        let (Some(points), Some(row), Some(needed)) = (points, row, needed) else {
            return Err(self.error(format!("{width} x {height} points of {step} bytes cannot be in {} bytes", layout.data.len())));
        };
        if points > 0 && (step == 0 || needed > layout.data.len() || (height > 1 && layout.row_step < row)) {
            return Err(self.error(format!("{width} x {height} points of {step} bytes do not fit its {} bytes", layout.data.len())));
        }
        if let Some(field) = layout.fields.iter().find(|f| f.offset.saturating_add(f.scalar.size()) > step) {
            return Err(self.error(format!("field {} reaches beyond the {step} bytes of a point", field.name)));
        }
        let is_packed = height <= 1 || layout.row_step == row;
        let data: Cow<'_, [u8]> = if is_packed {
            Cow::Borrowed(layout.data)
        } else {
            Cow::Owned(layout.data.chunks(layout.row_step).take(height).flat_map(|r| &r[..row.min(r.len())]).copied().collect())
        };
        let roles = Roles::of(&layout.fields, self.path).map_err(|e| self.error(e.to_string()))?;
        let column = |field: &Field| Column {
            bytes: data.get(field.offset..).unwrap_or(&[]),
            stride: step,
            len: points,
            scalar: field.scalar,
            big_endian: layout.big_endian,
        };
        Ok(Raw { width, height, ..Raw::gather(&layout.fields, &roles, column) })
    }

    /// Points of 19 packed bytes: time, x, y, z, reflectivity, tag, line. CDR aligns each to 4 bytes.
    fn livox(&self, wire: &mut Wire<'a>) -> Result<Raw> {
        const PACKED: usize = 19;
        let read = || -> Option<(usize, &'a [u8])> {
            wire.u64()?; // the time of the first point, which the header has too
            wire.bytes(4 + 1 + 3)?;
            let count = wire.count(PACKED)?;
            let stride = if wire.is_aligned() { PACKED + 1 } else { PACKED };
            wire.align(4);
            // Nothing follows the last point, not even its padding.
            let len = (stride * count).saturating_sub(if count > 0 { stride - PACKED } else { 0 });
            Some((count, wire.bytes(len)?))
        };
        let mut read = read;
        let (points, bytes) = read().ok_or_else(|| self.ended())?;
        let big_endian = wire.is_big_endian();
        let stride = if wire.is_aligned() { PACKED + 1 } else { PACKED };
        let field = |name: &str, scalar, offset| Field { name: name.into(), scalar, count: 1, offset, index: 0 };
        let fields = [
            field("offset_time", Scalar::U32, 0),
            field("x", Scalar::F32, 4),
            field("y", Scalar::F32, 8),
            field("z", Scalar::F32, 12),
            field("reflectivity", Scalar::U8, 16),
            field("line", Scalar::U8, 18),
        ];
        let roles = Roles::of(&fields, self.path)?;
        let column = |f: &Field| Column { bytes: bytes.get(f.offset..).unwrap_or(&[]), stride, len: points, scalar: f.scalar, big_endian };
        Ok(Raw { width: points, height: 1, ..Raw::gather(&fields, &roles, column) })
    }
}

/// What `sensor_msgs/PointCloud2` says behind its header.
struct Layout2<'a> {
    height: usize,
    width: usize,
    fields: Vec<Field>,
    big_endian: bool,
    point_step: usize,
    row_step: usize,
    data: &'a [u8],
}

impl<'a> Layout2<'a> {
    fn read(wire: &mut Wire<'a>) -> Option<Self> {
        let (height, width) = (wire.u32()? as usize, wire.u32()? as usize);
        let count = wire.count(13)?;
        let mut fields = Vec::with_capacity(count);
        for index in 0..count {
            let (name, offset, kind) = (wire.text()?, wire.u32()? as usize, wire.u8()?);
            let numbers = wire.u32()? as usize;
            // A type that does not exist: the field is passed over.
            if let Some(scalar) = scalar(kind) {
                fields.push(Field { name, scalar, count: numbers.max(1), offset, index });
            }
        }
        let big_endian = wire.u8()? != 0;
        let (point_step, row_step) = (wire.u32()? as usize, wire.u32()? as usize);
        let len = wire.count(1)?;
        Some(Self { height, width, fields, big_endian, point_step, row_step, data: wire.bytes(len)? })
    }
}

/// The constants of `sensor_msgs/PointField`.
fn scalar(kind: u8) -> Option<Scalar> {
    use Scalar::{F32, F64, I8, I16, I32, U8, U16, U32};
    [I8, U8, I16, U16, I32, U32, F32, F64].get(usize::from(kind).checked_sub(1)?).copied()
}

fn header(wire: &mut Wire<'_>, encoding: Encoding) -> Option<Header> {
    if encoding == Encoding::Ros1 {
        wire.u32()?; // a running number
    }
    let (seconds, nanoseconds) = (wire.u32()?, wire.u32()?);
    Some(Header { time: f64::from(seconds) + f64::from(nanoseconds) * 1e-9, frame: frame(wire.text()?) })
}

/// Frames may be written with a leading slash.
fn frame(name: String) -> String {
    name.strip_prefix('/').map_or_else(|| name.clone(), str::to_owned)
}

fn odometry(wire: &mut Wire<'_>, encoding: Encoding) -> Option<StampedPose> {
    let header = header(wire, encoding)?;
    let child = frame(wire.text()?);
    Some(StampedPose { time: header.time, parent: header.frame, child, t_parent_child: pose(wire)? })
}

fn pose_stamped(wire: &mut Wire<'_>, encoding: Encoding) -> Option<StampedPose> {
    let header = header(wire, encoding)?;
    Some(StampedPose { time: header.time, parent: header.frame, child: String::new(), t_parent_child: pose(wire)? })
}

/// A transform has its translation and rotation where a pose has its position and orientation.
fn transform(wire: &mut Wire<'_>, encoding: Encoding) -> Option<StampedPose> {
    odometry(wire, encoding)
}

type Read = fn(&mut Wire<'_>, Encoding) -> Option<StampedPose>;

fn list(wire: &mut Wire<'_>, encoding: Encoding, has_header: bool, read: Read) -> Option<Vec<StampedPose>> {
    if has_header {
        header(wire, encoding)?;
    }
    let count = wire.count(68)?;
    (0..count).map(|_| read(wire, encoding)).collect()
}

/// Position and quaternion; none if a number is not finite or the quaternion far from a unit one.
fn pose(wire: &mut Wire<'_>) -> Option<Pose> {
    let [x, y, z, qx, qy, qz, qw]: [f64; 7] = {
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = wire.f64().filter(|v| v.is_finite())?;
        }
        numbers
    };
    let q = Quaternion::new(qw, qx, qy, qz);
    let norm = q.norm();
    if (norm - 1.0).abs() > crate::text::ROTATION_TOLERANCE {
        return None;
    }
    // As in trajectory files: a unit quaternion, to the last bit or two, is kept as it is.
    let rotation = if (norm - 1.0).abs() < 4.0 * f64::EPSILON { UnitQuaternion::new_unchecked(q) } else { UnitQuaternion::new_normalize(q) };
    Some(Pose::from_parts(Translation3::new(x, y, z), rotation))
}
