//! How well scans lie on each other's planes.

use super::planes::seen;
use super::settings::Round;
use super::surfels::ScanSurface;
use voxelastic::Pose;

/// The gate of those that judge, metres. It is the same before and after.
pub(super) const GATE: f64 = 0.3;

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
    /// Mean distance of these from it, metres.
    pub distance_m: f64,
    /// Mean distance of all points that were held out, metres; those that are near no plane count as far as the gate.
    pub score_m: f64,
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
    let (mut near, mut sum) = (0.0, 0.0);
    for (_, distance, count) in seen.iter().flat_map(|plane| &plane.held_out) {
        near += count;
        sum += count * distance.min(round.gate);
    }
    let mut thickness: Vec<f64> = seen.iter().map(|plane| plane.variance.sqrt()).collect();
    thickness.sort_unstable_by(f64::total_cmp);
    let quantile = |q: f64| thickness.get(((thickness.len() as f64 - 1.0) * q).round() as usize).copied().unwrap_or(f64::NAN);
    Judgement {
        planes: seen.len(),
        thickness_m: quantile(0.5),
        thickness_90_m: quantile(0.9),
        held_out: all as usize,
        near: near / all.max(1.0),
        distance_m: sum / near.max(1.0),
        score_m: (sum + round.gate * (all - near)) / all.max(1.0),
    }
}

impl Judgement {
    /// Whether it is better than another by more than a share of the distances there.
    pub(super) fn is_better(&self, before: &Self, share: f64) -> bool {
        self.score_m < before.score_m - share * before.distance_m * before.near
    }
}
