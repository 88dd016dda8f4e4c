//! What `path.json` holds. The keys are documented in README.md and stay as they are; further ones may come.

use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;
use voxelastic::query::UnknownAs;
use voxelastic_plan::{Plan, Point, Request, anchor, distance, sharpest_turn};

/// Version of the file.
const FORMAT: u32 = 1;

/// Everything about a path. Points are in the map frame, metres.
#[derive(Debug, Serialize)]
pub struct PathFile {
    format: u32,
    generator: &'static str,
    map: PathBuf,
    frame: &'static str,
    #[serde(flatten)]
    pub figures: Figures,
    path: Vec<Point>,
    clearance_m: Vec<f64>,
    anchors: Vec<AnchorRecord>,
    tree: TreeRecord,
}

/// Request and result in numbers.
#[derive(Debug, Serialize)]
pub struct Figures {
    start: Point,
    goal: Point,
    radius_m: f64,
    ground: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    height_m: Option<f64>,
    unknown: &'static str,
    seed: u64,
    length_m: f64,
    straight_m: f64,
    least_clearance_m: f64,
    sharpest_turn_deg: f64,
    first_path_s: f64,
    first_path_m: f64,
    time_s: f64,
    samples: usize,
}

/// Where a waypoint is tied to the map: in the frame of the lidar at a pose-graph node.
#[derive(Debug, Serialize)]
struct AnchorRecord {
    node: NodeId,
    place: Point,
}

/// The tree of states: each is reached from its parent, the first from nowhere.
#[derive(Debug, Serialize)]
struct TreeRecord {
    points: Vec<Point>,
    parents: Vec<Option<u32>>,
}

impl Figures {
    pub fn new(request: &Request, plan: &Plan) -> Self {
        let ends = [plan.path.first(), plan.path.last()].map(|p| p.copied().unwrap_or_default());
        Self {
            start: ends[0],
            goal: ends[1],
            radius_m: request.robot.radius,
            ground: request.robot.ground.is_some(),
            height_m: plan.height,
            unknown: if request.robot.unknown == UnknownAs::Free { "free" } else { "occupied" },
            seed: request.seed,
            length_m: plan.length,
            straight_m: distance(ends[0], ends[1]),
            least_clearance_m: plan.least_clearance,
            sharpest_turn_deg: sharpest_turn(&plan.path),
            first_path_s: plan.first.seconds,
            first_path_m: plan.first.length,
            time_s: plan.seconds,
            samples: plan.samples,
        }
    }
}

impl PathFile {
    pub fn new(map: &Path, atlas: &Atlas, plan: &Plan, figures: Figures) -> Self {
        let anchors = anchor(atlas, &plan.path).into_iter().map(|a| AnchorRecord { node: a.node, place: a.place });
        // A tenth of a millimetre is enough to draw with.
        let short = |p: Point| p.map(|c| (c * 1e4).round() / 1e4);
        let (points, parents) = plan.tree.iter().map(|(p, parent)| (short(*p), *parent)).unzip();
        Self {
            format: FORMAT,
            generator: concat!("voxelastic ", env!("CARGO_PKG_VERSION")),
            map: map.to_path_buf(),
            frame: "map",
            figures,
            path: plan.path.clone(),
            clearance_m: plan.clearance.clone(),
            anchors: anchors.collect(),
            tree: TreeRecord { points, parents },
        }
    }
}
