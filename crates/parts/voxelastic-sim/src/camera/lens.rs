//! Lenses of the camera, and where it is.

use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::sync::OnceLock;
use voxelastic::Pose;
use voxelastic_colour::{CameraModel, Distortion};

/// Lenses of a simulated camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lens {
    /// 90 degrees across, with a barrel distortion (`plumb_bob`).
    #[default]
    Wide,
    /// 170 degrees across (`equidistant`).
    Fisheye,
}

/// Pixels across and down.
const SIZE: [u32; 2] = [640, 480];

impl Lens {
    /// Names of lenses.
    pub const NAMES: [&str; 2] = ["wide", "fisheye"];

    /// The lens with this name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Wide, Self::Fisheye].into_iter().zip(Self::NAMES).find(|(_, known)| *known == name).map(|(lens, _)| lens)
    }

    /// The camera with this lens.
    pub fn model(self) -> CameraModel {
        let (focal, distortion) = match self {
            Self::Wide => (300.0, Distortion::PlumbBob([-0.12, 0.012, 4e-4, -3e-4, 0.0, 0.0, 0.0, 0.0])),
            Self::Fisheye => (210.0, Distortion::Equidistant([-0.01, 0.004, -0.002, 0.0003])),
        };
        let centre = SIZE.map(|pixels| 0.5 * f64::from(pixels) - 1.7);
        // These numbers are possible.
        CameraModel::new(SIZE, [focal, 1.01 * focal], centre, distortion).unwrap_or_else(|e| unreachable!("{e}"))
    }

    /// Unit vectors along which the pixels see, row by row, in the camera frame; none beyond the lens. Undistorting takes longer than casting, so it is done once.
    pub(super) fn rays(self) -> &'static [Option<Vector3<f64>>] {
        static RAYS: [OnceLock<Vec<Option<Vector3<f64>>>>; 2] = [const { OnceLock::new() }; 2];
        RAYS[self as usize].get_or_init(|| {
            let (camera, [width, height]) = (self.model(), SIZE);
            let row = |v: u32| (0..width).map(move |u| [f64::from(u), f64::from(v)]);
            (0..height).flat_map(row).map(|pixel| camera.unproject(pixel).map(Vector3::from)).collect()
        })
    }
}

/// Pose of the camera in the LiDAR frame: ahead of it and below, looking ahead and a little down.
pub fn t_lidar_camera() -> Pose {
    let ahead = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&[-Vector3::y(), -Vector3::z(), Vector3::x()]));
    let down = UnitQuaternion::from_euler_angles(0.0, 8f64.to_radians(), 0.05);
    Pose::from_parts(Translation3::new(0.12, 0.03, -0.1), down * ahead)
}
