//! The 256 cases of marching cubes, derived rather than listed.
//!
//! Corner `c` of a cell lies at (c & 1, c >> 1 & 1, c >> 2); a bit of the case is set where the corner is inside (behind
//! the surface). On each face, crossings are joined around the inside corners; that depends on the face alone, so the two
//! cells that share it agree, also where it is ambiguous. The segments close to loops, and each loop is triangulated
//! without a diagonal inside a face, where the neighbour's polygon could have the same edge.

use std::sync::LazyLock;

/// The two corners of each of a cell's 12 edges; the first is the lower one.
pub(crate) const EDGES: [[usize; 2]; 12] = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// The corners of each face, counter-clockwise seen from outside.
const FACES: [[usize; 4]; 6] = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// Triangles of each case as triples of edges, wound so that their normals point out of the inside.
pub(crate) static CASES: LazyLock<Vec<Vec<[u8; 3]>>> = LazyLock::new(|| (0..256).map(|case| triangles(case as u8)).collect());

fn edge_between(a: usize, b: usize) -> usize {
    EDGES.iter().position(|e| *e == [a.min(b), a.max(b)]).expect("corners of a face's side share an edge")
}

/// For each edge that the surface crosses, the edge that follows it on the loop.
fn successors(case: u8) -> [Option<usize>; 12] {
    let inside = |corner: usize| case >> corner & 1 == 1;
    let mut next = [None; 12];
    for face in FACES {
        for i in 0..4 {
            let (before, first) = (face[i], face[(i + 1) % 4]);
            if inside(before) || !inside(first) {
                continue;
            }
            // A run of inside corners starts here: join the crossing into it with the crossing out of it.
            let mut last = i + 1;
            while inside(face[(last + 1) % 4]) {
                last += 1;
            }
            next[edge_between(before, first)] = Some(edge_between(face[last % 4], face[(last + 1) % 4]));
        }
    }
    next
}

fn share_a_face(a: usize, b: usize) -> bool {
    FACES.iter().any(|face| [a, b].iter().all(|&e| EDGES[e].iter().all(|c| face.contains(c))))
}

fn triangles(case: u8) -> Vec<[u8; 3]> {
    let mut next = successors(case);
    let mut triangles = Vec::new();
    for start in 0..12 {
        let mut polygon = Vec::new();
        let mut edge = start;
        while let Some(following) = next[edge].take() {
            polygon.push(edge);
            edge = following;
        }
        if polygon.len() >= 3 {
            let mut best: Option<(usize, Vec<[u8; 3]>)> = None;
            triangulate(&polygon, 0, &mut Vec::new(), &mut best);
            triangles.extend(best.map(|(_, t)| t).unwrap_or_default());
        }
    }
    triangles
}

/// Tries all triangulations of a loop and keeps the one with the fewest diagonals inside a face.
fn triangulate(polygon: &[usize], bad: usize, done: &mut Vec<[u8; 3]>, best: &mut Option<(usize, Vec<[u8; 3]>)>) {
    if best.as_ref().is_some_and(|(least, _)| bad >= *least) {
        return;
    }
    let corner = |i: usize| polygon[i % polygon.len()];
    if polygon.len() == 3 {
        done.push([polygon[0] as u8, polygon[1] as u8, polygon[2] as u8]);
        *best = Some((bad, done.clone()));
        done.pop();
        return;
    }
    for ear in 0..polygon.len() {
        let (a, b, c) = (corner(ear), corner(ear + 1), corner(ear + 2));
        let rest: Vec<usize> = polygon.iter().copied().filter(|&e| e != b).collect();
        done.push([a as u8, b as u8, c as u8]);
        triangulate(&rest, bad + usize::from(share_a_face(a, c)), done, best);
        done.pop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_crossed_edge_is_used_and_no_other() {
        for case in 0..256usize {
            for (e, [a, b]) in EDGES.iter().enumerate() {
                let crossed = (case >> a & 1) != (case >> b & 1);
                let used = CASES[case].iter().any(|t| t.contains(&(e as u8)));
                assert_eq!(crossed, used, "case {case} edge {e}");
            }
        }
    }

    #[test]
    fn one_inside_corner_gives_a_triangle_facing_away_from_it() {
        let middle = |e: u8| {
            let [a, b] = EDGES[usize::from(e)];
            std::array::from_fn::<f32, 3, _>(|k| ((a >> k & 1) + (b >> k & 1)) as f32 / 2.0)
        };
        assert_eq!(CASES[1].len(), 1);
        let [a, b, c] = CASES[1][0].map(middle);
        let (u, v): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        assert!(normal.iter().all(|&n| n > 0.0), "corner 0 is inside, so the normal points to +x +y +z: {normal:?}");
    }

    #[test]
    fn no_case_needs_a_diagonal_inside_a_face() {
        for (case, triangles) in CASES.iter().enumerate() {
            let next = successors(case as u8);
            for t in triangles {
                for i in 0..3 {
                    let (a, b) = (usize::from(t[i]), usize::from(t[(i + 1) % 3]));
                    let on_loop = next[a] == Some(b) || next[b] == Some(a);
                    assert!(on_loop || !share_a_face(a, b), "case {case}");
                }
            }
        }
    }
}
