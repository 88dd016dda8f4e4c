//! Textures of meshes from images of cameras.

use crate::error::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use voxelastic_colour::{Places, Surface, Texel, TextureLayout, texture_pages};
use voxelastic_io::mesh_io::{EncodedTexture, Texture};

/// Texels of an image of a texture: the images of cameras are looked at once for each, and what is known of its texels is held in memory meanwhile.
const TOGETHER: usize = 1 << 22;

/// A texture of a mesh.
#[derive(Debug, Default)]
pub struct MeshTexture {
    /// The images, encoded.
    pub images: Vec<EncodedTexture>,
    summary: TextureSummary,
}

/// A texture, as `--json` has it.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct TextureSummary {
    /// Images that it has.
    images: usize,
    /// Size of the largest one.
    width: usize,
    height: usize,
    /// Texels of triangles.
    texels: usize,
    /// Those that an image of a camera shows; others have the colours of vertices.
    texels_visible: usize,
}

/// The colours of some places on a mesh by the images of cameras; none for those that no image shows.
pub trait PaintPlaces: FnMut(Places<'_>) -> Vec<Option<[u8; 3]>> {}
impl<F: FnMut(Places<'_>) -> Vec<Option<[u8; 3]>>> PaintPlaces for F {}

impl MeshTexture {
    /// What `--json` says of it.
    pub fn summary(&self) -> TextureSummary {
        self.summary
    }

    /// A texture with texels about `texel` metres apart, one image after the other. Where `paint` has no colour, the `colours` of the vertices are taken.
    ///
    /// # Errors
    /// If an image cannot be encoded.
    pub fn paint(surface: Surface<'_>, colours: &[[u8; 3]], texel: f32, mut paint: impl PaintPlaces) -> Result<Self> {
        let mut texture = Self::default();
        for page in texture_pages(&surface, texel, TOGETHER) {
            if !page.is_empty() {
                texture.add(surface, colours, texel, &page, &mut paint)?;
            }
        }
        Ok(texture)
    }

    /// Adds the image of some triangles.
    fn add(&mut self, surface: Surface<'_>, colours: &[[u8; 3]], texel: f32, page: &[u32], paint: &mut impl PaintPlaces) -> Result<()> {
        let triangles: Vec<[u32; 3]> = page.iter().map(|t| surface.triangles[*t as usize]).collect();
        let too_large = |e| Error::new(format!("{e}"), "use larger texels (--texture), or a coarser mesh (--lod 1)");
        let layout = TextureLayout::new(&Surface { triangles: &triangles, ..surface }, texel).map_err(too_large)?;
        let [width, height] = layout.size();
        let of = |t: usize| layout.of(t).map(move |texel| (t as u32, texel));
        let all: Vec<(u32, Texel)> = (0..triangles.len()).into_par_iter().flat_map_iter(of).collect();
        let mix = |values: &[[f32; 3]], (t, texel): &(u32, Texel)| -> [f32; 3] {
            let corners = triangles[*t as usize];
            std::array::from_fn(|axis| (0..3).map(|c| texel.shares[c] * values[corners[c] as usize][axis]).sum())
        };
        let positions: Vec<[f32; 3]> = all.par_iter().map(|at| mix(surface.positions, at)).collect();
        let normals: Vec<[f32; 3]> = all.par_iter().map(|at| unit(mix(surface.normals, at))).collect();
        let found = paint(Places { positions: &positions, normals: &normals, spacing: texel });
        drop((positions, normals));
        let mut texels = vec![[128; 3]; width * height];
        for ((t, texel), colour) in all.iter().zip(&found) {
            let of_vertices = || -> [u8; 3] {
                let corners = triangles[*t as usize];
                let mean = |k: usize| (0..3).map(|c| texel.shares[c].max(0.0) * f32::from(colours[corners[c] as usize][k])).sum::<f32>();
                let sum: f32 = texel.shares.iter().map(|share| share.max(0.0)).sum();
                std::array::from_fn(|k| (mean(k) / sum).round() as u8)
            };
            texels[texel.at] = colour.unwrap_or_else(of_vertices);
        }
        let corners: Vec<[[f32; 2]; 3]> = (0..triangles.len()).into_par_iter().map(|t| layout.corners(t)).collect();
        let image = Texture { size: [width, height], texels: &texels, triangles: page, corners: &corners }.encode();
        self.images.push(image.map_err(|problem| Error::new(problem, ""))?);
        let summary = &mut self.summary;
        summary.images += 1;
        (summary.texels, summary.texels_visible) = (summary.texels + found.len(), summary.texels_visible + found.iter().flatten().count());
        if width * height > summary.width * summary.height {
            (summary.width, summary.height) = (width, height);
        }
        Ok(())
    }
}

fn unit(n: [f32; 3]) -> [f32; 3] {
    let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
    if length > 1e-6 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}
