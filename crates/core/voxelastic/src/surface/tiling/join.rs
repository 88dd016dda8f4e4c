//! Tiles of a surface become one mesh: vertices at the borders are shared, and pieces without evidence are left out.

use super::piece_sets::PieceSets;
use super::tile_surface::{TileIndex, TileSurface, VertexKey, tile_surfaces};
use crate::field::tsdf::TsdfField;
use crate::surface::evidence::SmallComponents;
use crate::surface::extract::MeshOptions;
use crate::surface::mesh::Mesh;
use crate::surface::simplify::coarsen;
use hashbrown::HashMap;

/// Of vertices that are left out.
const NONE: u32 = u32::MAX;

/// The surface of `field` as one mesh, with finest voxels of `voxel` metres, made in tiles with edges of 2^`shift` blocks; and what was left out for lack of evidence,
/// unless `options` keep it. The mesh does not depend on the size of tiles.
pub(crate) fn extract_joined(field: &TsdfField, voxel: f32, options: &MeshOptions, shift: u32) -> (Mesh, SmallComponents) {
    let mut index = TileIndex::new(shift);
    index.extend(field);
    let (tiles, mut joined) = (index.tiles(), JoinedTiles::default());
    for batch in index.batches(&tiles) {
        tile_surfaces(field, voxel, options, &index, batch).iter().for_each(|tile| joined.add(tile));
    }
    joined.finish(options, voxel)
}

/// Tiles that are joined one after the other, so that they need not be kept.
#[derive(Debug, Default)]
struct JoinedTiles {
    /// The vertices of all tiles, and their triangles.
    mesh: Mesh,
    /// By vertex.
    piece_of: Vec<u32>,
    pieces: PieceSets,
    /// The vertices that other tiles may use.
    border: HashMap<VertexKey, u32>,
    /// Corners of triangles at vertices of tiles that were not added before: the triangle, and which corner.
    corners: Vec<(u32, u8, VertexKey)>,
    /// Pieces that such vertices belong to.
    links: Vec<(u32, VertexKey)>,
}

impl JoinedTiles {
    /// Adds a tile. The order of tiles is that of their vertices and triangles in the mesh.
    pub fn add(&mut self, tile: &TileSurface) {
        let (own, first, first_piece) = (tile.own(), self.mesh.positions.len(), self.pieces.add(&tile.pieces));
        self.mesh.positions.extend_from_slice(&tile.mesh.positions[..own]);
        self.mesh.normals.extend_from_slice(&tile.mesh.normals[..own]);
        self.mesh.scales.extend_from_slice(&tile.mesh.scales[..own]);
        let (intensities, colours) = (tile.mesh.intensities.get(..own).unwrap_or(&[]), tile.mesh.colours.get(..own).unwrap_or(&[]));
        self.mesh.append_attributes(first, intensities, colours);
        self.piece_of.extend(tile.piece_of[..own].iter().map(|piece| first_piece + piece));
        self.border.extend(tile.border.iter().map(|&(key, v)| (key, first as u32 + v)));
        let foreign: Vec<Option<u32>> = tile.foreign.iter().map(|key| self.border.get(key).copied()).collect();
        for (i, (key, there)) in tile.foreign.iter().zip(&foreign).enumerate() {
            let piece = first_piece + tile.piece_of[own + i];
            match there {
                Some(vertex) => self.pieces.connect(piece, self.piece_of[*vertex as usize]),
                None => self.links.push((piece, *key)),
            }
        }
        for t in &tile.mesh.triangles {
            let mut triangle = [NONE; 3];
            for (corner, &v) in t.iter().enumerate() {
                triangle[corner] = match (v as usize).checked_sub(own) {
                    None => first as u32 + v,
                    Some(i) => foreign[i].unwrap_or_else(|| {
                        self.corners.push((self.mesh.triangles.len() as u32, corner as u8, tile.foreign[i]));
                        NONE
                    }),
                };
            }
            self.mesh.triangles.push(triangle);
        }
    }

    /// The mesh of all tiles, at the level of detail of `options`, with finest voxels of `voxel` metres; and what was left out of it.
    pub fn finish(mut self, options: &MeshOptions, voxel: f32) -> (Mesh, SmallComponents) {
        for (triangle, corner, key) in self.corners {
            self.mesh.triangles[triangle as usize][usize::from(corner)] = self.border.get(&key).copied().unwrap_or(NONE);
        }
        for (piece, key) in self.links {
            if let Some(&vertex) = self.border.get(&key) {
                self.pieces.connect(piece, self.piece_of[vertex as usize]);
            }
        }
        drop(self.border);
        let (stays, small_components) = self.pieces.judge(options.keep_all);
        if small_components.pieces > 0 {
            leave_out(&mut self.mesh, self.piece_of, &stays);
        }
        coarsen(&mut self.mesh, [0; 2], voxel, options.lod);
        self.mesh.shrink_to_fit();
        (self.mesh, small_components)
    }
}

/// Leaves the vertices and triangles of pieces out that do not stay.
fn leave_out(mesh: &mut Mesh, piece_of: Vec<u32>, stays: &[bool]) {
    let mut next = 0;
    let mut number_of = piece_of;
    for v in 0..number_of.len() {
        if !stays[number_of[v] as usize] {
            number_of[v] = NONE;
            continue;
        }
        number_of[v] = next as u32;
        mesh.positions[next] = mesh.positions[v];
        mesh.normals[next] = mesh.normals[v];
        mesh.scales[next] = mesh.scales[v];
        if let Some(&intensity) = mesh.intensities.get(v) {
            mesh.intensities[next] = intensity;
        }
        if let Some(&colour) = mesh.colours.get(v) {
            mesh.colours[next] = colour;
        }
        next += 1;
    }
    mesh.positions.truncate(next);
    mesh.normals.truncate(next);
    mesh.scales.truncate(next);
    mesh.intensities.truncate(next);
    mesh.colours.truncate(next);
    // All vertices of a triangle are of one piece.
    mesh.triangles.retain_mut(|triangle| {
        let number = triangle.map(|v| number_of[v as usize]);
        *triangle = number;
        number[0] != NONE
    });
}
