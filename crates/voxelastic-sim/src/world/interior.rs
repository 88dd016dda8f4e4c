//! How deep a point lies inside a union of convex solids: the distance to the nearest point outside of all of them.
//!
//! To be outside of a convex solid is to be in front of at least one of its faces. The nearest outside point is found by
//! branch and bound: take the nearest point that satisfies the faces chosen so far; if some solid still holds it, choose
//! one of that solid's faces in turn. A face farther than the best answer so far is never tried, so that a point near a
//! plain wall costs two look-ups.

use super::World;
use crate::solid::{Face, Vec3};

/// Solids count as this much thicker (metres) while the search runs, so that those that merely touch leave no crack
/// between them. The depth found is reduced by as much.
pub(super) const SKIN: f64 = 1e-5;

/// Faces chosen at once. A nearest point needs three; more are chosen on the way to one where solids crowd.
const MOST_FACES: usize = 8;
/// Look-ups after which a search ends with what it has: crowds of solids have many corners, all alike.
const MOST_LOOKUPS: usize = 4000;

struct Search<'a> {
    world: &'a World,
    p: Vec3,
    best: f64,
    lookups: usize,
}

impl World {
    /// Depth of `p` below the surface of the union, metres, no more than `limit`; negative by up to [`SKIN`] outside.
    pub(super) fn depth(&self, p: &Vec3, limit: f64) -> f64 {
        // A near way out is found soon if far ones are not tried first.
        let mut reach = limit.min(Self::DEPTH_LIMIT);
        loop {
            let mut search = Search { world: self, p: *p, best: reach + SKIN, lookups: 0 };
            search.descend(&mut Vec::with_capacity(MOST_FACES), *p);
            if search.best < reach + SKIN || reach >= limit {
                return search.best - SKIN;
            }
            reach = (1.5 * reach).min(limit);
        }
    }
}

impl Search<'_> {
    /// `q` is the nearest point to `p` that is in front of all `chosen` faces.
    fn descend(&mut self, chosen: &mut Vec<Face>, q: Vec3) {
        self.lookups += 1;
        let deepest = self.world.nearest_solid(&q).filter(|&(d, _)| d < SKIN - 1e-9);
        let Some((_, solid)) = deepest else {
            self.best = self.best.min((q - self.p).norm());
            return;
        };
        if chosen.len() == MOST_FACES || self.lookups > MOST_LOOKUPS {
            return;
        }
        let mut faces: Vec<(f64, Face)> = self.world.solids[solid as usize].faces().map(|f| (SKIN - f.eval(&self.p).0, f)).collect();
        faces.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (behind, face) in faces {
            if behind >= self.best {
                break;
            }
            chosen.push(face);
            if let Some(q) = nearest_in_front(&self.p, chosen).filter(|q| (q - self.p).norm() < self.best) {
                self.descend(chosen, q);
            }
            chosen.pop();
        }
    }
}

/// Nearest point to `p` in front of all faces, which lies on the last of them and on at most two others.
fn nearest_in_front(p: &Vec3, faces: &[Face]) -> Option<Vec3> {
    let (last, others) = faces.split_last()?;
    let mut best: Option<(f64, Vec3)> = None;
    let mut consider = |on: &[Face]| {
        let Some(q) = nearest_on(p, on) else { return };
        let distance = (q - p).norm();
        let in_front = || faces.iter().all(|f| f.eval(&q).0 >= SKIN - 1e-9);
        if best.is_none_or(|(b, _)| distance < b) && in_front() {
            best = Some((distance, q));
        }
    };
    consider(&[*last]);
    for (i, a) in others.iter().enumerate() {
        consider(&[*last, *a]);
        for b in &others[..i] {
            consider(&[*last, *a, *b]);
        }
    }
    best.map(|(_, q)| q)
}

/// Nearest point to `p` on one, two or three faces (each [`SKIN`] out): the faces are replaced by their tangent planes,
/// again and again until the point stays.
fn nearest_on(p: &Vec3, faces: &[Face]) -> Option<Vec3> {
    let mut q = *p;
    for _ in 0..60 {
        let mut normals = [Vec3::zeros(); 3];
        let mut short = [0.0; 3];
        for (k, face) in faces.iter().enumerate() {
            let (value, normal) = face.eval(&q);
            normals[k] = normal;
            // How far the plane is in front of p.
            short[k] = SKIN - value + normal.dot(&(q - p));
        }
        let next = p + shortest_step(&normals[..faces.len()], &short)?;
        let moved = (next - q).norm();
        q = next;
        if moved < 1e-11 {
            return Some(q);
        }
    }
    (faces.iter().all(|f| (f.eval(&q).0 - SKIN).abs() < 1e-7)).then_some(q)
}

/// The shortest vector with the given components along one to three unit normals; `None` when they are (nearly) dependent.
fn shortest_step(normals: &[Vec3], components: &[f64; 3]) -> Option<Vec3> {
    const DEPENDENT: f64 = 1e-10;
    match normals {
        [a] => Some(a * components[0]),
        [a, b] => {
            let c = a.dot(b);
            let det = 1.0 - c * c;
            (det > DEPENDENT).then(|| a * ((components[0] - c * components[1]) / det) + b * ((components[1] - c * components[0]) / det))
        }
        [a, b, c] => {
            // Dual basis of the three normals.
            let (bc, ca, ab) = (b.cross(c), c.cross(a), a.cross(b));
            let det = a.dot(&bc);
            (det.abs() > DEPENDENT).then(|| (bc * components[0] + ca * components[1] + ab * components[2]) / det)
        }
        _ => None,
    }
}
