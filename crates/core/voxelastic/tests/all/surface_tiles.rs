//! The surface in tiles is the surface.

use std::collections::BTreeSet;
use voxelastic::event::{Event, Scan};
use voxelastic::field::tsdf::TsdfField;
use voxelastic::octree::block_coords;
use voxelastic::surface::{Mesh, MeshOptions, TILE_EDGE, Tile, extract, extract_tiles};
use voxelastic::{Cloud, Mapper, Pose, Settings};

/// A hall of 60 x 16 x 8 m along x, seen from `x` metres along it: near blocks are fine, far ones coarse.
fn hall(x: f64) -> Cloud {
    let mut points = Vec::new();
    for row in 0..48 {
        for column in 0..900 {
            let (elevation, azimuth) = ((f64::from(row) - 23.5) * 0.025, f64::from(column) * std::f64::consts::TAU / 900.0);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let along = |side: f64, c: f64| if c.abs() < 1e-9 { f64::INFINITY } else { side / c.abs() };
            let range = along(8.0, d[1]).min(along(4.0, d[2])).min(along(30.0 - x * d[0].signum(), d[0]));
            points.push(d.map(|c| (c * range) as f32));
        }
    }
    Cloud::from_points(points)
}

fn scan(node: u64) -> Event {
    let x = 2.0 * node as f64;
    Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: hall(x) })
}

type Corners = [[u32; 3]; 3];

/// Triangles by the bits of their corners, each with its normals, in an order of their own.
fn triangles(meshes: &[Mesh]) -> Vec<(Corners, [[f32; 3]; 3])> {
    let of = |mesh: &Mesh| -> Vec<_> {
        let turned = |t: &[u32; 3]| {
            let corners = t.map(|v| mesh.positions[v as usize].map(f32::to_bits));
            let first = (0..3).min_by_key(|&i| corners[i]).unwrap();
            [0, 1, 2].map(|k| (corners[(first + k) % 3], mesh.normals[t[(first + k) % 3] as usize]))
        };
        mesh.triangles.iter().map(turned).map(|t| (t.map(|c| c.0), t.map(|c| c.1))).collect()
    };
    let mut all: Vec<_> = meshes.iter().flat_map(of).collect();
    all.sort_unstable_by_key(|t| t.0);
    all
}

fn assert_same(whole: &Mesh, parts: &[Mesh]) {
    let (whole, parts) = (triangles(std::slice::from_ref(whole)), triangles(parts));
    assert_eq!(whole.len(), parts.len());
    for (one, other) in whole.iter().zip(&parts) {
        assert_eq!(one.0, other.0);
        let differences = one.1.iter().flatten().zip(other.1.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(differences.fold(0.0, f32::max) < 1e-3, "normals {:?} {:?}", one.1, other.1);
    }
}

/// The tiles around all blocks of a field: vertices may lie in the next one.
fn tiles_of(field: &TsdfField) -> Vec<Tile> {
    let around = |id: u32| {
        let block = block_coords(field.head(id).key);
        (0..8).map(move |i| -> Tile { std::array::from_fn(|k| (block[k] - 1 + 2 * (i >> k & 1)).div_euclid(TILE_EDGE)) })
    };
    let all: BTreeSet<Tile> = field.ids_in_morton_order().into_iter().flat_map(around).collect();
    all.into_iter().collect()
}

#[test]
fn tiles_together_are_the_surface_at_all_levels_of_detail() {
    let mut mapper = Mapper::new(Settings { voxel_size: 0.065, ..Settings::default() }).unwrap();
    (0..3).for_each(|k| {
        mapper.handle(scan(k)).unwrap();
    });
    let submap = &mapper.atlas().submaps()[0];
    let scales = submap.tsdf().blocks_by_scale();
    assert!(scales.iter().filter(|n| **n > 50).count() >= 2, "{scales:?}");
    for lod in [0, 1, 3] {
        let options = MeshOptions { lod, ..MeshOptions::default() };
        let whole = extract(submap.tsdf(), 0.065, &options);
        assert!(whole.triangles.len() > 1000);
        let tiles = tiles_of(submap.tsdf());
        assert!(tiles.len() > 50);
        assert_same(&whole, &extract_tiles(submap.tsdf(), 0.065, &options, &tiles));
        // One by one, from fewer blocks.
        let one_by_one: Vec<Mesh> = tiles.iter().flat_map(|tile| extract_tiles(submap.tsdf(), 0.065, &options, &[*tile])).collect();
        assert_same(&whole, &one_by_one);
    }
}
