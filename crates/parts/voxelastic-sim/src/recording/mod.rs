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

#[cfg(test)]
mod tests {
    use crate::camera::Lens;
    use crate::imu::ImuSettings;
    use crate::{SimError, SimOptions, Simulation};
    use std::ops::ControlFlow;
    use std::path::Path;
    use voxelastic_io::{OpenOptions, bag};
    use voxelastic_testing::run_python;

    fn write(path: &Path) -> Result<Simulation, SimError> {
        let options = SimOptions { scans: Some(3), columns: Some(64), imu: Some(ImuSettings::default()), ..SimOptions::of("room") };
        let simulation = Simulation::new(SimOptions { rate: Some(10.0), camera: Some(Lens::Fisheye), ..options })?;
        assert_eq!(simulation.write_recording(path, &mut |_, _| ControlFlow::Continue(()))?, 3);
        Ok(simulation)
    }

    #[test]
    fn a_recording_counts_what_it_holds() -> Result<(), SimError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("recording.mcap");
        let simulation = write(&path)?;
        let description = bag::describe(&path, &OpenOptions::default()).unwrap();
        let messages = |name: &str| description.topics.iter().find(|topic| topic.name == name).and_then(|topic| topic.messages);
        let [clouds, poses, images] = ["/points", "/tf_static", "/front/image/compressed"].map(messages);
        assert_eq!((clouds, poses, images, messages("/front/camera_info")), (Some(3), Some(2), Some(3), Some(3)));
        assert!(messages("/imu").is_some_and(|n| n > 10), "{:?}", messages("/imu"));
        let scans = voxelastic_io::raw::open(&path, &OpenOptions::default()).unwrap();
        let first = scans.iter().next().unwrap().unwrap();
        let points = &simulation.cloud(0).unwrap_or_default().points;
        assert_eq!(first.cloud.points.iter().filter(|p| p[0].is_finite()).count(), points.iter().filter(|p| p[0].is_finite()).count());
        Ok(())
    }

    /// With the definitions that the file itself has, and to the last byte.
    #[test]
    fn another_implementation_reads_every_message() -> Result<(), SimError> {
        let script = "
import sys
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from mcap.reader import make_reader
counts = {}
with open(sys.argv[1], 'rb') as file:
    reader = make_reader(file, validate_crcs=True)
    stores = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if schema.name not in stores:
            stores[schema.name] = get_typestore(Stores.EMPTY)
            stores[schema.name].register(get_types_from_msg(schema.data.decode(), schema.name))
        value = stores[schema.name].deserialize_cdr(message.data, schema.name)
        assert bytes(stores[schema.name].serialize_cdr(value, schema.name)) == message.data, schema.name
        counts[channel.topic] = counts.get(channel.topic, 0) + 1
    assert counts == {c.topic: reader.get_summary().statistics.channel_message_counts[i] for i, c in reader.get_summary().channels.items()}
print(counts['/points'], counts['/front/image/compressed'])
";
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("recording.mcap");
        write(&path)?;
        let Some(read) = run_python("rosbags, mcap", script, &[&path]) else { return Ok(()) };
        assert_eq!(read.trim(), "3 3");
        Ok(())
    }
}
