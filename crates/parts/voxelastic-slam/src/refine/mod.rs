//! Refinement: the surfaces themselves correct the poses. Bundle adjustment over planes, as BALM does it (Liu and Zhang, "BALM: Bundle Adjustment for Lidar
//! Mapping", 2021; Liu, Liu and Zhang, "Efficient and Consistent Bundle Adjustment on Lidar Point Clouds", 2023).
//!
//! A scan is kept as surfels. Surfels of all scans that lie in one cube and look to one side are one plane, where a robust fit says so; other cubes are halved.
//! Of each plane, each scan knows ten sums, from which cost and derivatives follow for any pose. The cost is the sum of squares of the distances of all points
//! to their planes; planes are unknowns, too, and are eliminated, which leaves one sparse system over all poses. Edges between scans count beside them, and each pose is held, weakly, where it was: what no plane decides stays.
//! Round by round planes are found anew, and what is far from them no longer counts. One of ten surfels is held out and judges: poses that it does not find
//! better are not kept.

mod equations;
mod judge;
mod moments;
mod plane_fit;
mod planes;
#[cfg(test)]
mod reference;
mod settings;
mod surfels;

pub use judge::Judgement;
pub use settings::RefineSettings;
pub use surfels::ScanSurface;

use crate::SlamError;
use crate::graph::{Between, usable_information};
use equations::{Equations, Hold};
use settings::Round;
use voxelastic::Pose;
use voxelastic::event::Edge;
use voxelastic::geometry::PoseExt;

/// Standard deviations up to which an edge that is no odometry counts fully.
const HUBER: f64 = 3.5;

/// What a round did.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RoundReport {
    /// Surfels farther than this from a plane were not on it, metres.
    pub gate_m: f64,
    /// Planes that several scans shared.
    pub planes: usize,
    /// How well the scans lie on them after it.
    pub judgement: Judgement,
    /// Whether the poses were kept.
    pub is_kept: bool,
}

/// The outcome of a refinement.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Refined {
    /// The poses, in the order of the scans.
    pub poses: Vec<Pose>,
    /// How well the scans lay on each other before.
    pub before: Judgement,
    /// And after.
    pub after: Judgement,
    /// The rounds.
    pub rounds: Vec<RoundReport>,
}

/// Refines the poses of scans. `edges` are what else is known of the way between scans, by their numbers. `cell` is the edge of the
/// cells of the scans, metres.
///
/// # Errors
/// [`SlamError`]: edges that are none, or a system too large.
pub fn refine(poses: &[Pose], scans: &[ScanSurface], edges: &[Edge], cell: f64, settings: &RefineSettings) -> Result<Refined, SlamError> {
    let mut between = edges_between(poses.len(), edges)?;
    let hold = Hold { poses, sigmas: settings.held };
    let judging = Round::new(settings, judge::GATE, cell);
    let before = judge::judge(scans, poses, &judging);
    let (mut best, mut after, mut rounds) = (poses.to_vec(), before, Vec::new());
    for (k, gate) in settings.gates.iter().enumerate() {
        let planes = planes::shared(scans, &best, &Round::new(settings, *gate, cell));
        let mut trial = best.clone();
        Equations::new(scans.len(), &planes, &mut between, hold, settings.sigma)?.minimise(&mut trial, settings.steps);
        let judgement = judge::judge(scans, &trial, &judging);
        let is_near = trial.iter().zip(poses).all(|(now, given)| now.translation_distance(given) < settings.most_moved);
        let is_kept = is_near && judgement.is_better(&after, settings.least_gain);
        rounds.push(RoundReport { gate_m: *gate, planes: planes.len(), judgement, is_kept });
        if is_kept {
            (best, after) = (trial, judgement);
        } else if settings.gates.get(k + 1) == Some(gate) {
            // The same again would end the same.
            break;
        }
    }
    Ok(Refined { poses: best, before, after, rounds })
}

/// The edges as factors.
fn edges_between(scans: usize, edges: &[Edge]) -> Result<Vec<Between>, SlamError> {
    let mut out = Vec::with_capacity(edges.len());
    for edge in edges {
        if edge.from.max(edge.to) >= scans as u64 {
            return Err(SlamError::UnknownNode { node: edge.from.max(edge.to) });
        }
        if edge.from == edge.to {
            return Err(SlamError::SelfEdge { node: edge.from });
        }
        let is_odometry = edge.from.abs_diff(edge.to) == 1;
        let (information, _) = usable_information(edge)?;
        out.push(Between::new((edge.from as usize, edge.to as usize), edge.t_from_to, information, (!is_odometry).then_some(HUBER)));
    }
    Ok(out)
}
