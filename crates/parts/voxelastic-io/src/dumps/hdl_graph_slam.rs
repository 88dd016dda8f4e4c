//! hdl_graph_slam's dump service.
//!
//! ```text
//! dump/
//!   000000/cloud.pcd   the keyframe's cloud, lidar frame
//!   000000/data        stamp SEC NSEC, estimate (4 x 4), odom (4 x 4), id NODE, and more
//!   graph.g2o          the pose graph, with planes and priors besides
//! ```
//!
//! Layout from the project's `src/hdl_graph_slam/keyframe.cpp` (`KeyFrame::save`). The poses are the estimates.

use super::dump::{Dump, numbered_folders};
use super::labelled_text::LabelledText;
use crate::{Result, g2o};
use std::path::Path;

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let keyframes: Vec<_> = numbered_folders(path, "data").into_iter().filter(|(_, folder)| folder.join("cloud.pcd").is_file()).collect();
    if keyframes.is_empty() {
        return Ok(None);
    }
    let mut dump = Dump::new("hdl_graph_slam dump", "estimate in the data of each keyframe");
    for (number, folder) in keyframes {
        let text = LabelledText::read(&folder.join("data"))?;
        let Some(estimate) = text.labels("estimate").next() else {
            dump.without_pose.push(folder.join("cloud.pcd"));
            continue;
        };
        let stamp = text.labels("stamp").next().map(|at| text.numbers::<2>(at)).transpose()?;
        let id = text.labels("id").next().map(|at| text.numbers::<1>(at)).transpose()?;
        let time = stamp.map_or(number as f64, |[seconds, nanoseconds]| seconds + nanoseconds * 1e-9);
        let node = id.map_or(number, |[id]| id.max(0.0) as u64);
        dump.add(folder.join("cloud.pcd"), node, time, text.pose(estimate)?);
    }
    let graph = path.join("graph.g2o");
    if graph.is_file() {
        dump.graph = Some((graph.clone(), g2o::read(&graph)?));
    }
    Ok(Some(dump.in_order()))
}
