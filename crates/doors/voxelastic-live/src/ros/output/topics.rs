//! Names, types and delivery of the topics that are published.

use crate::link::Urgency;
use crate::ros::middleware::{Delivery, TopicProfile};
use crate::ros::names::Names;

/// The frame of the map.
pub const MAP_FRAME: &str = "map";

/// A topic that is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Triangle meshes.
    Surface,
    /// Their vertices.
    SurfacePoints,
    /// Points on things that move.
    MovingPoints,
    /// Free and occupied space.
    Octomap,
    /// The 2-D map of the storey that the robot is on.
    Grid,
    /// What has changed in it.
    GridUpdates,
    /// The costs of that map.
    GlobalCostmap,
    /// What has changed in them.
    GlobalCostmapUpdates,
    /// The costs around the robot.
    LocalCostmap,
    /// Distances to the nearest surface, around the robot.
    DistanceSlice,
    /// Poses of the scans.
    Path,
    /// Where free space meets unknown space.
    Frontier,
    /// The path of a robot that explores.
    ExplorePath,
    /// Its end.
    ExploreGoal,
    /// Root poses of the submaps.
    Submaps,
    /// How the node is.
    Diagnostics,
    /// Frames.
    Transforms,
}

impl Output {
    /// Whether it is about a robot that explores.
    pub fn is_of_exploration(self) -> bool {
        matches!(self, Self::Frontier | Self::ExplorePath | Self::ExploreGoal)
    }

    /// Whether a link of limited rate could not carry it: the page of the viewer has the same in a tenth of the bytes.
    pub fn is_large(self) -> bool {
        matches!(self, Self::Surface | Self::SurfacePoints | Self::MovingPoints | Self::Octomap | Self::DistanceSlice)
    }

    /// How urgent it is where a link limits what goes out, of what is published then.
    pub fn urgency(self) -> Urgency {
        match self {
            Self::Grid | Self::GridUpdates | Self::GlobalCostmap | Self::GlobalCostmapUpdates | Self::LocalCostmap => Urgency::Soon,
            // Small, and some of it seldom.
            _ => Urgency::AtOnce,
        }
    }
}

/// The topics of a node.
pub fn profiles(names: &Names) -> Vec<(Output, TopicProfile)> {
    use Delivery::{Latched, Periodic, Reliable};
    use Output::{
        Diagnostics, DistanceSlice, ExploreGoal, ExplorePath, Frontier, GlobalCostmap, GlobalCostmapUpdates, Grid, GridUpdates, LocalCostmap,
        MovingPoints, Octomap, Path, Submaps, Surface, SurfacePoints, Transforms,
    };
    let own = |name: &str| names.resolve(&format!("~/{name}"));
    // What is sent in parts is sent again to those who come, so it need not be kept: a reader of parts that are kept would show what is gone.
    [
        (Surface, own("surface"), "visualization_msgs/msg/MarkerArray", Reliable, 20),
        (SurfacePoints, own("surface_points"), "sensor_msgs/msg/PointCloud2", Reliable, 20),
        (MovingPoints, own("moving_points"), "sensor_msgs/msg/PointCloud2", Reliable, 20),
        (Octomap, own("octomap"), "octomap_msgs/msg/Octomap", Latched, 1),
        (Grid, own("grid"), "nav_msgs/msg/OccupancyGrid", Latched, 1),
        (GridUpdates, own("grid") + "_updates", "map_msgs/msg/OccupancyGridUpdate", Reliable, 50),
        (GlobalCostmap, own("global_costmap"), "nav_msgs/msg/OccupancyGrid", Latched, 1),
        (GlobalCostmapUpdates, own("global_costmap") + "_updates", "map_msgs/msg/OccupancyGridUpdate", Reliable, 50),
        (LocalCostmap, own("local_costmap"), "nav_msgs/msg/OccupancyGrid", Latched, 1),
        (DistanceSlice, own("distance_slice"), "sensor_msgs/msg/PointCloud2", Latched, 1),
        (Path, own("path"), "nav_msgs/msg/Path", Latched, 1),
        (Frontier, own("frontier"), "visualization_msgs/msg/MarkerArray", Latched, 1),
        (ExplorePath, own("explore_path"), "nav_msgs/msg/Path", Latched, 1),
        (ExploreGoal, own("explore_goal"), "geometry_msgs/msg/PoseStamped", Latched, 1),
        (Submaps, own("submaps"), "geometry_msgs/msg/PoseArray", Latched, 1),
        (Diagnostics, names.resolve("/diagnostics"), "diagnostic_msgs/msg/DiagnosticArray", Periodic, 10),
        (Transforms, names.resolve("/tf"), "tf2_msgs/msg/TFMessage", Periodic, 100),
    ]
    .into_iter()
    .map(|(output, name, kind, delivery, depth)| (output, TopicProfile { name, kind: kind.to_owned(), delivery, depth }))
    .collect()
}
