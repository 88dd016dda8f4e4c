//! The messages of a recording.

use super::cdr::CdrWriter;
use voxelastic::motion::ImuSample;
use voxelastic::{Cloud, Pose};
use voxelastic_colour::{CameraModel, Distortion};

/// A type of messages, with the definition that readers without ROS need.
#[derive(Clone, Copy)]
pub(super) struct MessageKind {
    pub(super) name: &'static str,
    pub(super) definition: &'static str,
}

pub(super) const CLOUD: MessageKind = MessageKind { name: "sensor_msgs/msg/PointCloud2", definition: include_str!("definitions/point_cloud2.msg") };
pub(super) const IMU: MessageKind = MessageKind { name: "sensor_msgs/msg/Imu", definition: include_str!("definitions/imu.msg") };
pub(super) const TRANSFORMS: MessageKind = MessageKind { name: "tf2_msgs/msg/TFMessage", definition: include_str!("definitions/tf_message.msg") };

pub(super) const CAMERA_INFO: MessageKind =
    MessageKind { name: "sensor_msgs/msg/CameraInfo", definition: include_str!("definitions/camera_info.msg") };
pub(super) const COMPRESSED_IMAGE: MessageKind =
    MessageKind { name: "sensor_msgs/msg/CompressedImage", definition: include_str!("definitions/compressed_image.msg") };

/// Fields of a point: name, offset, and the type's number in `sensor_msgs/PointField`.
const FIELDS: [(&str, u32, u8); 6] = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("t", 16, 6), ("ring", 20, 4)];
/// Bytes of a point.
const POINT: usize = 22;

/// `sensor_msgs/PointCloud2`.
pub(super) fn cloud(time: f64, frame: &str, cloud: &Cloud) -> CdrWriter {
    let mut message = CdrWriter::new(cloud.len() * POINT + 512);
    message.header(time, frame);
    message.u32(cloud.height as u32);
    message.u32(cloud.width as u32);
    message.u32(FIELDS.len() as u32);
    for (name, offset, kind) in FIELDS {
        message.text(name);
        message.u32(offset);
        message.u8(kind);
        message.u32(1);
    }
    message.u8(0);
    message.u32(POINT as u32);
    message.u32((POINT * cloud.width) as u32);
    let mut data = Vec::with_capacity(cloud.len() * POINT);
    let number = |values: &Option<Vec<f32>>, k: usize| values.as_ref().map_or(0.0, |v| v[k]);
    for (k, point) in cloud.points.iter().enumerate() {
        point.iter().for_each(|v| data.extend(v.to_le_bytes()));
        data.extend(number(&cloud.intensity, k).to_le_bytes());
        data.extend(((number(&cloud.time, k) * 1e9).round() as u32).to_le_bytes());
        data.extend(cloud.ring.as_ref().map_or(0, |r| r[k]).to_le_bytes());
    }
    message.blob(&data);
    message.u8(u8::from(cloud.points.iter().flatten().all(|v| v.is_finite())));
    message
}

/// `sensor_msgs/Imu` without an orientation, which its covariance says.
pub(super) fn imu(frame: &str, sample: &ImuSample) -> CdrWriter {
    let mut message = CdrWriter::new(400);
    message.header(sample.time, frame);
    message.f64s([0.0, 0.0, 0.0, 1.0]);
    message.f64s((0..9).map(|k| if k == 0 { -1.0 } else { 0.0 }));
    message.f64s(sample.angular_velocity);
    message.f64s([0.0; 9]);
    message.f64s(sample.acceleration);
    message.f64s([0.0; 9]);
    message
}

/// `tf2_msgs/TFMessage` with one transform.
pub(super) fn transform(time: f64, parent: &str, child: &str, t_parent_child: &Pose) -> CdrWriter {
    let mut message = CdrWriter::new(200);
    message.u32(1);
    message.header(time, parent);
    message.text(child);
    let (t, q) = (&t_parent_child.translation.vector, &t_parent_child.rotation.coords);
    message.f64s([t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
    message
}

/// `sensor_msgs/CameraInfo`.
pub(super) fn camera_info(time: f64, frame: &str, camera: &CameraModel) -> CdrWriter {
    let ([fx, fy], [cx, cy]) = (camera.focal(), camera.centre());
    let (model, distortion) = match camera.distortion() {
        Distortion::PlumbBob([k1, k2, p1, p2, k3, ..]) => ("plumb_bob", vec![k1, k2, p1, p2, k3]),
        Distortion::Equidistant(k) => ("equidistant", k.to_vec()),
    };
    let mut message = CdrWriter::new(512);
    message.header(time, frame);
    message.u32(camera.height() as u32);
    message.u32(camera.width() as u32);
    message.text(model);
    message.u32(distortion.len() as u32);
    message.f64s(distortion);
    message.f64s([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    message.f64s([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    message.f64s([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, no region of interest.
    (0..6).for_each(|_| message.u32(0));
    message.u8(0);
    message
}

/// `sensor_msgs/CompressedImage` with a PNG.
pub(super) fn compressed_image(time: f64, frame: &str, png: &[u8]) -> CdrWriter {
    let mut message = CdrWriter::new(png.len() + 128);
    message.header(time, frame);
    message.text("png");
    message.blob(png);
    message
}
