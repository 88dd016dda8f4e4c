//! Writing trajectories.

use crate::file::write_atomically;
use crate::pose_check::is_finite;
use crate::{Error, Result};
use std::io::Write;
use std::path::Path;
use voxelastic::Pose;

/// Writes a trajectory in the TUM format, atomically: a line `time x y z qx qy qz qw` per pose (seconds, metres).
/// Numbers are written so that they read back as the same bits.
///
/// # Errors
/// [`Error::Unwritable`] for a number that is not finite or times that do not increase, since no reader would take
/// the file; [`Error::Io`] if the disk refuses.
pub fn write_tum(path: impl AsRef<Path>, poses: &[(f64, Pose)]) -> Result<()> {
    let path = path.as_ref();
    for (k, (time, pose)) in poses.iter().enumerate() {
        if !time.is_finite() || !is_finite(pose) {
            return Err(Error::unwritable(path, format!("pose {k} holds a number that is not finite")));
        }
        if k > 0 && *time <= poses[k - 1].0 {
            return Err(Error::unwritable(path, format!("the time of pose {k}, {time}, is not after {}", poses[k - 1].0)));
        }
    }
    write_atomically(path, |w| {
        writeln!(w, "# time x y z qx qy qz qw")?;
        for (time, pose) in poses {
            let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
            writeln!(w, "{time} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)?;
        }
        Ok(())
    })
}

/// Writes a trajectory as KITTI rows, atomically: the upper 3 x 4 part of each pose's matrix, row by row, on a line.
///
/// # Errors
/// [`Error::Unwritable`] for a number that is not finite; [`Error::Io`] if the disk refuses.
pub fn write_kitti(path: impl AsRef<Path>, poses: &[Pose]) -> Result<()> {
    let path = path.as_ref();
    if let Some(k) = poses.iter().position(|p| !is_finite(p)) {
        return Err(Error::unwritable(path, format!("pose {k} holds a number that is not finite")));
    }
    write_atomically(path, |w| {
        for pose in poses {
            let m = pose.to_homogeneous();
            for k in 0..12 {
                let end = if k == 11 { '\n' } else { ' ' };
                write!(w, "{:e}{end}", m[(k / 4, k % 4)])?;
            }
        }
        Ok(())
    })
}
