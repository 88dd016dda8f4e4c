//! Samples of an inertial measurement unit in a folder of scans: `imu/samples.csv`.
//!
//! ```text
//! # t_lidar_imu 0.05 -0.03 -0.08 0 0 1 0                x y z qx qy qz qw: the unit in the lidar frame; without this line it is the lidar frame
//! time,wx,wy,wz,ax,ay,az                                seconds, radians per second, metres per square second, axes of the unit
//! 0,0.0012,-0.0034,0.0101,0.02,-0.05,9.79
//! ```

use crate::Result;
use crate::file::write_atomically;
use crate::text::{self, Line, check_increasing, lines, words};
use std::io::Write;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::motion::ImuSample;

/// The subfolder.
pub const FOLDER: &str = "imu";
/// The file in it.
pub const FILE: &str = "samples.csv";

/// What the line with the pose of the unit begins with.
const POSE: &str = "# t_lidar_imu ";
/// The names of the columns.
const COLUMNS: &str = "time,wx,wy,wz,ax,ay,az";

/// Writes samples, atomically.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io).
pub fn write(path: impl AsRef<Path>, t_lidar_imu: &Pose, samples: &[ImuSample]) -> Result<()> {
    write_atomically(path.as_ref(), |out| {
        let (t, q) = (&t_lidar_imu.translation.vector, &t_lidar_imu.rotation.coords);
        writeln!(out, "{POSE}{} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)?;
        writeln!(out, "{COLUMNS}")?;
        for ImuSample { time, angular_velocity: [wx, wy, wz], acceleration: [ax, ay, az] } in samples {
            writeln!(out, "{time},{wx},{wy},{wz},{ax},{ay},{az}")?;
        }
        Ok(())
    })
}

/// Reads samples, and the pose of the unit in the lidar frame.
///
/// # Errors
/// [`Error::Content`](crate::Error::Content) with the line for a number that is missing or not finite, or times that do not increase;
/// [`Error::Io`](crate::Error::Io).
pub fn read(path: impl AsRef<Path>) -> Result<(Pose, Vec<ImuSample>)> {
    let path = path.as_ref();
    let text = text::read(path)?;
    let mut t_lidar_imu = Pose::identity();
    if let Some((number, line)) = text.lines().enumerate().find(|(_, line)| line.starts_with(POSE)) {
        let line = Line { path, number: number + 1, text: &line[POSE.len()..] };
        t_lidar_imu = line.pose(line.numbers(words(line.text), &["x", "y", "z", "qx", "qy", "qz", "qw"])?)?;
    }
    let (mut samples, mut times, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    for line in lines(path, &text).filter(|line| line.text != COLUMNS) {
        let [time, wx, wy, wz, ax, ay, az] = line.numbers(line.words(), &["time", "wx", "wy", "wz", "ax", "ay", "az"])?;
        samples.push(ImuSample { time, angular_velocity: [wx, wy, wz], acceleration: [ax, ay, az] });
        times.push(time);
        numbers.push(line.number);
    }
    check_increasing(path, &times, &numbers)?;
    Ok((t_lidar_imu, samples))
}
