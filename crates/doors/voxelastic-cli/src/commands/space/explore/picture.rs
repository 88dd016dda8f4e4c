//! Picture of an exploration: the map from above, the true path coloured by time, and what is left of the frontier.

use super::course::Course;
use super::robot::SimulatedRobot;
use crate::map_picture;
use anyhow::Context;
use std::path::Path;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, Axis, SliceRequest};
use voxelastic_eval::colour::{Ramp, Rgb};
use voxelastic_eval::grid_view::{Dot, GridView, Line};
use voxelastic_explore::ExploreSettings;

const FRONTIER: Rgb = [226, 112, 46];
const HOME: Rgb = [30, 150, 60];

/// Draws the picture.
pub fn draw(file: &Path, robot: &SimulatedRobot, course: &Course, settings: &ExploreSettings) -> anyhow::Result<()> {
    let map = AtlasQuery::new(robot.atlas());
    let [low, high] = settings.bounds;
    let known = map.bounds();
    let mut bounds = Aabb { min: low.map(|c| c as f32), max: high.map(|c| c as f32) };
    (0..2).for_each(|k| (bounds.min[k], bounds.max[k]) = (bounds.min[k].max(known.min[k]), bounds.max[k].min(known.max[k])));
    let start = robot.start();
    let slice = SliceRequest { axis: Axis::Z, at: start[2], thickness: 0.0, pixel: map_picture::pixel(map.voxel_size(), bounds.size()), bounds };
    let image = map.slice(&slice);
    let cells = map_picture::cells(&image.states);
    let steps = robot.track.len().max(2) - 1;
    let lines = robot.track.windows(2).enumerate().map(|(i, ends)| Line {
        points: ends.iter().map(|p| [p[0], p[1]]).collect(),
        colour: Ramp::Rainbow.at(i as f32 / steps as f32),
        width: 3.0,
    });
    let frontier = course.frontier.iter().map(|cluster| Dot { at: [cluster.centre[0], cluster.centre[1]], colour: FRONTIER, radius: 4.0 });
    let home = Dot { at: [start[0], start[1]], colour: HOME, radius: 8.0 };
    let legend = [(Ramp::Rainbow.at(0.0), "first"), (Ramp::Rainbow.at(1.0), "last"), (FRONTIER, "frontier left"), (HOME, "home")];
    let known = 100.0 * course.share();
    let half = course.shares().find(|(_, share)| *share >= 0.5 * course.share()).map_or(0.0, |(time, _)| time);
    let drawing = GridView {
        title: format!("{known:.1} % known after {:.0} m in {:.0} s, half of it after {half:.0} s", robot.distance(), robot.time()),
        labels: ["x [m]", "y [m]"],
        origin: [slice.bounds.min[0], slice.bounds.min[1]].map(f64::from),
        pixel: slice.pixel,
        size: [image.width, image.height],
        cells: &cells,
        legend: map_picture::LEGEND.into_iter().chain(legend).map(|(colour, text)| (colour, text.to_owned())).collect(),
        lines: lines.collect(),
        dots: frontier.chain([home]).collect(),
    };
    drawing.write_png(file).with_context(|| format!("cannot draw {}", file.display()))
}
