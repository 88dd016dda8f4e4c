//! Projection: the pixel and the range of every point of a cloud.

use super::beam_model::{AxialPoint, BeamModel};
use super::cloud_layout::{CloudLayout, Grid, ring_ends};
use super::range_limits::RangeLimits;
use crate::Cloud;
use crate::simd::{Kernel, dispatch, floor_positive, gather, larger, smaller};
use rayon::prelude::*;

/// The point is outside of the field of view. Codes are larger than any pixel.
pub(crate) const OUTSIDE: u32 = u32::MAX - 4;
/// The point is farther than the maximum range. Used for clouds in pixel order only, where the pixel is known anyway.
pub(crate) const BEYOND: u32 = u32::MAX - 3;
/// The point is nearer than the near limit.
pub(crate) const TOO_NEAR: u32 = u32::MAX - 2;
/// The point is no return.
pub(crate) const NO_RETURN: u32 = u32::MAX - 1;

/// Points of one kernel call; their angles stay in the first-level cache.
const CHUNK: usize = 512;
/// Most points of [`project_chunk`].
pub(crate) const PROJECT_CHUNK: usize = CHUNK;

/// Finds the pixels of points in the way that a layout allows.
#[derive(Clone, Debug)]
pub(crate) struct Projector {
    layout: CloudLayout,
    /// Pixel of each point of a grid that is not the image itself, for clouds of `map_size` rings x columns.
    map: Vec<u32>,
    map_size: (usize, usize),
    /// Row of each point of a cloud with rings.
    rows: Vec<u16>,
}

impl Projector {
    pub(crate) fn new(layout: CloudLayout, model: &BeamModel) -> Self {
        let clip = |rows: &mut Vec<u16>| rows.iter_mut().for_each(|row| *row = (*row).min(model.rows() as u16 - 1));
        let mut layout = layout;
        match &mut layout {
            CloudLayout::Grid(grid) => {
                clip(&mut grid.row_of_ring);
                grid.shift_of_ring.resize(grid.row_of_ring.len(), 0);
            }
            CloudLayout::Rings { row_of_ring } | CloudLayout::RingOrder { row_of_ring } => clip(row_of_ring),
            CloudLayout::Projected | CloudLayout::Scattered => {}
        }
        Self { layout, map: Vec::new(), map_size: (0, 0), rows: Vec::new() }
    }

    pub(crate) fn layout(&self) -> &CloudLayout {
        &self.layout
    }

    /// Writes each point's pixel, or the code why it has none, and its range, infinite beyond the maximum. Returns whether the index of a point is its pixel;
    /// only then [`BEYOND`] is used.
    pub(crate) fn pixels_of(&mut self, cloud: &Cloud, model: &BeamModel, limits: RangeLimits, pixels: &mut Vec<u32>, ranges: &mut Vec<f32>) -> bool {
        pixels.resize(cloud.len(), 0);
        ranges.resize(cloud.len(), 0.0);
        let points = &cloud.points;
        match &self.layout {
            CloudLayout::Grid(grid) => {
                if let Some(size) = grid.size_in(cloud, model) {
                    if grid.is_identity(model, size.1) {
                        project_in_place(points, model, limits, pixels, ranges);
                        return true;
                    }
                    if self.map_size != size {
                        self.map = pixel_map(grid, size, model);
                        self.map_size = size;
                    }
                    mapped(points, &self.map, model, limits, (pixels, ranges));
                    return false;
                }
            }
            CloudLayout::Rings { row_of_ring } => {
                if let Some(ring) = cloud.ring.as_ref().filter(|ring| ring.len() == points.len()) {
                    self.rows.clear();
                    self.rows.extend(ring.iter().map(|&r| row_of_ring.get(usize::from(r)).copied().unwrap_or(u16::MAX)));
                    project(points, Some(&self.rows), model, limits, pixels, ranges);
                    return false;
                }
            }
            CloudLayout::RingOrder { row_of_ring } => {
                let ends = ring_ends(points);
                // A missing ring would shift all rings below it by a row, so such a scan is projected instead.
                if ends.len() == row_of_ring.len() {
                    self.rows.clear();
                    for (&end, &row) in ends.iter().zip(row_of_ring) {
                        self.rows.resize(end as usize, row);
                    }
                    project(points, Some(&self.rows), model, limits, pixels, ranges);
                    return false;
                }
            }
            CloudLayout::Projected | CloudLayout::Scattered => {}
        }
        project(points, None, model, limits, pixels, ranges);
        false
    }
}

/// Pixel of each point of an organised cloud.
fn pixel_map(grid: &Grid, (rings, columns): (usize, usize), model: &BeamModel) -> Vec<u32> {
    let mut map = vec![0; rings * columns];
    for ring in 0..rings {
        let row = usize::from(grid.row_of_ring[ring]);
        for column in 0..columns {
            let upright = (column as i64 + i64::from(grid.shift_of_ring[ring])).rem_euclid(model.columns() as i64) as usize;
            let index = if grid.transposed { column * rings + ring } else { ring * columns + column };
            map[index] = (row * model.columns() + upright) as u32;
        }
    }
    map
}

/// The pixel or code, and the range, of a point measured in `pixel`, after the range gate.
#[inline(always)]
fn gate(point: &[f32; 3], pixel: u32, range: f32, limits: RangeLimits, beyond: u32) -> (u32, f32) {
    let sum = point[0] + point[1] + point[2];
    let is_return = (sum.abs() < f32::INFINITY) & ((point[0] != 0.0) | (point[1] != 0.0) | (point[2] != 0.0));
    let code = if range > limits.max { beyond } else { pixel };
    let code = if range < limits.near { TOO_NEAR } else { code };
    let code = if is_return { code } else { NO_RETURN };
    (code, if range > limits.max { f32::INFINITY } else { range })
}

/// Range from the beam origin, which lies `ahead` metres before the axis and `height` above the lidar origin.
#[inline(always)]
fn range_of(p: &[f32; 3], ahead: f32, height: f32) -> f32 {
    let (h, up) = ((p[0] * p[0] + p[1] * p[1]).sqrt() - ahead, p[2] - height);
    (h * h + up * up).sqrt()
}

/// Pixels of a cloud in the order of the image.
fn project_in_place(points: &[[f32; 3]], model: &BeamModel, limits: RangeLimits, pixels: &mut [u32], ranges: &mut [f32]) {
    /// Fewer rows are not worth the overhead of a task.
    const ROWS_PER_TASK: usize = 16;
    let columns = model.columns();
    let height = model.origin_height();
    let rows = (points.par_chunks(columns), pixels.par_chunks_mut(columns), ranges.par_chunks_mut(columns));
    rows.into_par_iter().take(model.rows()).with_min_len(ROWS_PER_TASK).enumerate().for_each(|(row, (points, pixels, ranges))| {
        let (first, ahead) = ((row * columns) as u32, model.origin_ahead_of(row));
        dispatch(InPlace { points, first, ahead, height, limits, pixels, ranges });
    });
}

struct InPlace<'a> {
    points: &'a [[f32; 3]],
    first: u32,
    ahead: f32,
    height: f32,
    limits: RangeLimits,
    pixels: &'a mut [u32],
    ranges: &'a mut [f32],
}

impl Kernel for InPlace<'_> {
    #[inline(always)]
    fn run(self) {
        let count = self.points.len().min(self.pixels.len()).min(self.ranges.len());
        for i in 0..count {
            let range = range_of(&self.points[i], self.ahead, self.height);
            (self.pixels[i], self.ranges[i]) = gate(&self.points[i], self.first + i as u32, range, self.limits, BEYOND);
        }
    }
}

/// Pixels of a grid in another order.
fn mapped(points: &[[f32; 3]], map: &[u32], model: &BeamModel, limits: RangeLimits, (pixels, ranges): (&mut [u32], &mut [f32])) {
    let columns = model.columns() as u32;
    for (i, p) in points.iter().enumerate() {
        let pixel = map[i];
        let range = range_of(p, model.origin_ahead_of((pixel / columns) as usize), model.origin_height());
        (pixels[i], ranges[i]) = gate(p, pixel, range, limits, pixel);
    }
}

/// Projects points; `rows` are their rows if known, `u16::MAX` for none.
pub(crate) fn project(points: &[[f32; 3]], rows: Option<&[u16]>, model: &BeamModel, limits: RangeLimits, pixels: &mut [u32], ranges: &mut [f32]) {
    let chunks = pixels.par_chunks_mut(CHUNK).zip(ranges.par_chunks_mut(CHUNK)).zip(points.par_chunks(CHUNK));
    chunks.enumerate().with_min_len(16).for_each(|(i, ((pixels, ranges), points))| {
        let rows = rows.map(|rows| &rows[i * CHUNK..i * CHUNK + points.len()]);
        dispatch(Project { points, rows, model, limits, pixels, ranges });
    });
}

/// Projects up to [`PROJECT_CHUNK`] points, at any range, on the calling thread: the pixel of each, or [`OUTSIDE`] or a larger code, and its range.
pub(crate) fn project_chunk(points: &[[f32; 3]], model: &BeamModel, pixels: &mut [u32], ranges: &mut [f32]) {
    dispatch(Project { points, rows: None, model, limits: RangeLimits { near: 0.0, max: f32::MAX }, pixels, ranges });
}

struct Project<'a> {
    points: &'a [[f32; 3]],
    rows: Option<&'a [u16]>,
    model: &'a BeamModel,
    limits: RangeLimits,
    pixels: &'a mut [u32],
    ranges: &'a mut [f32],
}

impl Kernel for Project<'_> {
    /// Each step is a loop in vector instructions: angles, rows by look-up, columns. Agrees with [`BeamModel::project`] except at the border of two pixels.
    #[inline(always)]
    fn run(self) {
        let Self { points, rows, model, limits, pixels, ranges } = self;
        let count = points.len().min(CHUNK).min(pixels.len()).min(ranges.len());
        let (mut azimuth, mut elevation, mut horizontal) = ([0f32; CHUNK], [0f32; CHUNK], [0f32; CHUNK]);
        // The row of a point, the first where it has none; and whether it has one.
        let (mut row, mut is_visible) = ([0u32; CHUNK], [0u32; CHUNK]);
        for i in 0..count {
            let view = AxialPoint::new(points[i], model.origin_height());
            elevation[i] = view.elevation(model.mean_origin_ahead());
            (azimuth[i], horizontal[i]) = (view.azimuth, view.horizontal);
        }
        match rows {
            Some(known) => {
                for i in 0..count {
                    is_visible[i] = u32::from(usize::from(known[i]) < model.rows());
                    row[i] = u32::from(known[i]) * is_visible[i];
                }
            }
            None => {
                let mut rows = [0f32; CHUNK];
                model.rows_of::<CHUNK>(&elevation[..count], &mut rows[..count]);
                let last = model.rows() as f32 - 1.0;
                for i in 0..count {
                    let visible = (rows[i] >= -0.5) & (rows[i] < last + 0.5);
                    is_visible[i] = u32::from(visible);
                    row[i] = floor_positive(if visible { smaller(rows[i] + 0.5, last) } else { 0.0 }) as u32;
                }
            }
        }
        let [mut ahead, mut sideways, mut residual] = [[0f32; CHUNK]; 3];
        for (table, values) in model.beam_offsets().into_iter().zip([&mut ahead, &mut sideways, &mut residual]) {
            gather(table, &row[..count], &mut values[..count]);
        }
        let (columns, last_column) = (model.columns() as u32, model.columns() as u32 - 1);
        let least = larger(model.origin_radius(), f32::MIN_POSITIVE);
        for i in 0..count {
            let up = points[i][2] - model.origin_height();
            let h = horizontal[i] - ahead[i];
            // As `BeamModel::parallax` and `BeamModel::nearest_column`.
            let turned = azimuth[i] + sideways[i] / larger(horizontal[i], least);
            let column = floor_positive(larger(model.column_of(turned, residual[i]) + 0.5, 0.0)) as u32;
            let column = if column < last_column { column } else { last_column };
            let pixel = if is_visible[i] == 1 { row[i] * columns + column } else { OUTSIDE };
            (pixels[i], ranges[i]) = gate(&points[i], pixel, (h * h + up * up).sqrt(), limits, pixel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::preset;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn batches_agree_with_single_points(points in prop::collection::vec(prop::array::uniform3(-30f32..30.0), 1..700)) {
            let model = preset("os1-64").map_err(|e| TestCaseError::fail(e.to_string()))?;
            let (mut pixels, mut ranges) = (vec![0; points.len()], vec![0f32; points.len()]);
            project(&points, None, &model, RangeLimits { near: 1.0, max: 25.0 }, &mut pixels, &mut ranges);
            for (i, &p) in points.iter().enumerate() {
                let range = model.project(p).map_or(f32::NAN, |q| q.range);
                match model.project(p) {
                    _ if pixels[i] == TOO_NEAR => prop_assert!(range_of(&p, model.mean_origin_ahead(), 0.0) < 1.001),
                    None => prop_assert_eq!(pixels[i], OUTSIDE),
                    Some(q) if q.row.fract().abs() > 0.49 && q.row.fract().abs() < 0.51 => {}
                    Some(q) if (q.column + 0.5).fract() < 0.01 || (q.column + 0.5).fract() > 0.99 => {}
                    Some(q) => {
                        let pixel = model.nearest_row(q.row) * model.columns() + model.nearest_column(q.column);
                        prop_assert_eq!(pixels[i] as usize, pixel);
                        prop_assert_eq!(ranges[i].is_infinite(), range > 25.0);
                    }
                }
            }
        }
    }

    #[test]
    fn points_without_a_pixel_get_the_code_of_their_reason() {
        let limits = RangeLimits { near: 1.0, max: 10.0 };
        let code = |p: [f32; 3]| gate(&p, 7, range_of(&p, 0.0, 0.0), limits, BEYOND).0;
        assert_eq!(code([f32::NAN, 1.0, 1.0]), NO_RETURN);
        assert_eq!(code([f32::INFINITY, 1.0, f32::NEG_INFINITY]), NO_RETURN);
        assert_eq!(code([0.0; 3]), NO_RETURN);
        assert_eq!(code([0.0, 0.5, 0.0]), TOO_NEAR);
        assert_eq!(code([0.0, 5.0, 0.0]), 7);
        assert_eq!(code([0.0, 50.0, 0.0]), BEYOND);
    }
}
