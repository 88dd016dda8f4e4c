//! Picture of a path and its search tree over a slice of the map.

use crate::map_picture;
use anyhow::Context;
use std::path::Path;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, Axis, SliceRequest};
use voxelastic_eval::colour::Rgb;
use voxelastic_eval::grid_view::{Dot, GridView, Line};
use voxelastic_io::Origin;
use voxelastic_plan::{Plan, Point, Request};

const TREE: Rgb = [232, 120, 110];
const PATH: Rgb = [28, 84, 200];
const START: Rgb = [30, 150, 60];
const GOAL: Rgb = [205, 30, 40];
/// Margin around the tree and the path, metres.
const MARGIN: f32 = 3.0;
/// A path with a larger height difference is drawn over a slice at its median height, metres.
const FLAT: f64 = 1.0;

/// Draws the picture, with the coordinates of the map frame: `origin` is that of the map.
pub fn draw(file: &Path, map: &AtlasQuery<'_>, request: &Request, plan: &Plan, origin: Origin) -> anyhow::Result<()> {
    let slice = slice_request(map, request, plan);
    let image = map.slice(&slice);
    let cells = map_picture::cells(&image.states);
    let flat = |p: &Point| {
        let [x, y, _] = origin.point_to_map(*p);
        [x, y]
    };
    let branches = plan.tree.iter().filter_map(|(p, parent)| Some((p, plan.tree.get((*parent)? as usize)?)));
    let mut lines: Vec<Line> = branches.map(|(p, (q, _))| Line { points: vec![flat(q), flat(p)], colour: TREE, width: 1.0 }).collect();
    lines.push(Line { points: plan.path.iter().map(flat).collect(), colour: PATH, width: 4.0 });
    let end = |p: Option<&Point>, colour| p.map(|p| Dot { at: flat(p), colour, radius: 8.0 });
    let dots = [end(plan.path.first(), START), end(plan.path.last(), GOAL)].into_iter().flatten().collect();
    let at = slice.at + origin.coordinates()[2];
    let to = if slice.thickness > 0.0 { format!(" to {:.2}", at + slice.thickness) } else { String::new() };
    let title = format!("{:.1} m, radius {:.2} m, map at z = {at:.2}{to} m", plan.length, request.robot.radius);
    let legend = [(TREE, "tree"), (PATH, "path"), (START, "start"), (GOAL, "goal")];
    let drawing = GridView {
        title,
        labels: ["x [m]", "y [m]"],
        origin: [0, 1].map(|k| f64::from(slice.bounds.min[k]) + origin.coordinates()[k]),
        pixel: slice.pixel,
        size: [image.width, image.height],
        cells: &cells,
        legend: map_picture::LEGEND.into_iter().chain(legend).map(|(colour, text)| (colour, text.to_owned())).collect(),
        lines,
        dots,
    };
    drawing.write_png(file).with_context(|| format!("cannot draw {}", file.display()))
}

/// The slice: all heights that the robot covers, or that of the median waypoint.
fn slice_request(map: &AtlasQuery<'_>, request: &Request, plan: &Plan) -> SliceRequest {
    let mut bounds = Aabb::default();
    plan.tree.iter().map(|(p, _)| p).chain(&plan.path).for_each(|p| bounds.add(p.map(|c| c as f32)));
    bounds.min = bounds.min.map(|c| c - MARGIN);
    bounds.max = bounds.max.map(|c| c + MARGIN);
    let mut heights: Vec<f64> = plan.path.iter().map(|p| p[2]).collect();
    heights.sort_by(f64::total_cmp);
    let (low, high) = (heights.first().copied().unwrap_or_default(), heights.last().copied().unwrap_or_default());
    let radius = request.robot.radius;
    let (at, thickness) = if high - low <= FLAT { (low - radius, high - low + 2.0 * radius) } else { (heights[heights.len() / 2], 0.0) };
    SliceRequest { axis: Axis::Z, at, thickness, pixel: map_picture::pixel(map.voxel_size(), bounds.size()), bounds }
}
