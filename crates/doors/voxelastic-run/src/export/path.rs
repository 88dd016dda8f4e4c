//! A planned path as a file (`path.json`), written and read. Its keys are documented and stable; further keys may be added.

use crate::error::{Error, Result};
use crate::map_files::LoadedMap;
use serde::{Deserialize, Serialize};
use std::path::Path;
use voxelastic::event::NodeId;
use voxelastic::query::UnknownAs;
use voxelastic_io::Origin;
use voxelastic_plan::{Anchor, Plan, Point, Request, Robot, Wheels, anchor_path, distance, sharpest_turn};
use voxelastic_report::content::PlannedPath;

/// Version of the file.
const FORMAT: u32 = 1;

/// A planned path. Points are in the map frame, metres.
#[derive(Debug, Serialize)]
pub struct PathFile {
    format: u32,
    generator: &'static str,
    map: String,
    frame: &'static str,
    /// The request, and the properties of the path.
    #[serde(flatten)]
    pub figures: Figures,
    path: Vec<Point>,
    clearance_m: Vec<f64>,
    anchors: Vec<AnchorRecord>,
    tree: TreeRecord,
}

/// The request, and the properties of the path.
#[derive(Debug, Serialize)]
pub struct Figures {
    start: Point,
    goal: Point,
    radius_m: f64,
    ground: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    height_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    step_m: Option<f64>,
    unknown: &'static str,
    seed: u64,
    length_m: f64,
    straight_m: f64,
    least_clearance_m: f64,
    sharpest_turn_deg: f64,
    first_path_s: f64,
    first_path_samples: usize,
    first_path_m: f64,
    time_s: f64,
    samples: usize,
}

/// Anchor of a waypoint: its position in the lidar frame at a pose-graph node.
#[derive(Debug, Serialize, Deserialize)]
struct AnchorRecord {
    node: NodeId,
    place: Point,
}

/// The search tree: points, and the index of the parent of each; none for a root.
#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(default)]
struct TreeRecord {
    points: Vec<Point>,
    parents: Vec<Option<u32>>,
}

impl Figures {
    /// Of what was planned in a map with this origin.
    pub fn new(request: &Request, plan: &Plan, origin: Origin) -> Self {
        let ends = [plan.path.first(), plan.path.last()].map(|p| p.copied().unwrap_or_default());
        Self {
            start: origin.point_to_map(ends[0]),
            goal: origin.point_to_map(ends[1]),
            radius_m: request.robot.radius,
            ground: request.robot.ground.is_some(),
            height_m: plan.height,
            step_m: request.robot.ground.and_then(|wheels| wheels.step),
            unknown: if request.robot.unknown == UnknownAs::Free { "free" } else { "occupied" },
            seed: request.seed,
            length_m: plan.length,
            straight_m: distance(ends[0], ends[1]),
            least_clearance_m: plan.least_clearance,
            sharpest_turn_deg: sharpest_turn(&plan.path),
            first_path_s: plan.first.seconds,
            first_path_samples: plan.first.samples,
            first_path_m: plan.first.length,
            time_s: plan.seconds,
            samples: plan.samples,
        }
    }
}

impl PathFile {
    /// Of what was planned in `map`, which was loaded from `path`.
    pub fn new(path: &Path, map: &LoadedMap, plan: &Plan, figures: Figures) -> Self {
        let anchors = anchor_path(&map.atlas, &plan.path).into_iter().map(|a| AnchorRecord { node: a.node, place: a.position });
        // A tenth of a millimetre is enough to draw with.
        let short = |p: Point| map.origin.point_to_map(p).map(|c| (c * 1e4).round() / 1e4);
        let (points, parents) = plan.tree.iter().map(|(p, parent)| (short(*p), *parent)).unzip();
        Self {
            format: FORMAT,
            generator: concat!("voxelastic ", env!("CARGO_PKG_VERSION")),
            map: path.to_string_lossy().into_owned(),
            frame: "map",
            figures,
            path: plan.path.iter().map(|p| map.origin.point_to_map(*p)).collect(),
            clearance_m: plan.clearance.clone(),
            anchors: anchors.collect(),
            tree: TreeRecord { points, parents },
        }
    }
}

/// A path file as it is read: only `path` is required.
#[derive(Debug, Deserialize)]
pub struct StoredPath {
    #[serde(default = "format")]
    format: u32,
    /// Waypoints of the robot centre, map frame at the time of planning, metres.
    pub path: Vec<Point>,
    #[serde(default)]
    anchors: Vec<AnchorRecord>,
    #[serde(default)]
    tree: TreeRecord,
    start: Option<Point>,
    goal: Option<Point>,
    radius_m: Option<f64>,
    #[serde(default)]
    ground: bool,
    height_m: Option<f64>,
    step_m: Option<f64>,
    unknown: Option<String>,
}

fn format() -> u32 {
    FORMAT
}

impl StoredPath {
    /// Reads a path file, for a map with this origin: points have it taken off.
    pub fn read(file: &Path, origin: Origin) -> Result<Self> {
        let text = std::fs::read_to_string(file)
            .map_err(|e| Error::During { doing: format!("cannot read the planned path {}", file.display()), source: Box::new(e.into()) })?;
        let refuse = |why: String| Error::new(format!("{}: not a planned path: {why}", file.display()), "give a file that `voxelastic plan` wrote");
        let mut stored: Self = serde_json::from_str(&text).map_err(|e| refuse(e.to_string()))?;
        if stored.format != FORMAT {
            return Err(refuse(format!("its format is {}, supported is {FORMAT}", stored.format)));
        }
        let count = stored.tree.points.len();
        if stored.tree.parents.len() != count || stored.tree.parents.iter().flatten().any(|parent| *parent as usize >= count) {
            return Err(refuse("its tree has parents that do not exist".to_owned()));
        }
        let points = stored.path.iter_mut().chain(&mut stored.tree.points).chain(stored.start.iter_mut()).chain(stored.goal.iter_mut());
        points.for_each(|p| *p = origin.point_to_local(*p));
        Ok(stored)
    }

    /// The robot that it was planned for; `otherwise` has the values that the file lacks.
    pub fn robot(&self, otherwise: Robot) -> Robot {
        let wheels = otherwise.ground.unwrap_or_default();
        let wheels = Wheels { height: self.height_m.or(wheels.height), step: self.step_m.or(wheels.step) };
        Robot {
            radius: self.radius_m.unwrap_or(otherwise.radius),
            unknown: match self.unknown.as_deref() {
                Some("free") => UnknownAs::Free,
                Some(_) => UnknownAs::Blocked,
                None => otherwise.unknown,
            },
            ground: (self.ground || otherwise.ground.is_some()).then_some(wheels),
        }
    }

    /// The anchors of the waypoints; none if the file does not have one for each.
    pub fn anchors(&self) -> Option<Vec<Anchor>> {
        let anchors = self.anchors.iter().map(|a| Anchor { node: a.node, position: a.place });
        (self.anchors.len() == self.path.len()).then(|| anchors.collect())
    }

    /// The path and the search tree for a report.
    pub fn into_drawing(self) -> PlannedPath {
        let TreeRecord { points, parents } = self.tree;
        let branches = points.iter().zip(&parents).filter_map(|(p, parent)| Some([points[(*parent)? as usize], *p]));
        PlannedPath {
            start: self.start.or(self.path.first().copied()),
            goal: self.goal.or(self.path.last().copied()),
            tree: branches.collect(),
            path: self.path,
        }
    }
}
