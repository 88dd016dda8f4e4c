//! The frontier: where free space meets the unknown, and a robot might look next.

use super::FieldQuery;
use super::faces::{Boundary, Face, faces};
use std::collections::BTreeMap;

/// A piece of the frontier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontierPoint {
    /// Mean position of the piece, metres.
    pub position: [f64; 3],
    /// Unit vector from free towards unknown space: the mean over the piece, weighted by area.
    pub normal: [f64; 3],
    /// Area of the piece, square metres.
    pub area: f64,
}

/// A face with the free and the unknown side of it, metres in the submap frame.
pub(super) struct FrontierFace {
    pub point: FrontierPoint,
    /// A quarter of the finest voxel into the unknown, and as far into free space.
    pub unknown: [f64; 3],
    pub free: [f64; 3],
}

impl FieldQuery<'_> {
    /// The frontier, a point for each cube of 2^level finest voxels that holds a piece of it (cubes of one level tile the
    /// submap frame), in the order of their coordinates; submap frame. Unknown space outside of the field counts.
    pub fn frontier(&self, level: u32) -> Vec<FrontierPoint> {
        gather(self.frontier_faces().into_iter().map(|face| face.point), self.voxel * f64::from(1u32 << level.min(30)))
    }

    /// Every face of the frontier.
    pub(super) fn frontier_faces(&self) -> Vec<FrontierFace> {
        faces(self.field, Boundary::Frontier, false).iter().map(|face| self.frontier_face(face)).collect()
    }

    fn frontier_face(&self, face: &Face) -> FrontierFace {
        let mut middle = face.low.map(f64::from);
        middle[(face.axis + 1) % 3] += 0.5 * f64::from(face.span[0]);
        middle[(face.axis + 2) % 3] += 0.5 * f64::from(face.span[1]);
        // Faces look from unknown to free space.
        let towards = if face.positive { -1.0 } else { 1.0 };
        let beside = |by: f64| {
            let mut p = middle;
            p[face.axis] += by * towards;
            p.map(|c| c * self.voxel)
        };
        let mut normal = [0.0; 3];
        normal[face.axis] = towards;
        let area = f64::from(face.span[0]) * f64::from(face.span[1]) * self.voxel * self.voxel;
        FrontierFace { point: FrontierPoint { position: beside(0.0), normal, area }, unknown: beside(0.25), free: beside(-0.25) }
    }
}

/// Sums up pieces by cubes of `edge` metres.
pub(super) fn gather(pieces: impl Iterator<Item = FrontierPoint>, edge: f64) -> Vec<FrontierPoint> {
    let mut cubes: BTreeMap<[i64; 3], Vec<FrontierPoint>> = BTreeMap::new();
    for piece in pieces {
        // A little to the free side, so that a face on the border of two cubes is in the one that is free.
        let cube = std::array::from_fn(|k| ((piece.position[k] - 1e-3 * edge * piece.normal[k]) / edge).floor() as i64);
        cubes.entry(cube).or_default().push(piece);
    }
    cubes.into_values().map(|pieces| mean(&pieces)).collect()
}

fn mean(pieces: &[FrontierPoint]) -> FrontierPoint {
    let area: f64 = pieces.iter().map(|p| p.area).sum();
    let weighted =
        |of: fn(&FrontierPoint) -> [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| pieces.iter().map(|p| of(p)[k] * p.area).sum::<f64>() / area) };
    let normal = weighted(|p| p.normal);
    let length = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
    // Faces that look in opposite directions may cancel: the first is then as good as any.
    let normal = if length > 1e-6 { normal.map(|c| c / length) } else { pieces[0].normal };
    FrontierPoint { position: weighted(|p| p.position), normal, area }
}
