//! How well scans lie on each other's planes.

use super::planes::seen;
use super::settings::Round;
use super::surfels::ScanSurface;
use voxelastic::Pose;

/// The gate of those that judge, metres. It is the same before and after.
pub(super) const GATE: f64 = 0.2;

/// How well scans lie on each other's planes at some poses.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Judgement {
    /// Planes that several scans share.
    pub planes: usize,
    /// Thickness of the planes, one standard deviation of the points across them, metres: that of the middle plane ..
    pub thickness_m: f64,
    /// .. and that which 90 % of them do not exceed.
    pub thickness_90_m: f64,
    /// Points that were held out.
    pub held_out: usize,
    /// The share of these that lies near a plane of other scans.
    pub near: f64,
    /// Distance of these from it: that of the middle one, metres.
    pub distance_m: f64,
    /// How ill all points that were held out lie on the planes of other scans: the mean of half the logarithm of one plus the square of the distance, in units of the roughness
    /// of flat planes. A point near no plane counts as one as far as the gate.
    pub score: f64,
}

/// Judges poses.
pub(super) fn judge(scans: &[ScanSurface], poses: &[Pose], round: &Round) -> Judgement {
    let seen = seen(scans, poses, round);
    let all: f64 = (scans.iter().enumerate())
        .map(|(scan, surface)| {
            let held_out = surface.surfels.iter().enumerate().filter(|(k, _)| round.holds_out(scan as u32, *k as u32));
            held_out.map(|(_, s)| f64::from(s.count)).sum::<f64>()
        })
        .sum();
    let mut held: Vec<(f64, f64)> = seen.iter().flat_map(|plane| &plane.held_out).map(|(_, distance, count)| (*distance, *count)).collect();
    held.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let near = held.iter().fold(0.0, |sum, (_, count)| sum + count);
    // A distance on a rough plane says little; such a loss hears most of what flat ones say.
    let loss = |distance: f64| 0.5 * (distance.min(round.gate) / round.roughness).powi(2).ln_1p();
    let sum: f64 = held.iter().map(|(distance, count)| count * loss(*distance)).sum();
    let mut below = 0.0;
    let middle = held.iter().find(|(_, count)| {
        below += count;
        below >= 0.5 * near
    });
    let mut thickness: Vec<f64> = seen.iter().map(|plane| plane.variance.sqrt()).collect();
    thickness.sort_unstable_by(f64::total_cmp);
    let quantile = |q: f64| thickness.get(((thickness.len() as f64 - 1.0) * q).round() as usize).copied().unwrap_or(f64::NAN);
    Judgement {
        planes: seen.len(),
        thickness_m: quantile(0.5),
        thickness_90_m: quantile(0.9),
        held_out: all as usize,
        near: near / all.max(1.0),
        distance_m: middle.map_or(f64::NAN, |(distance, _)| *distance),
        score: (sum + loss(round.gate) * (all - near)) / all.max(1.0),
    }
}

impl Judgement {
    /// Whether it is better than another by more than a gain.
    pub(super) fn is_better(&self, before: &Self, gain: f64) -> bool {
        self.score < before.score - gain
    }
}
