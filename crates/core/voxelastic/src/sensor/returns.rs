//! The usable returns of a scan.

/// The usable returns of one scan, one entry a return in all vectors: pixel by pixel (row-major), and within a pixel in the order of the cloud. Returns whose
/// pixel shows a nearer one are included. Those of [scattered](crate::sensor::CloudLayout::Scattered) clouds are in the order of small cells in space, and points
/// between them may follow.
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

    /// Makes room for `more` points between returns.
    pub(super) fn reserve(&mut self, more: usize) {
        let Self { points, normals, roughness, ranges, origins, source, pixel, spacing, .. } = self;
        [points, normals].into_iter().for_each(|all| all.reserve(more));
        [roughness, ranges, spacing].into_iter().for_each(|all| all.reserve(more));
        [source, pixel].into_iter().for_each(|all| all.reserve(more));
        if !origins.is_empty() {
            origins.reserve(more);
        }
    }

    /// Adds a point on the way from return `i` to return `j`, at `share` of it. What is not measured in metres is that of the nearer return.
    pub(super) fn push_between(&mut self, i: usize, j: usize, share: f32) {
        let nearest = if share <= 0.5 { i } else { j };
        let mix = |a: [f32; 3], b: [f32; 3]| -> [f32; 3] { std::array::from_fn(|k| a[k] + share * (b[k] - a[k])) };
        let normal = mix(self.normals[i], self.normals[j]);
        let length = normal.iter().map(|c| c * c).sum::<f32>().sqrt();
        self.points.push(mix(self.points[i], self.points[j]));
        self.normals.push(normal.map(|c| c / length));
        self.roughness.push(self.roughness[nearest]);
        self.ranges.push(self.ranges[i] + share * (self.ranges[j] - self.ranges[i]));
        if !self.origins.is_empty() {
            self.origins.push(mix(self.origins[i], self.origins[j]));
        }
        self.source.push(self.source[nearest]);
        self.pixel.push(self.pixel[nearest]);
        self.spacing.push(self.spacing[nearest]);
    }

    /// Whether the scan has no usable return.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
