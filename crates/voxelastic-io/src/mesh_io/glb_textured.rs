//! Meshes with a texture as GLB.

use super::MeshRef;
use super::glb::INDEX_BUFFER;
use super::glb::{FLOAT, GlbFile, TRIANGLES, UNSIGNED_INT, VERTEX_BUFFER, unit, up_rotation};
use crate::file::write_atomically;
use crate::{Error, Result};
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use serde_json::json;
use std::io::Write;
use std::path::Path;

/// An image and where triangles lie in it.
#[derive(Clone, Copy, Debug)]
pub struct Texture<'a> {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Red, green and blue (sRGB) of each texel, row by row from the top.
    pub texels: &'a [[u8; 3]],
    /// The corners of each triangle, 0 to 1 from the left and from the top.
    pub corners: &'a [[[f32; 2]; 3]],
}

/// Writes a mesh with a texture as GLB (glTF 2.0), atomically. Each triangle has vertices of its own, with `POSITION`, `NORMAL` if the mesh has normals, and `TEXCOORD_0`;
/// the texture is a PNG in the file, filtered linearly and without smaller copies, because neighbours in it are not neighbours on the mesh. The rest is as in
/// [`write_glb`](super::write_glb): z up is turned into y up, an origin is the translation of the node. Colours and intensities of vertices are left out.
///
/// # Errors
/// [`Error::Unwritable`] if the mesh has no triangles, lengths differ, a position is not finite, a triangle names a missing vertex or the file would pass the format's 4 GB;
/// [`Error::Io`] if the disk refuses.
pub fn write_textured_glb(path: impl AsRef<Path>, mesh: &MeshRef<'_>, texture: &Texture<'_>) -> Result<()> {
    let path = path.as_ref();
    mesh.check(path)?;
    let [width, height] = texture.size;
    if texture.corners.len() != mesh.triangles.len() || texture.texels.len() != width * height || mesh.triangles.is_empty() || width * height == 0 {
        let problem = format!(
            "{} triangles with {} in the texture, and {} texels for {width} x {height}",
            mesh.triangles.len(),
            texture.corners.len(),
            texture.texels.len()
        );
        return Err(Error::unwritable(path, problem));
    }
    let count = 3 * mesh.triangles.len();
    let too_large = |bytes: usize| Error::unwritable(path, format!("{bytes} bytes are more than the 4 GB that GLB allows: write a coarser mesh"));
    // Position, normal, place in the texture and number of each vertex.
    if count.saturating_mul(36) > u32::MAX as usize {
        return Err(too_large(count * 36));
    }
    let mut file = GlbFile::default();
    let corners = || mesh.triangles.iter().flatten().map(|v| *v as usize);
    let extreme =
        |pick: fn(f32, f32) -> f32| corners().map(|v| mesh.positions[v]).reduce(|m, p| std::array::from_fn(|k| pick(m[k], p[k]))).unwrap_or_default();
    let bytes = |vectors: &mut dyn Iterator<Item = [f32; 3]>| vectors.flatten().flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let position = json!({ "componentType": FLOAT, "type": "VEC3", "count": count, "min": extreme(f32::min), "max": extreme(f32::max) });
    let positions = file.add(bytes(&mut corners().map(|v| mesh.positions[v])), VERTEX_BUFFER, None, position);
    let mut attributes = json!({ "POSITION": positions });
    if !mesh.normals.is_empty() {
        let normal = json!({ "componentType": FLOAT, "type": "VEC3", "count": count });
        attributes["NORMAL"] = json!(file.add(bytes(&mut corners().map(|v| unit(mesh.normals[v]))), VERTEX_BUFFER, None, normal));
    }
    let places = texture.corners.iter().flatten().flatten().flat_map(|c| c.to_le_bytes()).collect();
    attributes["TEXCOORD_0"] = json!(file.add(places, VERTEX_BUFFER, None, json!({ "componentType": FLOAT, "type": "VEC2", "count": count })));
    let numbers = (0..count as u32).flat_map(u32::to_le_bytes).collect();
    let indices = file.add(numbers, INDEX_BUFFER, None, json!({ "componentType": UNSIGNED_INT, "type": "SCALAR", "count": count }));
    let image = file.add_blob(&png(path, texture)?);
    if file.length() > u32::MAX as usize - (1 << 16) {
        return Err(too_large(file.length()));
    }
    let mut node = json!({ "name": "map", "mesh": 0, "rotation": up_rotation() });
    if mesh.has_origin() {
        let [x, y, z] = mesh.origin;
        node["translation"] = json!([x, z, -y]);
    }
    let surface = json!({ "metallicFactor": 0.0, "roughnessFactor": 1.0, "baseColorTexture": { "index": 0 } });
    let document = json!({
        "asset": { "version": "2.0", "generator": "Voxelastic" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": 0 }] }],
        "materials": [{ "doubleSided": true, "pbrMetallicRoughness": surface }],
        "textures": [{ "sampler": 0, "source": 0 }],
        "samplers": [{ "magFilter": LINEAR, "minFilter": LINEAR, "wrapS": CLAMP, "wrapT": CLAMP }],
        "images": [{ "bufferView": image, "mimeType": "image/png" }],
        "buffers": [{ "byteLength": file.length() }],
        "bufferViews": file.views(),
        "accessors": file.accessors(),
    });
    let bytes = file.bytes(document);
    write_atomically(path, |w| w.write_all(&bytes))
}

/// How textures are filtered, and what is beyond their border: the numbers of OpenGL.
const LINEAR: u32 = 9729;
const CLAMP: u32 = 33071;

fn png(path: &Path, texture: &Texture<'_>) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    let [width, height] = texture.size.map(|side| side as u32);
    let written = encoder.write_image(texture.texels.as_flattened(), width, height, image::ExtendedColorType::Rgb8);
    written.map_err(|e| Error::unwritable(path, format!("the texture cannot be encoded: {e}")))?;
    Ok(bytes)
}
