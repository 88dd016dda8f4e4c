//! One LiDAR cloud as it enters the system, before any projection.

use crate::Motion;

/// A LiDAR cloud in the lidar frame L, in metres.
///
/// Optional channels are either absent or exactly as long as [`Cloud::points`]. A point with a NaN or all-zero
/// coordinate is "no return"; it is kept so that an organised cloud keeps its pixel grid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Coordinates x, y, z in the lidar frame, metres.
    pub points: Vec<[f32; 3]>,
    /// Columns of an organised cloud; for an unorganised cloud the number of points.
    pub width: usize,
    /// Rows (rings) of an organised cloud; 1 for an unorganised cloud. Row-major: point `row * width + column`.
    pub height: usize,
    /// Return strength in the sensor's own scale (intensity or reflectivity).
    pub intensity: Option<Vec<f32>>,
    /// Colour of each point, sRGB; [0, 0, 0] where it has none.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Ring (row) of each point, 0-based, in the sensor's own order.
    pub ring: Option<Vec<u16>>,
    /// Time of each point in seconds, relative to the cloud's time stamp.
    pub time: Option<Vec<f32>>,
    /// How the lidar moved during the sweep, where that is known; the points are then set right by their times when the cloud is mapped.
    pub motion: Option<Motion>,
}

impl Cloud {
    /// An unorganised cloud of bare points.
    pub fn from_points(points: Vec<[f32; 3]>) -> Self {
        Self { width: points.len(), height: 1, points, ..Self::default() }
    }

    /// Number of points, returns or not.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the cloud holds no point at all.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Whether the points form a grid of rings x columns.
    pub fn is_organised(&self) -> bool {
        self.height > 1 && self.width * self.height == self.points.len()
    }

    /// Whether `p` is a measured return: finite and not the origin.
    #[inline]
    pub fn is_return([x, y, z]: &[f32; 3]) -> bool {
        // Without a branch: which points are returns is as good as random.
        (x.is_finite() & y.is_finite() & z.is_finite()) & ((*x != 0.0) | (*y != 0.0) | (*z != 0.0))
    }
}
