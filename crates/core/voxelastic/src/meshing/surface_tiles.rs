//! The surface of a map tile by tile, for those who write it: at no time is all of it in memory.

use crate::atlas::Atlas;
use crate::atlas::fusion::FusedField;
use crate::geometry::{Pose, Rigid};
use crate::meshing::TileKey;
use crate::surface::{Mesh, MeshOptions, Seams, SmallComponents, TileIndex, TileSeam, tile_surfaces};
use std::borrow::Borrow;
use std::collections::BTreeMap;

/// log2 of the edge of a tile in blocks.
const TILE_SHIFT: u32 = 4;
/// Edge of a tile, finest voxels.
const TILE_EDGE: f64 = 128.0;
/// Triangles reach this far beyond their tile: a voxel of the coarsest scale, and what one block is bent, finest voxels.
const BEYOND: f64 = 16.0;
/// Of the surface around a part that is asked for, so much is looked at to tell small components from pieces that go on there, finest voxels.
const AROUND: f64 = 64.0;
/// Colour of vertices without one, where others have one.
const GREY: [u8; 3] = [128; 3];

/// The one surface of an atlas, in tiles of 128 x 128 x 128 finest voxels that are made when they are asked for.
///
/// They are made twice: first to find out which pieces have enough evidence, of which the borders of tiles are kept, a small part of them; then for the caller. Where
/// tiles meet, they have the same vertices, bit by bit. Together they are [`Atlas::mesh`] at full detail.
///
/// `A` is an [`Atlas`] or a reference to one. One that is handed over is dropped as soon as its submaps are fused.
///
/// ```
/// use voxelastic::atlas::Atlas;
/// use voxelastic::meshing::SurfaceTiles;
/// use voxelastic::surface::MeshOptions;
/// let surface = SurfaceTiles::new(Atlas::new(0.065), MeshOptions::default());
/// for batch in surface.batches(surface.tiles()) {
///     for (tile, mesh) in batch.iter().zip(surface.meshes(batch)) {
///         println!("{:?}: {} triangles", surface.bounds(*tile), mesh.triangles.len());
///     }
/// }
/// ```
#[derive(Debug)]
pub struct SurfaceTiles<A> {
    fused: FusedField<A>,
    voxel: f32,
    options: MeshOptions,
    index: TileIndex,
    /// Ascending.
    tiles: Vec<TileKey>,
    /// By tile, which of its pieces stay.
    stays: Vec<Vec<bool>>,
    small_components: SmallComponents,
    /// Number of vertices by their height in the map frame, in finest voxels.
    heights: BTreeMap<i32, u64>,
    vertices: u64,
    /// With small components.
    triangles: u64,
}

impl<A: Borrow<Atlas>> SurfaceTiles<A> {
    /// The surface of the map. Runs in parallel; the result does not depend on the number of threads.
    pub fn new(atlas: A, options: MeshOptions) -> Self {
        let voxel = atlas.borrow().voxel_size();
        Self::of(FusedField::new(atlas), voxel, options)
    }

    /// The surface in and around a box of the map frame, metres: submaps are fused there alone. In the box it is the whole one, but for small components at its faces: of pieces that
    /// go on beyond, the evidence of some voxels around the box counts.
    pub fn within(atlas: A, options: MeshOptions, low: [f64; 3], high: [f64; 3]) -> Self {
        let voxel = atlas.borrow().voxel_size();
        let around = AROUND * f64::from(voxel);
        Self::of(FusedField::within(atlas, low.map(|c| c - around), high.map(|c| c + around)), voxel, options)
    }

    fn of(fused: FusedField<A>, voxel: f32, options: MeshOptions) -> Self {
        // Levels of detail are made of whole meshes.
        let options = MeshOptions { lod: 0, ..options };
        let index = TileIndex::new(TILE_SHIFT);
        let (tiles, stays, small_components) = (Vec::new(), Vec::new(), SmallComponents::default());
        let mut surface = Self { fused, voxel, options, index, tiles, stays, small_components, heights: BTreeMap::new(), vertices: 0, triangles: 0 };
        surface.judge();
        surface
    }

    /// Finds out which pieces stay, and where the vertices are.
    fn judge(&mut self) {
        let Some((field, t_map_field)) = self.fused.field() else { return };
        self.index.extend(field);
        let (tiles, t_map_field) = (self.index.tiles(), Rigid::from(&t_map_field));
        let mut seams: Vec<TileSeam> = Vec::with_capacity(tiles.len());
        for batch in self.index.batches(&tiles) {
            for tile in tile_surfaces(field, self.voxel, &self.options, &self.index, batch) {
                seams.push(TileSeam::from(&tile));
                self.triangles += tile.mesh.triangles.len() as u64;
                for p in &tile.mesh.positions[..tile.own()] {
                    *self.heights.entry((t_map_field.apply(*p)[2] / self.voxel).floor() as i32).or_default() += 1;
                    self.vertices += 1;
                }
            }
        }
        let seams = Seams::new(&seams, self.options.keep_all);
        (self.small_components, self.stays, self.tiles) = (seams.small_components, seams.stays, tiles);
    }

    /// The tiles, ascending. Near tiles are near each other. Some may be empty.
    pub fn tiles(&self) -> &[TileKey] {
        &self.tiles
    }

    /// Whether there is no surface.
    pub fn is_empty(&self) -> bool {
        !self.stays.iter().flatten().any(|stays| *stays)
    }

    /// Number of triangles of all tiles, without small components.
    pub fn triangles(&self) -> u64 {
        self.triangles - self.small_components.triangles
    }

    /// Splits tiles into batches that are to be made one after the other, so that the memory for it is bounded.
    pub fn batches<'a>(&self, tiles: &'a [TileKey]) -> Vec<&'a [TileKey]> {
        self.index.batches(tiles)
    }

    /// A box of the map frame that contains the surface in a tile: least and largest coordinates, metres.
    pub fn bounds(&self, tile: TileKey) -> ([f64; 3], [f64; 3]) {
        let (voxel, edge) = (f64::from(self.voxel), TILE_EDGE);
        let half = (0.5 * edge + BEYOND) * voxel;
        let middle = self.index.origin(tile).map(|c| (f64::from(c) + 0.5 * edge) * voxel);
        let t_map_field = self.fused.field().map_or_else(Pose::identity, |(_, pose)| pose);
        let middle = t_map_field * nalgebra::Point3::from(middle);
        let turn = t_map_field.rotation.to_rotation_matrix();
        let half: [f64; 3] = std::array::from_fn(|row| half * (0..3).map(|k| turn[(row, k)].abs()).sum::<f64>());
        (std::array::from_fn(|k| middle[k] - half[k]), std::array::from_fn(|k| middle[k] + half[k]))
    }

    /// The surfaces in some tiles, in their order, each in metres of the map frame. Those of other keys than [`tiles`](Self::tiles) has are empty.
    pub fn meshes(&self, tiles: &[TileKey]) -> Vec<Mesh> {
        let Some((field, t_map_field)) = self.fused.field() else { return vec![Mesh::default(); tiles.len()] };
        let (t_map_field, has_colours) = (Rigid::from(&t_map_field), self.has_colours());
        let made = tile_surfaces(field, self.voxel, &self.options, &self.index, tiles);
        let finish = |(tile, surface): (&TileKey, crate::surface::TileSurface)| {
            let stays = self.tiles.binary_search(tile).map_or(&[][..], |number| &self.stays[number]);
            let mut mesh = surface.mesh_of(stays);
            mesh.transform(&t_map_field);
            if has_colours {
                mesh.colours.resize(mesh.positions.len(), GREY);
            }
            mesh
        };
        tiles.iter().zip(made).map(finish).collect()
    }

    /// Whether the map has colours.
    pub fn has_colours(&self) -> bool {
        self.fused.field().is_some_and(|(field, _)| !field.colours().is_empty())
    }

    /// Range of heights without outliers, to a voxel: the 1st and 99th percentiles, metres.
    pub fn height_range(&self) -> (f32, f32) {
        let at = |share: f64| {
            let mut left = (self.vertices.saturating_sub(1) as f64 * share).round() as u64;
            let found = self.heights.iter().find(|(_, count)| {
                let is_here = left < **count;
                left = left.saturating_sub(**count);
                is_here
            });
            found.map_or(0.0, |(height, _)| (*height as f32 + 0.5) * self.voxel)
        };
        let (low, high) = (at(0.01), at(0.99));
        (low, high.max(low + 0.01))
    }

    /// Pieces that are left out because they have too little evidence.
    pub fn small_components(&self) -> SmallComponents {
        self.small_components
    }
}
