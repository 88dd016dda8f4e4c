//! Settings of the search for loop closures.

/// What makes a closure. Lengths in voxels are those of the odometry: 0.2 m in a room, 0.7 m on a road.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LoopSettings {
    /// Edge of a voxel, metres; `None`: from the ranges of the first scan.
    pub voxel_size: Option<f64>,
    /// Nearest return that is used, metres.
    pub min_range: f64,
    /// Farthest return that is used, metres.
    pub max_range: f64,
    /// Length of path that makes a place, in voxels. A place begins every half of it.
    pub place_length: f64,
    /// Candidates for each place whose images are compared.
    pub most_compared: usize,
    /// Candidates for each place that are registered.
    pub most_registered: usize,
    /// Least correlation of the images.
    pub least_correlation: f32,
    /// Least share of the surfaces with a counterpart.
    pub least_overlap: f64,
    /// Least mean weight of the surfaces.
    pub least_score: f64,
    /// Largest share of surfaces in space that was observed to be free.
    pub most_contradiction: f64,
}

impl Default for LoopSettings {
    fn default() -> Self {
        Self {
            voxel_size: None,
            min_range: 0.5,
            max_range: 100.0,
            place_length: 50.0,
            most_compared: 20,
            most_registered: 3,
            least_correlation: 0.45,
            least_overlap: 0.4,
            least_score: 0.05,
            most_contradiction: 0.025,
        }
    }
}
