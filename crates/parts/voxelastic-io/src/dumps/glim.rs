//! GLIM's dump.
//!
//! ```text
//! dump/
//!   000000/data.txt             id, T_world_origin (4 x 4), .., stamp of each frame
//!   000000/points_compact.bin   the submap's points, its own frame: x y z as 32-bit floats
//!   graph.txt, graph.bin, ..    the factor graph, in GTSAM's own format: not read
//! ```
//!
//! Layout from the project's `src/glim/mapping/sub_map.cpp` (`SubMap::save`); `points_compact.bin` is gtsam_points' `save_compact`. A
//! submap holds the points of a second or more of scans; it is mapped as one scan from its origin.

use super::dump::{Dump, numbered_folders};
use super::labelled_text::LabelledText;
use crate::Result;
use std::path::Path;

/// Name of the points of a submap.
const POINTS: &str = "points_compact.bin";

pub(super) fn find(path: &Path) -> Result<Option<Dump>> {
    let submaps: Vec<_> = numbered_folders(path, "data.txt").into_iter().filter(|(_, folder)| folder.join(POINTS).is_file()).collect();
    if submaps.is_empty() {
        return Ok(None);
    }
    let mut dump = Dump::new("GLIM dump", "T_world_origin in the data.txt of each submap");
    dump.notes.push("each submap is mapped as one scan from its origin: free space is approximate".into());
    for (number, folder) in submaps {
        let text = LabelledText::read(&folder.join("data.txt"))?;
        let Some(origin) = text.labels("T_world_origin").next() else {
            dump.without_pose.push(folder.join(POINTS));
            continue;
        };
        // The origin is the frame in the middle.
        let stamps: Vec<usize> = text.labels("stamp").collect();
        let stamp = stamps.get(stamps.len() / 2).map(|at| text.numbers::<1>(*at)).transpose()?;
        dump.add(folder.join(POINTS), number, stamp.map_or(number as f64, |[stamp]| stamp), text.pose(origin)?);
    }
    Ok(Some(dump.in_order()))
}
