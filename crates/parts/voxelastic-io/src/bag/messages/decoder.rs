//! Decoding messages: clouds, poses, transforms.

use super::camera_info::CameraInfo;
use super::header::{Header, frame, header};
use super::packets::PacketLayout;
use super::point_clouds::{livox_cloud, point_cloud2, point_cloud2_fields};
use super::topic_role::TopicRole;
use crate::bag::containers::container::{Encoding, Message, Topic};
use crate::images::RawPixels;
use crate::ouster::FRAME;
use crate::ros::MessageReader;
use crate::stamped_cloud::StampedCloud;
use crate::{Error, Position, Result};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::borrow::Cow;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::motion::ImuSample;

/// A pose of frame `child` in frame `parent`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StampedPose {
    pub(crate) time: f64,
    pub(crate) parent: String,
    /// Empty where the message does not say.
    pub(crate) child: String,
    pub(crate) t_parent_child: Pose,
}

/// A message with what is needed to decode it and to report errors in it.
#[derive(Clone, Copy)]
pub(crate) struct MessageDecoder<'a> {
    pub(crate) path: &'a Path,
    pub(crate) topic: &'a Topic,
    pub(crate) message: &'a Message,
}

impl<'a> MessageDecoder<'a> {
    fn cursor(&self) -> Result<MessageReader<'a>> {
        MessageReader::of(&self.message.data, self.topic.encoding).ok_or_else(|| self.error("it does not begin like a CDR message"))
    }

    /// The message from its beginning, for decoders beside this one.
    pub(super) fn reader(&self) -> Result<MessageReader<'a>> {
        self.cursor()
    }

    /// The error of a message that is shorter than its fields.
    pub(super) fn ends_early(&self) -> Error {
        self.truncated()
    }

    fn error(&self, problem: impl Into<Cow<'static, str>>) -> Error {
        let problem = format!("message of {} at {:.3} s: {}", self.topic.name, self.message.time(), problem.into());
        Error::content(self.path, Position::Byte(self.message.at), problem, "the recording is damaged, or the topic is not of the type it claims")
    }

    fn truncated(&self) -> Error {
        self.error("it ends early")
    }

    /// Time and frame of a message that begins with a header. Packets of Ouster's sensors have none: they are in the frame that their driver gives clouds.
    pub(crate) fn header(&self) -> Result<Header> {
        if PacketLayout::of(&self.topic.kind) == Some(PacketLayout::Bare) {
            return Ok(Header { time: self.message.time(), frame: FRAME.into() });
        }
        header(&mut self.cursor()?, self.topic.encoding).ok_or_else(|| self.truncated())
    }

    /// The poses of a message of poses.
    pub(crate) fn poses(&self, role: TopicRole) -> Result<Vec<StampedPose>> {
        let mut cursor = self.cursor()?;
        let poses = match role {
            TopicRole::Odometry => odometry(&mut cursor, self.topic.encoding).map(|p| vec![p]),
            TopicRole::PoseStamped => pose_stamped(&mut cursor, self.topic.encoding).map(|p| vec![p]),
            TopicRole::Path => list(&mut cursor, self.topic.encoding, true, pose_stamped),
            // A transform is laid out like the first fields of an odometry message.
            TopicRole::Transforms => list(&mut cursor, self.topic.encoding, false, odometry),
            _ => Some(Vec::new()),
        };
        poses.ok_or_else(|| Error::BadPose {
            path: self.path.to_owned(),
            problem: format!(
                "message of {} at {:.3} s: it ends early, or its pose is not finite, or its quaternion zero",
                self.topic.name,
                self.message.time()
            ),
        })
    }

    /// The sample in a message of an inertial measurement unit.
    pub(crate) fn imu(&self) -> Result<ImuSample> {
        let mut cursor = self.cursor()?;
        imu(&mut cursor, self.topic.encoding).ok_or_else(|| self.error("it ends early, or holds a number that is not finite"))
    }

    /// The pixels of a `sensor_msgs/Image`.
    pub(crate) fn raw_image(&self) -> Result<(Header, RawPixels)> {
        let mut cursor = self.cursor()?;
        raw_image(&mut cursor, self.topic.encoding).ok_or_else(|| self.truncated())
    }

    /// The file in a `sensor_msgs/CompressedImage`.
    pub(crate) fn compressed_image(&self) -> Result<(Header, Vec<u8>)> {
        let mut cursor = self.cursor()?;
        compressed_image(&mut cursor, self.topic.encoding).ok_or_else(|| self.truncated())
    }

    /// What a `sensor_msgs/CameraInfo` says.
    pub(crate) fn camera_info(&self) -> Result<(Header, CameraInfo)> {
        let mut cursor = self.cursor()?;
        camera_info(&mut cursor, self.topic.encoding).ok_or_else(|| self.truncated())
    }

    /// The packets of a message, each with the time at which it came, seconds.
    pub(crate) fn packets(&self) -> Result<Vec<(f64, &'a [u8])>> {
        let mut cursor = self.cursor()?;
        let packets = PacketLayout::of(&self.topic.kind).and_then(|layout| layout.packets(&mut cursor, self.topic.encoding, self.message.time()));
        let packets = packets.ok_or_else(|| self.truncated())?;
        if packets.iter().any(|(came, _)| *came <= 0.0) { Err(self.error("its packets have no time stamps")) } else { Ok(packets) }
    }

    /// The text of a `std_msgs/String`.
    pub(crate) fn text(&self) -> Result<String> {
        self.cursor()?.text().ok_or_else(|| self.truncated())
    }

    /// Names of the fields of a cloud.
    pub(crate) fn cloud_fields(&self, role: TopicRole) -> Result<Vec<String>> {
        if role == TopicRole::Packets {
            return Ok(["x", "y", "z", "intensity", "ring", "time"].map(String::from).to_vec());
        }
        let mut cursor = self.cursor()?;
        header(&mut cursor, self.topic.encoding).ok_or_else(|| self.truncated())?;
        if role == TopicRole::Livox {
            return Ok(["offset_time", "x", "y", "z", "reflectivity", "tag", "line"].map(String::from).to_vec());
        }
        point_cloud2_fields(&mut cursor).ok_or_else(|| self.truncated())
    }

    /// The cloud, in its own frame. Point times are relative to the returned stamp, or to the header's if there is none.
    pub(crate) fn cloud(&self, role: TopicRole) -> Result<StampedCloud> {
        let mut cursor = self.cursor()?;
        header(&mut cursor, self.topic.encoding).ok_or_else(|| self.truncated())?;
        let decode = if role == TopicRole::Livox { livox_cloud } else { point_cloud2 };
        decode(&mut cursor, self.path).map_err(|problem| self.error(problem))?.finish(self.path).map_err(|e| match e {
            // Errors about the content do not name the message.
            Error::NoReturn { points, .. } => self.error(format!("no return among its {points} points")),
            Error::Content { problem, .. } => self.error(problem),
            other => other,
        })
    }
}

fn odometry(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<StampedPose> {
    let header = header(cursor, encoding)?;
    let child = frame(cursor.text()?);
    Some(StampedPose { time: header.time, parent: header.frame, child, t_parent_child: pose(cursor)? })
}

fn pose_stamped(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<StampedPose> {
    let header = header(cursor, encoding)?;
    Some(StampedPose { time: header.time, parent: header.frame, child: String::new(), t_parent_child: pose(cursor)? })
}

type Read = fn(&mut MessageReader<'_>, Encoding) -> Option<StampedPose>;

fn list(cursor: &mut MessageReader<'_>, encoding: Encoding, has_header: bool, read: Read) -> Option<Vec<StampedPose>> {
    if has_header {
        header(cursor, encoding)?;
    }
    let count = cursor.count(68)?;
    (0..count).map(|_| read(cursor, encoding)).collect()
}

/// Stamp and measurements; the orientation between them, which few units have, is left out.
fn imu(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<ImuSample> {
    let Header { time, .. } = header(cursor, encoding)?;
    let mut numbers = |skipped: usize| {
        (0..skipped).try_for_each(|_| cursor.f64().map(|_| ()))?;
        Some([cursor.f64()?, cursor.f64()?, cursor.f64()?])
    };
    // A quaternion and nine covariances, then nine more between the two vectors.
    let (angular_velocity, acceleration) = (numbers(4 + 9)?, numbers(9)?);
    let is_finite = angular_velocity.iter().chain(&acceleration).all(|v| v.is_finite());
    is_finite.then_some(ImuSample { time, angular_velocity, acceleration })
}

fn raw_image(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<(Header, RawPixels)> {
    let header = header(cursor, encoding)?;
    let (height, width) = (cursor.u32()? as usize, cursor.u32()? as usize);
    let encoding = cursor.text()?;
    let _is_big_endian = cursor.u8()?;
    let step = cursor.u32()? as usize;
    let count = cursor.u32()? as usize;
    let bytes = cursor.bytes(count)?.to_vec();
    Some((header, RawPixels { width, height, encoding, step, bytes }))
}

fn compressed_image(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<(Header, Vec<u8>)> {
    let header = header(cursor, encoding)?;
    let _format = cursor.text()?;
    let count = cursor.u32()? as usize;
    Some((header, cursor.bytes(count)?.to_vec()))
}

fn camera_info(cursor: &mut MessageReader<'_>, encoding: Encoding) -> Option<(Header, CameraInfo)> {
    let header = header(cursor, encoding)?;
    let (height, width) = (cursor.u32()?, cursor.u32()?);
    let model = cursor.text()?;
    let count = cursor.count(8)?;
    let distortion = (0..count).map(|_| cursor.f64()).collect::<Option<Vec<f64>>>()?;
    let mut numbers = |slots: &mut [f64]| slots.iter_mut().try_for_each(|slot| cursor.f64().map(|value| *slot = value));
    let (mut intrinsics, mut rectification, mut projection) = ([0.0; 9], [0.0; 9], [0.0; 12]);
    numbers(&mut intrinsics)?;
    numbers(&mut rectification)?;
    numbers(&mut projection)?;
    Some((header, CameraInfo { size: [width, height], model, distortion, intrinsics, rectification, projection }))
}

/// Position and quaternion; `None` if a number is not finite or the quaternion is not close to a unit quaternion.
fn pose(cursor: &mut MessageReader<'_>) -> Option<Pose> {
    let [x, y, z, qx, qy, qz, qw]: [f64; 7] = {
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = cursor.f64().filter(|v| v.is_finite())?;
        }
        numbers
    };
    let q = Quaternion::new(qw, qx, qy, qz);
    let norm = q.norm();
    if (norm - 1.0).abs() > crate::text::ROTATION_TOLERANCE {
        return None;
    }
    // As in trajectory files: a quaternion that is a unit quaternion up to rounding is kept as it is.
    let rotation = if (norm - 1.0).abs() < 4.0 * f64::EPSILON { UnitQuaternion::new_unchecked(q) } else { UnitQuaternion::new_normalize(q) };
    Some(Pose::from_parts(Translation3::new(x, y, z), rotation))
}
