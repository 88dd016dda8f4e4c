//! The frontier: the boundary between free and unknown space, where exploration continues.

use super::FieldQuery;
use crate::field::occupancy::{Boundary, Face, faces};
use std::collections::BTreeMap;

/// The part of the frontier within a cube.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrontierPoint {
    /// Mean position, metres.
    pub position: [f64; 3],
    /// Unit vector from free towards unknown space: the mean weighted by area.
    pub normal: [f64; 3],
    /// Area, square metres.
    pub area: f64,
}

/// A face with points on both sides, metres in the submap frame.
pub(super) struct FrontierFace {
    pub point: FrontierPoint,
    /// A quarter of the finest voxel into the unknown, and as far into free space.
    pub unknown: [f64; 3],
    pub free: [f64; 3],
}

impl FieldQuery<'_> {
    /// The frontier in the submap frame, one point per cube of 2^level finest voxels (cubes of one level tile the submap frame), ordered by
    /// the cubes' coordinates. Includes the boundary to unknown space outside of the field.
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
        // Faces point from unknown to free space.
        let towards = if face.positive { -1.0 } else { 1.0 };
        let offset = |by: f64| {
            let mut p = middle;
            p[face.axis] += by * towards;
            p.map(|c| c * self.voxel)
        };
        let mut normal = [0.0; 3];
        normal[face.axis] = towards;
        let area = f64::from(face.span[0]) * f64::from(face.span[1]) * self.voxel * self.voxel;
        FrontierFace { point: FrontierPoint { position: offset(0.0), normal, area }, unknown: offset(0.25), free: offset(-0.25) }
    }
}

/// Averages points within cubes of `edge` metres.
pub(super) fn gather(points: impl Iterator<Item = FrontierPoint>, edge: f64) -> Vec<FrontierPoint> {
    let mut cubes: BTreeMap<[i64; 3], Vec<FrontierPoint>> = BTreeMap::new();
    for point in points {
        // Shifted towards free space, so that a face between two cubes belongs to the free one.
        let cube = std::array::from_fn(|k| ((point.position[k] - 1e-3 * edge * point.normal[k]) / edge).floor() as i64);
        cubes.entry(cube).or_default().push(point);
    }
    cubes.into_values().map(|points| mean(&points)).collect()
}

fn mean(points: &[FrontierPoint]) -> FrontierPoint {
    let area: f64 = points.iter().map(|p| p.area).sum();
    let weighted =
        |of: fn(&FrontierPoint) -> [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| points.iter().map(|p| of(p)[k] * p.area).sum::<f64>() / area) };
    let normal = weighted(|p| p.normal);
    let length = normal.iter().map(|c| c * c).sum::<f64>().sqrt();
    // Opposite normals may cancel; then the first one is used.
    let normal = if length > 1e-6 { normal.map(|c| c / length) } else { points[0].normal };
    FrontierPoint { position: weighted(|p| p.position), normal, area }
}
