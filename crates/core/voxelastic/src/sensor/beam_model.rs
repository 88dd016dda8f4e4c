//! The beam model: the direction of each pixel (paper Sec. III, the spherical projection).

use super::error::SensorError;
use super::row_lookup::RowLookup;
use crate::simd::atan2;
use std::f32::consts::{FRAC_PI_2, TAU};

/// Most rows that a model may have.
pub const MAX_ROWS: usize = 4096;
/// Most columns that a model may have.
pub const MAX_COLUMNS: usize = 65_536;

/// The facts about a spinning LiDAR from which a [`BeamModel`] is made. Angles in radians, lengths in metres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BeamTables {
    /// What the model is called in messages.
    pub name: String,
    /// Elevation of each row above the horizon, in the sensor's own order.
    pub elevations: Vec<f32>,
    /// Azimuth of each row's beam relative to the sensor's head, counter-clockwise seen from above, in the order of
    /// `elevations`; empty when all are zero.
    pub azimuth_offsets: Vec<f32>,
    /// Firings in one full turn.
    pub columns: usize,
    /// Whether azimuth falls from one column to the next (the head turns clockwise seen from above).
    pub clockwise: bool,
    /// Azimuth of column 0, counter-clockwise from the x axis.
    pub azimuth_of_first: f32,
    /// Distance from the axis of rotation to the point that the beams start from (Ouster: lidar origin to beam origin).
    pub origin_radius: f32,
    /// Height of that point above the origin of the lidar frame.
    pub origin_height: f32,
}

/// Where a point falls in the range image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projection {
    /// Fractional row, -0.5 to rows - 0.5, counted from the top; whole at the centre of a pixel.
    pub row: f32,
    /// Fractional column, -0.5 to columns - 0.5; whole at the centre of a pixel of the nearest row.
    pub column: f32,
    /// Distance from the beam's origin to the point, metres.
    pub range: f32,
}

/// A spinning LiDAR's pixels: rows top to bottom, columns in the order of firing, one full turn wide.
///
/// Pixel (row, column) has the azimuth `azimuth_of_first ± column * step + residual[row]`: where the sensor staggers its
/// rows by more than a pixel (Ouster), the whole pixels of the stagger are taken out, so that a column is upright in space
/// and neighbours in the image are neighbours in the world. [`BeamModel::firing_column`] gives the time at which a pixel was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamModel {
    name: String,
    table: RowLookup,
    /// Top to bottom.
    elevations: Vec<f32>,
    /// Full azimuth offset of each row, counter-clockwise.
    offsets: Vec<f32>,
    /// Whole columns to be added to the column of firing.
    shifts: Vec<i32>,
    /// What is left of the offset beyond whole columns.
    residuals: Vec<f32>,
    /// Row of each entry of the table that the model was made from.
    row_of_ring: Vec<u16>,
    columns: usize,
    clockwise: bool,
    azimuth_of_first: f32,
    /// Signed columns per radian of azimuth.
    columns_per_radian: f32,
    origin_radius: f32,
    origin_height: f32,
    /// How far each row's beam origin is before the axis along its beam, and beside it, metres.
    ahead: Vec<f32>,
    sideways: Vec<f32>,
    mean_ahead: f32,
}

impl BeamModel {
    /// A model from the sensor's tables, in whatever order their rows come.
    ///
    /// # Errors
    /// Sizes, angles or origins out of bounds; tables of unequal length; rows too close to be distinguished.
    pub fn from_tables(tables: BeamTables) -> Result<Self, SensorError> {
        let rows = tables.elevations.len();
        check(&tables)?;
        let mut order: Vec<usize> = (0..rows).collect();
        order.sort_by(|&a, &b| tables.elevations[b].total_cmp(&tables.elevations[a]).then(a.cmp(&b)));
        let mut row_of_ring = vec![0u16; rows];
        order.iter().enumerate().for_each(|(row, &ring)| row_of_ring[ring] = row as u16);
        let elevations: Vec<f32> = order.iter().map(|&ring| tables.elevations[ring]).collect();
        let offsets: Vec<f32> = order.iter().map(|&ring| tables.azimuth_offsets.get(ring).copied().unwrap_or(0.0)).collect();
        let step = TAU / tables.columns as f32;
        let table = RowLookup::new(&elevations, step).map_err(|first| SensorError::RowsCoincide {
            first,
            second: first + 1,
            gap_degrees: (elevations[first] - elevations[first + 1]).to_degrees(),
        })?;
        let sign = if tables.clockwise { -1.0 } else { 1.0 };
        let shifts: Vec<i32> = offsets.iter().map(|&o| (sign * o / step).round() as i32).collect();
        let residuals = offsets.iter().zip(&shifts).map(|(o, &s)| o - sign * s as f32 * step).collect();
        let ahead: Vec<f32> = offsets.iter().map(|o| tables.origin_radius * o.cos()).collect();
        let sideways = offsets.iter().map(|o| tables.origin_radius * o.sin()).collect();
        let mean_ahead = ahead.iter().sum::<f32>() / rows as f32;
        Ok(Self {
            name: tables.name,
            table,
            elevations,
            offsets,
            shifts,
            residuals,
            row_of_ring,
            columns: tables.columns,
            clockwise: tables.clockwise,
            azimuth_of_first: tables.azimuth_of_first,
            columns_per_radian: sign / step,
            origin_radius: tables.origin_radius,
            origin_height: tables.origin_height,
            ahead,
            sideways,
            mean_ahead,
        })
    }

    /// A model with `rows` evenly spaced from `top` to `bottom` (elevations in radians), turning counter-clockwise from
    /// the x axis.
    ///
    /// # Errors
    /// As [`BeamModel::from_tables`].
    pub fn even(rows: usize, columns: usize, top: f32, bottom: f32) -> Result<Self, SensorError> {
        if rows == 0 || rows > MAX_ROWS {
            return Err(SensorError::Size { rows, columns });
        }
        let gap = (top - bottom) / (rows.max(2) - 1) as f32;
        let elevations = (0..rows).map(|row| top - row as f32 * gap).collect();
        Self::from_tables(BeamTables { name: format!("even {rows}x{columns}"), elevations, columns, ..BeamTables::default() })
    }

    /// What the model is called.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The same model under another name.
    pub fn with_name(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.elevations.len()
    }

    /// Number of columns in a full turn.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.rows() * self.columns
    }

    /// Elevation of each row, top to bottom, radians.
    pub fn elevations(&self) -> &[f32] {
        &self.elevations
    }

    /// Azimuth offset of each row's beam from the sensor's head, top to bottom, counter-clockwise, radians.
    pub fn azimuth_offsets(&self) -> &[f32] {
        &self.offsets
    }

    /// Whole columns between firing and pixel of each row: pixel column = column of firing + shift, modulo the columns.
    pub fn shifts(&self) -> &[i32] {
        &self.shifts
    }

    /// Row of each entry of the tables that the model was made from (the sensor's own ring numbers).
    pub fn row_of_ring(&self) -> &[u16] {
        &self.row_of_ring
    }

    /// Whether azimuth falls from one column to the next.
    pub fn is_clockwise(&self) -> bool {
        self.clockwise
    }

    /// Angle between neighbouring columns, radians.
    pub fn azimuth_step(&self) -> f32 {
        TAU / self.columns as f32
    }

    /// Distance of the beams' origin from the axis of rotation, metres.
    pub fn origin_radius(&self) -> f32 {
        self.origin_radius
    }

    /// Height of the beams' origin above the origin of the lidar frame, metres.
    pub fn origin_height(&self) -> f32 {
        self.origin_height
    }

    /// Smallest angle between adjacent rays, radians: the cone that decides the integration scale (paper Sec. III-A).
    ///
    /// Rows nearer to each other than a quarter of the usual gap count as one, as in sensors of two stacked heads, whose fields of view overlap.
    pub fn smallest_angle(&self) -> f32 {
        let mut gaps: Vec<f32> = self.gaps().collect();
        gaps.sort_by(f32::total_cmp);
        let usual = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
        gaps.into_iter().filter(|&g| g > 0.25 * usual).fold(self.azimuth_step(), f32::min)
    }

    /// Largest angle between neighbouring rows or columns, radians.
    pub fn largest_gap(&self) -> f32 {
        self.gaps().fold(self.azimuth_step(), f32::max)
    }

    fn gaps(&self) -> impl Iterator<Item = f32> + '_ {
        self.elevations.windows(2).map(|pair| pair[0] - pair[1])
    }

    /// Index of the row nearest to a fractional row.
    #[inline(always)]
    pub fn nearest_row(&self, row: f32) -> usize {
        ((row + 0.5).max(0.0) as usize).min(self.rows() - 1)
    }

    /// Index of the column nearest to a fractional column of -0.5 to columns - 0.5.
    #[inline(always)]
    pub fn nearest_column(&self, column: f32) -> usize {
        ((column + 0.5).max(0.0) as usize).min(self.columns - 1)
    }

    /// Azimuth of a pixel's beam, counter-clockwise from the x axis, radians, not wrapped.
    #[inline(always)]
    pub fn azimuth(&self, row: f32, column: f32) -> f32 {
        self.azimuth_of_first + column / self.columns_per_radian + self.residuals[self.nearest_row(row)]
    }

    /// Elevation of a row, radians.
    #[inline(always)]
    pub fn elevation(&self, row: f32) -> f32 {
        self.table.elevation(row)
    }

    /// Fractional row of an elevation in radians, not limited to the field of view.
    #[inline(always)]
    pub fn row(&self, elevation: f32) -> f32 {
        self.table.row(elevation)
    }

    /// Fractional rows of up to `N` elevations in radians; as [`row`](Self::row), in vector instructions.
    #[inline(always)]
    pub(crate) fn rows_of<const N: usize>(&self, elevations: &[f32], rows: &mut [f32]) {
        self.table.rows::<N>(elevations, rows);
    }

    /// What each row's beams are turned and moved by: how far their origins are before and beside the axis, metres, and what is left of their azimuth offsets
    /// beyond whole columns, radians.
    pub(super) fn beam_offsets(&self) -> [&[f32]; 3] {
        [&self.ahead, &self.sideways, &self.residuals]
    }

    /// Fractional column of an azimuth in radians as `row` sees it, -0.5 to columns - 0.5.
    #[inline(always)]
    pub fn column(&self, row: usize, azimuth: f32) -> f32 {
        self.column_of(azimuth, self.residuals[row])
    }

    /// As [`column`](Self::column), for a row whose beams are turned by `residual` radians beyond whole columns.
    #[inline(always)]
    pub(super) fn column_of(&self, azimuth: f32, residual: f32) -> f32 {
        let columns = self.columns as f32;
        let column = (azimuth - self.azimuth_of_first - residual) * self.columns_per_radian;
        let column = column - columns * ((column + 0.5) / columns).floor();
        // Rounding may leave a value a hair outside of the turn.
        if column >= columns - 0.5 { column - columns } else { column }
    }

    /// Column of firing of a pixel: divided by the columns it is the fraction of the turn at which the pixel was measured.
    pub fn firing_column(&self, row: usize, column: usize) -> usize {
        (column as i64 - i64::from(self.shifts[row])).rem_euclid(self.columns as i64) as usize
    }

    /// Pixel column of a row's measurement at a column of firing: the inverse of [`BeamModel::firing_column`].
    pub fn pixel_column(&self, row: usize, firing_column: usize) -> usize {
        (firing_column as i64 + i64::from(self.shifts[row])).rem_euclid(self.columns as i64) as usize
    }

    /// Unit vector along a pixel's beam, lidar frame. Row and column may be fractional.
    pub fn direction(&self, row: f32, column: f32) -> [f32; 3] {
        let (sin_az, cos_az) = self.azimuth(row, column).sin_cos();
        let (sin_el, cos_el) = self.elevation(row).sin_cos();
        [cos_el * cos_az, cos_el * sin_az, sin_el]
    }

    /// Point that a pixel's beam starts from, lidar frame, metres.
    pub fn origin(&self, row: f32, column: f32) -> [f32; 3] {
        let head = self.azimuth(row, column) - self.offsets[self.nearest_row(row)];
        [self.origin_radius * head.cos(), self.origin_radius * head.sin(), self.origin_height]
    }

    /// Point at `range` metres along a pixel's beam, lidar frame.
    pub fn point(&self, row: f32, column: f32, range: f32) -> [f32; 3] {
        let (o, d) = (self.origin(row, column), self.direction(row, column));
        std::array::from_fn(|k| o[k] + range * d[k])
    }

    /// Pixel of `point` (lidar frame, metres), or `None` if it is outside of the field of view or not a return.
    ///
    /// For any sensor whose beams all start from the origin of the lidar frame this inverts [`BeamModel::point`] exactly;
    /// for others within a hundredth of a pixel from 0.5 m on.
    #[inline]
    pub fn project(&self, point: [f32; 3]) -> Option<Projection> {
        let view = AxialPoint::new(point, self.origin_height);
        let mut row = self.table.row(view.elevation(self.mean_ahead));
        if self.origin_radius != 0.0 {
            row = self.table.row(view.elevation(self.ahead[self.nearest_row(row)]));
        }
        let nearest = usize::from(self.visible_row(row)?);
        let ahead = view.horizontal - self.ahead[nearest];
        let range = (ahead * ahead + view.up * view.up).sqrt();
        let is_return = range > 0.0 && range.is_finite();
        is_return.then(|| Projection { row, column: self.column(nearest, view.azimuth + self.parallax(nearest, view.horizontal)), range })
    }

    /// Angle by which the beam of `row` to a point is turned against the direction from the axis to that point.
    ///
    /// Beams that do not start on the axis point past it: the turn is asin(radius sin(offset) / horizontal).
    #[inline(always)]
    pub(crate) fn parallax(&self, row: usize, horizontal: f32) -> f32 {
        self.sideways[row] / horizontal.max(self.origin_radius).max(f32::MIN_POSITIVE)
    }

    /// How far the beam origin of `row` is before the axis, along the beam, metres.
    #[inline(always)]
    pub(crate) fn origin_ahead_of(&self, row: usize) -> f32 {
        self.ahead[row]
    }

    /// Mean of [`BeamModel::origin_ahead_of`] over the rows.
    #[inline(always)]
    pub(crate) fn mean_origin_ahead(&self) -> f32 {
        self.mean_ahead
    }

    /// The row whose pixels hold a fractional row, if any does.
    #[inline(always)]
    pub(crate) fn visible_row(&self, row: f32) -> Option<u16> {
        (row >= -0.5 && row < self.rows() as f32 - 0.5).then(|| self.nearest_row(row) as u16)
    }
}

/// Cylindrical coordinates of a point around the sensor's axis, at the height of the beams' origin.
pub(crate) struct AxialPoint {
    pub(crate) horizontal: f32,
    pub(crate) up: f32,
    pub(crate) azimuth: f32,
}

impl AxialPoint {
    #[inline(always)]
    pub(crate) fn new(p: [f32; 3], height: f32) -> Self {
        Self { horizontal: (p[0] * p[0] + p[1] * p[1]).sqrt(), up: p[2] - height, azimuth: atan2(p[1], p[0]) }
    }

    /// Elevation from a beam origin `ahead` metres before the axis towards the point.
    #[inline(always)]
    pub(crate) fn elevation(&self, ahead: f32) -> f32 {
        atan2(self.up, self.horizontal - ahead)
    }
}

/// Checks that a model can be made of the tables.
fn check(tables: &BeamTables) -> Result<(), SensorError> {
    let (rows, columns) = (tables.elevations.len(), tables.columns);
    if !(1..=MAX_ROWS).contains(&rows) || !(2..=MAX_COLUMNS).contains(&columns) {
        return Err(SensorError::Size { rows, columns });
    }
    let offsets = tables.azimuth_offsets.len();
    if offsets != 0 && offsets != rows {
        return Err(SensorError::TableLength { elevations: rows, offsets });
    }
    let is_angle = |row: usize| tables.elevations[row].abs() <= FRAC_PI_2 && tables.azimuth_offsets.get(row).is_none_or(|o| o.is_finite());
    if let Some(row) = (0..rows).find(|&row| !is_angle(row)) {
        return Err(SensorError::Angle { row });
    }
    let (radius, height) = (tables.origin_radius, tables.origin_height);
    let plausible = (0.0..1.0).contains(&radius) && height.abs() < 1.0 && tables.azimuth_of_first.is_finite();
    if plausible { Ok(()) } else { Err(SensorError::Origin { radius, height }) }
}
