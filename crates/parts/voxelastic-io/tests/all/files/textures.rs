//! Meshes with textures, read back here by the letter of glTF and by Open3D.

use crate::files::meshes::{accessor, floats, open_glb};
use voxelastic_io::mesh_io::{MeshRef, Texture, write_textured_glb};
use voxelastic_testing::run_python;

/// Two triangles, and a texture of 4 x 3 texels of which no two are alike.
const POSITIONS: [[f32; 3]; 4] = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 1.0]];
const TRIANGLES: [[u32; 3]; 2] = [[0, 1, 2], [0, 2, 3]];
const SIZE: [usize; 2] = [4, 3];

fn texels() -> Vec<[u8; 3]> {
    (0..12).map(|k| [20 * k, 240 - 20 * k, 7 * k]).collect()
}

/// The middles of texels: of the first triangle in the first two columns, of the second in the others.
fn corners() -> Vec<[[f32; 2]; 3]> {
    let at = |x: usize, y: usize| [(x as f32 + 0.5) / 4.0, (y as f32 + 0.5) / 3.0];
    vec![[at(0, 0), at(1, 0), at(0, 2)], [at(3, 2), at(2, 2), at(3, 0)]]
}

fn written(dir: &std::path::Path) -> std::path::PathBuf {
    let path = dir.join("t.glb");
    let normals = [[0.0, 0.0, 1.0]; 4];
    let mesh = MeshRef { positions: &POSITIONS, normals: &normals, triangles: &TRIANGLES, ..MeshRef::default() };
    let texture = Texture { size: SIZE, texels: &texels(), triangles: &[0, 1], corners: &corners() };
    write_textured_glb(&path, &mesh, &[texture.encode().unwrap()]).unwrap();
    path
}

#[test]
fn corners_show_their_texels() {
    let dir = tempfile::tempdir().unwrap();
    let (document, binary) = open_glb(&std::fs::read(written(dir.path())).unwrap());
    let primitive = &document["meshes"][0]["primitives"][0];
    let of = |name: &str| floats(accessor(&document, &binary, &primitive["attributes"][name]).1);
    let expected: Vec<f32> = TRIANGLES.iter().flatten().flat_map(|v| POSITIONS[*v as usize]).collect();
    assert_eq!((of("POSITION"), of("TEXCOORD_0")), (expected, corners().as_flattened().as_flattened().to_vec()));
    assert_eq!(of("NORMAL").len(), 18);
    let view = &document["bufferViews"][document["images"][0]["bufferView"].as_u64().unwrap() as usize];
    assert!(view.get("target").is_none() && view.get("byteStride").is_none());
    let (from, length) = (view["byteOffset"].as_u64().unwrap() as usize, view["byteLength"].as_u64().unwrap() as usize);
    let image = image::load_from_memory(&binary[from..from + length]).unwrap().into_rgb8();
    assert_eq!((image.width(), image.height(), image.as_raw()), (4, 3, &texels().concat()));
    assert_eq!(document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
    // Neighbours in the image are not neighbours on the mesh: no smaller copies.
    assert_eq!(document["samplers"][0]["minFilter"], 9729);
}

#[test]
fn what_does_not_fit_together_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.glb");
    let mesh = MeshRef { positions: &POSITIONS, triangles: &TRIANGLES, ..MeshRef::default() };
    let (texels, corners) = (texels(), corners());
    let good = Texture { size: SIZE, texels: &texels, triangles: &[0, 1], corners: &corners };
    let wrong = [Texture { size: [4, 4], ..good }, Texture { corners: &corners[..1], ..good }, Texture { triangles: &[], corners: &[], ..good }];
    for texture in wrong {
        let error = texture.encode().unwrap_err();
        assert!(error.contains("in the texture"), "{error}");
    }
    let image = |triangles: &[u32]| Texture { triangles, corners: &corners[..triangles.len()], ..good }.encode().unwrap();
    for (images, expected) in [
        (vec![], "0 of 2 triangles"),
        (vec![image(&[1])], "1 of 2 triangles"),
        (vec![image(&[0, 1]), image(&[1])], "triangle 1 is missing, or in two places"),
        (vec![image(&[0, 2])], "triangle 2 is missing"),
    ] {
        let error = write_textured_glb(&path, &mesh, &images).unwrap_err().to_string();
        assert!(error.contains(expected) && !path.exists(), "{error}");
    }
}

#[test]
fn a_texture_may_have_several_images() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("t.glb");
    let (texels, corners) = (texels(), corners());
    let mesh = MeshRef { positions: &POSITIONS, normals: &[[0.0, 0.0, 1.0]; 4], triangles: &TRIANGLES, ..MeshRef::default() };
    // The second triangle first; images of sizes that need padding.
    let one = |triangle: u32, size: [usize; 2]| {
        let texture = Texture { size, texels: &texels[..size[0] * size[1]], triangles: &[triangle], corners: &corners[..1] };
        texture.encode().unwrap()
    };
    write_textured_glb(&path, &mesh, &[one(1, [4, 3]), one(0, [5, 1])]).unwrap();
    let (document, binary) = open_glb(&std::fs::read(&path).unwrap());
    assert_eq!(document["buffers"][0]["byteLength"].as_u64().unwrap() as usize, binary.len());
    for (number, triangle, size) in [(0, 1, (4, 3)), (1, 0, (5, 1))] {
        let primitive = &document["meshes"][0]["primitives"][number];
        let expected: Vec<f32> = TRIANGLES[triangle].iter().flat_map(|v| POSITIONS[*v as usize]).collect();
        assert_eq!(floats(accessor(&document, &binary, &primitive["attributes"]["POSITION"]).1), expected);
        assert_eq!(floats(accessor(&document, &binary, &primitive["attributes"]["TEXCOORD_0"]).1), corners[0].as_flattened());
        let (_, indices) = accessor(&document, &binary, &primitive["indices"]);
        assert_eq!(indices, [0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]);
        let texture = &document["materials"][primitive["material"].as_u64().unwrap() as usize]["pbrMetallicRoughness"]["baseColorTexture"]["index"];
        let source = &document["textures"][texture.as_u64().unwrap() as usize]["source"];
        let view = &document["bufferViews"][document["images"][source.as_u64().unwrap() as usize]["bufferView"].as_u64().unwrap() as usize];
        let (from, length) = (view["byteOffset"].as_u64().unwrap() as usize, view["byteLength"].as_u64().unwrap() as usize);
        let image = image::load_from_memory(&binary[from..from + length]).unwrap().into_rgb8();
        assert_eq!((image.width(), image.height()), size);
        assert_eq!(*image.as_raw(), texels[..(size.0 * size.1) as usize].concat());
    }
}

/// For each corner of each triangle: where it is, and the texel of the texture there.
const READ: &str = r#"
import sys, numpy as np, open3d as o3d
model = o3d.io.read_triangle_model(sys.argv[1])
mesh, material = model.meshes[0].mesh, model.materials[model.meshes[0].material_idx]
image = np.asarray(material.albedo_img)
vertices, triangles, places = np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.asarray(mesh.triangle_uvs)
for k, v in enumerate(triangles.reshape(-1)):
    # Open3D counts from the bottom.
    x, y = places[k][0] * image.shape[1], (1 - places[k][1]) * image.shape[0]
    print(*vertices[v], *image[int(y), int(x)][:3])
"#;

#[test]
fn open3d_sees_the_same_texels_at_the_corners() {
    let dir = tempfile::tempdir().unwrap();
    let Some(text) = run_python("open3d, numpy", READ, &[&written(dir.path())]) else { return };
    let mut read: Vec<Vec<f64>> = text.lines().map(|l| l.split_whitespace().map(|w| w.parse().unwrap()).collect()).collect();
    let texels = texels();
    let shown = [0, 1, 8, 11, 10, 3].map(|k| texels[k]);
    let mut expected: Vec<Vec<f64>> = TRIANGLES
        .iter()
        .flatten()
        .zip(shown)
        .map(|(v, texel)| {
            // glTF's y axis points up.
            let [x, y, z] = POSITIONS[*v as usize].map(f64::from);
            [x, z, -y].into_iter().chain(texel.map(f64::from)).collect()
        })
        .collect();
    read.iter_mut().flatten().for_each(|value| *value = (*value * 1e3).round() / 1e3 + 0.0);
    expected.iter_mut().flatten().for_each(|value| *value += 0.0);
    read.sort_by(|a, b| a.partial_cmp(b).unwrap());
    expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(read, expected);
}
