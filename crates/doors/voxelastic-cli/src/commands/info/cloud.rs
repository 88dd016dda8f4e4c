//! Description of a cloud.

use super::rows::{Bounds, row};
use serde::Serialize;
use std::path::Path;
use std::time::Instant;
use voxelastic::Cloud;
use voxelastic::geometry::Aabb;

/// The keys of `--json`.
#[derive(Debug, Serialize)]
pub struct CloudInfo {
    kind: &'static str,
    points: usize,
    /// Points that are returns: finite and not the origin.
    returns: usize,
    width: usize,
    height: usize,
    /// Whether the points form a grid of rings x columns.
    organised: bool,
    /// Channels besides x, y, z.
    channels: Vec<&'static str>,
    /// Box around the returns, lidar frame.
    bounds_m: Option<Bounds>,
    /// Smallest and largest distance of a return from the origin, metres.
    range_m: Option<[f32; 2]>,
    /// Time from the first to the last point, seconds.
    duration_s: Option<f32>,
    /// Number of rings.
    rings: Option<usize>,
    read_ms: f64,
}

/// Reads a cloud file and describes it.
pub fn describe(path: &Path) -> anyhow::Result<CloudInfo> {
    let clock = Instant::now();
    let cloud = voxelastic_io::clouds::read(path)?.cloud;
    let read_ms = clock.elapsed().as_secs_f64() * 1e3;
    let mut bounds = Aabb::default();
    let (mut returns, mut nearest, mut farthest) = (0, f32::INFINITY, 0.0f32);
    for p in cloud.points.iter().filter(|p| Cloud::is_return(p)) {
        bounds.add(*p);
        returns += 1;
        let range = p.iter().map(|c| c * c).sum::<f32>().sqrt();
        (nearest, farthest) = (nearest.min(range), farthest.max(range));
    }
    let channels = [("intensity", cloud.intensity.is_some()), ("ring", cloud.ring.is_some()), ("time", cloud.time.is_some())];
    Ok(CloudInfo {
        kind: "cloud",
        points: cloud.len(),
        returns,
        width: cloud.width,
        height: cloud.height,
        organised: cloud.is_organised(),
        channels: channels.iter().filter(|(_, present)| *present).map(|(name, _)| *name).collect(),
        bounds_m: Bounds::of(&bounds),
        range_m: (returns > 0).then_some([nearest, farthest]),
        duration_s: cloud.time.as_deref().and_then(duration),
        rings: cloud.ring.as_deref().and_then(|r| r.iter().max()).map(|&last| usize::from(last) + 1),
        read_ms,
    })
}

fn duration(times: &[f32]) -> Option<f32> {
    let finite = || times.iter().copied().filter(|t| t.is_finite());
    let (first, last) = (finite().reduce(f32::min)?, finite().reduce(f32::max)?);
    Some(last - first)
}

/// The description as rows of a table.
pub fn table(info: &CloudInfo) -> Vec<(String, String)> {
    let layout = if info.organised { format!("{} rings x {} columns", info.height, info.width) } else { "unorganised".to_owned() };
    let channels = if info.channels.is_empty() { "none".to_owned() } else { info.channels.join(", ") };
    let mut rows =
        vec![row("points", format!("{} ({} returns)", info.points, info.returns)), row("layout", layout), row("further channels", channels)];
    rows.extend(info.rings.map(|n| row("rings", n)));
    rows.extend(info.duration_s.map(|s| row("times over", format!("{s:.4} s"))));
    rows.extend(info.range_m.map(|[near, far]| row("ranges", format!("{near:.2} to {far:.2} m"))));
    rows.extend(info.bounds_m.map(|b| row("extent", b)));
    rows.push(row("read in", format!("{:.1} ms", info.read_ms)));
    rows
}
