//! The paper's three settings, and the two fields.

use voxelastic::settings::FieldKind;

/// How far and how finely is mapped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Largest range integrated, metres.
    pub max_range: f32,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
}

/// The setting that everything published is slow at.
pub const HARD: Setting = Setting { max_range: 60.0, voxel: 0.065 };

/// The settings of the paper's Sec. V.
pub const SETTINGS: [Setting; 3] = [HARD, Setting { max_range: 60.0, voxel: 0.26 }, Setting { max_range: 20.0, voxel: 0.26 }];

/// What is mapped.
pub const FIELDS: [FieldKind; 2] = [FieldKind::Tsdf, FieldKind::Occupancy];

/// A length in centimetres, as it was typed.
pub(crate) fn centimetres(metres: f32) -> String {
    format!("{} cm", (f64::from(metres) * 1e4).round() / 100.0)
}

impl std::fmt::Display for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} m / {}", self.max_range, centimetres(self.voxel))
    }
}
