//! Alignment against dense least squares, and sampling of displaced fields against planes.

use super::found::{Pair, Term};
use super::solve::{REST, SMOOTHNESS, displacements};
use super::surface_points::SurfacePoint;
use super::*;
use crate::atlas::fusion::samples::reference;
use crate::atlas::fusion::samples::tsdf_sampling::{TsdfSampling, displaced_target_blocks};
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, block_coords, voxel_coords};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use proptest::prelude::*;

/// The least squares of [`displacements`] as one dense system: the vectors of all cells and fields, by field and then cell.
fn dense(expected: &[HashMap<Cell, [f32; 3]>], terms: &[Term]) -> Vec<((usize, Cell), Vector3<f64>)> {
    let mut places: Vec<(usize, Cell)> = expected.iter().enumerate().flat_map(|(f, cells)| cells.keys().map(move |c| (f, *c))).collect();
    places.sort_unstable();
    let number = |field: usize, cell: Cell| places.binary_search(&(field, cell)).ok();
    let (mut matrix, mut right) = (DMatrix::<f64>::identity(3 * places.len(), 3 * places.len()) * REST, DVector::<f64>::zeros(3 * places.len()));
    // Adds the square of the difference between two unknowns.
    let mut tie = |a: usize, b: usize, of: Matrix3<f64>| {
        for (i, j, sign) in [(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)] {
            let mut part = matrix.fixed_view_mut::<3, 3>(3 * i, 3 * j);
            part += sign * of;
        }
    };
    for (i, &(field, cell)) in places.iter().enumerate() {
        let of = |cell: &Cell| Vector3::from(expected[field][cell].map(f64::from));
        let mut part = right.fixed_rows_mut::<3>(3 * i);
        part += REST * of(&cell);
        for k in 0..3 {
            let next = std::array::from_fn(|l| cell[l] + i32::from(l == k));
            if let Some(j) = number(field, next) {
                tie(i, j, SMOOTHNESS * Matrix3::identity());
                for (n, sign) in [(i, 1.0), (j, -1.0)] {
                    let mut part = right.fixed_rows_mut::<3>(3 * n);
                    part += sign * SMOOTHNESS * (of(&cell) - of(&next));
                }
            }
        }
    }
    for term in terms {
        let [Some(a), Some(b)] = term.fields.map(|field| number(field, term.cell)) else { continue };
        tie(a, b, term.normals);
        for (i, sign) in [(a, 1.0), (b, -1.0)] {
            let mut part = right.fixed_rows_mut::<3>(3 * i);
            part += sign * term.gap;
        }
    }
    let found = matrix.cholesky().unwrap().solve(&right);
    places.into_iter().enumerate().map(|(i, place)| (place, found.fixed_rows::<3>(3 * i).into_owned())).collect()
}

/// A place, displaced, and the block that it is in then.
fn placed(point: &SurfacePoint, displacements: &[Displacement]) -> (Vector3<f32>, Vector3<i32>) {
    let at = Vector3::from(point.position) + Vector3::from(displacements[point.field as usize].at(point.position));
    (at, at.map(|c| (c / BLOCK_EDGE as f32).floor() as i32))
}

/// Each place with each other field that has places in the blocks around, and the nearest of these that may be the same surface: all are looked at.
fn all_partners(points: &[SurfacePoint], displacements: &[Displacement], reach: f32) -> Vec<(usize, u32, Option<usize>)> {
    let mut all = Vec::new();
    for (i, one) in points.iter().enumerate() {
        let (at, block) = placed(one, displacements);
        for field in (0..displacements.len() as u32).filter(|field| *field != one.field) {
            let others = points.iter().enumerate().filter(|(_, other)| other.field == field);
            let around: Vec<(usize, &SurfacePoint)> = others.filter(|(_, other)| (placed(other, displacements).1 - block).amax() <= 1).collect();
            let between = |other: &SurfacePoint| at - placed(other, displacements).0;
            let is_same = |other: &SurfacePoint| {
                let (a, b, between) = (Vector3::from(one.normal), Vector3::from(other.normal), between(other));
                let along = between.dot(&(a + b).normalize());
                a.dot(&b) >= 0.85 && along.abs() <= reach && between.norm_squared() - along * along <= 64.0
            };
            let nearest = around.iter().filter(|(_, other)| is_same(other));
            let nearest = nearest.min_by(|(_, a), (_, b)| between(a).norm_squared().total_cmp(&between(b).norm_squared()));
            if !around.is_empty() {
                all.push((i, field, nearest.map(|(j, _)| *j)));
            }
        }
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn partners_are_those_that_are_found_by_looking_at_all_places(
        places in prop::collection::vec((prop::array::uniform3(-40f32..40.0), prop::array::uniform3(-1f32..1.0), 0u32..4), 2..400),
        vectors in prop::collection::vec(prop::array::uniform3(-3f32..3.0), 4), flat in any::<bool>(), reach in 1f32..5.0,
    ) {
        let points: Vec<SurfacePoint> = places.into_iter().map(|(position, normal, field)| {
            // Walls: else hardly any two normals are alike.
            let normal = if flat { Vector3::new(0.0, 0.1 * normal[1], 1.0) } else { Vector3::from(normal) + Vector3::new(0.0, 0.0, 1e-3) };
            SurfacePoint { position: if flat { [position[0], position[1], 0.1 * position[2]] } else { position }, normal: normal.normalize().into(), field }
        }).collect();
        let displacements: Vec<Displacement> = vectors.iter().map(|vector| Displacement::new([([0; 3], *vector)].into_iter())).collect();
        let found = Pairs::new(points.clone(), 4).find(&displacements, reach);
        let expected = all_partners(&points, &displacements, reach);
        prop_assert!(found.places.values().map(|count| *count as usize).sum::<usize>() == expected.len());
        let pairs: Vec<(usize, usize)> = expected.iter().filter_map(|(i, _, partner)| Some((*i, (*partner)?))).collect();
        prop_assert_eq!(found.pairs.len(), pairs.len());
        for (Pair { cell, fields, apart, moved_apart, .. }, (i, j)) in found.pairs.iter().zip(pairs) {
            prop_assert_eq!((*cell, *fields), (cell_of(points[i].position), [points[i].field, points[j].field]));
            let normal = (Vector3::from(points[i].normal) + Vector3::from(points[j].normal)).normalize();
            let still = (Vector3::from(points[i].position) - Vector3::from(points[j].position)).dot(&normal);
            let moved = (placed(&points[i], &displacements).0 - placed(&points[j], &displacements).0).dot(&normal);
            prop_assert!((apart - still).abs() < 1e-3 && (moved_apart - moved).abs() < 1e-3);
        }
    }

    #[test]
    fn displacements_equal_those_of_dense_least_squares(
        cells in prop::collection::vec(prop::collection::hash_map(prop::array::uniform3(0i32..4), prop::array::uniform3(-3f32..3.0), 1..16), 2..4),
        asked in prop::collection::vec((prop::array::uniform3(0i32..4), 0usize..3, 0usize..3, prop::array::uniform3(-1f64..1.0), -5f64..5.0), 1..30),
    ) {
        let cells: Vec<HashMap<Cell, [f32; 3]>> = cells.into_iter().map(|cells| cells.into_iter().collect()).collect();
        let terms: Vec<Term> = asked.into_iter().filter(|(_, a, b, ..)| a < b && *b < cells.len()).map(|(cell, a, b, normal, gap)| {
            let normal = (Vector3::from(normal) + Vector3::new(0.0, 0.0, 1e-3)).normalize();
            Term { cell, fields: [a, b], normals: normal * normal.transpose(), gap: gap * normal }
        }).collect();
        let found = displacements(&cells, &terms);
        for ((field, cell), expected) in dense(&cells, &terms) {
            let vector = Vector3::from(found[field].of_cell(&cell).map(f64::from));
            prop_assert!((vector - expected).norm() < 1e-3, "{:?} instead of {:?}", vector, expected);
        }
    }

    #[test]
    fn a_displaced_plane_is_sampled_where_it_was_moved(
        vectors in prop::collection::vec(prop::array::uniform3(-3f32..3.0), 8), angles in prop::array::uniform3(-3f64..3.0),
        shift in prop::array::uniform3(20f64..44.0), normal in prop::array::uniform3(-1f32..1.0),
    ) {
        let normal = (Vector3::from(normal) + Vector3::new(0.0, 0.0, 1e-3)).normalize();
        let blocks: Vec<([i32; 3], u8)> = (0..64).map(|i| ([i % 4 - 2, i / 4 % 4 - 2, i / 16 - 2], 0)).collect();
        // Without noise: the plane lies 0.15 voxels beside the origin.
        let source = reference::field(&blocks, normal, 0.0, || 0.5);
        let placement = Placement::new(&Pose::new(Vector3::from(shift), Vector3::from(angles)), 1.0);
        let displacement = Displacement::new((0..8).map(|i| ([i & 1, i >> 1 & 1, i >> 2], vectors[i as usize])));
        let ids: Vec<u32> = source.ids().collect();
        let targets = displaced_target_blocks(&source, &placement, &displacement, &ids);
        let sampled = TsdfSampling::displaced(&source, &placement, displacement.clone(), targets.clone()).sample(0..targets.len());
        let mut count = 0;
        for block in &sampled {
            for (i, voxel) in block.voxels.iter().enumerate().filter(|(_, voxel)| voxel.is_observed()) {
                let (corner, c) = (block_coords(block.key), voxel_coords(i, 0));
                let centre: [f32; 3] = std::array::from_fn(|k| (corner[k] * BLOCK_EDGE as i32) as f32 + c[k] as f32 + 0.5);
                let moved = displacement.at(centre);
                let place = placement.t_source_target.apply(std::array::from_fn(|k| centre[k] - moved[k]));
                let expected = normal.dot(&Vector3::from(place)) + 0.15;
                // At the ends of the band and of the field corners are unobserved.
                if expected.abs() < 0.5 && place.iter().all(|c| c.abs() < 15.0) {
                    prop_assert!((voxel.distance_in_voxels() - expected).abs() < 0.02, "{} instead of {}", voxel.distance_in_voxels(), expected);
                    count += 1;
                }
            }
        }
        // The plane crosses the middle of a cube of 30 voxels, all of which are sampled somewhere.
        prop_assert!(count > 500, "{count} voxels");
    }
}

/// Of two fields of level plates, each as high as `height` says for the field and the plate, those that are refused.
fn refused(plate: i32, height: impl Fn(u32, [i32; 2]) -> f32) -> HashSet<[usize; 2]> {
    let place = |field: u32, x: i32, y: i32| {
        let number = [x.div_euclid(plate), y.div_euclid(plate)];
        SurfacePoint { position: [x as f32, y as f32, 32.0 + height(field, number)], normal: [0.0, 0.0, 1.0], field }
    };
    let axis = || (0..256).step_by(4);
    let points: Vec<SurfacePoint> =
        (0..2).flat_map(|field| axis().flat_map(move |x| axis().map(move |y| (field, x, y)))).map(|(f, x, y)| place(f, x, y)).collect();
    let mut cells = [HashMap::new(), HashMap::new()];
    points.iter().for_each(|point| _ = cells[point.field as usize].insert(cell_of(point.position), [0.0; 3]));
    let pairs = Pairs::new(points, 2);
    let first = pairs.find(&[Displacement::default(), Displacement::default()], REACH);
    let after = pairs.find(&bent(&pairs, &cells, &first, &HashSet::new()), REACH);
    let mean = |found: &Found| found.distances().values().map(|(count, sum)| sum / *count as f64).sum::<f64>();
    println!("{:.2} of {:.2} voxels are left", mean(&after), mean(&first));
    first.not_explained(&after)
}

#[test]
fn different_things_that_stand_close_together_are_not_bent_onto_each_other() {
    // Drift raises all plates of a field by about as much.
    let drifted = |field: u32, [x, y]: [i32; 2]| field as f32 * (1.5 + 0.1 * (x + y) as f32 * 0.2);
    assert!(refused(24, drifted).is_empty());
    // Clutter: of each plate, smaller than a cell, either field has another height.
    let clutter = |field: u32, [x, y]: [i32; 2]| ((field as i32 * 7 + x * 13 + y * 29) as f32 * 0.618_034).fract() * 4.0;
    assert!(refused(24, clutter) == HashSet::from([[0, 1]]));
}
