//! Meshes of analytic shapes over blocks of mixed scales.

use super::*;
use crate::field::tsdf::{DISTANCE_STEPS, TsdfField, Voxel, WEIGHT_ONE};
use crate::octree::{BLOCK_EDGE, Cursor, block_key, voxel_coords, voxels_at};
use proptest::prelude::*;
use std::collections::HashMap;

/// A field whose blocks within `reach` of the origin hold `distance` (finest voxels), each block at its own scale.
fn field_of(reach: i32, distance: impl Fn([f32; 3]) -> f32, scale_of: impl Fn([i32; 3]) -> usize) -> TsdfField {
    let mut field = TsdfField::default();
    field.tree.grow_to(block_key([-reach; 3]));
    field.tree.grow_to(block_key([reach - 1; 3]));
    let mut cursor = Cursor::new(&field.tree);
    for z in -reach..reach {
        for y in -reach..reach {
            for x in -reach..reach {
                let scale = scale_of([x, y, z]);
                let (id, _) = field.make(&mut cursor, block_key([x, y, z]), scale as u8, false);
                let slot = field.blocks[id].data[scale];
                for i in 0..voxels_at(scale) {
                    let c = voxel_coords(i, scale);
                    let size = (1 << scale) as f32;
                    let block = [x, y, z];
                    let centre = std::array::from_fn(|k| (block[k] * BLOCK_EDGE as i32) as f32 + (c[k] as f32 + 0.5) * size);
                    let steps = (distance(centre) / size).clamp(-15.0, 15.0) * DISTANCE_STEPS;
                    let weight = if steps.is_nan() { 0 } else { 10 * WEIGHT_ONE };
                    field.voxels.get_mut(scale, slot)[i] = Voxel { distance: steps as i16, weight };
                }
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
    let few = extract(&field, 1.0, &MeshOptions { min_weight: 11.0, lod: 0 });
    assert!(few.triangles.is_empty(), "no voxel has 11 observations");
}

#[test]
fn a_coarser_level_of_detail_is_closed_and_smaller() {
    let field = field_of(4, sphere(25.0), |c| usize::from(c[2] > 0));
    let sizes: Vec<usize> = (0..3)
        .map(|lod| {
            let mesh = extract(&field, 1.0, &MeshOptions { lod, ..MeshOptions::default() });
            assert_eq!(assert_closed_manifold(&mesh), 2, "lod {lod}");
            mesh.triangles.len()
        })
        .collect();
    assert!(sizes[1] < sizes[0] && sizes[2] * 2 < sizes[1], "{sizes:?}");
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
        let slot = field.shades.insert(0);
        field.shades.get_mut(0, slot).fill(9);
        field.blocks[id].shade[0] = slot;
    }
    let mesh = extract(&field, 0.1, &MeshOptions::default());
    assert_eq!(mesh.shades.len(), mesh.positions.len());
    assert!(mesh.shades.contains(&9) && mesh.shades.contains(&128));
}
