//! The usable returns of a scan.

/// The usable returns of one scan, one entry a return in all vectors: pixel by pixel (row-major), and within a pixel in the order of the cloud. Returns whose
/// pixel shows a nearer one are included. Of [scattered](crate::sensor::CloudLayout::Scattered) clouds, points between returns may follow them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Returns {
    /// The measured points, lidar frame at the cloud's time stamp, metres.
    pub points: Vec<[f32; 3]>,
    /// Unit normals of the local surface, facing the sensor, lidar frame; zero where no plane could be trusted. Empty until planes are fitted.
    pub normals: Vec<[f32; 3]>,
    /// Deviation of the neighbours from the local plane along its normal, metres (1 sigma); zero where there is no plane. Empty until planes are fitted.
    pub roughness: Vec<f32>,
    /// Distances from the origins of the beams to the points, metres.
    pub ranges: Vec<f32>,
    /// Position of the lidar when it measured each point, lidar frame at the cloud's time stamp, metres; empty when it stood still.
    pub origins: Vec<[f32; 3]>,
    /// Index of each point in the cloud.
    pub source: Vec<u32>,
    /// Pixel of the range image (row * columns + column) that each point falls into; a larger number for points of scattered clouds that have none.
    pub pixel: Vec<u32>,
    /// Distance between returns around each point, metres, of scattered clouds; else empty. Empty until planes are fitted.
    pub spacing: Vec<f32>,
    /// Number of points that were measured; those after them lie between returns on one plane, and are for surfaces only.
    pub measured: usize,
    /// Smallest angle between adjacent beams, radians.
    pub smallest_angle: f32,
}

impl Returns {
    /// Number of usable returns, and points between them.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the scan has no usable return.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
