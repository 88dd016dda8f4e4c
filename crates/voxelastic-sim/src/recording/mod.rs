//! Writes a simulation as a ROS 2 recording (MCAP), as a robot would have recorded it.
//!
//! | topic | what |
//! | --- | --- |
//! | `/points` | `sensor_msgs/PointCloud2`, organised, with `t` (nanoseconds after the stamp, which is the beginning of the sweep) and `ring`; recorded at the end of its sweep |
//! | `/points_2` | as `/points`, of the second sensor, if there is one, in its own frame |
//! | `/imu` | `sensor_msgs/Imu` in the frame of the unit, if the simulation has one |
//! | `/front/camera_info`, `/front/image/compressed` | `sensor_msgs/CameraInfo` and `CompressedImage`, if the simulation has a camera |
//! | `/tf_static` | `tf2_msgs/TFMessage`: where in the lidar frame the unit, the second sensor and the camera are |

mod messages;
mod topic_writer;

use crate::camera::t_lidar_camera;
use crate::{SimError, Simulation};
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;
use topic_writer::TopicWriter;
use voxelastic_io::ros::{Header, transforms};

/// Frames of the lidar and of the inertial measurement unit.
const LIDAR_FRAME: &str = "lidar";
const IMU_FRAME: &str = "imu";
/// Frame of the second lidar.
const SECOND_FRAME: &str = "lidar_2";
/// Frame of the camera.
const CAMERA_FRAME: &str = "front_optical";

impl Simulation {
    /// Writes scans and samples of the inertial measurement unit to an MCAP file, in the order of the times at which they are complete; returns the
    /// number of scans written. `progress` as in [`write`](Self::write).
    ///
    /// # Errors
    /// [`SimError::File`].
    pub fn write_recording(&self, path: &Path, progress: &mut crate::dataset::Progress<'_>) -> Result<usize, SimError> {
        voxelastic_files::write(path, |out| self.record(out, progress)).map_err(SimError::file(path))
    }

    fn record(&self, out: &mut BufWriter<File>, progress: &mut crate::dataset::Progress<'_>) -> io::Result<usize> {
        let second = self.t_lidar_second();
        let mut topics = TOPICS[..if second.is_some() { 4 } else { 3 }].to_vec();
        let of_camera = topics.len();
        topics.extend(self.options().camera.map(|_| CAMERA_TOPICS).into_iter().flatten());
        let mut file = TopicWriter::new(out, &topics)?;
        let samples = self.imu();
        let mut next = 0;
        let mut samples_until = |file: &mut TopicWriter<_>, end: f64| -> io::Result<()> {
            while let Some(sample) = samples.get(next).filter(|s| s.time <= end) {
                file.message(IMU_SAMPLES, nanoseconds(sample.time), &messages::imu(IMU_FRAME, sample))?;
                next += 1;
            }
            Ok(())
        };
        let imu = self.imu_unit().map(|imu| (IMU_FRAME, *imu.t_lidar_imu()));
        let camera = self.options().camera.map(|_| (CAMERA_FRAME, t_lidar_camera()));
        for (frame, t_lidar_frame) in [second.map(|t_lidar_second| (SECOND_FRAME, t_lidar_second)), imu, camera].into_iter().flatten() {
            let header = Header { stamp: 0.0, frame: LIDAR_FRAME };
            file.message(FIXED_TRANSFORMS, 0, &transforms(&[(header, frame, t_lidar_frame)]))?;
        }
        let mut written = 0;
        for (k, &time) in self.times().iter().enumerate() {
            let end = time + self.lidar().settings().period;
            samples_until(&mut file, end)?;
            let cloud = self.cloud(k).unwrap_or_default();
            file.message(POINTS, nanoseconds(end), &messages::cloud(time, LIDAR_FRAME, &cloud))?;
            if let Some((time, cloud)) = self.second_cloud(k) {
                let end = time + self.lidar().settings().period;
                samples_until(&mut file, end)?;
                file.message(POINTS_OF_SECOND, nanoseconds(end), &messages::cloud(time, SECOND_FRAME, &cloud))?;
            }
            if let (Some(lens), Some(taken), Some(png)) = (self.options().camera, self.image_time(k), self.encoded_image(k)) {
                let png = png.map_err(io::Error::other)?;
                let recorded = nanoseconds(taken.max(end));
                file.message(of_camera, recorded, &messages::camera_info(taken, CAMERA_FRAME, &lens.model()))?;
                file.message(of_camera + 1, recorded, &messages::compressed_image(taken, CAMERA_FRAME, &png))?;
            }
            written = k + 1;
            if progress(written, self.len()).is_break() {
                break;
            }
        }
        file.finish()?;
        Ok(written)
    }
}

/// Topics of the recording, by their indices.
const POINTS: usize = 0;
const IMU_SAMPLES: usize = 1;
const FIXED_TRANSFORMS: usize = 2;
const POINTS_OF_SECOND: usize = 3;
/// Names of topics, and types of their messages.
const TOPICS: [(&str, &str); 4] = [
    ("/points", "sensor_msgs/msg/PointCloud2"),
    ("/imu", "sensor_msgs/msg/Imu"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
    ("/points_2", "sensor_msgs/msg/PointCloud2"),
];
const CAMERA_TOPICS: [(&str, &str); 2] =
    [("/front/camera_info", "sensor_msgs/msg/CameraInfo"), ("/front/image/compressed", "sensor_msgs/msg/CompressedImage")];

/// Nanoseconds, as recordings count.
fn nanoseconds(time: f64) -> u64 {
    (time.max(0.0) * 1e9).round() as u64
}
