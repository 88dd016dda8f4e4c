//! Tiles of a surface become one mesh: vertices at the borders are shared, and pieces without evidence are left out.

use super::evidence::{Crumbs, Evidence};
use super::extract::MeshOptions;
use super::mesh::Mesh;
use super::simplify::coarsen;
use super::tile_surface::{TileIndex, TileSurface, VertexKey, tile_surfaces};
use crate::field::tsdf::TsdfField;
use hashbrown::HashMap;
use std::borrow::Borrow;

/// The surface of `field` as one mesh, with finest voxels of `voxel` metres, made in tiles with edges of 2^`shift` blocks; and what was left out for lack of evidence,
/// unless `options` keep it. The mesh does not depend on the size of tiles.
pub(crate) fn extract_joined(field: &TsdfField, voxel: f32, options: &MeshOptions, shift: u32) -> (Mesh, Crumbs) {
    let mut index = TileIndex::new(shift);
    index.extend(field);
    let (tiles, mut surfaces) = (index.tiles(), Vec::new());
    for batch in index.batches(&tiles) {
        surfaces.extend(tile_surfaces(field, voxel, options, &index, batch));
    }
    let seams = Seams::new(&surfaces.iter().map(TileSeam::from).collect::<Vec<_>>(), options.keep_all);
    (seams.join(surfaces.into_iter(), voxel, options.lod), seams.crumbs)
}

/// What of a tile tells how it fits to others: a small part of it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TileSeam {
    /// Vertices of other tiles that it uses, and their pieces.
    foreign: Vec<(VertexKey, u32)>,
    /// Own vertices that others may use, by name and number, and their pieces.
    border: Vec<(VertexKey, u32, u32)>,
    pieces: Vec<Evidence>,
    /// Number of own vertices and of triangles.
    sizes: [usize; 2],
}

impl From<&TileSurface> for TileSeam {
    fn from(tile: &TileSurface) -> Self {
        let foreign = tile.foreign.iter().copied().zip(tile.piece_of[tile.own()..].iter().copied()).collect();
        let border = tile.border.iter().map(|&(key, v)| (key, v, tile.piece_of[v as usize])).collect();
        Self { foreign, border, pieces: tile.pieces.clone(), sizes: [tile.own(), tile.mesh.triangles.len()] }
    }
}

/// How tiles fit together.
pub(crate) struct Seams {
    /// By name, tile and number of the vertices at borders, and their pieces among all.
    border: HashMap<VertexKey, (u32, u32, u32)>,
    /// By tile, whether each of its pieces stays.
    stays: Vec<Vec<bool>>,
    /// The pieces that do not.
    pub crumbs: Crumbs,
    /// Number of vertices and triangles of all tiles.
    sizes: [usize; 2],
}

impl Seams {
    /// Finds out how `tiles` fit together, which must be all tiles of a surface; with `keep_all` all pieces stay.
    pub fn new<T: Borrow<TileSeam>>(tiles: &[T], keep_all: bool) -> Self {
        let tiles: Vec<&TileSeam> = tiles.iter().map(T::borrow).collect();
        let mut border = HashMap::with_capacity(tiles.iter().map(|tile| tile.border.len()).sum());
        let (mut first, mut starts) = (0, Vec::with_capacity(tiles.len()));
        for (number, tile) in tiles.iter().enumerate() {
            border.extend(tile.border.iter().map(|&(key, v, piece)| (key, (number as u32, v, first + piece))));
            starts.push(first);
            first += tile.pieces.len() as u32;
        }
        let mut roots: Vec<u32> = (0..first).collect();
        for (tile, start) in tiles.iter().zip(&starts) {
            for (key, piece) in &tile.foreign {
                if let Some(&(_, _, there)) = border.get(key) {
                    let (a, b) = (root(&mut roots, start + piece), root(&mut roots, there));
                    roots[a.max(b) as usize] = a.min(b);
                }
            }
        }
        let mut evidence = vec![Evidence::default(); first as usize];
        let pieces = tiles.iter().flat_map(|tile| &tile.pieces).zip(0..);
        pieces.for_each(|(piece, i)| evidence[root(&mut roots, i) as usize].add(piece));
        let mut crumbs = Crumbs::default();
        for (i, piece) in evidence.iter().enumerate() {
            if !keep_all && roots[i] == i as u32 && !piece.is_enough() {
                crumbs.add(piece);
            }
        }
        let stays = tiles.iter().zip(&starts).map(|(tile, start)| {
            let stays = |i: u32| keep_all || evidence[root(&mut roots, start + i) as usize].is_enough();
            (0..tile.pieces.len() as u32).map(stays).collect()
        });
        let sizes = [0, 1].map(|k| tiles.iter().map(|tile| tile.sizes[k]).sum());
        Self { stays: stays.collect(), sizes, border, crumbs }
    }

    /// Which pieces of tile `number` stay.
    pub fn stays(&self, number: usize) -> &[bool] {
        &self.stays[number]
    }

    /// Which pieces of each tile stay.
    pub fn into_stays(self) -> Vec<Vec<bool>> {
        self.stays
    }

    /// Joins the tiles that this was made of, in the same order, at a level of detail; finest voxels have edges of `voxel` metres.
    pub fn join<T: Borrow<TileSurface>>(&self, tiles: impl Iterator<Item = T>, voxel: f32, lod: usize) -> Mesh {
        let mut mesh = Mesh::default();
        mesh.positions.reserve_exact(self.sizes[0]);
        mesh.normals.reserve_exact(self.sizes[0]);
        mesh.scales.reserve_exact(self.sizes[0]);
        mesh.triangles.reserve_exact(self.sizes[1]);
        // Numbers in the mesh of the vertices at borders, once their tile was added; triangles that came before wait for them.
        let mut numbers: HashMap<(u32, u32), u32> = HashMap::with_capacity(self.border.len());
        let mut waiting: Vec<(usize, usize, (u32, u32))> = Vec::new();
        for (number, tile) in tiles.enumerate() {
            let tile = tile.borrow();
            self.add(&mut mesh, (number, tile), &mut numbers, &mut waiting);
        }
        for (triangle, corner, vertex) in waiting {
            mesh.triangles[triangle][corner] = numbers.get(&vertex).copied().unwrap_or(0);
        }
        coarsen(&mut mesh, [0; 2], voxel, lod);
        mesh
    }

    fn add(
        &self,
        mesh: &mut Mesh,
        (number, tile): (usize, &TileSurface),
        numbers: &mut HashMap<(u32, u32), u32>,
        waiting: &mut Vec<(usize, usize, (u32, u32))>,
    ) {
        let (stays, own, first) = (self.stays(number), tile.own(), mesh.positions.len());
        let mut next = first as u32;
        let new: Vec<u32> = (0..own)
            .map(|v| {
                let number = next;
                next += u32::from(stays[tile.piece_of[v] as usize]);
                number
            })
            .collect();
        let kept: Vec<usize> = (0..own).filter(|&v| stays[tile.piece_of[v] as usize]).collect();
        mesh.positions.extend(kept.iter().map(|&v| tile.mesh.positions[v]));
        mesh.normals.extend(kept.iter().map(|&v| tile.mesh.normals[v]));
        mesh.scales.extend(kept.iter().map(|&v| tile.mesh.scales[v]));
        let intensities: Vec<u8> = kept.iter().filter_map(|&v| tile.mesh.intensities.get(v).copied()).collect();
        let colours: Vec<[u8; 3]> = kept.iter().filter_map(|&v| tile.mesh.colours.get(v).copied()).collect();
        mesh.append_attributes(first, &intensities, &colours);
        numbers.extend(tile.border.iter().map(|&(_, v)| ((number as u32, v), new[v as usize])));
        for t in tile.mesh.triangles.iter().filter(|t| stays[tile.piece_of[t[0] as usize] as usize]) {
            let mut triangle = [0; 3];
            for (corner, &v) in t.iter().enumerate() {
                if let Some(&number) = new.get(v as usize) {
                    triangle[corner] = number;
                    continue;
                }
                let (owner, there, _) = self.border.get(&tile.foreign[v as usize - own]).copied().unwrap_or_default();
                let vertex = (owner, there);
                match numbers.get(&vertex) {
                    Some(&number) => triangle[corner] = number,
                    None => waiting.push((mesh.triangles.len(), corner, vertex)),
                }
            }
            mesh.triangles.push(triangle);
        }
    }
}

/// The root of `v`; halves the way there.
fn root(roots: &mut [u32], mut v: u32) -> u32 {
    while roots[v as usize] != v {
        let next = roots[roots[v as usize] as usize];
        roots[v as usize] = next;
        v = next;
    }
    v
}
