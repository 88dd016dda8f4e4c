//! One field.

use super::*;
use crate::field::occupancy::{Boundary, faces};
use crate::query::collision::with_solid;
use crate::query::field::blocks;
use crate::query::shape::moved;
use crate::query::shape_sdf::Solid;
use crate::surface::{OccupancySurface, extract_occupancy};
use std::collections::BTreeSet;

/// Whether `shape` touches no leaf that blocks.
fn slow_is_free(field: &OccupancyField, shape: &Shape, unknown: UnknownAs) -> bool {
    let root = root(field);
    with_solid!(shape, 1.0 / f64::from(VOXEL), |solid| {
        let (low, high) = solid.bounds();
        let (first, last) = root.corners();
        let inside = (0..3).all(|k| low[k] > first[k] && high[k] < last[k]);
        let meets = |leaf: &Leaf| {
            let (low, high) = leaf.corners();
            blocks(leaf.value, unknown) && solid.meets(low, high)
        };
        (inside || unknown == UnknownAs::Free) && !leaves(field).iter().any(meets)
    })
}

/// Distance in voxels between a leaf and a motion, sought in double precision: along the way it falls and then rises.
fn slow_gap(leaf: &Leaf, from: [f64; 3], to: [f64; 3]) -> f64 {
    let gap = |t: f64| -> f64 {
        let p: [f64; 3] = std::array::from_fn(|k| (from[k] + t * (to[k] - from[k])) / f64::from(VOXEL));
        (0..3).map(|k| (f64::from(leaf.low[k]) - p[k]).max(p[k] - f64::from(leaf.low[k] + leaf.edge)).max(0.0).powi(2)).sum::<f64>().sqrt()
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if gap(a) <= gap(b) {
            high = b;
        } else {
            low = a;
        }
    }
    gap(0.5 * (low + high))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    // The solids have a share in the test below this one; here nothing is shared with what is tested.
    #[test]
    fn a_motion_is_free_when_no_leaf_that_blocks_is_within_its_radius(
        seed in any::<u64>(), rare in 20u64..400, motions in prop::collection::vec((prop::array::uniform3(-1.7..1.7f64), prop::array::uniform3(-1.5..1.5f64), 0.0..0.5f64), 4),
    ) {
        let field = random_field(seed, rare);
        let query = FieldQuery::new(&field, VOXEL);
        for (from, by, radius) in motions {
            let to: [f64; 3] = std::array::from_fn(|k| (from[k] + by[k]).clamp(-1.7, 1.7));
            let all = leaves(&field);
            // A box around the motion comes first: the search is slow.
            let near = |l: &&Leaf| (0..3).all(|k| {
                let [low, high] = [from[k].min(to[k]) - radius, from[k].max(to[k]) + radius].map(|c| c / f64::from(VOXEL));
                f64::from(l.low[k]) <= high + 1.0 && f64::from(l.low[k] + l.edge) >= low - 1.0
            });
            let blocking = all.iter().filter(near).filter(|l| blocks(l.value, UnknownAs::Blocked));
            // Beyond the root cube all is unknown.
            let root = root(&field);
            let out = [from, to].into_iter().flat_map(|p| (0..3).map(move |k| (p[k] / f64::from(VOXEL), k)));
            let out = out.map(|(c, k)| (c - f64::from(root.low[k])).min(f64::from(root.low[k] + root.edge) - c)).fold(f64::INFINITY, f64::min);
            let (out, least) = (out * f64::from(VOXEL), blocking.map(|l| slow_gap(l, from, to)).fold(out, f64::min) * f64::from(VOXEL));
            // Nearer than a fiftieth of a millimetre to touching, single precision may say either; near the root cube's faces a thousandth
            // of a voxel is kept.
            if (least - radius).abs() > 2e-5 && (out - radius).abs() > 2e-3 * f64::from(VOXEL) {
                prop_assert_eq!(query.is_free(&Capsule { from, to, radius }.into(), UnknownAs::Blocked), least > radius, "{:?} {:?} {} {}", from, to, radius, least);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn a_shape_is_free_when_it_touches_no_leaf_that_blocks(seed in any::<u64>(), rare in 20u64..400, shapes in prop::collection::vec(shape(), 40), unknown in policy()) {
        let field = random_field(seed, rare);
        let query = FieldQuery::new(&field, VOXEL);
        for shape in &shapes {
            prop_assert_eq!(query.is_free(shape, unknown), slow_is_free(&field, shape, unknown), "{:?}", shape);
            prop_assert_eq!(query.is_free_with_stats(shape, unknown).0, query.is_free(shape, unknown));
        }
    }

    #[test]
    fn a_ray_ends_at_the_first_leaf_that_blocks(seed in any::<u64>(), rare in 2u64..200, rays in prop::collection::vec(ray(), 40), unknown in policy()) {
        let field = random_field(seed, rare);
        let query = FieldQuery::new(&field, VOXEL);
        let (all, root) = (leaves(&field), root(&field));
        for ray in rays.iter().filter_map(Ray::normalised) {
            let length = ray.length / f64::from(VOXEL);
            let first = |by: f64| {
                let entries = all.iter().filter(|l| blocks(l.value, unknown)).filter_map(|l| slab(&ray, l, by)).map(|s| s.0);
                // Leaving the root is entering the unknown.
                let outside = slab(&ray, &root, -by).map_or(0.0, |s| if s.0 > 0.0 { 0.0 } else { s.1 });
                let outside = if unknown == UnknownAs::Blocked { outside } else { f64::INFINITY };
                let entry = entries.fold(outside, f64::min);
                if entry <= length { entry } else { f64::INFINITY }
            };
            let found = query.ray_cast(&ray, unknown);
            let at = found.map_or(f64::INFINITY, |hit| hit.distance / f64::from(VOXEL));
            // Rays that graze an edge may count either way.
            let (early, late) = (first(1e-6), first(-1e-6));
            prop_assert!(at >= early - 1e-4 && at <= late + 1e-4, "{ray:?}: {at} is not within {early} to {late}");
            if let Some(hit) = found.filter(|hit| hit.distance > 0.0) {
                let into: [f64; 3] = std::array::from_fn(|k| ray.origin[k] + hit.distance * ray.direction[k] - 1e-4 * hit.normal[k]);
                prop_assert!(early < late || query.state(into) == hit.state);
                prop_assert!((0..3).map(|k| hit.normal[k] * ray.direction[k]).sum::<f64>() < 0.0);
            }
        }
    }

    #[test]
    fn bounds_hold_all_that_was_observed(seed in any::<u64>(), t in pose()) {
        let field = random_field(seed, 2);
        let bounds = FieldQuery::new(&field, VOXEL).bounds_in(&t);
        for leaf in leaves(&field).iter().filter(|l| l.value != UNKNOWN) {
            for corner in 0..8 {
                let c = std::array::from_fn(|k| f64::from(leaf.low[k] + (corner >> k & 1) * leaf.edge) * f64::from(VOXEL));
                let p = moved(&t, c);
                prop_assert!((0..3).all(|k| p[k] >= f64::from(bounds.min[k]) - 1e-4 && p[k] <= f64::from(bounds.max[k]) + 1e-4));
            }
        }
    }

    #[test]
    fn points_and_cubes_know_what_their_voxels_know(seed in any::<u64>(), points in prop::collection::vec(prop::array::uniform3(-3.0..3.0f64), 20), level in 0u32..9) {
        let field = random_field(seed, 3);
        let query = FieldQuery::new(&field, VOXEL);
        for p in points {
            let c = p.map(|v| (v / f64::from(VOXEL)).floor() as i32);
            prop_assert_eq!(query.state(p), field.state_at(c));
            let region = query.at_level(p, level);
            let base = block_coords(0).map(|v| v << BLOCK_SHIFT);
            // Cubes of blocks are aligned where Morton keys are, not to the origin.
            let low: [i32; 3] = std::array::from_fn(|k| ((c[k] - base[k]) >> level << level) + base[k]);
            let (mut max, mut observed) = (UNKNOWN, true);
            for leaf in leaves(&field) {
                if (0..3).all(|k| leaf.low[k] < low[k] + (1 << level) && leaf.low[k] + leaf.edge > low[k]) {
                    max = max.max(leaf.value);
                    observed &= leaf.value != UNKNOWN;
                }
            }
            let root = root(&field);
            let covered = (0..3).all(|k| low[k] >= root.low[k] && low[k] + (1 << level) <= root.low[k] + root.edge);
            prop_assert_eq!(region, CellSummary { max, observed: observed && covered });
        }
    }
}

/// Faces of single finest voxels: smallest corner, axis, direction.
type Units = BTreeSet<([i32; 3], usize, bool)>;

fn slow_faces(field: &OccupancyField, solid: impl Fn(State) -> bool, air: impl Fn(State) -> bool) -> Units {
    let root = root(field);
    let mut units = Units::new();
    let range = |k: usize| root.low[k] - 1..root.low[k] + root.edge;
    for (z, y, x) in range(2).flat_map(|z| range(1).flat_map(move |y| range(0).map(move |x| (z, y, x)))) {
        let here = field.state_at([x, y, z]);
        for axis in 0..3 {
            let mut next = [x, y, z];
            next[axis] += 1;
            let there = field.state_at(next);
            if solid(here) && air(there) {
                units.insert((next, axis, true));
            }
            if air(here) && solid(there) {
                units.insert((next, axis, false));
            }
        }
    }
    units
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn faces_are_those_between_voxels_each_once(seed in any::<u64>(), rare in 2u64..30, merged in any::<bool>()) {
        let field = random_field(seed, rare);
        let (occupied, free, unknown) = (|s| s == State::Occupied, |s| s == State::Free, |s| s == State::Unknown);
        let expected = [
            (Boundary::Occupied, slow_faces(&field, occupied, |s| !occupied(s))),
            (Boundary::Free, slow_faces(&field, |s| !free(s), free)),
            (Boundary::Frontier, slow_faces(&field, unknown, free)),
        ];
        for (boundary, expected) in expected {
            let mut units = Units::new();
            for face in faces(&field, boundary, merged) {
                for (u, v) in (0..face.span[0]).flat_map(|u| (0..face.span[1]).map(move |v| (u, v))) {
                    let mut low = face.low;
                    low[(face.axis + 1) % 3] += u;
                    low[(face.axis + 2) % 3] += v;
                    prop_assert!(units.insert((low, face.axis, face.positive)), "{face:?} comes twice");
                }
            }
            prop_assert!(units == expected, "{boundary:?}: {} faces instead of {}", units.len(), expected.len());
        }
    }

    #[test]
    fn meshes_are_closed_and_look_away_from_what_is_occupied(seed in any::<u64>(), rare in 2u64..30) {
        let field = random_field(seed, rare);
        for surface in [OccupancySurface::Occupied, OccupancySurface::FreeHull, OccupancySurface::Frontier] {
            let mesh = extract_occupancy(&field, 1.0, surface, 0);
            let (mut sum, mut area) = ([0f64; 3], 0f64);
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|v| mesh.positions[v as usize].map(f64::from));
                let (u, v): ([f64; 3], [f64; 3]) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| c[k] - a[k]));
                let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
                let normal = mesh.normals[t[0] as usize].map(f64::from);
                prop_assert!((0..3).map(|k| n[k] * normal[k]).sum::<f64>() > 0.0);
                (0..3).for_each(|k| sum[k] += n[k]);
                area += 0.5 * n.iter().map(|c| c * c).sum::<f64>().sqrt();
            }
            // The normals of a closed surface add up to nothing.
            prop_assert!(surface == OccupancySurface::Frontier || sum.iter().all(|c| c.abs() < 1e-6), "{surface:?}: {sum:?}");
            let units: i32 = match surface {
                OccupancySurface::Frontier => faces(&field, Boundary::Frontier, true).iter().map(|f| f.span[0] * f.span[1]).sum(),
                _ => area.round() as i32,
            };
            prop_assert!((area - f64::from(units)).abs() < 1e-6);
        }
    }

    #[test]
    fn coarser_meshes_have_one_vertex_a_cell_near_all_that_was_there(seed in any::<u64>(), rare in 2u64..30, lod in 1usize..4) {
        let field = random_field(seed, rare);
        let cell = (1 << lod) as f32;
        let cell_of = |p: &[f32; 3]| p.map(|c| (c / cell).floor() as i32);
        for surface in [OccupancySurface::Occupied, OccupancySurface::FreeHull, OccupancySurface::Frontier] {
            let (full, coarse) = (extract_occupancy(&field, 1.0, surface, 0), extract_occupancy(&field, 1.0, surface, lod));
            let cells: BTreeSet<[i32; 3]> = coarse.positions.iter().map(cell_of).collect();
            prop_assert_eq!(cells.len(), coarse.positions.len());
            prop_assert_eq!(cells, full.positions.iter().map(cell_of).collect::<BTreeSet<_>>());
            prop_assert!(coarse.triangles.len() <= full.triangles.len());
            prop_assert!(coarse.triangles.iter().all(|[a, b, c]| a != b && b != c && c != a));
        }
    }

    #[test]
    fn frontier_points_lie_between_free_and_unknown(seed in any::<u64>(), rare in 2u64..30) {
        let field = random_field(seed, rare);
        let query = FieldQuery::new(&field, VOXEL);
        let all = query.frontier(3);
        let area: f64 = all.iter().map(|p| p.area).sum();
        let units = slow_faces(&field, |s| s == State::Unknown, |s| s == State::Free).len();
        prop_assert!((area / f64::from(VOXEL).powi(2) - units as f64).abs() < 1e-6);
        for point in &all {
            prop_assert!((point.normal.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-9);
        }
        for face in query.frontier_faces() {
            prop_assert_eq!(query.state(face.unknown), State::Unknown);
            prop_assert_eq!(query.state(face.free), State::Free);
        }
    }
}

#[test]
fn nonsense_is_never_free_and_hits_nothing() {
    let field = random_field(5, 1_000_000);
    let query = FieldQuery::new(&field, VOXEL);
    for shape in [
        Shape::from(Sphere { centre: [f64::NAN, 0.0, 0.0], radius: 0.1 }),
        Sphere { centre: [0.0; 3], radius: -0.1 }.into(),
        Capsule { from: [0.0; 3], to: [0.0, f64::INFINITY, 0.0], radius: 0.1 }.into(),
        OrientedBox { t_frame_box: crate::Pose::identity(), half: [0.1, 0.1, f64::NAN] }.into(),
    ] {
        assert!(!query.is_free(&shape, UnknownAs::Free) && !query.is_free(&shape, UnknownAs::Blocked));
    }
    let far = Sphere { centre: [1e300, 0.0, 0.0], radius: 1e200 };
    assert!(!query.is_free(&far.into(), UnknownAs::Blocked));
    assert_eq!(query.state([1e300, 0.0, 0.0]), State::Unknown);
    assert_eq!(query.state([f64::NAN; 3]), State::Unknown);
    for (direction, length) in [([0.0; 3], 1.0), ([f64::NAN, 0.0, 1.0], 1.0), ([1.0, 0.0, 0.0], -1.0), ([1.0, 0.0, 0.0], f64::NAN)] {
        assert_eq!(query.ray_cast(&Ray { origin: [0.0; 3], direction, length }, UnknownAs::Blocked), None);
    }
    let endless = Ray { origin: [0.0; 3], direction: [1.0, 0.0, 0.0], length: f64::INFINITY };
    assert!(query.ray_cast(&endless, UnknownAs::Blocked).is_some() && query.ray_cast(&endless, UnknownAs::Free).is_none());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn clearance_is_the_distance_to_the_nearest_leaf_that_blocks(
        seed in any::<u64>(), rare in 5u64..800, points in prop::collection::vec(prop::array::uniform3(-2.3..2.3f64), 30), up_to in 0.01..1.5f64, unknown in policy(),
    ) {
        let field = random_field(seed, rare);
        let query = FieldQuery::new(&field, VOXEL);
        let (all, root) = (leaves(&field), root(&field));
        for p in points {
            let v = p.map(|c| c / f64::from(VOXEL));
            let gap = |l: &Leaf| (0..3).map(|k| (f64::from(l.low[k]) - v[k]).max(v[k] - f64::from(l.low[k] + l.edge)).max(0.0).powi(2)).sum::<f64>().sqrt();
            let out = (0..3).map(|k| (v[k] - f64::from(root.low[k])).min(f64::from(root.low[k] + root.edge) - v[k])).fold(f64::INFINITY, f64::min).max(0.0);
            let start = if unknown == UnknownAs::Blocked { out } else { f64::INFINITY };
            let nearest = all.iter().filter(|l| blocks(l.value, unknown)).map(gap).fold(start, f64::min) * f64::from(VOXEL);
            let found = query.clearance(p, up_to, unknown);
            prop_assert!((found - nearest.min(up_to)).abs() < 1e-5, "{found} instead of {nearest} up to {up_to}");
        }
    }
}

#[test]
fn clearance_of_what_is_no_question_is_none() {
    let field = random_field(3, 1000);
    let query = FieldQuery::new(&field, VOXEL);
    for unknown in [UnknownAs::Blocked, UnknownAs::Free] {
        assert_eq!(query.clearance([f64::NAN, 0.0, 0.0], 1.0, unknown), 0.0);
        assert_eq!(query.clearance([0.0; 3], f64::INFINITY, unknown), 0.0);
        assert_eq!(query.clearance([0.0; 3], -1.0, unknown), 0.0);
    }
    assert_eq!(query.clearance([1e30, 0.0, 0.0], 1.0, UnknownAs::Blocked), 0.0);
    assert_eq!(query.clearance([1e30, 0.0, 0.0], 1.0, UnknownAs::Free), 1.0);
}
