//! Settings of the odometry.

/// Settings of the odometry. The defaults are for handheld, driving and indoor recordings alike.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct OdometrySettings {
    /// Edge of the finest voxels of the local map, metres; `None`: 0.08 of the root mean square range of the first scan, 0.2 to 0.7.
    pub voxel_size: Option<f64>,
    /// Nearest return that is used, metres.
    pub min_range: f64,
    /// Farthest return that is used, and radius of the local map, metres.
    pub max_range: f64,
    /// Points per voxel edge that enter the map from a scan.
    pub map_density: f64,
    /// Distance between points that are registered, in voxel edges.
    pub source_spacing: f64,
    /// Levels of the map, each with voxels twice as large as the one before.
    pub levels: usize,
    /// Whether points that have times are moved to the time stamp by constant velocity.
    pub deskew: bool,
    /// Scale of the robust kernel at the end of a registration, metres: a distance of this counts a quarter.
    pub kernel_scale: f64,
    /// Weight of the distance to points that are no plane, relative to the weight that their spread alone gives them.
    pub point_weight: f64,
    /// Most iterations on each level.
    pub max_iterations: usize,
    /// Consecutive scans that cannot be registered, after which a new piece begins.
    pub max_failures: usize,
    /// A keyframe is due after this distance, metres ..
    pub keyframe_distance: f64,
    /// .. or this rotation, degrees.
    pub keyframe_angle: f64,
}

impl Default for OdometrySettings {
    fn default() -> Self {
        Self {
            voxel_size: None,
            min_range: 0.5,
            max_range: 100.0,
            map_density: 3.0,
            source_spacing: 1.4,
            levels: 3,
            deskew: true,
            kernel_scale: 0.2,
            point_weight: 30.0,
            max_iterations: 50,
            max_failures: 3,
            keyframe_distance: 1.0,
            keyframe_angle: 20.0,
        }
    }
}
