//! `sensor_msgs/CameraInfo`: intrinsics.

use crate::images::distortion;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use voxelastic::Pose;
use voxelastic_colour::{CameraModel, Distortion};

/// `sensor_msgs/CameraInfo`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CameraInfo {
    pub(crate) size: [u32; 2],
    pub(crate) model: String,
    pub(crate) distortion: Vec<f64>,
    /// Of the image as it was taken, by rows.
    pub(crate) intrinsics: [f64; 9],
    /// From the camera to the rectified frame, by rows.
    pub(crate) rectification: [f64; 9],
    /// Of the rectified image, by rows.
    pub(crate) projection: [f64; 12],
}

impl CameraInfo {
    /// The intrinsics, and the pose of the frame that they are for in the camera frame.
    ///
    /// # Errors
    /// In words.
    pub(crate) fn camera(&self, is_rectified: bool) -> Result<(CameraModel, Pose), String> {
        let (k, p) = (&self.intrinsics, &self.projection);
        let problem = |e: voxelastic_colour::ColourError| e.to_string();
        if is_rectified {
            let model = CameraModel::new(self.size, [p[0], p[5]], [p[2], p[6]], Distortion::NONE).map_err(problem)?;
            let rotation = Matrix3::from_row_slice(&self.rectification);
            let is_rotation = (rotation * rotation.transpose() - Matrix3::identity()).norm() < 1e-3;
            let turned = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation.transpose()));
            let t_camera_rectified = if is_rotation { Pose::from_parts([0.0; 3].into(), turned) } else { Pose::identity() };
            return Ok((model, t_camera_rectified));
        }
        let distortion = distortion(&self.model, &self.distortion)
            .ok_or_else(|| format!("{} coefficients of the distortion {:?} are not known", self.distortion.len(), self.model))?;
        Ok((CameraModel::new(self.size, [k[0], k[4]], [k[2], k[5]], distortion).map_err(problem)?, Pose::identity()))
    }
}
