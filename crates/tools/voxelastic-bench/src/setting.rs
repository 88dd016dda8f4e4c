//! The three settings of the paper, and the two fields.

use voxelastic::settings::FieldKind;

/// Range and resolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Largest integrated range, metres.
    pub max_range: f32,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
}

/// The most expensive setting.
pub const HARDEST: Setting = Setting { max_range: 60.0, voxel: 0.065 };

/// The settings of the paper's Sec. V.
pub const SETTINGS: [Setting; 3] = [HARDEST, Setting { max_range: 60.0, voxel: 0.26 }, Setting { max_range: 20.0, voxel: 0.26 }];

/// The fields to map.
pub const FIELDS: [FieldKind; 2] = [FieldKind::Tsdf, FieldKind::Occupancy];

/// A length in centimetres as text, rounded to 0.1 mm.
pub(crate) fn centimetres(metres: f32) -> String {
    format!("{} cm", (f64::from(metres) * 1e4).round() / 100.0)
}

impl std::fmt::Display for Setting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} m / {}", self.max_range, centimetres(self.voxel))
    }
}
