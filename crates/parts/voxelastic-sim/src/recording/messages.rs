//! The messages of a recording.

use voxelastic::Cloud;
use voxelastic::motion::ImuSample;
use voxelastic_colour::{CameraModel, Distortion};
use voxelastic_io::ros::{self, FieldType, Header, MessageWriter};

/// Fields of a point.
const FIELDS: [(&str, FieldType); 6] = [
    ("x", FieldType::F32),
    ("y", FieldType::F32),
    ("z", FieldType::F32),
    ("intensity", FieldType::F32),
    ("t", FieldType::U32),
    ("ring", FieldType::U16),
];
/// Bytes of a point.
const POINT: usize = 22;

/// `sensor_msgs/PointCloud2`.
pub(super) fn cloud(stamp: f64, frame: &str, cloud: &Cloud) -> Vec<u8> {
    let mut data = Vec::with_capacity(cloud.len() * POINT);
    let number = |values: &Option<Vec<f32>>, k: usize| values.as_ref().map_or(0.0, |v| v[k]);
    for (k, point) in cloud.points.iter().enumerate() {
        point.iter().for_each(|v| data.extend(v.to_le_bytes()));
        data.extend(number(&cloud.intensity, k).to_le_bytes());
        data.extend(((number(&cloud.time, k) * 1e9).round() as u32).to_le_bytes());
        data.extend(cloud.ring.as_ref().map_or(0, |r| r[k]).to_le_bytes());
    }
    let is_dense = cloud.points.iter().flatten().all(|v| v.is_finite());
    ros::point_cloud(Header { stamp, frame }, [cloud.height, cloud.width], &FIELDS, &data, is_dense)
}

/// `sensor_msgs/Imu` without an orientation, which its covariance says.
pub(super) fn imu(frame: &str, sample: &ImuSample) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(400);
    message.header(Header { stamp: sample.time, frame });
    message.f64s(&[0.0, 0.0, 0.0, 1.0]).f64s(&[-1.0]).f64s(&[0.0; 8]);
    message.f64s(&sample.angular_velocity).f64s(&[0.0; 9]);
    message.f64s(&sample.acceleration).f64s(&[0.0; 9]).finish()
}

/// `sensor_msgs/CameraInfo`.
pub(super) fn camera_info(time: f64, frame: &str, camera: &CameraModel) -> Vec<u8> {
    let ([fx, fy], [cx, cy]) = (camera.focal(), camera.centre());
    let (model, distortion) = match camera.distortion() {
        Distortion::PlumbBob([k1, k2, p1, p2, k3, ..]) => ("plumb_bob", vec![k1, k2, p1, p2, k3]),
        Distortion::Equidistant(k) => ("equidistant", k.to_vec()),
    };
    let mut message = MessageWriter::with_capacity(512);
    message.header(Header { stamp: time, frame });
    message.u32(camera.height() as u32);
    message.u32(camera.width() as u32);
    message.text(model);
    message.u32(distortion.len() as u32);
    message.f64s(&distortion);
    message.f64s(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]);
    message.f64s(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
    message.f64s(&[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]);
    // No binning, no region of interest.
    (0..6).for_each(|_| _ = message.u32(0));
    message.bool(false).finish()
}

/// `sensor_msgs/CompressedImage` with a PNG.
pub(super) fn compressed_image(time: f64, frame: &str, png: &[u8]) -> Vec<u8> {
    let mut message = MessageWriter::with_capacity(png.len() + 128);
    message.header(Header { stamp: time, frame });
    message.text("png").bytes(png).finish()
}
