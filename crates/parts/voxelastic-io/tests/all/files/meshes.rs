//! Meshes are written so that others can read them.

use proptest::prelude::*;
use serde_json::Value;
use voxelastic_io::mesh_io::{MeshRef, write_glb, write_ply};
use voxelastic_io::{Error, ply};

/// A chunk-by-chunk reader of GLB that shares no code with the writer.
pub(crate) fn open_glb(bytes: &[u8]) -> (Value, Vec<u8>) {
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!((number(4), number(8)), (2, bytes.len()));
    let json = number(12);
    assert_eq!(&bytes[16..20], b"JSON");
    assert_eq!(json % 4, 0);
    let document = serde_json::from_slice(&bytes[20..20 + json]).unwrap();
    let rest = &bytes[20 + json..];
    if rest.is_empty() {
        return (document, Vec::new());
    }
    assert_eq!(&rest[4..8], b"BIN\0");
    assert_eq!(u32::from_le_bytes(rest[..4].try_into().unwrap()) as usize, rest.len() - 8);
    (document, rest[8..].to_vec())
}

/// The bytes of an accessor, with the rules of the specification checked.
pub(crate) fn accessor<'a>(document: &'a Value, binary: &'a [u8], index: &Value) -> (&'a Value, &'a [u8]) {
    let accessor = &document["accessors"][index.as_u64().unwrap() as usize];
    let view = &document["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let (offset, length) = (view["byteOffset"].as_u64().unwrap() as usize, view["byteLength"].as_u64().unwrap() as usize);
    assert_eq!(offset % 4, 0);
    assert!(accessor["count"].as_u64().unwrap() >= 1);
    (accessor, &binary[offset..offset + length])
}

pub(crate) fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

#[derive(Debug, Clone)]
struct Owned {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    colours: Option<Vec<[u8; 3]>>,
    intensity: Option<Vec<f32>>,
    triangles: Vec<[u32; 3]>,
}

impl Owned {
    fn view(&self) -> MeshRef<'_> {
        MeshRef {
            positions: &self.positions,
            origin: [0.0; 3],
            normals: &self.normals,
            colours: self.colours.as_deref(),
            intensity: self.intensity.as_deref(),
            triangles: &self.triangles,
        }
    }
}

fn meshes() -> impl Strategy<Value = Owned> {
    let coordinate = -500.0f32..500.0;
    (1usize..40, any::<[bool; 3]>()).prop_flat_map(move |(n, [normals, colours, intensity])| {
        let vectors = |present: bool| prop::collection::vec(prop::array::uniform3(coordinate.clone()), if present { n } else { 0 });
        let colour = prop::collection::vec(any::<[u8; 3]>(), n);
        let strength = prop::collection::vec(0.0f32..1e5, n);
        let triangle = prop::array::uniform3(0..n as u32);
        (vectors(true), vectors(normals), colour, strength, prop::collection::vec(triangle, 0..60)).prop_map(move |(p, v, c, i, triangles)| Owned {
            positions: p,
            normals: v,
            colours: colours.then_some(c),
            intensity: intensity.then_some(i),
            triangles,
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn ply_reads_back_as_it_was(mesh in meshes()) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.ply");
        write_ply(&path, &mesh.view()).unwrap();
        let back = ply::read_mesh(&path).unwrap();
        prop_assert_eq!(back.positions, mesh.positions);
        prop_assert_eq!(back.normals.unwrap_or_default(), mesh.normals);
        prop_assert_eq!(back.colours, mesh.colours);
        prop_assert_eq!(back.intensity, mesh.intensity);
        prop_assert_eq!(back.triangles, mesh.triangles);
    }

    #[test]
    fn glb_obeys_its_specification(mesh in meshes()) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.glb");
        write_glb(&path, &mesh.view()).unwrap();
        let (document, binary) = open_glb(&std::fs::read(&path).unwrap());
        prop_assert_eq!(document["buffers"][0]["byteLength"].as_u64().unwrap() as usize, binary.len());
        let primitive = &document["meshes"][0]["primitives"][0];

        let (position, bytes) = accessor(&document, &binary, &primitive["attributes"]["POSITION"]);
        let positions = floats(bytes);
        prop_assert_eq!(&positions, &mesh.positions.concat());
        for axis in 0..3 {
            let values = || mesh.positions.iter().map(|p| p[axis]);
            prop_assert_eq!(position["min"][axis].as_f64().unwrap() as f32, values().fold(f32::INFINITY, f32::min));
            prop_assert_eq!(position["max"][axis].as_f64().unwrap() as f32, values().fold(f32::NEG_INFINITY, f32::max));
        }
        if !mesh.normals.is_empty() {
            let (_, bytes) = accessor(&document, &binary, &primitive["attributes"]["NORMAL"]);
            for normal in floats(bytes).chunks(3) {
                let length: f32 = normal.iter().map(|c| c * c).sum::<f32>().sqrt();
                prop_assert!((length - 1.0).abs() < 1e-5);
            }
        }
        prop_assert_eq!(primitive["attributes"].get("COLOR_0").is_some(), mesh.colours.is_some());
        if mesh.triangles.is_empty() {
            prop_assert_eq!(primitive["mode"].as_u64(), Some(0));
        } else {
            let (_, bytes) = accessor(&document, &binary, &primitive["indices"]);
            let indices: Vec<u32> = bytes.chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap())).collect();
            prop_assert_eq!(indices, mesh.triangles.concat());
        }
    }
}

#[test]
fn colours_in_glb_are_linear() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.glb");
    write_glb(&path, &MeshRef { positions: &[[0.0; 3]], colours: Some(&[[0, 255, 188]]), ..MeshRef::default() }).unwrap();
    let (document, binary) = open_glb(&std::fs::read(&path).unwrap());
    let (_, bytes) = accessor(&document, &binary, &document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]);
    let colour: Vec<u16> = bytes.chunks_exact(2).map(|b| u16::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!((colour[0], colour[1], colour[3]), (0, 65535, 65535));
    // sRGB 188 is half of the light.
    assert!((f32::from(colour[2]) / 65535.0 - 0.5).abs() < 0.01);
}

#[test]
fn an_empty_mesh_is_an_empty_scene() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.glb");
    write_glb(&path, &MeshRef::default()).unwrap();
    let (document, binary) = open_glb(&std::fs::read(&path).unwrap());
    assert!(binary.is_empty() && document.get("meshes").is_none());
    let path = dir.path().join("m.ply");
    write_ply(&path, &MeshRef::default()).unwrap();
    assert!(ply::read_mesh(&path).unwrap().positions.is_empty());
}

#[test]
fn meshes_that_make_no_sense_are_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let p = [[0.0f32; 3]; 3];
    for (mesh, expected) in [
        (MeshRef { positions: &p, triangles: &[[0, 1, 3]], ..MeshRef::default() }, "triangle 0"),
        (MeshRef { positions: &p, normals: &p[..2], ..MeshRef::default() }, "2 normals"),
        (MeshRef { positions: &p, colours: Some(&[]), ..MeshRef::default() }, "0 colours"),
        (MeshRef { positions: &[[0.0, f32::NAN, 0.0]], ..MeshRef::default() }, "vertex 0"),
    ] {
        for result in [write_ply(dir.path().join("m.ply"), &mesh), write_glb(dir.path().join("m.glb"), &mesh)] {
            let error = result.unwrap_err();
            assert!(matches!(error, Error::Unwritable { .. }) && error.to_string().contains(expected), "{error}");
        }
    }
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_large_ply_reads_back_as_it_was() {
    let positions: Vec<[f32; 3]> = (0..10_000).map(|i| [i as f32, 0.5 * i as f32, -(i as f32)]).collect();
    let intensity: Vec<f32> = (0..10_000).map(|i| (i % 251) as f32).collect();
    let triangles: Vec<[u32; 3]> = (0..9_001).map(|i| [i, 9_999 - i, 37 * i % 10_000]).collect();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.ply");
    let mesh = MeshRef { positions: &positions, intensity: Some(&intensity), triangles: &triangles, ..MeshRef::default() };
    write_ply(&path, &mesh).unwrap();
    let back = ply::read_mesh(&path).unwrap();
    assert!(back.positions == positions && back.intensity == Some(intensity) && back.triangles == triangles);
}
