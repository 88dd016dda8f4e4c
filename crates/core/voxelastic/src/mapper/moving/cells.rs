//! A range image and its planes in six bytes a pixel, to be kept.

use super::packed_plane::PackedPlane;
use crate::sensor::{NO_POINT, PreparedScan, RangeImage};
use rayon::prelude::*;

/// Ranges are stored in steps of this, metres.
pub(super) const STEP: f32 = 0.02;
/// A cell without return.
pub(super) const HOLE: u16 = u16::MAX;
/// Most steps.
const FARTHEST: f32 = 65_000.0;
/// Pixels of a row are joined until there are at most so many cells.
const MOST_COLUMNS: usize = 1024;

/// The nearest return of each cell of a range image, a cell being one or several pixels of a row.
#[derive(Clone, Debug)]
pub(in crate::mapper) struct Cells {
    pub rows: usize,
    pub columns: usize,
    /// A cell is so many pixels wide, as a power of two.
    pub shift: u32,
    /// In steps, at least one; or [`HOLE`].
    pub steps: Vec<u16>,
    /// The plane at the return of each cell.
    pub planes: Vec<PackedPlane>,
}

impl Cells {
    /// What a scan saw from its pose at the time stamp. Returns without a plane are taken to have none.
    pub fn new(scan: &PreparedScan) -> Self {
        let image = scan.view_from_one_pose(false).0;
        let mut cells = Self::of_image(image);
        let returns = &scan.returns;
        if returns.normals.len() < returns.measured {
            return cells;
        }
        // The returns that the image shows are few of all, and in the order of its pixels, unless the sensor moved.
        let mut at_point: Vec<u32> = vec![NO_POINT; returns.source.iter().take(returns.measured).max().map_or(0, |&last| last as usize + 1)];
        (0u32..).zip(&returns.source[..returns.measured]).for_each(|(i, &source)| at_point[source as usize] = i);
        let plane = |pixel: usize| {
            let i = *at_point.get(image.points[pixel] as usize)?;
            let (normal, point) = (returns.normals.get(i as usize)?, returns.points[i as usize]);
            Some(PackedPlane::new(*normal, point))
        };
        let (columns, shift) = (cells.columns, cells.shift);
        cells.planes.par_chunks_mut(columns).enumerate().for_each(|(row, planes)| {
            for (c, out) in planes.iter_mut().enumerate() {
                let pixels = row * image.columns + (c << shift)..row * image.columns + ((c + 1) << shift).min(image.columns);
                let nearest = pixels.filter(|&pixel| image.ranges[pixel] > 0.0).min_by(|&a, &b| image.ranges[a].total_cmp(&image.ranges[b]));
                *out = nearest.and_then(plane).unwrap_or(PackedPlane::NONE);
            }
        });
        cells
    }

    /// As [`new`](Self::new), without planes.
    pub fn of_image(image: &RangeImage) -> Self {
        // Beyond the maximum range is no farther than that, for all that is known.
        let farthest = image.ranges.iter().copied().filter(|range| range.is_finite()).fold(0.0, f32::max).min(FARTHEST * STEP);
        let steps = |&range: &f32| {
            let steps = if range < farthest { range / STEP } else { farthest / STEP };
            if range > 0.0 { (steps as i32 as u16).max(1) } else { HOLE }
        };
        let mut cells =
            Self { rows: image.rows, columns: image.columns, shift: 0, steps: image.ranges.iter().map(steps).collect(), planes: Vec::new() };
        while cells.columns > MOST_COLUMNS {
            let (columns, half) = (cells.columns, cells.columns.div_ceil(2));
            let pairs = cells.steps.chunks_exact(columns).flat_map(|row| row.chunks(2).map(|pair| pair.iter().copied().min().unwrap_or(HOLE)));
            cells.steps = pairs.collect();
            (cells.columns, cells.shift) = (half, cells.shift + 1);
        }
        cells.planes = vec![PackedPlane::NONE; cells.steps.len()];
        cells
    }
}
