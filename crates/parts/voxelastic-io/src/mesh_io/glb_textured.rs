//! Meshes with a texture as GLB.

use super::glb::INDEX_BUFFER;
use super::glb::{FLOAT, TRIANGLES, UNSIGNED_INT, VERTEX_BUFFER, unit, up_rotation};
use super::mesh_ref::MeshRef;
use crate::file::write_atomically;
use crate::{Error, Result};
use image::ImageEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;

/// An image and where some triangles lie in it.
#[derive(Clone, Copy, Debug)]
pub struct Texture<'a> {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Red, green and blue (sRGB) of each texel, row by row from the top.
    pub texels: &'a [[u8; 3]],
    /// The triangles in it, by their numbers in the mesh.
    pub triangles: &'a [u32],
    /// The corners of each of these, 0 to 1 from the left and from the top.
    pub corners: &'a [[[f32; 2]; 3]],
}

/// An image of a texture as it goes into a file: a fraction of the size of its texels.
#[derive(Clone, Debug)]
pub struct EncodedTexture {
    png: Vec<u8>,
    triangles: Vec<u32>,
    corners: Vec<[[f32; 2]; 3]>,
}

impl Texture<'_> {
    /// Encodes the image as PNG.
    ///
    /// # Errors
    /// What is wrong, if it has no triangles or lengths differ.
    pub fn encode(&self) -> std::result::Result<EncodedTexture, String> {
        let [width, height] = self.size;
        if self.corners.len() != self.triangles.len() || self.texels.len() != width * height || self.triangles.is_empty() || width * height == 0 {
            let (triangles, corners, texels) = (self.triangles.len(), self.corners.len(), self.texels.len());
            return Err(format!("{triangles} triangles with {corners} in the texture, and {texels} texels for {width} x {height}"));
        }
        let mut png = Vec::new();
        let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive);
        let written = encoder.write_image(self.texels.as_flattened(), width as u32, height as u32, image::ExtendedColorType::Rgb8);
        written.map_err(|e| format!("the texture cannot be encoded: {e}"))?;
        Ok(EncodedTexture { png, triangles: self.triangles.to_vec(), corners: self.corners.to_vec() })
    }
}

/// Writes a mesh with a texture as GLB (glTF 2.0), atomically. Each triangle has vertices of its own, with `POSITION`, `NORMAL` if the mesh has normals, and `TEXCOORD_0`;
/// each image of the texture is a PNG in the file, with a primitive of the triangles that lie in it, filtered linearly and without smaller copies, because neighbours in it are not neighbours on the mesh. The rest is as in
/// [`write_glb`](super::write_glb): z up is turned into y up, an origin is the translation of the node. Colours and intensities of vertices are left out.
///
/// # Errors
/// [`Error::Unwritable`] if there are no images, some triangle of the mesh is in none or in several of them, a position is not finite, a triangle names a missing vertex or the file would pass the format's 4 GB;
/// [`Error::Io`] if the disk refuses.
pub fn write_textured_glb(path: impl AsRef<Path>, mesh: &MeshRef<'_>, images: &[EncodedTexture]) -> Result<()> {
    let path = path.as_ref();
    mesh.check(path)?;
    let mut in_image = vec![false; mesh.triangles.len()];
    for &triangle in images.iter().flat_map(|image| &image.triangles) {
        if in_image.get_mut(triangle as usize).is_none_or(|is| std::mem::replace(is, true)) {
            return Err(Error::unwritable(path, format!("triangle {triangle} is missing, or in two places of the texture")));
        }
    }
    if images.is_empty() || in_image.contains(&false) {
        let count = in_image.iter().filter(|is| **is).count();
        return Err(Error::unwritable(path, format!("{count} of {} triangles are in the texture", mesh.triangles.len())));
    }
    let mut layout = FileLayout::default();
    let primitives: Vec<Value> = images.iter().enumerate().map(|(number, image)| layout.primitive(mesh, image, number)).collect();
    let views: Vec<usize> = images.iter().map(|image| layout.view(image.png.len(), None)).collect();
    let mut node = json!({ "name": "map", "mesh": 0, "rotation": up_rotation() });
    if mesh.has_origin() {
        let [x, y, z] = mesh.origin;
        node["translation"] = json!([x, z, -y]);
    }
    let surface = |number: usize| json!({ "metallicFactor": 0.0, "roughnessFactor": 1.0, "baseColorTexture": { "index": number } });
    let document = json!({
        "asset": { "version": "2.0", "generator": "Voxelastic" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": primitives }],
        "materials": (0..images.len()).map(|number| json!({ "doubleSided": true, "pbrMetallicRoughness": surface(number) })).collect::<Vec<_>>(),
        "textures": (0..images.len()).map(|number| json!({ "sampler": 0, "source": number })).collect::<Vec<_>>(),
        "samplers": [{ "magFilter": LINEAR, "minFilter": LINEAR, "wrapS": CLAMP, "wrapT": CLAMP }],
        "images": views.into_iter().map(|view| json!({ "bufferView": view, "mimeType": "image/png" })).collect::<Vec<_>>(),
        "buffers": [{ "byteLength": layout.length }],
        "bufferViews": layout.views,
        "accessors": layout.accessors,
    });
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = 12 + 8 + text.len() + 8 + layout.length;
    let Ok(total) = u32::try_from(total) else {
        return Err(Error::unwritable(path, format!("{total} bytes are more than the 4 GB that GLB allows: write a coarser mesh")));
    };
    write_atomically(path, |w| {
        w.write_all(b"glTF")?;
        [2, total, text.len() as u32].iter().try_for_each(|n| w.write_all(&n.to_le_bytes()))?;
        w.write_all(b"JSON")?;
        w.write_all(&text)?;
        w.write_all(&(layout.length as u32).to_le_bytes())?;
        w.write_all(b"BIN\0")?;
        images.iter().try_for_each(|image| write_primitive(w, mesh, image))?;
        for image in images {
            w.write_all(&image.png)?;
            w.write_all(&[0; 3][..padding(image.png.len())])?;
        }
        Ok(())
    })
}

/// How textures are filtered, and what is beyond their border: the numbers of OpenGL.
const LINEAR: u32 = 9729;
const CLAMP: u32 = 33071;

/// Bytes to the next multiple of four.
fn padding(length: usize) -> usize {
    length.next_multiple_of(4) - length
}

/// Where the parts of a file lie that is written afterwards.
#[derive(Default)]
struct FileLayout {
    views: Vec<Value>,
    accessors: Vec<Value>,
    length: usize,
}

impl FileLayout {
    /// The number of the view of the next bytes.
    fn view(&mut self, bytes: usize, target: Option<u32>) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.length, "byteLength": bytes });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.views.push(view);
        self.length += bytes + padding(bytes);
        self.views.len() - 1
    }

    /// The number of the accessor of the next array.
    fn array(&mut self, element: usize, target: u32, mut accessor: Value) -> usize {
        let count = accessor["count"].as_u64().unwrap_or(0) as usize;
        accessor["bufferView"] = json!(self.view(count * element, Some(target)));
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The triangles in an image, in the order of [`write_primitive`].
    fn primitive(&mut self, mesh: &MeshRef<'_>, image: &EncodedTexture, number: usize) -> Value {
        let count = 3 * image.triangles.len();
        let extreme = |pick: fn(f32, f32) -> f32| {
            corners(mesh, image).map(|v| mesh.positions[v]).reduce(|m, p| std::array::from_fn(|k| pick(m[k], p[k]))).unwrap_or_default()
        };
        let position = json!({ "componentType": FLOAT, "type": "VEC3", "count": count, "min": extreme(f32::min), "max": extreme(f32::max) });
        let mut attributes = json!({ "POSITION": self.array(12, VERTEX_BUFFER, position) });
        if !mesh.normals.is_empty() {
            let normal = json!({ "componentType": FLOAT, "type": "VEC3", "count": count });
            attributes["NORMAL"] = json!(self.array(12, VERTEX_BUFFER, normal));
        }
        attributes["TEXCOORD_0"] = json!(self.array(8, VERTEX_BUFFER, json!({ "componentType": FLOAT, "type": "VEC2", "count": count })));
        let indices = self.array(4, INDEX_BUFFER, json!({ "componentType": UNSIGNED_INT, "type": "SCALAR", "count": count }));
        json!({ "attributes": attributes, "indices": indices, "mode": TRIANGLES, "material": number })
    }
}

/// The vertices of the corners of the triangles in an image.
fn corners<'a>(mesh: &'a MeshRef<'_>, image: &'a EncodedTexture) -> impl Iterator<Item = usize> + 'a {
    image.triangles.iter().flat_map(|t| mesh.triangles[*t as usize]).map(|v| v as usize)
}

fn write_primitive(w: &mut impl Write, mesh: &MeshRef<'_>, image: &EncodedTexture) -> std::io::Result<()> {
    let vector = |w: &mut dyn Write, v: [f32; 3]| v.iter().try_for_each(|c| w.write_all(&c.to_le_bytes()));
    corners(mesh, image).try_for_each(|v| vector(w, mesh.positions[v]))?;
    if !mesh.normals.is_empty() {
        corners(mesh, image).try_for_each(|v| vector(w, unit(mesh.normals[v])))?;
    }
    image.corners.iter().flatten().flatten().try_for_each(|c| w.write_all(&c.to_le_bytes()))?;
    (0..3 * image.triangles.len() as u32).try_for_each(|n| w.write_all(&n.to_le_bytes()))
}
