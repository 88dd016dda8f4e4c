//! Planes of the world: surfels of all scans in cubes, halved where they are no plane.

use super::moments::Cluster;
use super::plane_fit::{Placed, Plane, tukey};
use super::settings::Round;
use super::surfels::ScanSurface;
use crate::registration::key;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use voxelastic::Pose;

/// Lines do not vary by more than this across the plane that they are on, metres (one standard deviation).
const LINE_SPREAD: f64 = 0.05;

/// A plane that several scans see.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// One for each scan, in their order.
    pub(super) clusters: Vec<Cluster>,
}

/// A surfel on a plane: its number, and its weight.
#[derive(Clone, Copy)]
struct Member {
    scan: u32,
    surfel: u32,
    weight: f64,
}

/// What is in a cube at the root.
pub(super) struct Cube<'a> {
    scans: &'a [ScanSurface],
    poses: &'a [Pose],
    round: &'a Round,
    /// Its centre in the map frame, metres.
    centre: Vector3<f64>,
}

/// A plane in a cube, with the corner and the edge of the smaller cube that it fills.
struct Found {
    plane: Plane,
    low: Vector3<f64>,
    size: f64,
    members: Vec<Member>,
    held_out: Vec<HeldOut>,
}

/// A surfel that was held out, on a plane.
#[derive(Clone, Copy)]
struct HeldOut {
    scan: u32,
    point: Vector3<f64>,
    /// Variance of its points across the plane, metres squared.
    variance: f64,
    count: f64,
}

/// Surfels by the cube at the root in which poses put them: sorted by the key of the cube, then by scan and surfel.
pub(super) struct Sorted {
    places: Vec<(u64, u32, u32)>,
    origin: Vector3<f64>,
}

impl Sorted {
    pub(super) fn new(scans: &[ScanSurface], poses: &[Pose], round: &Round) -> Self {
        let origin = poses.first().map_or_else(Vector3::zeros, |pose| pose.translation.vector);
        let mut places: Vec<(u64, u32, u32)> = Vec::new();
        for (scan, (surface, pose)) in scans.iter().zip(poses).enumerate() {
            places.extend(surface.surfels.iter().enumerate().map(|(surfel, s)| {
                let p = ((pose * Point3::from(s.mean.map(f64::from))).coords - origin) / round.cube;
                (key([p.x, p.y, p.z].map(|v| v.floor() as i32)), scan as u32, surfel as u32)
            }));
        }
        places.par_sort_unstable();
        Self { places, origin }
    }

    /// Does something with each cube, in their order.
    pub(super) fn cubes<T: Send>(
        &self,
        scans: &[ScanSurface],
        poses: &[Pose],
        round: &Round,
        work: impl Fn(&Cube<'_>, &[(u64, u32, u32)]) -> Vec<T> + Sync,
    ) -> Vec<T> {
        let pieces: Vec<&[(u64, u32, u32)]> = self.places.chunk_by(|a, b| a.0 == b.0).collect();
        let of_piece = |piece: &&[(u64, u32, u32)]| {
            let (_, scan, surfel) = piece[0];
            let mean = scans[scan as usize].surfels[surfel as usize].mean;
            let p = ((poses[scan as usize] * Point3::from(mean.map(f64::from))).coords - self.origin) / round.cube;
            let centre = self.origin + p.map(|v| (v.floor() + 0.5) * round.cube);
            work(&Cube { scans, poses, round, centre }, piece)
        };
        let lists: Vec<Vec<T>> = pieces.par_iter().with_min_len(64).map(of_piece).collect();
        lists.into_iter().flatten().collect()
    }
}

/// The planes that are shared by several scans.
pub(super) fn shared(scans: &[ScanSurface], poses: &[Pose], round: &Round) -> Vec<Shared> {
    Sorted::new(scans, poses, round).cubes(scans, poses, round, |cube, piece| {
        let found = cube.planes(piece);
        found.iter().filter_map(|found| cube.share(&found.members, round.flatness_weight(found.plane.variance))).collect()
    })
}

/// A plane as those see it that judge: variance of its points across it, and the distances of points that were held out.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) variance: f64,
    /// Scan, distance to the plane through the surfels of other scans, and number of points.
    pub(super) held_out: Vec<(u32, f64, f64)>,
}

/// The planes that are shared by several scans, as those see them that judge.
pub(super) fn seen(scans: &[ScanSurface], poses: &[Pose], round: &Round) -> Vec<Seen> {
    Sorted::new(scans, poses, round).cubes(scans, poses, round, |cube, piece| {
        let found = cube.planes(piece);
        found.iter().filter_map(|found| cube.see(found)).collect()
    })
}

impl Cube<'_> {
    fn place(&self, scan: u32, surfel: u32) -> Placed {
        let (pose, s) = (&self.poses[scan as usize], &self.scans[scan as usize].surfels[surfel as usize]);
        Placed {
            point: (pose * Point3::from(s.mean.map(f64::from))).coords - self.centre,
            normal: pose.rotation * Vector3::from(s.normal.map(f64::from)),
            weight: f64::from(s.count).min(self.round.most_points),
            scan,
            surfel,
        }
    }

    /// The planes in the cube with the surfels on them.
    fn planes(&self, piece: &[(u64, u32, u32)]) -> Vec<Found> {
        let first = piece[0].1;
        if piece.iter().all(|(_, scan, _)| *scan == first) {
            return Vec::new();
        }
        let mut sides: [Vec<Placed>; 6] = std::array::from_fn(|_| Vec::new());
        let mut rest = Vec::new();
        for (_, scan, surfel) in piece {
            let placed = self.place(*scan, *surfel);
            if placed.normal == Vector3::zeros() || self.round.holds_out(*scan, *surfel) {
                rest.push(placed);
            } else {
                sides[side(&placed.normal)].push(placed);
            }
        }
        let (mut found, half) = (Vec::new(), 0.5 * self.round.cube);
        for surfels in sides {
            self.divide(surfels, Vector3::repeat(-half), self.round.cube, self.round.halvings, &mut found);
        }
        rest.iter().for_each(|placed| self.attach(placed, &mut found));
        found
    }

    /// The plane of the surfels of one side in a cube, or those in its eight parts.
    fn divide(&self, surfels: Vec<Placed>, low: Vector3<f64>, size: f64, halvings: u32, found: &mut Vec<Found>) {
        let Some(first) = surfels.first() else { return };
        if surfels.iter().all(|s| s.scan == first.scan) {
            return;
        }
        if let Some(plane) = Plane::through(&surfels, size, self.round) {
            let member = |s: &Placed| Member { scan: s.scan, surfel: s.surfel, weight: s.weight * plane.trust(s, self.round.gate) };
            let members = surfels.iter().map(member).filter(|m| m.weight > 0.0).collect();
            found.push(Found { plane, low, size, members, held_out: Vec::new() });
            return;
        }
        if halvings == 0 {
            return;
        }
        let half = 0.5 * size;
        let mut parts: [Vec<Placed>; 8] = std::array::from_fn(|_| Vec::new());
        for placed in surfels {
            let part = (0..3).filter(|i| placed.point[*i] >= low[*i] + half).map(|i| 1 << i).sum::<usize>();
            parts[part].push(placed);
        }
        for (part, surfels) in parts.into_iter().enumerate() {
            let step = Vector3::new((part & 1) as f64, (part >> 1 & 1) as f64, (part >> 2) as f64);
            self.divide(surfels, low + half * step, half, halvings - 1, found);
        }
    }

    /// Gives a line, or what is held out, to the nearest plane on which it is.
    fn attach(&self, placed: &Placed, found: &mut [Found]) {
        let (pose, s) = (&self.poses[placed.scan as usize], &self.scans[placed.scan as usize].surfels[placed.surfel as usize]);
        let to_sensor = pose.translation.vector - self.centre - placed.point;
        let mut best: Option<(f64, usize, f64)> = None;
        for (k, found) in found.iter().enumerate() {
            let (plane, from_low) = (&found.plane, placed.point - found.low);
            let distance = plane.distance(&placed.point).abs();
            let is_inside = (0..3).all(|i| from_low[i] >= 0.0 && from_low[i] < found.size);
            if !is_inside || distance >= self.round.gate || best.is_some_and(|(least, ..)| least <= distance) || plane.normal.dot(&to_sensor) <= 0.0 {
                continue;
            }
            let normal = pose.rotation.inverse() * plane.normal;
            let variance = s.variance_along([normal.x, normal.y, normal.z]);
            let is_on = if s.is_plane() { plane.trust(placed, self.round.gate) > 0.0 } else { variance < LINE_SPREAD * LINE_SPREAD };
            if is_on {
                best = Some((distance, k, variance));
            }
        }
        let Some((distance, k, variance)) = best else { return };
        if self.round.holds_out(placed.scan, placed.surfel) {
            found[k].held_out.push(HeldOut { scan: placed.scan, point: placed.point, variance, count: f64::from(s.count) });
        } else {
            let weight = placed.weight * tukey(distance, self.round.gate);
            found[k].members.push(Member { scan: placed.scan, surfel: placed.surfel, weight });
        }
    }

    /// The plane as scans share it, if several do.
    fn share(&self, members: &[Member], factor: f64) -> Option<Shared> {
        let mut members = members.to_vec();
        members.sort_unstable_by_key(|m| (m.scan, m.surfel));
        let point = |m: &Member| (factor * m.weight, Vector3::from(self.scans[m.scan as usize].surfels[m.surfel as usize].mean.map(f64::from)));
        let clusters: Vec<Cluster> =
            members.chunk_by(|a, b| a.scan == b.scan).map(|of_scan| Cluster::of(of_scan[0].scan, of_scan.iter().map(point))).collect();
        (clusters.len() > 1).then_some(Shared { clusters })
    }

    fn see(&self, found: &Found) -> Option<Seen> {
        let whole = self.share(&found.members, 1.0)?;
        let normal = |scan: u32| self.poses[scan as usize].rotation.inverse() * found.plane.normal;
        let (mut points, mut squares) = (0.0, 0.0);
        for m in &found.members {
            let (placed, q) = (self.place(m.scan, m.surfel), normal(m.scan));
            let s = &self.scans[m.scan as usize].surfels[m.surfel as usize];
            points += f64::from(s.count);
            squares += f64::from(s.count) * (found.plane.distance(&placed.point).powi(2) + s.variance_along([q.x, q.y, q.z]));
        }
        let mut held_out = Vec::with_capacity(found.held_out.len());
        for held in &found.held_out {
            let others: Vec<Cluster> = whole.clusters.iter().filter(|c| c.scan != held.scan).copied().collect();
            if let Some(plane) = super::moments::fit(&others, self.poses) {
                let distance = plane.normal.dot(&(held.point + self.centre - plane.centre)).abs();
                held_out.push((held.scan, distance, held.count));
                points += held.count;
                squares += held.count * (found.plane.distance(&held.point).powi(2) + held.variance);
            }
        }
        Some(Seen { variance: squares / points, held_out })
    }
}

/// The side of a cube towards which a normal looks most.
fn side(normal: &Vector3<f64>) -> usize {
    let axis = normal.iamax();
    2 * axis + usize::from(normal[axis] > 0.0)
}
