//! Textures of meshes from images of cameras.

use crate::failure::Failure;
use rayon::prelude::*;
use serde::Serialize;
use voxelastic_colour::{Places, Surface, TextureLayout};

/// Texels that are painted together: the images are looked at once for each so many, and memory is bounded.
const TOGETHER: usize = 1 << 22;

/// A texture of a mesh.
#[derive(Debug)]
pub struct MeshTexture {
    pub size: [usize; 2],
    /// sRGB, row by row.
    pub texels: Vec<[u8; 3]>,
    /// Where the corners of each triangle lie.
    pub corners: Vec<[[f32; 2]; 3]>,
    /// Of all texels of triangles, how many there are, and how many an image shows.
    painted: [usize; 2],
}

/// A texture, as `--json` has it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TextureSummary {
    width: usize,
    height: usize,
    /// Texels of triangles.
    texels: usize,
    /// Those that an image shows; others have the colours of vertices.
    texels_visible: usize,
}

/// Where triangles lie in a texture with texels about `texel` metres apart.
///
/// # Errors
/// If the texture would be too large.
pub fn layout(surface: &Surface<'_>, texel: f32) -> anyhow::Result<TextureLayout> {
    let too_large = |e| Failure::new(format!("{e}"), "use larger texels (--texture), or a coarser mesh (--lod 1)");
    Ok(TextureLayout::new(surface, texel).map_err(too_large)?)
}

impl MeshTexture {
    /// What `--json` says of it.
    pub fn summary(&self) -> TextureSummary {
        let ([width, height], [texels, texels_visible]) = (self.size, self.painted);
        TextureSummary { width, height, texels, texels_visible }
    }

    /// A texture of this `layout`, with texels about `texel` metres apart. `paint` colours some places of the surface; where it does not, the `colours` of the vertices are taken.
    pub fn paint(
        surface: Surface<'_>,
        colours: &[[u8; 3]],
        texel: f32,
        layout: &TextureLayout,
        mut paint: impl FnMut(Places<'_>) -> Vec<Option<[u8; 3]>>,
    ) -> Self {
        let [width, height] = layout.size();
        let count = surface.triangles.len();
        let mut texture = Self { size: [width, height], texels: vec![[128; 3]; width * height], corners: Vec::new(), painted: [0; 2] };
        texture.corners = (0..count).into_par_iter().map(|t| layout.corners(t)).collect();
        let mut first = 0;
        while first < count {
            let (mut last, mut texels) = (first, 0);
            while last < count && (texels == 0 || texels + layout.texels(last) <= TOGETHER) {
                texels += layout.texels(last);
                last += 1;
            }
            let of = |t: usize| layout.of(t).map(move |texel| (surface.triangles[t], texel));
            let all: Vec<_> = (first..last).into_par_iter().flat_map_iter(of).collect();
            let mix = |values: &[[f32; 3]], (corners, texel): &([u32; 3], voxelastic_colour::Texel)| -> [f32; 3] {
                std::array::from_fn(|axis| (0..3).map(|c| texel.shares[c] * values[corners[c] as usize][axis]).sum())
            };
            let positions: Vec<[f32; 3]> = all.par_iter().map(|at| mix(surface.positions, at)).collect();
            let normals: Vec<[f32; 3]> = all.par_iter().map(|at| unit(mix(surface.normals, at))).collect();
            let found = paint(Places { positions: &positions, normals: &normals, spacing: texel });
            for ((corners, texel), colour) in all.iter().zip(&found) {
                let of_vertices = || -> [u8; 3] {
                    let mean = |k: usize| (0..3).map(|c| texel.shares[c].max(0.0) * f32::from(colours[corners[c] as usize][k])).sum::<f32>();
                    let sum: f32 = texel.shares.iter().map(|share| share.max(0.0)).sum();
                    std::array::from_fn(|k| (mean(k) / sum).round() as u8)
                };
                texture.texels[texel.at] = colour.unwrap_or_else(of_vertices);
            }
            texture.painted[0] += found.len();
            texture.painted[1] += found.iter().flatten().count();
            first = last;
        }
        texture
    }
}

fn unit(n: [f32; 3]) -> [f32; 3] {
    let length = n.iter().map(|c| c * c).sum::<f32>().sqrt();
    if length > 1e-6 { n.map(|c| c / length) } else { [0.0, 0.0, 1.0] }
}
