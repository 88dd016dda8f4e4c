//! Why there is no ground.

/// Why the ground of a map cannot be found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GroundError {
    /// The map has surfaces only.
    #[error("the map has no occupancy, so nothing says what is free and what is unknown")]
    NoOccupancy,
    /// Cells that the map cannot fill.
    #[error("cells of {resolution} m in a map with voxels of {finest:.3} m")]
    Resolution {
        /// What was asked for, metres.
        resolution: f64,
        /// The finest voxel of the map, metres.
        finest: f64,
    },
    /// A grid that does not fit in memory.
    #[error("the map has {} x {} cells and is {high} voxels high", size[0], size[1])]
    TooLarge {
        /// Cells along x and y.
        size: [usize; 2],
        /// Voxels along z.
        high: usize,
    },
    /// A number of the robot that has no meaning.
    #[error("the robot's {what} is {value}: must be {must}")]
    Robot {
        /// Which.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        must: &'static str,
    },
    /// Nothing under the sensor's way carries a robot.
    #[error("no floor is seen below the places where the {scans} scans were taken")]
    NoFloor {
        /// Scans that were looked below.
        scans: usize,
    },
}

impl GroundError {
    /// What helps.
    pub fn remedy(&self) -> String {
        match self {
            Self::NoOccupancy => "map the data again with --field occupancy or --field both".to_owned(),
            Self::Resolution { finest, .. } => format!("use {:.3} to {:.1} m", 0.5 * finest, 100.0 * finest),
            Self::TooLarge { .. } => "use larger cells".to_owned(),
            Self::Robot { must, .. } => format!("use {must}"),
            Self::NoFloor { .. } => {
                "check that z points up in the map and that the sensor saw the floor: `voxelastic slice MAP --axis y` shows both".to_owned()
            }
        }
    }
}
