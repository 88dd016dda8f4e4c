//! The normal equations of all poses: planes are eliminated, so that scans which share one are tied to each other.

use super::moments::{Cluster, Fitted, fit};
use super::planes::Shared;
use crate::SlamError;
use crate::graph::{Between, Structure, System, exp, log, renormalised};
use nalgebra::{Matrix3, Matrix6, Matrix6x3, Vector3, Vector6};
use rayon::prelude::*;
use voxelastic::Pose;

/// Damping after a step that made things worse, and that with which it gives up, relative to the diagonal.
const DAMPING: (f64, f64) = (1e-5, 1e3);

/// Planes and edges as functions of the poses.
pub(super) struct Equations<'a> {
    planes: &'a [Shared],
    edges: &'a mut [Between],
    hold: Hold<'a>,
    /// Weight of a point of a plane: the inverse of its variance.
    per_point: f64,
    system: System,
    /// For each scan the planes that it sees, as numbers of the plane and of the cluster in it.
    seen_by: Vec<Vec<(u32, u32)>>,
    /// For each scan those before it with which it shares a plane.
    before: Vec<Vec<u32>>,
}

/// Standard deviation with which the first pose is held: it says where the map is, as in a pose graph.
const FIRST: f64 = 1e-4;

/// Poses are held, weakly, where they were: what surfaces do not decide stays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hold<'a> {
    pub(super) poses: &'a [Pose],
    /// Standard deviations, radians and metres.
    pub(super) sigmas: [f64; 2],
}

impl Hold<'_> {
    fn information(&self, scan: usize) -> Vector6<f64> {
        Vector6::from_fn(|i, _| if scan == 0 { FIRST } else { self.sigmas[i / 3] }.powi(-2))
    }

    fn cost(&self, scan: usize, pose: &Pose) -> f64 {
        let off = self.off(scan, pose);
        0.5 * off.dot(&self.information(scan).component_mul(&off))
    }

    /// The way from where a pose is held to where it is.
    fn off(&self, scan: usize, pose: &Pose) -> Vector6<f64> {
        log(&self.poses[scan].inv_mul(pose))
    }
}

/// A plane that is eliminated.
struct Eliminated {
    plane: Fitted,
    /// Where its own unknowns go when the poses stay.
    moved: Vector3<f64>,
    /// What it takes away from the block of two scans is the product of theirs.
    shared: Vec<Matrix6x3<f64>>,
}

impl<'a> Equations<'a> {
    /// The equations of so many scans.
    pub(super) fn new(scans: usize, planes: &'a [Shared], edges: &'a mut [Between], hold: Hold<'a>, sigma: f64) -> Result<Self, SlamError> {
        let mut seen_by = vec![Vec::new(); scans];
        for (p, plane) in planes.iter().enumerate() {
            for (c, cluster) in plane.clusters.iter().enumerate() {
                seen_by[cluster.scan as usize].push((p as u32, c as u32));
            }
        }
        let mut before = vec![Vec::new(); scans];
        let mut last_for = vec![u32::MAX; scans];
        for (scan, planes_of) in seen_by.iter().enumerate() {
            for (p, c) in planes_of {
                for other in &planes[*p as usize].clusters[..*c as usize] {
                    if last_for[other.scan as usize] != scan as u32 {
                        last_for[other.scan as usize] = scan as u32;
                        before[scan].push(other.scan);
                    }
                }
            }
            before[scan].sort_unstable();
        }
        let by_planes = before.iter().enumerate().flat_map(|(scan, before)| before.iter().map(move |b| (*b as usize, scan)));
        let by_edges = edges.iter().map(|e| e.nodes);
        let failed = || SlamError::Failed { reason: format!("the equations of {scans} scans do not fit into memory") };
        let system = Structure::new(scans, by_planes.chain(by_edges)).and_then(System::new).ok_or_else(failed)?;
        Ok(Self { planes, edges, hold, per_point: 1.0 / (sigma * sigma), system, seen_by, before })
    }

    /// Half the sum of all squares, in standard deviations.
    pub(super) fn cost(&self, poses: &[Pose]) -> f64 {
        let costs: Vec<f64> = self.planes.par_iter().map(|plane| fit(&plane.clusters, poses).map_or(0.0, |plane| plane.cost)).collect();
        let edges: f64 = self.edges.iter().map(|e| e.evaluate(&poses[e.nodes.0], &poses[e.nodes.1]).cost).sum();
        let held: f64 = poses.iter().enumerate().map(|(k, pose)| self.hold.cost(k, pose)).sum();
        0.5 * self.per_point * costs.iter().sum::<f64>() + edges + held
    }

    /// Takes steps while they gain something. Returns the cost at the end.
    pub(super) fn minimise(&mut self, poses: &mut Vec<Pose>, steps: usize) -> f64 {
        let (mut cost, mut damping) = (self.cost(poses), 0.0);
        let mut gradient = self.linearise(poses);
        let mut taken = 0;
        while taken < steps {
            let better = self.system.factorise(damping).then(|| {
                let step = self.system.solve(&gradient);
                let trial: Vec<Pose> = poses.iter().zip(&step).map(|(pose, step)| renormalised(pose * exp(&-step))).collect();
                (self.cost(&trial), trial)
            });
            match better.filter(|(after, _)| *after < cost) {
                Some((after, trial)) => {
                    let gain = cost - after;
                    (*poses, cost, damping, taken) = (trial, after, 0.1 * damping, taken + 1);
                    if gain < 1e-6 * cost || taken == steps {
                        break;
                    }
                    gradient = self.linearise(poses);
                }
                None if damping >= DAMPING.1 => break,
                None => damping = (10.0 * damping).max(DAMPING.0),
            }
        }
        cost
    }

    /// The step of Gauss-Newton, to be taken off; none if the system is not positive definite.
    #[cfg(test)]
    pub(super) fn step(&mut self, poses: &[Pose]) -> Option<Vec<Vector6<f64>>> {
        let gradient = self.linearise(poses);
        self.system.factorise(0.0).then(|| self.system.solve(&gradient))
    }

    /// Puts matrix and gradient together.
    pub(super) fn linearise(&mut self, poses: &[Pose]) -> Vec<Vector6<f64>> {
        let eliminated: Vec<Option<Eliminated>> = self.planes.par_iter().map(|plane| eliminate(plane, poses)).collect();
        let none = vec![None; poses.len()];
        let row = |place: &mut Vec<Option<u32>>, scan: usize| {
            let before = &self.before[scan];
            before.iter().enumerate().for_each(|(k, b)| place[*b as usize] = Some(k as u32));
            let mut blocks = vec![Matrix6::zeros(); before.len()];
            let (mut own, mut pull) = (Matrix6::zeros(), Vector6::zeros());
            for (p, c) in &self.seen_by[scan] {
                let (Some(Eliminated { plane, moved, shared }), c) = (&eliminated[*p as usize], *c as usize) else { continue };
                let clusters = &self.planes[*p as usize].clusters;
                let linear = clusters[c].linear(&poses[scan], plane);
                own += linear.pose - shared[c] * shared[c].transpose();
                pull += linear.pull - linear.both * moved;
                for (other, cluster) in shared[..c].iter().zip(clusters) {
                    if let Some(k) = place[cluster.scan as usize] {
                        blocks[k as usize] -= other * shared[c].transpose();
                    }
                }
            }
            before.iter().for_each(|b| place[*b as usize] = None);
            (own, pull, blocks)
        };
        let rows: Vec<_> = (0..poses.len()).into_par_iter().map_init(|| none.clone(), row).collect();
        self.system.clear();
        let mut gradient = vec![Vector6::zeros(); poses.len()];
        for (scan, (own, pull, blocks)) in rows.into_iter().enumerate() {
            self.system.add_diagonal(scan, &(self.per_point * own));
            gradient[scan] += self.per_point * pull;
            for (b, block) in self.before[scan].iter().zip(&blocks) {
                if let Some(place) = self.system.structure().block(*b as usize, scan) {
                    self.system.add(place, &(self.per_point * block));
                }
            }
        }
        for edge in self.edges.iter_mut() {
            let (a, b) = edge.nodes;
            let at = edge.evaluate(&poses[a], &poses[b]);
            let (first, second) = edge.gradient(&at);
            gradient[a] += first;
            gradient[b] += second;
            edge.linearise(&at, true);
            if let (Some(linear), Some(place)) = (edge.linear(), self.system.structure().block(a, b)) {
                self.system.add_diagonal(a, &linear.blocks[0]);
                self.system.add(place, &linear.blocks[1]);
                self.system.add_diagonal(b, &linear.blocks[2]);
            }
        }
        for (k, pose) in poses.iter().enumerate() {
            let information = self.hold.information(k);
            gradient[k] += information.component_mul(&self.hold.off(k, pose));
            self.system.add_diagonal(k, &Matrix6::from_diagonal(&information));
        }
        gradient
    }
}

/// Eliminates a plane; none if it has no direction.
fn eliminate(shared: &Shared, poses: &[Pose]) -> Option<Eliminated> {
    let plane = fit(&shared.clusters, poses)?;
    let linear = |c: &Cluster| c.linear(&poses[c.scan as usize], &plane);
    let (mut whole, mut pull) = (Matrix3::zeros(), Vector3::zeros());
    for l in shared.clusters.iter().map(linear) {
        whole += l.plane;
        pull += l.plane_pull;
    }
    let factor = whole.cholesky()?;
    // L X^T = both^T: the product of two such is what elimination takes away.
    let share = |c: &Cluster| factor.l_dirty().solve_lower_triangular(&linear(c).both.transpose()).map(|x| x.transpose());
    let taken: Option<Vec<Matrix6x3<f64>>> = shared.clusters.iter().map(share).collect();
    Some(Eliminated { plane, moved: factor.solve(&pull), shared: taken? })
}
