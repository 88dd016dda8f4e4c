//! Triangles of a surface that lie together.

use crate::geometry::{Aabb, Pose, Rigid};
use crate::surface::Mesh;
use std::collections::BTreeMap;

/// A connected part of a surface that only one of two maps has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ChangedPiece {
    /// Its surface, map frame, metres.
    pub mesh: Mesh,
    /// The box around it, map frame, metres.
    pub bounds: Aabb,
    /// Its area, square metres.
    pub area: f64,
}

impl ChangedPiece {
    /// The surfaces of several pieces as one mesh.
    pub fn join(pieces: &[Self]) -> Mesh {
        let mut mesh = Mesh::default();
        pieces.iter().for_each(|piece| mesh.append(&piece.mesh, &Rigid::from(&Pose::identity())));
        mesh
    }
}

/// The pieces of at least `least_area` square metres, largest first, that the triangles of `mesh` make for which `is_changed` says so. Triangles belong together
/// whose vertices are in the same cube of edge `cell` metres, or in neighbouring ones.
pub(super) fn pieces(mesh: &Mesh, is_changed: impl Fn([u32; 3]) -> bool, cell: f64, least_area: f64) -> Vec<ChangedPiece> {
    let cube_of = |vertex: u32| mesh.positions[vertex as usize].map(|c| (f64::from(c) / cell).floor() as i64);
    let changed: Vec<[u32; 3]> = mesh.triangles.iter().copied().filter(|&triangle| is_changed(triangle)).collect();
    // Numbers of cubes in the order of their coordinates, so that the result depends on nothing else.
    let mut cubes: BTreeMap<[i64; 3], usize> = changed.as_flattened().iter().map(|&vertex| (cube_of(vertex), 0)).collect();
    cubes.values_mut().enumerate().for_each(|(number, of)| *of = number);
    let mut sets = DisjointSets::new(cubes.len());
    for (at, &number) in &cubes {
        for step in 0..27 {
            let near = [at[0] + step % 3 - 1, at[1] + step / 3 % 3 - 1, at[2] + step / 9 - 1];
            if let Some(&other) = cubes.get(&near) {
                sets.join(number, other);
            }
        }
    }
    // A triangle may be larger than a cube.
    for &[a, b, c] in &changed {
        let of = cubes[&cube_of(a)];
        sets.join(of, cubes[&cube_of(b)]);
        sets.join(of, cubes[&cube_of(c)]);
    }
    let mut triangles: BTreeMap<usize, Vec<[u32; 3]>> = BTreeMap::new();
    for &triangle in &changed {
        triangles.entry(sets.root(cubes[&cube_of(triangle[0])])).or_default().push(triangle);
    }
    let all = triangles.into_values().map(|triangles| piece(mesh, &triangles));
    let mut pieces: Vec<ChangedPiece> = all.filter(|piece| piece.area >= least_area).collect();
    pieces.sort_by(|a, b| b.area.total_cmp(&a.area));
    pieces
}

/// The triangles of `mesh` by themselves.
fn piece(mesh: &Mesh, triangles: &[[u32; 3]]) -> ChangedPiece {
    let mut numbers: BTreeMap<u32, u32> = triangles.as_flattened().iter().map(|&vertex| (vertex, 0)).collect();
    numbers.values_mut().zip(0..).for_each(|(number, n)| *number = n);
    let vertices = || numbers.keys().map(|&vertex| vertex as usize);
    let part = Mesh {
        positions: vertices().map(|v| mesh.positions[v]).collect(),
        normals: vertices().filter_map(|v| mesh.normals.get(v).copied()).collect(),
        intensities: vertices().filter_map(|v| mesh.intensities.get(v).copied()).collect(),
        colours: vertices().filter_map(|v| mesh.colours.get(v).copied()).collect(),
        scales: vertices().filter_map(|v| mesh.scales.get(v).copied()).collect(),
        triangles: triangles.iter().map(|triangle| triangle.map(|vertex| numbers[&vertex])).collect(),
    };
    let mut bounds = Aabb::default();
    part.positions.iter().for_each(|&p| bounds.add(p));
    let area = triangles.iter().map(|&triangle| area(mesh, triangle)).sum();
    ChangedPiece { mesh: part, bounds, area }
}

/// The area of a triangle of `mesh`, square metres.
pub(super) fn area(mesh: &Mesh, triangle: [u32; 3]) -> f64 {
    let [a, b, c] = triangle.map(|vertex| nalgebra::Vector3::from(mesh.positions[vertex as usize].map(f64::from)));
    0.5 * (b - a).cross(&(c - a)).norm()
}

/// Numbers in sets that are joined.
struct DisjointSets(Vec<usize>);

impl DisjointSets {
    fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    /// The smallest number of the set of `number`.
    fn root(&mut self, mut number: usize) -> usize {
        while self.0[number] != number {
            self.0[number] = self.0[self.0[number]];
            number = self.0[number];
        }
        number
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Small triangles at `places`.
    fn mesh_at(places: &[[f32; 3]]) -> Mesh {
        let corners = |p: &[f32; 3]| [*p, [p[0] + 0.1, p[1], p[2]], [p[0], p[1] + 0.1, p[2]]];
        let positions: Vec<[f32; 3]> = places.iter().flat_map(corners).collect();
        let triangles = (0..places.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        Mesh { normals: vec![[0.0, 0.0, 1.0]; positions.len()], positions, triangles, ..Mesh::default() }
    }

    /// The number of sets of triangles, by comparing all with all again and again.
    fn slow_count(mesh: &Mesh, cell: f64) -> usize {
        let cubes = |triangle: &[u32; 3]| triangle.map(|v| mesh.positions[v as usize].map(|c| (f64::from(c) / cell).floor() as i64));
        let near = |a: [i64; 3], b: [i64; 3]| (0..3).all(|k| (a[k] - b[k]).abs() <= 1);
        let mut of: Vec<usize> = (0..mesh.triangles.len()).collect();
        loop {
            let mut has_changed = false;
            for i in 0..of.len() {
                for j in 0..of.len() {
                    let (a, b) = (cubes(&mesh.triangles[i]), cubes(&mesh.triangles[j]));
                    if of[i] < of[j] && a.iter().any(|&a| b.iter().any(|&b| near(a, b))) {
                        of[j] = of[i];
                        has_changed = true;
                    }
                }
            }
            if !has_changed {
                return of.iter().enumerate().filter(|(i, of)| i == *of).count();
            }
        }
    }

    proptest! {
        #[test]
        fn pieces_are_those_of_a_slow_search(places in prop::collection::vec(prop::array::uniform3(-3f32..3.0), 0..40), cell in 0.2f64..1.5) {
            let mesh = mesh_at(&places);
            let found = pieces(&mesh, |_| true, cell, 0.0);
            prop_assert_eq!(found.len(), slow_count(&mesh, cell));
            let total: f64 = found.iter().map(|piece| piece.area).sum();
            prop_assert!((total - 0.005 * places.len() as f64).abs() < 1e-4);
            prop_assert_eq!(found.iter().map(|piece| piece.mesh.triangles.len()).sum::<usize>(), places.len());
            for piece in &found {
                prop_assert_eq!(piece.mesh.positions.len(), 3 * piece.mesh.triangles.len());
                prop_assert_eq!(piece.mesh.normals.len(), piece.mesh.positions.len());
                prop_assert!(piece.mesh.positions.iter().all(|p| (0..3).all(|k| piece.bounds.min[k] <= p[k] && p[k] <= piece.bounds.max[k])));
            }
            prop_assert!(found.is_sorted_by(|a, b| a.area >= b.area));
        }
    }

    #[test]
    fn small_pieces_and_unchanged_triangles_are_left_out() {
        let mesh = mesh_at(&[[0.0; 3], [0.05, 0.0, 0.0], [5.0, 0.0, 0.0], [9.0, 0.0, 0.0]]);
        let found = pieces(&mesh, |triangle| triangle[0] != 9, 0.5, 0.008);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
        assert!(pieces(&Mesh::default(), |_| true, 0.5, 0.0).is_empty());
    }
}
