//! Meshes of tiles as GLB: small, with coordinates on a lattice (glTF extension KHR_mesh_quantization).

use super::glb::{BYTE, FLOAT, GlbFile, TRIANGLES, UNSIGNED_INT, UNSIGNED_SHORT, VERTEX_BUFFER, linear_from_srgb, unit};
use super::glb::{INDEX_BUFFER, up_rotation};
use super::mesh_ref::MeshRef;
use serde_json::{Value, json};

/// The lattice of a tile's vertices: a vertex lies at `origin` plus whole multiples of `step`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Least coordinates, metres: themselves multiples of the step, so that neighbouring tiles agree on the border.
    pub origin: [f64; 3],
    /// Distance between neighbouring places, metres.
    pub step: f64,
}

/// The bytes of a GLB file of a mesh whose vertices are rounded to a lattice: coordinates in 16 bits where they fit, else as whole numbers in 32-bit floats;
/// normals in 8 bits, colours (linear) in 16, indices in 16 where they fit. The mesh hangs on a node that turns z up into glTF's y up. Intensities are
/// left out.
///
/// The mesh must be one that [`write_glb`](super::write_glb) takes, and not empty.
pub fn tile_glb(mesh: &MeshRef<'_>, lattice: &Lattice) -> Vec<u8> {
    let places: Vec<[u32; 3]> = mesh.positions.iter().map(|p| lattice.place(*p)).collect();
    let mut file = GlbFile::default();
    let mut attributes = json!({ "POSITION": add_places(&mut file, &places) });
    if !mesh.normals.is_empty() {
        let normals = mesh.normals.iter().flat_map(|n| {
            let [x, y, z] = unit(*n).map(|c| (c * 127.0).round() as i8 as u8);
            [x, y, z, 0]
        });
        let accessor = json!({ "componentType": BYTE, "normalized": true, "type": "VEC3", "count": mesh.normals.len() });
        attributes["NORMAL"] = json!(file.add(normals.collect(), VERTEX_BUFFER, Some(4), accessor));
    }
    if let Some(colours) = mesh.colours {
        let linear: Vec<u16> = (0..=255).map(linear_from_srgb).collect();
        let colours = colours.iter().flat_map(|c| {
            let [r, g, b] = c.map(|v| linear[usize::from(v)]);
            [r, g, b, u16::MAX].map(u16::to_le_bytes)
        });
        let accessor = json!({ "componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4", "count": mesh.positions.len() });
        attributes["COLOR_0"] = json!(file.add(colours.flatten().collect(), VERTEX_BUFFER, Some(8), accessor));
    }
    let indices = add_indices(&mut file, mesh);
    let json = document(&file, &attributes, indices, lattice);
    file.bytes(json)
}

impl Lattice {
    /// The place of a point, in steps from the origin.
    fn place(&self, p: [f32; 3]) -> [u32; 3] {
        // Negative numbers become zero.
        std::array::from_fn(|k| ((f64::from(p[k]) - self.origin[k]) / self.step).round() as u32)
    }
}

fn add_places(file: &mut GlbFile, places: &[[u32; 3]]) -> usize {
    let extreme = |pick: fn(u32, u32) -> u32| places.iter().fold(places[0], |m, p| std::array::from_fn(|k| pick(m[k], p[k])));
    let (low, high) = (extreme(u32::min), extreme(u32::max));
    let is_short = high.iter().all(|c| *c <= u32::from(u16::MAX));
    let (kind, stride) = if is_short { (UNSIGNED_SHORT, 8) } else { (FLOAT, 12) };
    let bytes = if is_short {
        places.iter().flat_map(|[x, y, z]| [*x as u16, *y as u16, *z as u16, 0].map(u16::to_le_bytes)).flatten().collect()
    } else {
        places.iter().flatten().flat_map(|c| (*c as f32).to_le_bytes()).collect()
    };
    file.add(bytes, VERTEX_BUFFER, Some(stride), json!({ "componentType": kind, "type": "VEC3", "count": places.len(), "min": low, "max": high }))
}

fn add_indices(file: &mut GlbFile, mesh: &MeshRef<'_>) -> usize {
    let is_short = mesh.positions.len() <= usize::from(u16::MAX);
    let indices = mesh.triangles.iter().flatten();
    let (kind, bytes) = match is_short {
        true => (UNSIGNED_SHORT, indices.flat_map(|i| (*i as u16).to_le_bytes()).collect()),
        false => (UNSIGNED_INT, indices.flat_map(|i| i.to_le_bytes()).collect()),
    };
    file.add(bytes, INDEX_BUFFER, None, json!({ "componentType": kind, "type": "SCALAR", "count": 3 * mesh.triangles.len() }))
}

fn document(file: &GlbFile, attributes: &Value, indices: usize, lattice: &Lattice) -> Value {
    // From z up to y up, as the rotation does.
    let [x, y, z] = lattice.origin;
    let scale = [lattice.step; 3];
    json!({
        "asset": { "version": "2.0", "generator": "Voxelastic" },
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "rotation": up_rotation(), "translation": [x, z, -y], "scale": scale }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": 0 }] }],
        "materials": [{ "doubleSided": true, "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 } }],
        "buffers": [{ "byteLength": file.length() }],
        "bufferViews": file.views(),
        "accessors": file.accessors(),
    })
}
