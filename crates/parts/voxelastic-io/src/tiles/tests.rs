//! Tiles read back from their files: whatever levels a viewer chooses, they make one surface without cracks.

use super::*;
use crate::{Error, Origin};
use proptest::prelude::*;
use serde_json::Value;
use std::collections::{BTreeSet, HashMap};
use std::fs;
use std::path::Path;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, Scan};
use voxelastic::meshing::SurfaceTiles;
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic::{Cloud, Mapper, Pose, Settings};

const VOXEL: f64 = 0.1;

/// A closed surface: a ball with bumps, of triangles of some centimetres to half a metre.
fn ball(centre: [f64; 3], radius: f64, rows: usize) -> Mesh {
    let columns = 2 * rows;
    let place = |row: usize, column: usize| {
        let (polar, azimuth) = (std::f64::consts::PI * row as f64 / rows as f64, std::f64::consts::TAU * column as f64 / columns as f64);
        let direction = [polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()];
        let bumpy = radius * (1.0 + 0.05 * (7.0 * azimuth).sin() * (5.0 * polar).sin());
        (std::array::from_fn(|k| (centre[k] + bumpy * direction[k]) as f32), direction.map(|c| c as f32))
    };
    let mut mesh = Mesh::default();
    let mut add = |(position, normal): ([f32; 3], [f32; 3])| {
        mesh.positions.push(position);
        mesh.normals.push(normal);
        mesh.colours.push([200, 100, 50]);
        mesh.positions.len() as u32 - 1
    };
    let (top, bottom) = (add(place(0, 0)), add(place(rows, 0)));
    let ring: Vec<Vec<u32>> = (1..rows).map(|row| (0..columns).map(|column| add(place(row, column))).collect()).collect();
    for column in 0..columns {
        let next = (column + 1) % columns;
        mesh.triangles.push([top, ring[0][column], ring[0][next]]);
        mesh.triangles.push([bottom, ring[rows - 2][next], ring[rows - 2][column]]);
        for row in 0..rows - 2 {
            mesh.triangles.push([ring[row][column], ring[row + 1][column], ring[row + 1][next]]);
            mesh.triangles.push([ring[row][column], ring[row + 1][next], ring[row][next]]);
        }
    }
    mesh
}

fn write(folder: &Path, mesh: &Mesh) -> TilesetReport {
    let mut writer = TilesetWriter::create(folder, VOXEL).unwrap();
    split(mesh, VOXEL).into_iter().for_each(|(cell, mesh)| writer.leaf(cell, mesh).unwrap());
    writer.finish("a ball").unwrap().unwrap()
}

/// A hall of 24 x 12 x 6 m in several submaps, one of them turned a little.
fn hall() -> Atlas {
    let scan = |node: u64| {
        let x = f64::from(node as u32) - 3.0;
        let mut points = Vec::new();
        for i in 0..30_000 {
            let (elevation, azimuth) = ((f64::from(i / 600) - 24.5) * 0.028, f64::from(i % 600) * std::f64::consts::TAU / 600.0);
            let d = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let along = |side: f64, c: f64| if c.abs() < 1e-9 { f64::INFINITY } else { side / c.abs() };
            let range = along(6.0, d[1]).min(along(3.0, d[2])).min(along(12.0 - x * d[0].signum(), d[0]));
            points.push(d.map(|c| (c * range) as f32));
        }
        Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::translation(x, 0.0, 0.0), cloud: Cloud::from_points(points) })
    };
    let settings = Settings { voxel_size: VOXEL as f32, lambda_odom: 2.5, ..Settings::default() };
    let mut mapper = Mapper::new(settings).unwrap();
    (0..7).for_each(|node| {
        mapper.handle(scan(node)).unwrap();
    });
    mapper.finish();
    mapper.into_atlas()
}

#[test]
fn leaves_of_a_map_are_those_of_its_whole_surface() {
    let atlas = hall();
    assert!(atlas.submaps().len() > 1);
    // By cell, corners of triangles and normals there.
    let corners = |mesh: &Mesh| -> BTreeSet<Vec<[u32; 3]>> {
        let of = |t: &[u32; 3]| {
            let corners = t.map(|v| mesh.positions[v as usize].map(f32::to_bits));
            let first = (0..3).min_by_key(|i| corners[*i]).unwrap();
            (0..3).map(|k| corners[(first + k) % 3]).collect()
        };
        mesh.triangles.iter().map(of).collect()
    };
    let whole = split(&atlas.mesh(&MeshOptions::default()), VOXEL);
    let mut made = Vec::new();
    leaves(&SurfaceTiles::new(&atlas, MeshOptions::default()), VOXEL, |cell, mesh| {
        made.push((cell, mesh));
        Ok(())
    })
    .unwrap();
    assert!(made.len() == whole.len() && made.len() >= 8 && made.is_sorted_by_key(|(cell, _)| cell.order()));
    for ((cell, mesh), (expected_cell, expected)) in made.iter().zip(&whole) {
        assert_eq!((cell, mesh.triangles.len(), mesh.positions.len()), (expected_cell, expected.triangles.len(), expected.positions.len()));
        assert!(corners(mesh) == corners(expected));
    }
    let error = Error::unwritable(Path::new("x"), "full".to_owned());
    let mut error = Some(error);
    assert!(leaves(&SurfaceTiles::new(&atlas, MeshOptions::default()), VOXEL, |_, _| Err(error.take().unwrap())).is_err());
}

#[test]
fn the_origin_of_a_map_is_where_its_tiles_are() {
    let folder = tempfile::tempdir().unwrap();
    let origin = Origin::new([448_000.0, 5_412_000.0, 0.0]).unwrap();
    let mut writer = TilesetWriter::create(folder.path(), VOXEL).unwrap().with_origin(origin);
    split(&ball([3.0, 2.0, 1.0], 2.0, 30), VOXEL).into_iter().for_each(|(cell, mesh)| writer.leaf(cell, mesh).unwrap());
    writer.finish("far").unwrap().unwrap();
    let root = &json(&folder.path().join("tileset.json"))["root"];
    let columns = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [448_000.0, 5_412_000.0, 0.0, 1.0]];
    assert_eq!(root["transform"], serde_json::json!(columns.concat()));
    assert!((root["boundingVolume"]["box"][0].as_f64().unwrap() - 3.0).abs() < 0.5, "{root}");
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Vertices on the lattice and triangles of a tile.
fn read_tile(path: &Path) -> (Vec<[i64; 3]>, Vec<[usize; 3]>) {
    let bytes = fs::read(path).unwrap();
    let length = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], length(8)), (&b"glTF"[..], bytes.len()));
    let head: Value = serde_json::from_slice(&bytes[20..20 + length(12)]).unwrap();
    let binary = &bytes[28 + length(12)..];
    let view = |accessor: &Value| {
        let accessor = &head["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &head["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let from = view["byteOffset"].as_u64().unwrap() as usize;
        (accessor.clone(), view["byteStride"].as_u64().unwrap_or(0) as usize, &binary[from..from + view["byteLength"].as_u64().unwrap() as usize])
    };
    let primitive = &head["meshes"][0]["primitives"][0];
    let (positions, stride, data) = view(&primitive["attributes"]["POSITION"]);
    let node = &head["nodes"][0];
    let (step, shift) = (node["scale"][0].as_f64().unwrap(), &node["translation"]);
    // Back to z up.
    let origin = [&shift[0], &shift[2], &shift[1]].map(|c| (c.as_f64().unwrap() / step).round() as i64);
    let origin = [origin[0], -origin[1], origin[2]];
    let number = |vertex: &[u8], k: usize| match positions["componentType"].as_u64() {
        Some(5123) => i64::from(u16::from_le_bytes([vertex[2 * k], vertex[2 * k + 1]])),
        _ => f32::from_le_bytes(vertex[4 * k..4 * k + 4].try_into().unwrap()) as i64,
    };
    let places: Vec<[i64; 3]> = data.chunks_exact(stride).map(|v| std::array::from_fn(|k| origin[k] + number(v, k))).collect();
    for (bound, pick) in [("min", i64::min as fn(i64, i64) -> i64), ("max", i64::max)] {
        let extreme: [i64; 3] = std::array::from_fn(|k| places.iter().map(|p| p[k] - origin[k]).reduce(pick).unwrap());
        assert_eq!(serde_json::json!(extreme), positions[bound], "{bound}");
    }
    let (indices, _, data) = view(&primitive["indices"]);
    let indices: Vec<usize> = match indices["componentType"].as_u64() {
        Some(5123) => data.chunks_exact(2).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
        _ => data.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap()) as usize).collect(),
    };
    (places, indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect())
}

/// All tiles of a tree, those in other files included.
fn tile(folder: &Path, tile: &Value, prefix: &str) -> Tree {
    let uri = tile["content"]["uri"].as_str().unwrap();
    if uri.ends_with(".json") {
        return self::tile(folder, &json(&folder.join(prefix).join(uri))["root"], "content");
    }
    let children = tile["children"].as_array().map_or_else(Vec::new, |all| all.iter().map(|child| self::tile(folder, child, prefix)).collect());
    let file = format!("{prefix}/{uri}").trim_start_matches('/').to_owned();
    Tree { file, error: tile["geometricError"].as_f64().unwrap(), bounds: tile["boundingVolume"]["box"].clone(), children }
}

struct Tree {
    file: String,
    error: f64,
    bounds: Value,
    children: Vec<Tree>,
}

impl Tree {
    /// A choice of tiles that cover everything once, as a viewer makes it.
    fn cut<'a>(&'a self, choose: &mut impl FnMut() -> bool, into: &mut Vec<&'a Tree>) {
        if self.children.is_empty() || choose() {
            into.push(self);
        } else {
            self.children.iter().for_each(|child| child.cut(choose, into));
        }
    }

    fn check(&self, folder: &Path, files: &mut BTreeSet<String>) {
        assert!(files.insert(self.file.clone()), "{} twice", self.file);
        let b: Vec<f64> = self.bounds.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let half = [b[3], b[7], b[11]];
        for p in &read_tile(&folder.join(&self.file)).0 {
            let inside = (0..3).all(|k| (p[k] as f64 * VOXEL / STEPS_PER_VOXEL - b[k]).abs() <= half[k] + 1e-6);
            assert!(inside, "{p:?} of {} is not in its box {b:?}", self.file);
        }
        for child in &self.children {
            assert!(child.error < self.error, "errors fall towards the leaves");
            child.check(folder, files);
        }
    }
}

/// Edges that do not have an even number of triangles: where one could look through a closed surface.
fn cracks(folder: &Path, tiles: &[&Tree]) -> usize {
    let mut edges: HashMap<[[i64; 3]; 2], usize> = HashMap::new();
    for tile in tiles {
        let (places, triangles) = read_tile(&folder.join(&tile.file));
        for t in triangles {
            let corners = t.map(|v| places[v]);
            for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a], corners[b])).into_iter().filter(|(a, b)| a != b) {
                *edges.entry(if a < b { [a, b] } else { [b, a] }).or_default() += 1;
            }
        }
    }
    edges.values().filter(|count| !count.is_multiple_of(2)).count()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: ProptestConfig::default().cases.min(12), ..ProptestConfig::default() })]
    #[test]
    fn tiles_of_any_levels_fit_together(centre in [-30.0f64..30.0, -30.0..30.0, -9.0..9.0], radius in 4.0f64..30.0, choices in any::<u64>()) {
        let folder = tempfile::tempdir().unwrap();
        let mesh = ball(centre, radius, 90);
        let report = write(folder.path(), &mesh);
        prop_assert_eq!(report.triangles, mesh.triangles.len());
        let document = json(&folder.path().join("tileset.json"));
        prop_assert_eq!(&document["asset"]["version"], "1.1");
        let tree = tile(folder.path(), &document["root"], "");
        let mut files = BTreeSet::new();
        tree.check(folder.path(), &mut files);
        prop_assert_eq!(files.len(), report.tiles);
        let mut bits = choices;
        for chance in [0, 1, 3, 1 << 20] {
            // Never, and ever more often, a tile instead of those below it; at last only the root.
            let mut choose = || { bits = bits.rotate_left(7).wrapping_mul(0x9e37_79b9_7f4a_7c15); chance > 0 && (bits >> 40) % 4 < chance };
            let mut cut = Vec::new();
            tree.cut(&mut choose, &mut cut);
            prop_assert_eq!(cracks(folder.path(), &cut), 0, "{} tiles", cut.len());
        }
    }
}

#[test]
fn a_coarser_tile_has_fewer_triangles_and_is_near() {
    let folder = tempfile::tempdir().unwrap();
    // Triangles have edges of a quarter of a metre and the cells of the root 0.4 m or more.
    write(folder.path(), &ball([0.0; 3], 20.0, 250));
    let tree = tile(folder.path(), &json(&folder.path().join("tileset.json"))["root"], "");
    let leaves = {
        let mut all = Vec::new();
        tree.cut(&mut || false, &mut all);
        all
    };
    let count = |tree: &Tree| read_tile(&folder.path().join(&tree.file)).1.len();
    let (all, root) = (leaves.iter().map(|leaf| count(leaf)).sum::<usize>(), count(&tree));
    let cells = 4.0 * std::f64::consts::PI * 20f64.powi(2) / tree.error.powi(2);
    assert!(root < all / 3 && (root as f64) < 3.0 * cells, "{root} of {all}, {cells}");
    for p in read_tile(&folder.path().join(&tree.file)).0 {
        let length = p.iter().map(|c| (*c as f64 * VOXEL / STEPS_PER_VOXEL).powi(2)).sum::<f64>().sqrt();
        assert!((20.0 * 0.95 - tree.error..=20.0 * 1.05 + tree.error).contains(&length), "{length} m, {} m", tree.error);
    }
}

#[test]
fn an_export_writes_what_changed_and_removes_what_is_old() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = ball([1.0, 2.0, 0.0], 15.0, 60);
    let first = write(folder.path(), &mesh);
    let text = fs::read(folder.path().join("tileset.json")).unwrap();
    let again = write(folder.path(), &mesh);
    assert!(first.kept == 0 && again.kept == again.tiles && fs::read(folder.path().join("tileset.json")).unwrap() == text);
    let other = write(folder.path(), &ball([1.0, 2.0, 0.0], 8.0, 60));
    assert_eq!(fs::read_dir(folder.path().join("content")).unwrap().count(), other.tiles);
}

#[test]
fn parts_of_a_map_make_the_map() {
    let (whole, pieces) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mesh = ball([-3.0, 5.0, 1.0], 28.0, 80);
    write(whole.path(), &mesh);
    let mut parts: Vec<Part> = Vec::new();
    let leaves = split(&mesh, VOXEL);
    let above = |cell: &Cell| cell.above(2);
    for region in leaves.chunk_by(|a, b| above(&a.0) == above(&b.0)) {
        let mut writer = TilesetWriter::create(pieces.path(), VOXEL).unwrap();
        region.iter().for_each(|(cell, mesh)| writer.leaf(*cell, mesh.clone()).unwrap());
        parts.extend(writer.parts(2).unwrap());
    }
    let mut writer = TilesetWriter::create(pieces.path(), VOXEL).unwrap();
    for part in parts {
        let bytes = part.to_bytes();
        assert_eq!(Part::from_bytes(&bytes, Path::new("part")).unwrap(), part);
        for at in [0, 9, bytes.len() / 2, bytes.len() - 1] {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x11;
            assert!(Part::from_bytes(&damaged, Path::new("part")).is_err(), "byte {at}");
        }
        writer.part(part).unwrap();
    }
    writer.finish("a ball").unwrap();
    let text = |folder: &Path| fs::read_to_string(folder.join("tileset.json")).unwrap();
    assert_eq!(text(pieces.path()), text(whole.path()));
}

#[test]
fn folders_of_others_disorder_and_emptiness_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.tex"), "precious").unwrap();
    assert!(TilesetWriter::create(folder.path(), VOXEL).unwrap_err().to_string().contains("thesis.tex"));
    let folder = tempfile::tempdir().unwrap();
    let leaves = split(&ball([0.0; 3], 10.0, 30), VOXEL);
    let mut writer = TilesetWriter::create(folder.path(), VOXEL).unwrap();
    writer.leaf(leaves[1].0, leaves[1].1.clone()).unwrap();
    assert!(writer.leaf(leaves[0].0, leaves[0].1.clone()).unwrap_err().to_string().contains("order"));
    let empty = TilesetWriter::create(folder.path().join("new"), VOXEL).unwrap();
    assert_eq!(empty.finish("nothing").unwrap(), None);
    assert!(!folder.path().join("new").exists());
}
