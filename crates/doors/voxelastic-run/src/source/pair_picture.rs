//! Two scans on each other, from above.

use super::sample::Examination;
use crate::error::{Error, Result};
use std::collections::HashMap;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::geometry::{PoseExt, Rigid};
use voxelastic_eval::colour::Rgb;
use voxelastic_eval::grid_view::GridView;
use voxelastic_slam::pose_check::CheckScan;

const FIRST: Rgb = [214, 96, 34];
const SECOND: Rgb = [38, 96, 190];
const BOTH: Rgb = [40, 44, 52];
const PAPER: Rgb = [255, 255, 255];
/// Edge of a cell, metres, and how far around the lidar is drawn.
const PIXEL: f64 = 0.1;
const HALF: usize = 250;
/// Columns between two drawings.
const GAP: usize = 12;

/// Draws the pair of scans that lies farthest apart, from above.
///
/// # Errors
/// A picture that cannot be written.
pub fn draw_pair(file: &Path, found: &Examination, t_base_lidar: Option<&Pose>) -> Result<()> {
    let track = &found.sample.track;
    let distance = |(a, b): &&(CheckScan, CheckScan)| track[a.index()].1.translation_distance(&track[b.index()].1);
    let Some((first, second)) = found.sample.pairs.iter().max_by(|a, b| distance(a).total_cmp(&distance(b))) else { return Ok(()) };
    let given = track[first.index()].1.inv_mul(&track[second.index()].1);
    let best = found.poses.as_ref().and_then(|check| check.motion_under_best_reading(track, t_base_lidar, (first.index(), second.index())));
    let drawings: Vec<Vec<Rgb>> = [Some(given), best].into_iter().flatten().map(|motion| cells(first, second, &motion)).collect();
    let side = 2 * HALF;
    let width = drawings.len() * side + (drawings.len() - 1) * GAP;
    let mut all = vec![PAPER; width * side];
    for (k, drawing) in drawings.iter().enumerate() {
        for (row, cells) in drawing.chunks(side).enumerate() {
            let start = row * width + k * (side + GAP);
            all[start..start + side].copy_from_slice(cells);
        }
    }
    let title = if drawings.len() == 2 {
        "two scans from above: by the poses as they are (left), and as the scans agree (right)"
    } else {
        "two scans from above, by their poses"
    };
    let view = GridView {
        title: title.to_owned(),
        labels: ["x [m]", "y [m]"],
        origin: [-(HALF as f64) * PIXEL; 2],
        pixel: PIXEL,
        size: [width, side],
        cells: &all,
        legend: vec![(FIRST, "one scan".to_owned()), (SECOND, "the other".to_owned()), (BOTH, "both".to_owned())],
        ..GridView::default()
    };
    view.write_png(file)
        .map_err(|error| Error::new(format!("cannot draw {}: {error}", file.display()), "name a PNG file in a folder that can be written"))
}

/// The cells that the points of two scans are in, around the first lidar.
fn cells(first: &CheckScan, second: &CheckScan, motion: &Pose) -> Vec<Rgb> {
    let side = 2 * HALF;
    let moved = Rigid::from(motion);
    let mut scans_of: HashMap<usize, u8> = HashMap::new();
    let points = first.points().iter().map(|p| (*p, 1)).chain(second.points().iter().map(|p| (moved.apply(*p), 2)));
    for (p, scan) in points {
        let cell = |v: f32| (f64::from(v) / PIXEL).floor() as i64 + HALF as i64;
        if let (Ok(x), Ok(y)) = (usize::try_from(cell(p[0])), usize::try_from(cell(p[1])))
            && x < side
            && y < side
        {
            *scans_of.entry(y * side + x).or_default() |= scan;
        }
    }
    let colour = |k: usize| match scans_of.get(&k) {
        None => PAPER,
        Some(1) => FIRST,
        Some(2) => SECOND,
        Some(_) => BOTH,
    };
    (0..side * side).map(colour).collect()
}
