//! Meshes of analytic shapes over blocks of mixed scales.

use super::marching_cubes::{cells, mc_table};
use super::*;
use crate::field::tsdf::storage::brick_codec::EncodedArray;
use crate::field::tsdf::{Array, DISTANCE_STEPS, TsdfField, Voxel, WEIGHT_ONE};
use crate::octree::{BLOCK_EDGE, Cursor, block_key, voxel_coords, voxels_at};
use proptest::prelude::*;
use std::collections::HashMap;

/// A field whose blocks within `reach` of the origin hold `distance` (finest voxels), each block at its own scale.
fn field_of(reach: i32, distance: impl Fn([f32; 3]) -> f32, scale_of: impl Fn([i32; 3]) -> usize) -> TsdfField {
    observed_field(reach, distance, |_| 10, scale_of)
}

/// As [`field_of`], with the number of observations at each voxel.
fn observed_field(
    reach: i32,
    distance: impl Fn([f32; 3]) -> f32,
    observations: impl Fn([f32; 3]) -> u16,
    scale_of: impl Fn([i32; 3]) -> usize,
) -> TsdfField {
    let mut field = TsdfField::default();
    field.tree.grow_to(block_key([-reach; 3]));
    field.tree.grow_to(block_key([reach - 1; 3]));
    let mut cursor = Cursor::new(&field.tree);
    for z in -reach..reach {
        for y in -reach..reach {
            for x in -reach..reach {
                let scale = scale_of([x, y, z]);
                let (id, _) = field.find_or_create(&mut cursor, block_key([x, y, z]), scale as u8, false);
                let mut voxels = vec![Voxel::default(); voxels_at(scale)];
                for (i, voxel) in voxels.iter_mut().enumerate() {
                    let c = voxel_coords(i, scale);
                    let size = (1 << scale) as f32;
                    let block = [x, y, z];
                    let centre = std::array::from_fn(|k| (block[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * size);
                    let steps = (distance(centre) / size).clamp(-15.0, 15.0) * DISTANCE_STEPS;
                    let weight = if steps.is_nan() { 0 } else { observations(centre) * WEIGHT_ONE };
                    *voxel = Voxel { distance: steps as i16, weight };
                }
                field.store(id, Array::Data(scale), &EncodedArray::new(scale, &voxels, None));
            }
        }
    }
    field
}

fn sphere(radius: f32) -> impl Fn([f32; 3]) -> f32 {
    move |p| (0..3).map(|k| (p[k] - [0.3, -0.7, 0.45][k]).powi(2)).sum::<f32>().sqrt() - radius
}

/// Fails unless every edge is shared by exactly two triangles that agree on the orientation; returns the Euler number.
fn assert_closed_manifold(mesh: &Mesh) -> i64 {
    let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
    for t in &mesh.triangles {
        (0..3).for_each(|i| *edges.entry((t[i], t[(i + 1) % 3])).or_default() += 1);
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(count, 1, "edge {a}-{b} is used {count} times in one direction");
        assert!(edges.contains_key(&(b, a)), "edge {a}-{b} is open at {:?}", mesh.positions[a as usize]);
    }
    mesh.positions.len() as i64 - edges.len() as i64 / 2 + mesh.triangles.len() as i64
}

#[test]
fn a_sphere_seen_at_three_scales_is_closed() {
    let field = field_of(4, sphere(20.0), |c| if c[0] < -1 { 2 } else { usize::from(c[0] < 1) });
    let mesh = extract(&field, 0.1, &MeshOptions::default());
    assert_eq!(assert_closed_manifold(&mesh), 2);
    assert!([0, 1, 2].iter().all(|s| mesh.scales.contains(s)));
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        let distance = sphere(20.0)(p.map(|c| c / 0.1));
        assert!(distance.abs() < 0.5, "a vertex is {distance} voxels off");
        assert!(p.iter().zip(n).map(|(p, n)| p * n).sum::<f32>() > 0.0, "normals point outwards, to free space");
    }
}

#[test]
fn unobserved_voxels_leave_a_hole_and_no_panic() {
    let field = field_of(3, |p| if p[0] > 5.0 { f32::NAN } else { sphere(15.0)(p) }, |_| 0);
    let mesh = extract(&field, 1.0, &MeshOptions::default());
    assert!(!mesh.triangles.is_empty());
    assert!(mesh.positions.iter().all(|p| p[0] <= 5.0));
    let few = extract(&field, 1.0, &MeshOptions { min_weight: 11.0, ..MeshOptions::default() });
    assert!(few.triangles.is_empty(), "no voxel has 11 observations");
}

/// Balls around centres with radii, finest voxels, and the number of observations of each.
type Ball = ([f32; 3], f32, u16);

/// A field of balls, each in the voxels that are nearer to it than to the others.
fn balls(all: &[Ball]) -> TsdfField {
    let nearest = |p: [f32; 3]| {
        let distance = |ball: &Ball| (0..3).map(|k| (p[k] - ball.0[k]).powi(2)).sum::<f32>().sqrt() - ball.1;
        all.iter().map(|ball| (distance(ball), ball.2)).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f32::NAN, 0))
    };
    observed_field(5, |p| if nearest(p).0.abs() > 2.5 { f32::NAN } else { nearest(p).0 }, |p| nearest(p).1, |_| 0)
}

#[test]
fn pieces_of_little_evidence_are_left_out() {
    // At the corner of eight blocks, and all of them far enough from each other.
    let (large, often) = (([-15.0, -14.0, -13.0], 12.0, 1), ([16.2, 16.1, 15.8], 2.0, 40));
    assert!(extract(&balls(&[often]), 1.0, &MeshOptions::default()).positions.len() < 110);
    let small_components = [([16.0, -16.0, 0.3], 2.0, 1), ([-20.0, 20.0, 20.0], 1.2, 3)];
    let field = balls(&[large, small_components[0], often, small_components[1]]);
    let mesh = |keep_all| extract_joined(&field, 0.1, &MeshOptions { keep_all, ..MeshOptions::default() }, 3);
    let (all, nothing) = mesh(true);
    assert_eq!(nothing, SmallComponents::default());
    assert!(all == extract(&field, 0.1, &MeshOptions::default()));
    let (evident, left_out) = mesh(false);
    assert!(evident == extract(&balls(&[large, often]), 0.1, &MeshOptions::default()), "what stays is as it was");
    let alone = extract(&balls(&small_components), 0.1, &MeshOptions::default());
    assert_eq!((left_out.pieces, left_out.triangles), (2, alone.triangles.len() as u64));
    let expected = 4.0 * std::f64::consts::PI * (0.2f64.powi(2) + 0.12f64.powi(2));
    assert!((left_out.area / expected - 1.0).abs() < 0.15, "{} of {expected} m2", left_out.area);
    // A piece is one however many tiles it lies in.
    for shift in [1, 2, 5] {
        assert!(extract_joined(&field, 0.1, &MeshOptions::default(), shift) == (evident.clone(), left_out), "tiles of {shift}");
    }
}

#[test]
fn small_flat_pieces_stay_if_they_were_seen() {
    // Two patches of a plane: one of 36 voxels, of which a vertex lies above each, and one of four.
    let plane = |p: [f32; 3]| {
        let within = |low: f32, edge: f32| (0..2).all(|k| (low..low + edge).contains(&p[k]));
        if within(5.0, 6.0) || within(-12.0, 2.0) { p[2] - 0.3 } else { f32::NAN }
    };
    let field = observed_field(2, |p| if p[2].abs() > 2.5 { f32::NAN } else { plane(p) }, |_| 2, |_| 0);
    let (mesh, small_components) = extract_joined(&field, 1.0, &MeshOptions::default(), 3);
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (36, 50));
    assert_eq!((small_components.pieces, small_components.triangles), (1, 2));
    assert!((small_components.area - 1.0).abs() < 1e-6);
}

#[test]
fn a_coarser_level_of_detail_is_closed_and_smaller() {
    let field = field_of(4, sphere(25.0), |c| usize::from(c[2] > 0));
    let full = extract(&field, 1.0, &MeshOptions::default());
    assert_eq!(assert_closed_manifold(&full), 2);
    let mut before = full.triangles.len();
    for lod in 1..4 {
        let mut mesh = full.clone();
        let options = MeshOptions { lod, ..MeshOptions::default() };
        extract_onto(&mut mesh, &field, 1.0, &options, None);
        let alone = extract(&field, 1.0, &options);
        assert!(mesh.positions[..full.positions.len()] == full.positions && mesh.positions[full.positions.len()..] == alone.positions);
        assert_eq!(assert_closed_manifold(&alone), 2, "lod {lod}");
        assert!(alone.positions.iter().all(|p| sphere(25.0)(*p).abs() < 0.1 * (1 << (2 * lod)) as f32), "lod {lod}");
        assert!(alone.triangles.len() * 3 < before, "lod {lod}: {} of {before}", alone.triangles.len());
        before = alone.triangles.len();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn any_mix_of_scales_is_closed(scales in prop::collection::vec(0usize..4, 512), radius in 14f32..27.0) {
        let at = |c: [i32; 3]| scales[((c[0] + 4) + 8 * (c[1] + 4) + 64 * (c[2] + 4)) as usize];
        let mesh = extract(&field_of(4, sphere(radius), at), 1.0, &MeshOptions::default());
        assert_closed_manifold(&mesh);
    }

    #[test]
    fn tiles_of_any_size_join_to_the_same_closed_mesh(scales in prop::collection::vec(0usize..4, 512), radius in 14f32..27.0, gaps in prop_oneof![Just(0.0f32), 0f32..0.2], seed in any::<u64>()) {
        let at = |c: [i32; 3]| scales[((c[0] + 4) + 8 * (c[1] + 4) + 64 * (c[2] + 4)) as usize];
        let field = field_of(4, |p| if hash(p, seed) < gaps { f32::NAN } else { sphere(radius)(p) }, at);
        let options = MeshOptions { keep_all: true, ..MeshOptions::default() };
        let whole = extract(&field, 1.0, &options);
        let (joined, _) = extract_joined(&field, 1.0, &options, 5);
        // The same vertices; triangles in another order.
        prop_assert!(joined.positions == whole.positions && joined.normals == whole.normals && joined.scales == whole.scales);
        let sorted = |mesh: &Mesh| { let mut triangles = mesh.triangles.clone(); triangles.sort_unstable(); triangles };
        prop_assert!(sorted(&joined) == sorted(&whole));
        for shift in 1..4 {
            prop_assert!(extract_joined(&field, 1.0, &options, shift).0 == joined, "tiles of {}", shift);
        }
        if gaps == 0.0 {
            assert_closed_manifold(&joined);
        }
        // A level of detail and small components, too.
        let coarse = MeshOptions { lod: 1, ..MeshOptions::default() };
        prop_assert!(extract_joined(&field, 1.0, &coarse, 1) == extract_joined(&field, 1.0, &coarse, 3));
    }

    #[test]
    fn rough_shapes_are_closed_too(seed in any::<u64>()) {
        // Random signs make every ambiguous case; values near zero keep crossings from being too steep.
        let noise = |p: [f32; 3]| {
            let mut h = seed;
            for c in p { h = (h ^ c.to_bits() as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29); }
            let edge = p.iter().map(|c| c.abs()).fold(0f32, f32::max);
            if edge > 12.0 { 0.5 } else { (h >> 40) as f32 / (1u64 << 24) as f32 - 0.5 }
        };
        let mesh = extract(&field_of(2, noise, |c| usize::from(c[0] == 0) + usize::from(c[1] == 0)), 1.0, &MeshOptions::default());
        assert_closed_manifold(&mesh);
    }
}

#[test]
fn blocks_without_intensity_among_others_count_as_grey() {
    let mut field = field_of(4, sphere(20.0), |_| 0);
    for id in field.ids().filter(|id| id % 3 == 0) {
        let voxels = field.current(field.block(id));
        field.blocks[id].has_intensity = true;
        field.store(id, Array::Data(0), &EncodedArray::new(0, &voxels, Some(&[9; voxels_at(0)])));
    }
    let mesh = extract(&field, 0.1, &MeshOptions::default());
    assert_eq!(mesh.intensities.len(), mesh.positions.len());
    assert!(mesh.intensities.contains(&9) && mesh.intensities.contains(&128));
}

/// Numbers from 0 to 1 that depend on `p` and `seed` alone.
fn hash(p: [f32; 3], seed: u64) -> f32 {
    let h = p.iter().fold(seed, |h, c| (h ^ u64::from(c.to_bits())).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29));
    (h >> 40) as f32 / (1u64 << 24) as f32
}

/// Marching cubes by the book: a map of voxels at one scale, gaps closed one by one, triangles as triples of points.
fn by_the_book(known: &HashMap<[i32; 3], f32>, inside: impl Fn([i32; 3]) -> bool, voxels: &[[i32; 3]]) -> Vec<[[i32; 3]; 3]> {
    let step = |c: [i32; 3], k: usize, by: i32| std::array::from_fn(|i| c[i] + if i == k { by } else { 0 });
    let mut closed = known.clone();
    for &c in voxels.iter().filter(|&&c| inside(c) && !known.contains_key(&c)) {
        let pairs = (0..3).filter_map(|k| Some([*known.get(&step(c, k, -1))?, *known.get(&step(c, k, 1))?]));
        let pairs: Vec<f32> = pairs.flatten().collect();
        let mean = pairs.iter().sum::<f32>() / pairs.len() as f32;
        let neighbours = (0..3).flat_map(|k| [-1, 1].map(|by| known.get(&step(c, k, by)))).flatten();
        if !pairs.is_empty() && neighbours.into_iter().all(|d| (d - mean).abs() <= 1.5) {
            closed.insert(c, mean);
        }
    }
    let mut triangles = Vec::new();
    for &c in voxels {
        let corners = cells::corners(c.map(|v| v + 1));
        let Some(values) = corners.iter().map(|corner| closed.get(corner).copied()).collect::<Option<Vec<f32>>>() else { continue };
        if mc_table::EDGES.iter().any(|&[a, b]| (values[a] < 0.0) != (values[b] < 0.0) && (values[a] - values[b]).abs() > 4.0) {
            continue;
        }
        let case = values.iter().enumerate().fold(0, |case, (i, v)| case | usize::from(*v < 0.0) << i);
        for triangle in &mc_table::CASES[case] {
            triangles.push(triangle.map(|edge| {
                let [a, b] = mc_table::EDGES[usize::from(edge)];
                let t = values[a] / (values[a] - values[b]);
                std::array::from_fn(|k| {
                    let at = corners[a][k] as f32 + 0.5 + t * (corners[b][k] - corners[a][k]) as f32;
                    (at * 256.0).round() as i32
                })
            }));
        }
    }
    triangles
}

/// Marching cubes among scales by the book: around each point of the grid a cell of the finest voxels that meet there, larger ones counting as
/// often as they fill its corners.
fn mixed_by_the_book(reach: i32, distance: impl Fn([f32; 3]) -> f32, scale_of: impl Fn([i32; 3]) -> usize) -> Vec<[[i32; 3]; 3]> {
    let inside = |c: [i32; 3]| c.iter().all(|v| (-8 * reach..8 * reach).contains(v));
    // Centre and distance of the voxel that covers a finest one, and its scale.
    let sample = |c: [i32; 3]| {
        let scale = scale_of(c.map(|v| v >> 3));
        let size = (1 << scale) as f32;
        let centre = c.map(|v| ((v >> scale) as f32 + 0.5) * size);
        let steps = (distance(centre) / size).clamp(-15.0, 15.0) * DISTANCE_STEPS;
        (centre, if steps.is_nan() { f32::NAN } else { f32::from(steps as i16) * size / DISTANCE_STEPS }, scale)
    };
    let mut triangles = Vec::new();
    let width = 16 * reach - 1;
    for i in 0..width * width * width {
        let c = [i % width, i / width % width, i / (width * width)].map(|v| v - 8 * reach + 1);
        let voxels = cells::corners(c);
        assert!(voxels.iter().all(|&v| inside(v)));
        let corners = voxels.map(sample);
        let finest = corners.iter().map(|corner| corner.2).min().unwrap_or(0);
        let spacing = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
        let steep = |&[a, b]: &[usize; 2]| {
            let (a, b) = (corners[a], corners[b]);
            (a.1 < 0.0) != (b.1 < 0.0) && (a.1 - b.1).abs() > 4.0 * spacing(a.0, b.0)
        };
        if c.iter().any(|v| v % (1 << finest) != 0) || corners.iter().any(|corner| corner.1.is_nan()) || mc_table::EDGES.iter().any(steep) {
            continue;
        }
        let case = (0..8).fold(0, |case, i| case | usize::from(corners[i].1 < 0.0) << i);
        for triangle in &mc_table::CASES[case] {
            let edges = triangle.map(|edge| mc_table::EDGES[usize::from(edge)].map(|i| corners[i]));
            // Edges between the same two voxels are one.
            let same = |a: usize, b: usize| edges[a].map(|corner| corner.0) == edges[b].map(|corner| corner.0);
            if !same(0, 1) && !same(1, 2) && !same(2, 0) {
                triangles.push(edges.map(|[a, b]| {
                    let t = a.1 / (a.1 - b.1);
                    std::array::from_fn(|k| ((a.0[k] + t * (b.0[k] - a.0[k])) * 64.0).round() as i32)
                }));
            }
        }
    }
    triangles
}

/// Triangles as a set that does not depend on the order or on which vertex comes first.
fn canonical(triangles: impl IntoIterator<Item = [[i32; 3]; 3]>) -> Vec<[[i32; 3]; 3]> {
    let mut sorted: Vec<_> = triangles
        .into_iter()
        .map(|t| {
            let first = (0..3).min_by_key(|&i| t[i]).unwrap_or(0);
            [t[first], t[(first + 1) % 3], t[(first + 2) % 3]]
        })
        .collect();
    sorted.sort_unstable();
    sorted
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn a_field_with_gaps_is_meshed_as_by_the_book(seed in any::<u64>(), gaps in 0.0f32..0.3, holes in 0i32..4) {
        // Distances are whole 1/256 voxels, so that both sides compute with the same numbers.
        let shape = |p: [f32; 3]| {
            if hash(p, seed) < gaps { f32::NAN } else { ((sphere(9.0)(p) + hash(p, !seed) - 0.5) * 256.0).round() / 256.0 }
        };
        let mut field = field_of(2, shape, |_| 0);
        let mut gone = vec![[i32::MAX; 3]];
        if holes > 0 {
            // Some blocks do not exist at all: what a mesh needs of them cannot be closed either.
            gone.push([holes % 2, holes / 2 - 1, 0]);
            let id = field.find(block_key(gone[1])).unwrap();
            let (level, _) = field.tree.find(field.block(id).key).unwrap();
            prop_assert_eq!(level, 0);
            field.tree.octant_mut(field.block(id).key, 0).unwrap().link = crate::octree::NONE;
        }
        let inside = |c: [i32; 3]| !gone.contains(&c.map(|v| v.div_euclid(8))) && c.iter().all(|v| (-16..16).contains(v));
        let voxels: Vec<[i32; 3]> = (0..34 * 34 * 34).map(|i| [i % 34 - 17, i / 34 % 34 - 17, i / (34 * 34) - 17]).collect();
        let known = voxels.iter().filter(|&&c| inside(c)).map(|&c| (c, shape(c.map(|v| v as f32 + 0.5)))).filter(|(_, d)| !d.is_nan()).collect();
        let slow = canonical(by_the_book(&known, inside, &voxels));
        let mesh = extract(&field, 1.0, &MeshOptions::default());
        let points: Vec<[i32; 3]> = mesh.positions.iter().map(|p| p.map(|v| (v * 256.0).round() as i32)).collect();
        let fast = canonical(mesh.triangles.iter().map(|t| t.map(|v| points[v as usize])));
        let missing = slow.iter().filter(|t| fast.binary_search(t).is_err()).count();
        let extra = fast.iter().filter(|t| slow.binary_search(t).is_err()).count();
        prop_assert!(fast.len() > 1000 && fast.len() == slow.len());
        // A crossing may round to either side.
        prop_assert!(missing + extra <= fast.len() / 100, "{missing} missing, {extra} too many of {}", slow.len());
        let mut used = vec![false; mesh.positions.len()];
        mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
        prop_assert!(used.iter().all(|&u| u), "a vertex is in no triangle");
    }

    #[test]
    fn mixed_scales_are_meshed_as_by_the_book(seed in any::<u64>(), scales in prop::collection::vec(0usize..4, 64), gaps in 0.0f32..0.05) {
        let at = |c: [i32; 3]| scales[((c[0] + 2) + 4 * (c[1] + 2) + 16 * (c[2] + 2)) as usize];
        let shape = |p: [f32; 3]| if hash(p, seed) < gaps { f32::NAN } else { sphere(9.0)(p) + 3.0 * hash(p, !seed) };
        let mesh = extract(&field_of(2, shape, at), 1.0, &MeshOptions { close_gaps: false, ..MeshOptions::default() });
        let points: Vec<[i32; 3]> = mesh.positions.iter().map(|p| p.map(|v| (v * 64.0).round() as i32)).collect();
        let fast = canonical(mesh.triangles.iter().map(|t| t.map(|v| points[v as usize])));
        let slow = canonical(mixed_by_the_book(2, shape, at));
        let differing = slow.iter().filter(|t| fast.binary_search(t).is_err()).count() + fast.iter().filter(|t| slow.binary_search(t).is_err()).count();
        prop_assert!(fast.len() > 20 && fast.len() == slow.len(), "{} triangles instead of {}", fast.len(), slow.len());
        // A crossing may round to either side.
        prop_assert!(differing <= 2 + fast.len() / 50, "{differing} differ of {}", fast.len());
    }

    #[test]
    fn gaps_among_mixed_scales_tear_nothing(seed in any::<u64>(), scales in prop::collection::vec(0usize..4, 64), gaps in 0.0f32..0.3) {
        let at = |c: [i32; 3]| scales[((c[0] + 2) + 4 * (c[1] + 2) + 16 * (c[2] + 2)) as usize];
        let field = field_of(2, |p| if hash(p, seed) < gaps { f32::NAN } else { sphere(9.0)(p) }, at);
        let [open, closed] = [false, true].map(|close_gaps| extract(&field, 1.0, &MeshOptions { close_gaps, ..MeshOptions::default() }));
        for mesh in [&open, &closed] {
            // An edge has a triangle on either side at most, and they agree on the orientation.
            let mut edges = HashMap::new();
            for t in &mesh.triangles {
                (0..3).for_each(|i| *edges.entry((t[i], t[(i + 1) % 3])).or_insert(0) += 1);
            }
            prop_assert!(edges.values().all(|&count| count == 1));
            let mut used = vec![false; mesh.positions.len()];
            mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
            prop_assert!(used.iter().all(|&u| u), "a vertex is in no triangle");
        }
        // Closing adds triangles and takes none away.
        let points = |mesh: &Mesh| canonical(mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].map(|c| (c * 64.0).round() as i32))));
        let closed = points(&closed);
        prop_assert!(points(&open).iter().all(|t| closed.binary_search(t).is_ok()));
    }
}
