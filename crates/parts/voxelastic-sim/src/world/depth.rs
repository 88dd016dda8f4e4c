//! Depth of a point inside a union of convex solids: the distance to the nearest point outside of all of them.
//!
//! A point is outside of a convex solid if it is in front of at least one of its faces. The nearest outside point is found by branch and bound: compute
//! the nearest point in front of all faces chosen so far; if a solid contains it, branch over the faces of that solid. Faces farther than the
//! best solution are skipped, so that a point near a plain wall costs two queries.

use super::union::Union;
use crate::solid::{Face, Vec3};

/// During the search solids are thicker by this, metres, so that there are no cracks between solids that touch. The result is reduced by the same
/// amount.
pub(super) const SKIN: f64 = 1e-5;

/// Most faces chosen at once. A nearest point is determined by three; the search may choose more where many solids overlap.
const MAX_FACES: usize = 8;
/// Queries after which a search ends with the best solution so far: overlapping solids have many similar corners.
const MAX_QUERIES: usize = 4000;

struct Search<'a> {
    union: &'a Union,
    p: Vec3,
    best: f64,
    queries: usize,
}

/// Depth of `p` below the surface of the union, metres, at most `limit`; outside it is negative, at least minus [`SKIN`]. The search radius starts at
/// `first_radius` and grows, since a small radius prunes more.
pub(super) fn depth(union: &Union, p: &Vec3, first_radius: f64, limit: f64) -> f64 {
    let mut radius = limit.min(first_radius);
    loop {
        let mut search = Search { union, p: *p, best: radius + SKIN, queries: 0 };
        search.descend(&mut Vec::with_capacity(MAX_FACES), *p);
        if search.best < radius + SKIN || radius >= limit {
            return search.best - SKIN;
        }
        radius = (1.5 * radius).min(limit);
    }
}

impl Search<'_> {
    /// Branches at `q`, the point nearest to `p` in front of all `chosen` faces.
    fn descend(&mut self, chosen: &mut Vec<Face>, q: Vec3) {
        self.queries += 1;
        let deepest = self.union.nearest(&q).filter(|&(d, _)| d < SKIN - 1e-9);
        let Some((_, solid)) = deepest else {
            self.best = self.best.min((q - self.p).norm());
            return;
        };
        if chosen.len() == MAX_FACES || self.queries > MAX_QUERIES {
            return;
        }
        let mut faces: Vec<(f64, Face)> = self.union.solids[solid as usize].faces().map(|f| (SKIN - f.eval(&self.p).0, f)).collect();
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

/// Nearest point to `p` on one, two or three faces (each moved out by [`SKIN`]), by iterated linearisation with tangent planes.
fn nearest_on(p: &Vec3, faces: &[Face]) -> Option<Vec3> {
    let mut q = *p;
    for _ in 0..60 {
        let mut normals = [Vec3::zeros(); 3];
        let mut offsets = [0.0; 3];
        for (k, face) in faces.iter().enumerate() {
            let (value, normal) = face.eval(&q);
            normals[k] = normal;
            // Distance from p to the plane.
            offsets[k] = SKIN - value + normal.dot(&(q - p));
        }
        let next = p + shortest_step(&normals[..faces.len()], &offsets)?;
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
