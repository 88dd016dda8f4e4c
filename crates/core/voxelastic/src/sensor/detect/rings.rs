//! Sensors whose clouds have the ring of each point.

use super::angles::{Direction, circular_mean, columns_of, median, mode, separate, wrap};
use crate::Cloud;
use crate::sensor::beam_model::{BeamModel, BeamTables, MAX_ROWS};
use crate::sensor::cloud_layout::{CloudLayout, ring_ends};
use std::f32::consts::TAU;

/// The returns of one ring in the order of the cloud; gaps between clouds are harmless.
pub(super) type Ring = Vec<Direction>;

/// What the rings of a sensor have in common.
pub(super) struct Rows {
    /// Elevation of each ring, radians.
    pub(super) elevations: Vec<f32>,
    /// Distance of the beams' origin from the axis, and its height, metres.
    pub(super) origin: [f32; 2],
}

/// From a ring channel.
pub(super) fn recognise_field(clouds: &[&Cloud]) -> Option<(BeamModel, CloudLayout)> {
    let mut rings: Vec<Ring> = Vec::new();
    for cloud in clouds {
        let field = cloud.ring.as_ref().filter(|field| field.len() == cloud.len())?;
        for (p, &ring) in cloud.points.iter().zip(field) {
            let ring = usize::from(ring);
            if ring < MAX_ROWS
                && let Some(direction) = Direction::of(p)
            {
                if ring >= rings.len() {
                    rings.resize_with(ring + 1, Ring::new);
                }
                rings[ring].push(direction);
            }
        }
    }
    if rings.iter().filter(|ring| !ring.is_empty()).count() < 2 || !are_narrow(&rings) {
        return None;
    }
    let model = measure(&rings, true, "ring channel")?;
    let row_of_ring = model.row_of_ring().to_vec();
    Some((model, CloudLayout::Rings { row_of_ring }))
}

/// From points that come ring by ring.
pub(super) fn recognise_order(clouds: &[&Cloud]) -> Option<(BeamModel, CloudLayout)> {
    /// Share of the steps between points that must have the same direction.
    const ONE_WAY: f32 = 0.95;
    let mut rings: Vec<Ring> = Vec::new();
    let ends_of: Vec<Vec<u32>> = clouds.iter().map(|cloud| ring_ends(&cloud.points)).collect();
    // Rings may be missing from some clouds: the number that most clouds have is the sensor's.
    let count = most_frequent(ends_of.iter().map(Vec::len))?;
    if !(4..=512).contains(&count) {
        return None;
    }
    rings.resize_with(count, Ring::new);
    for (cloud, ends) in clouds.iter().zip(&ends_of).filter(|(_, ends)| ends.len() == count) {
        let mut start = 0;
        for (ring, &end) in rings.iter_mut().zip(ends) {
            ring.extend(cloud.points[start..end as usize].iter().filter_map(Direction::of));
            start = end as usize;
        }
    }
    let steps = || rings.iter().flat_map(|ring| ring.windows(2)).map(|pair| wrap(pair[1].azimuth - pair[0].azimuth));
    let (left, all) = steps().fold((0usize, 0usize), |(left, all), step| (left + usize::from(step > 0.0), all + 1));
    let one_way = left.max(all - left) as f32 / all.max(1) as f32;
    if one_way < ONE_WAY || !are_narrow(&rings) {
        return None;
    }
    let model = measure(&rings, false, "ring order")?;
    let row_of_ring = model.row_of_ring().to_vec();
    Some((model, CloudLayout::RingOrder { row_of_ring }))
}

fn most_frequent(values: impl Iterator<Item = usize>) -> Option<usize> {
    let mut counts = std::collections::BTreeMap::new();
    values.for_each(|v| *counts.entry(v).or_insert(0) += 1);
    counts.into_iter().max_by_key(|&(value, count)| (count, value)).map(|(value, _)| value)
}

/// Whether each ring has one elevation, compared with the span of all rings.
fn are_narrow(rings: &[Ring]) -> bool {
    let middle = |ring: &Ring| median(ring.iter().map(|r| r.elevation).collect());
    let seen: Vec<(f32, f32)> = rings
        .iter()
        .filter(|ring| ring.len() >= 10)
        .map(|ring| {
            let m = middle(ring);
            (m, median(ring.iter().map(|r| (r.elevation - m).abs()).collect()))
        })
        .collect();
    let spread = seen.iter().fold(f32::MIN, |s, x| s.max(x.0)) - seen.iter().fold(f32::MAX, |s, x| s.min(x.0));
    let width = median(seen.iter().map(|x| x.1).collect());
    seen.len() >= 2 && width < 0.5 * spread / seen.len() as f32
}

/// The model of a sensor with these rings, in columns of its own choice.
fn measure(rings: &[Ring], has_origin: bool, source: &str) -> Option<BeamModel> {
    let steps: Vec<f32> =
        rings.iter().flat_map(|ring| ring.windows(2)).map(|pair| wrap(pair[1].azimuth - pair[0].azimuth)).filter(|s| *s != 0.0).collect();
    let clockwise = steps.iter().filter(|s| **s < 0.0).count() * 2 > steps.len();
    let sizes: Vec<f32> = steps.iter().map(|s| s.abs()).collect();
    let step = mode(&sizes, 2e-4, 0.2).or_else(|| sorted_step(rings))?;
    let columns = columns_of(step);
    let rows = rows(rings, has_origin);
    // Where the pixels' centres are: the phase of the azimuths, ring by ring.
    let turn = columns as f32;
    let phase = |ring: &Ring| circular_mean(ring.iter().map(|r| wrap(r.azimuth * turn))) / turn;
    let phases: Vec<f32> = rings.iter().map(phase).collect();
    BeamModel::from_tables(BeamTables {
        name: source.into(),
        elevations: rows.elevations,
        azimuth_offsets: phases,
        columns,
        clockwise,
        azimuth_of_first: 0.0,
        origin_radius: rows.origin[0],
        origin_height: rows.origin[1],
    })
    .ok()
}

/// Step between columns of clouds whose rings are not in order: between neighbours by azimuth.
fn sorted_step(rings: &[Ring]) -> Option<f32> {
    let mut steps = Vec::new();
    for ring in rings {
        let mut azimuths: Vec<f32> = ring.iter().map(|r| r.azimuth).collect();
        azimuths.sort_by(f32::total_cmp);
        steps.extend(azimuths.windows(2).map(|w| w[1] - w[0]));
    }
    mode(&steps, 2e-4, 0.2)
}

/// Elevations of rings, and, where the rings agree on it, the point that the beams start from.
///
/// A beam that starts `r` before the axis at height `h` follows height = h + tan(elevation) (horizontal - r): a straight line for each ring, whose slope is the
/// beam's and whose intercepts over the slopes give the origin.
pub(super) fn rows(rings: &[Ring], has_origin: bool) -> Rows {
    let lines: Vec<Option<[f64; 2]>> = rings.iter().map(line).collect();
    if has_origin && let Some(origin) = origin(&lines) {
        // A beam's slope is surer through the common origin than through its own line.
        let slope = |ring: &Ring| {
            median(ring.iter().filter(|r| r.horizontal > 2.0 * origin[0]).map(|r| (r.height - origin[1]) / (r.horizontal - origin[0])).collect())
        };
        let mut elevations: Vec<f32> = rings.iter().map(|ring| slope(ring).atan()).collect();
        fill(&mut elevations, rings);
        return Rows { elevations, origin };
    }
    let far = |ring: &Ring| {
        let typical = median(ring.iter().map(|r| r.horizontal).collect());
        median(ring.iter().filter(|r| r.horizontal >= typical).map(|r| r.elevation).collect())
    };
    let mut elevations: Vec<f32> = rings.iter().map(far).collect();
    fill(&mut elevations, rings);
    Rows { elevations, origin: [0.0; 2] }
}

/// Gives rings without returns an elevation between their neighbours', and separates all.
fn fill(elevations: &mut [f32], rings: &[Ring]) {
    let known: Vec<usize> = (0..rings.len()).filter(|&i| !rings[i].is_empty()).collect();
    for i in 0..rings.len() {
        let after = known.partition_point(|&k| k < i);
        let (Some(&before), Some(&next)) = (known.get(after.saturating_sub(1)), known.get(after.min(known.len().saturating_sub(1)))) else {
            continue;
        };
        if rings[i].is_empty() {
            let at = if next > before { (i as f32 - before as f32) / (next - before) as f32 } else { i as f32 - before as f32 };
            let rise = if next > before { elevations[next] - elevations[before] } else { -0.01 };
            elevations[i] = elevations[before] + rise * at;
        }
    }
    separate(elevations);
}

/// Slope and intercept of height over horizontal; `None` where the ring's returns are all about equally far.
fn line(ring: &Ring) -> Option<[f64; 2]> {
    const LEAST: usize = 60;
    const LEAST_SPREAD: f64 = 1.0;
    let n = ring.len() as f64;
    let mean = |f: fn(&Direction) -> f32| ring.iter().map(|r| f64::from(f(r))).sum::<f64>() / n;
    let (horizontal, height) = (mean(|r| r.horizontal), mean(|r| r.height));
    let (xx, xy) = ring.iter().fold((0.0, 0.0), |(xx, xy), r| {
        let (x, y) = (f64::from(r.horizontal) - horizontal, f64::from(r.height) - height);
        (xx + x * x, xy + x * y)
    });
    (ring.len() >= LEAST && (xx / n).sqrt() > LEAST_SPREAD).then(|| [xy / xx, height - xy / xx * horizontal])
}

/// The origin of the beams whose rings follow `lines`: intercept = height - slope * radius.
fn origin(lines: &[Option<[f64; 2]>]) -> Option<[f32; 2]> {
    /// With a larger residual the lines have no common point: the sensor has several heads, or the cloud is undistorted.
    const MOST_RESIDUAL: f64 = 0.004;
    /// No sensor is larger.
    const LARGEST: f64 = 0.2;
    const LEAST: f64 = 0.002;
    let lines: Vec<[f64; 2]> = lines.iter().flatten().copied().collect();
    if lines.len() < 8 {
        return None;
    }
    let n = lines.len() as f64;
    let (s, c) = lines.iter().fold((0.0, 0.0), |(s, c), l| (s + l[0] / n, c + l[1] / n));
    let (ss, sc) = lines.iter().fold((0.0, 0.0), |(ss, sc), l| (ss + (l[0] - s).powi(2), sc + (l[0] - s) * (l[1] - c)));
    let radius = if ss > 1e-6 { (-sc / ss).max(0.0) } else { 0.0 };
    let height = c + radius * s;
    let residual = (lines.iter().map(|l| (l[1] - height + radius * l[0]).powi(2)).sum::<f64>() / n).sqrt();
    // What is below the rounding of coordinates is no offset.
    let rounded = |length: f64| if length.abs() < LEAST { 0.0 } else { length as f32 };
    (residual < MOST_RESIDUAL && radius < LARGEST && height.abs() < LARGEST).then(|| [rounded(radius), rounded(height)])
}

/// Columns in a full turn of a sensor that measured `width` columns `step` apart.
pub(super) fn columns_of_turn(step: f32, width: usize) -> usize {
    let turn = TAU / step;
    if (turn - width as f32).abs() < 0.03 * turn { width } else { columns_of(step).max(width) }
}
