//! Writing GLB, the binary form of glTF 2.0 (Khronos specification, section 4.4: a JSON chunk and a binary chunk).

use super::mesh_ref::MeshRef;
use crate::file::write_atomically;
use crate::{Error, Result};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

pub(super) const BYTE: u32 = 5120;
pub(super) const UNSIGNED_SHORT: u32 = 5123;
pub(super) const UNSIGNED_INT: u32 = 5125;
pub(super) const FLOAT: u32 = 5126;
pub(super) const VERTEX_BUFFER: u32 = 34962;
pub(super) const INDEX_BUFFER: u32 = 34963;
const POINTS: u32 = 0;
pub(super) const TRIANGLES: u32 = 4;

/// Writes a mesh as GLB (glTF 2.0), atomically: `POSITION`, then where present `NORMAL`, `COLOR_0`, `_INTENSITY`, and
/// indices. glTF's y axis points up, so the mesh hangs on a node that turns z up into y up. Colours are converted from sRGB to
/// the linear scale that glTF wants, in 16 bits. An origin is the translation of the node: positions themselves are single precision. Normals are normalised; a zero normal becomes z. Without triangles the
/// vertices are drawn as points; an empty mesh becomes an empty scene.
///
/// # Errors
/// [`Error::Unwritable`] if array lengths differ, a position is not finite, a triangle names a missing vertex or the file
/// would pass the format's 4 GB; [`Error::Io`] if the disk refuses.
pub fn write_glb(path: impl AsRef<Path>, mesh: &MeshRef<'_>) -> Result<()> {
    let path = path.as_ref();
    mesh.check(path)?;
    let mut json = Buffers::describe(mesh).to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let binary = Buffers::of(mesh).length;
    // Header, JSON chunk, binary chunk; the latter is left out when there is nothing in it.
    let total = 12 + 8 + json.len() + if binary > 0 { 8 + binary } else { 0 };
    let Ok(total) = u32::try_from(total) else {
        return Err(Error::unwritable(path, format!("{total} bytes are more than the 4 GB that GLB allows: write PLY, or a coarser mesh")));
    };
    write_atomically(path, |w| {
        w.write_all(b"glTF")?;
        w.write_all(&2u32.to_le_bytes())?;
        w.write_all(&total.to_le_bytes())?;
        w.write_all(&(json.len() as u32).to_le_bytes())?;
        w.write_all(b"JSON")?;
        w.write_all(&json)?;
        if binary > 0 {
            w.write_all(&(binary as u32).to_le_bytes())?;
            w.write_all(b"BIN\0")?;
            write_arrays(w, mesh)?;
        }
        Ok(())
    })
}

/// A GLB file that is made in memory.
#[derive(Debug, Default)]
pub(super) struct GlbFile {
    views: Vec<Value>,
    accessors: Vec<Value>,
    binary: Vec<u8>,
}

impl GlbFile {
    /// Adds an array, whose elements are `stride` bytes apart if they are not packed, and returns the number of its accessor.
    pub(super) fn add(&mut self, bytes: Vec<u8>, target: u32, stride: Option<usize>, mut accessor: Value) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len(), "target": target });
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(view);
        self.accessors.push(accessor);
        self.binary.extend(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.accessors.len() - 1
    }

    pub(super) fn views(&self) -> &[Value] {
        &self.views
    }

    pub(super) fn accessors(&self) -> &[Value] {
        &self.accessors
    }

    /// Bytes of the arrays.
    pub(super) fn length(&self) -> usize {
        self.binary.len()
    }

    /// The file with a JSON chunk that describes it. Less than 4 GB.
    pub(super) fn bytes(self, json: Value) -> Vec<u8> {
        let mut json = json.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + json.len() + 8 + self.binary.len();
        let mut bytes = Vec::with_capacity(total);
        bytes.extend(b"glTF");
        [2, total as u32, json.len() as u32].iter().for_each(|n| bytes.extend(n.to_le_bytes()));
        bytes.extend(b"JSON");
        bytes.extend(json);
        bytes.extend((self.binary.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(self.binary);
        bytes
    }
}

/// The rotation that turns z up into y up, as a quaternion x, y, z, w.
pub(super) fn up_rotation() -> [f64; 4] {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    [-half, 0.0, 0.0, half]
}

/// The arrays of the binary chunk, in the order of [`write_arrays`]. Every element is a multiple of 4 bytes, so that all
/// of them are aligned.
#[derive(Default)]
struct Buffers {
    views: Vec<Value>,
    accessors: Vec<Value>,
    length: usize,
}

impl Buffers {
    /// Adds an array and returns the number of its accessor.
    fn add(&mut self, size: usize, target: u32, mut accessor: Value) -> usize {
        let count = accessor["count"].as_u64().unwrap_or(0) as usize;
        let bytes = count * size;
        self.views.push(json!({"buffer": 0, "byteOffset": self.length, "byteLength": bytes, "target": target}));
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.length += bytes;
        self.accessors.len() - 1
    }

    fn of(mesh: &MeshRef<'_>) -> Self {
        let mut buffers = Self::default();
        if !mesh.positions.is_empty() {
            buffers.primitive(mesh);
        }
        buffers
    }

    /// Adds all arrays and returns the primitive that names them.
    fn primitive(&mut self, mesh: &MeshRef<'_>) -> Value {
        let count = mesh.positions.len();
        let extreme =
            |pick: fn(f32, f32) -> f32| mesh.positions[1..].iter().fold(mesh.positions[0], |m, p| std::array::from_fn(|k| pick(m[k], p[k])));
        let position = json!({"componentType": FLOAT, "type": "VEC3", "count": count, "min": extreme(f32::min), "max": extreme(f32::max)});
        let mut attributes = json!({"POSITION": self.add(12, VERTEX_BUFFER, position)});
        if !mesh.normals.is_empty() {
            attributes["NORMAL"] = json!(self.add(12, VERTEX_BUFFER, json!({"componentType": FLOAT, "type": "VEC3", "count": count})));
        }
        if mesh.colours.is_some() {
            let colour = json!({"componentType": UNSIGNED_SHORT, "normalized": true, "type": "VEC4", "count": count});
            attributes["COLOR_0"] = json!(self.add(8, VERTEX_BUFFER, colour));
        }
        if mesh.intensity.is_some() {
            attributes["_INTENSITY"] = json!(self.add(4, VERTEX_BUFFER, json!({"componentType": FLOAT, "type": "SCALAR", "count": count})));
        }
        let mut primitive = json!({"attributes": attributes, "mode": POINTS, "material": 0});
        if !mesh.triangles.is_empty() {
            let indices = json!({"componentType": UNSIGNED_INT, "type": "SCALAR", "count": mesh.triangles.len() * 3});
            primitive["indices"] = json!(self.add(4, INDEX_BUFFER, indices));
            primitive["mode"] = json!(TRIANGLES);
        }
        primitive
    }

    fn describe(mesh: &MeshRef<'_>) -> Value {
        let asset = json!({"version": "2.0", "generator": "Voxelastic"});
        if mesh.positions.is_empty() {
            return json!({"asset": asset, "scene": 0, "scenes": [{}]});
        }
        let mut buffers = Self::default();
        let primitive = buffers.primitive(mesh);
        let mut node = json!({"name": "map", "mesh": 0, "rotation": up_rotation()});
        if mesh.has_origin() {
            let [x, y, z] = mesh.origin;
            node["translation"] = json!([x, z, -y]);
        }
        json!({
            "asset": asset,
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [node],
            "meshes": [{"primitives": [primitive]}],
            "materials": [{"doubleSided": true, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}],
            "buffers": [{"byteLength": buffers.length}],
            "bufferViews": buffers.views,
            "accessors": buffers.accessors,
        })
    }
}

fn write_arrays(w: &mut impl Write, mesh: &MeshRef<'_>) -> std::io::Result<()> {
    let vector = |w: &mut dyn Write, v: [f32; 3]| v.iter().try_for_each(|c| w.write_all(&c.to_le_bytes()));
    mesh.positions.iter().try_for_each(|p| vector(w, *p))?;
    mesh.normals.iter().try_for_each(|n| vector(w, unit(*n)))?;
    if let Some(colours) = mesh.colours {
        let linear: Vec<u16> = (0..=255).map(linear_from_srgb).collect();
        for colour in colours {
            let [r, g, b] = colour.map(|c| linear[usize::from(c)]);
            [r, g, b, u16::MAX].iter().try_for_each(|c| w.write_all(&c.to_le_bytes()))?;
        }
    }
    if let Some(intensity) = mesh.intensity {
        // JSON has no NaN, but this is binary: what was measured is kept.
        intensity.iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))?;
    }
    mesh.triangles.iter().flatten().try_for_each(|v| w.write_all(&v.to_le_bytes()))
}

pub(super) fn unit(n: [f32; 3]) -> [f32; 3] {
    let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
    if length.is_finite() && length > 1e-6 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}

/// The linear intensity of an 8-bit sRGB value (IEC 61966-2-1), scaled to 16 bits.
pub(super) fn linear_from_srgb(value: u8) -> u16 {
    let v = f32::from(value) / 255.0;
    let linear = if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) };
    (linear * 65535.0).round() as u16
}
