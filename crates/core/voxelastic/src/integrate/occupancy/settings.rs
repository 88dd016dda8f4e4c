//! Settings of occupancy integration.

/// How scans update occupancy. Lengths in metres, evidence in log-odds.
#[derive(Clone, Debug, PartialEq)]
pub struct OccupancySettings {
    /// Edge of the finest voxel, metres.
    pub voxel_size: f32,
    /// Largest range that is integrated, metres.
    pub max_range: f32,
    /// Evidence of one scan that a voxel is free (negative).
    pub free: f32,
    /// Evidence of one scan that a voxel is occupied. Much larger than `free`: a return proves that something is there, while rays that pass may have passed a
    /// thin object on both sides.
    pub hit: f32,
    /// Smallest log-odds; a voxel with this value is saturated free.
    pub min: f32,
    /// Largest log-odds.
    pub max: f32,
    /// Range noise, 1 sigma, constant part, metres.
    pub sigma: f32,
    /// Range noise, 1 sigma, per metre of range.
    pub sigma_per_metre: f32,
    /// Thickness that a surface is assumed to have behind its return, voxels of the integration scale.
    pub thickness_voxels: f32,
    /// Whether a ray without return clears the space up to the maximum range.
    pub clear_no_return: bool,
    /// Radius around the sensor within which space counts as observed once as free, unless it was observed occupied or is hidden behind what was, metres; 0 for
    /// none. At most 128 voxels are used.
    pub robot_radius: f32,
    /// How far that space reaches along the sensor's own z axis, to both sides, metres.
    pub robot_height: f32,
}

/// Largest radius of the robot's own space, finest voxels.
pub(super) const MAX_ROBOT_RADIUS_VOXELS: f32 = 128.0;

impl Default for OccupancySettings {
    fn default() -> Self {
        Self {
            voxel_size: 0.065,
            max_range: 60.0,
            free: -0.5,
            hit: 2.2,
            min: -2.0,
            max: 3.5,
            sigma: 0.02,
            sigma_per_metre: 0.0005,
            thickness_voxels: 1.5,
            clear_no_return: false,
            robot_radius: 0.0,
            robot_height: f32::INFINITY,
        }
    }
}
