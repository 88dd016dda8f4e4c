//! Sensors whose clouds are bare points: rows and columns from the angles between neighbours.

use super::angles::{Direction, columns_of, mode};
use super::rings::{Ring, rows};
use crate::Cloud;
use crate::sensor::beam_model::{BeamModel, BeamTables};
use crate::sensor::error::SensorError;

/// Thickness of a slice of elevations, radians: thinner than the gap between rows, wider than a row's own spread.
const SLICE: f32 = 0.0015;
/// Usual numbers of rows.
const USUAL_ROWS: [usize; 9] = [16, 20, 32, 40, 64, 80, 96, 128, 192];
/// If fewer than this share of the columns between neighbouring returns of a row have a return, the cloud was thinned: nothing of the sensor's lattice is left.
const LEAST_CONTINUOUS: f32 = 0.5;

/// The model that fits the returns of `clouds` best; none if the clouds were thinned.
pub(super) fn recognise(clouds: &[&Cloud]) -> Result<Option<BeamModel>, SensorError> {
    let scans: Vec<Vec<Direction>> = clouds.iter().map(|c| c.points.iter().filter_map(Direction::of).collect()).collect();
    let mut elevations: Vec<f32> = scans.iter().flatten().map(|r| r.elevation).collect();
    // Squares of coordinates below 1e-23 m vanish, so there may be returns and no directions.
    if elevations.is_empty() {
        return Err(SensorError::NoSpread);
    }
    elevations.sort_by(f32::total_cmp);
    // A few strays must not widen the field of view.
    let strays = elevations.len() / 1000;
    let (bottom, top) = (elevations[strays], elevations[elevations.len() - 1 - strays]);
    if top - bottom < 1e-3 {
        return Err(SensorError::NoSpread);
    }
    let step = column_step(&scans, top - bottom).ok_or(SensorError::NoSpread)?;
    let gap = row_gap(&scans, step).unwrap_or(3.0 * step).min(top - bottom);
    let rows = usual_rows((top - bottom) / gap + 1.0);
    let columns = columns_of(step);
    if continuity(&scans, step) < LEAST_CONTINUOUS {
        return Ok(None);
    }
    let peaks = peaks(&scans, gap, top, bottom);
    let fits = peaks.len().abs_diff(rows) * 10 <= rows;
    let model = if fits { uneven(peaks, columns, [0.0; 2]) } else { None };
    let model = model.map_or_else(|| even(rows, columns, top, bottom, "unorganised cloud"), Ok)?;
    Ok(Some(with_origin(&model, &scans).unwrap_or(model)))
}

/// The model with the origin of its beams, if the returns of its rows have a common one.
fn with_origin(model: &BeamModel, scans: &[Vec<Direction>]) -> Option<BeamModel> {
    let mut origin = [0.0; 2];
    let mut better = None;
    // Returns near the sensor go to wrong rows until the origin is known.
    for _ in 0..2 {
        let model = better.as_ref().unwrap_or(model);
        let mut rings: Vec<Ring> = vec![Ring::new(); model.rows()];
        for direction in scans.iter().flatten() {
            let row = model.row((direction.height - origin[1]).atan2(direction.horizontal - origin[0]));
            if row > -0.5 && row < model.rows() as f32 - 0.5 {
                rings[model.nearest_row(row)].push(*direction);
            }
        }
        let rows = rows(&rings, true);
        if rows.origin == [0.0; 2] {
            return None;
        }
        origin = rows.origin;
        better = uneven(rows.elevations, model.columns(), origin);
    }
    better
}

fn even(rows: usize, columns: usize, top: f32, bottom: f32, name: &str) -> Result<BeamModel, SensorError> {
    BeamModel::even(rows, columns, top, bottom).map(|model| model.with_name(name))
}

fn uneven(elevations: Vec<f32>, columns: usize, [origin_radius, origin_height]: [f32; 2]) -> Option<BeamModel> {
    let name = "unorganised cloud".into();
    BeamModel::from_tables(BeamTables { name, elevations, columns, origin_radius, origin_height, ..BeamTables::default() }).ok()
}

/// The usual number of rows next to `rows`, if it is near.
fn usual_rows(rows: f32) -> usize {
    let near = USUAL_ROWS.into_iter().min_by(|a, b| (rows / *a as f32).ln().abs().total_cmp(&(rows / *b as f32).ln().abs())).unwrap_or(64);
    if (rows / near as f32 - 1.0).abs() < 0.15 { near } else { rows.round().clamp(2.0, 1024.0) as usize }
}

/// Angle between neighbouring columns: the most frequent step in azimuth within thin slices of elevation.
fn column_step(scans: &[Vec<Direction>], span: f32) -> Option<f32> {
    let mut steps = Vec::new();
    for scan in scans {
        steps.extend(steps_in_slices(scan, SLICE, |r| r.elevation, |r| r.azimuth));
    }
    mode(&steps, 5e-4, span.clamp(0.02, 0.2))
}

/// Share of the columns between neighbouring returns of a row that have a return, over gaps of at most a few columns.
fn continuity(scans: &[Vec<Direction>], step: f32) -> f32 {
    let (mut kept, mut passed) = (0.0, 0.0);
    for steps in scans.iter().map(|scan| steps_in_slices(scan, SLICE, |r| r.elevation, |r| r.azimuth)) {
        for columns in steps.iter().map(|s| (s / step).round()).filter(|c| (1.0..=6.0).contains(c)) {
            kept += 1.0;
            passed += columns;
        }
    }
    kept / f32::max(passed, 1.0)
}

/// Angle between neighbouring rows: the most frequent step in elevation within slices a column wide. Neighbours were measured at nearly the same time or in the same
/// turn of the head, so this works for undistorted clouds, too.
fn row_gap(scans: &[Vec<Direction>], step: f32) -> Option<f32> {
    let mut gaps = Vec::new();
    for scan in scans {
        gaps.extend(steps_in_slices(scan, step, |r| r.azimuth, |r| r.elevation));
    }
    let usual = mode(&gaps, 1.5e-3, 0.2)?;
    // Gaps of a sensor are unequal; what is much smaller or larger is jitter or a missing row.
    let (sum, count) = gaps.iter().filter(|g| (0.6 * usual..1.6 * usual).contains(*g)).fold((0.0, 0), |(s, n), g| (s + f64::from(*g), n + 1));
    Some((sum / f64::from(count.max(1))) as f32)
}

/// Steps along one angle between neighbours within slices of the other.
fn steps_in_slices(scan: &[Direction], slice: f32, across: impl Fn(&Direction) -> f32, along: impl Fn(&Direction) -> f32) -> Vec<f32> {
    let mut cells: Vec<(i32, f32)> = scan.iter().map(|r| ((across(r) / slice).floor() as i32, along(r))).collect();
    cells.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    cells.windows(2).filter(|w| w[0].0 == w[1].0).map(|w| w[1].1 - w[0].1).collect()
}

/// Elevations at which returns accumulate, top to bottom; empty if there are none.
fn peaks(scans: &[Vec<Direction>], gap: f32, top: f32, bottom: f32) -> Vec<f32> {
    /// Cells of the histogram per gap between rows.
    const CELLS: f32 = 24.0;
    /// Most cells of the histogram.
    const MOST: f32 = 16_384.0;
    let cell = (gap / CELLS).max((top - bottom + 2.0 * gap) / MOST);
    let start = bottom - gap;
    let cells = ((top - bottom + 2.0 * gap) / cell).ceil() as usize + 1;
    let mut counts = vec![0f32; cells];
    for r in scans.iter().flatten() {
        let at = (r.elevation - start) / cell;
        if at >= 0.0 && at < cells as f32 {
            counts[at as usize] += 1.0;
        }
    }
    let smooth = blur(&blur(&counts, 2), 3);
    let background = blur(&counts, CELLS as usize);
    let reach = (0.35 * gap / cell) as usize;
    let is_peak = |i: usize| {
        let around = i.saturating_sub(reach)..(i + reach + 1).min(cells);
        smooth[i] > 1.4 * background[i] && around.clone().all(|k| smooth[k] < smooth[i] || (k >= i && smooth[k] == smooth[i]))
    };
    let centre = |i: usize| {
        let around = i.saturating_sub(4)..(i + 5).min(cells);
        let (sum, weight) = around.fold((0.0, 0.0), |(s, w), k| (s + counts[k] * (k as f32 + 0.5), w + counts[k]));
        start + cell * sum / weight.max(1.0)
    };
    let mut found: Vec<f32> = (0..cells).filter(|&i| is_peak(i)).map(centre).collect();
    found.reverse();
    // Most returns must be in peaks, else the peaks are artefacts of the scene.
    let near = scans.iter().flatten().filter(|r| {
        let below = found.partition_point(|e| *e > r.elevation);
        [below.wrapping_sub(1), below].iter().any(|&k| found.get(k).is_some_and(|e| (e - r.elevation).abs() < 0.25 * gap))
    });
    let share = near.count() as f32 / scans.iter().map(Vec::len).sum::<usize>().max(1) as f32;
    if share > 0.75 { found } else { Vec::new() }
}

/// Mean over `reach` cells to both sides.
fn blur(counts: &[f32], reach: usize) -> Vec<f32> {
    let mut sums = vec![0f64; counts.len() + 1];
    for (i, c) in counts.iter().enumerate() {
        sums[i + 1] = sums[i] + f64::from(*c);
    }
    let mean = |i: usize| {
        let (from, to) = (i.saturating_sub(reach), (i + reach + 1).min(counts.len()));
        ((sums[to] - sums[from]) / (to - from) as f64) as f32
    };
    (0..counts.len()).map(mean).collect()
}
