//! Marching cubes over the dual cells of all blocks, in parallel, with shared vertices.
//!
//! Each step processes all blocks in Morton order, in parts, and stores what the next step needs of the surrounding blocks: masks of
//! measured voxels, filled holes, crossed edges and cells. Then all vertices have numbers, and positions and triangles are written to
//! their final positions.

use super::blocks::block_grid::{BlockGrid, PART};
use super::blocks::block_masks::MaskedField;
use super::blocks::fill_holes::FilledField;
use super::blocks::resolved_blocks::ResolvedBlocks;
use super::marching_cubes::colour;
use super::marching_cubes::crossings;
use super::marching_cubes::mesh_part::{BlockVertices, MeshPart};
use super::marching_cubes::triangles::{Connect, NORMAL_STEPS, NormalSum, added};
use super::marching_cubes::vertices::PlaceVertices;
use super::mesh::Mesh;
use super::simplify::coarsen;
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::simd::dispatch;
use rayon::prelude::*;

/// Options of mesh extraction.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshOptions {
    /// Least number of observations of a voxel that is used.
    pub min_weight: f32,
    /// Level of detail: 0 for full detail; with 1 to 3 all vertices in a cell of two to eight finest voxels are joined.
    pub lod: usize,
    /// Whether an unobserved voxel between two observed ones on opposite sides is interpolated.
    pub close_gaps: bool,
    /// Whether pieces with little evidence stay in the surface of an atlas: see [`Atlas::mesh`](crate::atlas::Atlas::mesh).
    pub keep_all: bool,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { min_weight: 1.0, lod: 0, close_gaps: true, keep_all: false }
    }
}

/// Extracts the zero crossings of `field` in metres of the submap frame, with finest voxels of `voxel` metres: all of them, because what has little
/// evidence in one submap may have more in others.
pub fn extract(field: &TsdfField, voxel: f32, options: &MeshOptions) -> Mesh {
    let mut mesh = Mesh::default();
    extract_onto(&mut mesh, field, voxel, options, None);
    mesh
}

/// Appends the result of [`extract`], transformed by `t`, to `mesh`. For many fields this is faster than appending meshes.
pub fn extract_onto(mesh: &mut Mesh, field: &TsdfField, voxel: f32, options: &MeshOptions, t: Option<&Rigid>) {
    if field.is_empty() {
        return;
    }
    let first = [mesh.positions.len(), mesh.triangles.len()];
    extract_blocks(mesh, &ResolvedBlocks::new(field), voxel, options);
    coarsen(mesh, first, voxel, options.lod);
    if let Some(t) = t {
        mesh.transform_from(first[0], t);
    }
}

/// Appends the surface of blocks that are resolved, which may be some of a field's, to `mesh`: at full detail, and all of it. Returns the blocks, their vertices, and
/// the cells and triangles of parts of them.
pub(super) fn extract_blocks(
    mesh: &mut Mesh,
    resolved: &ResolvedBlocks<'_>,
    voxel: f32,
    options: &MeshOptions,
) -> (BlockGrid, Vec<BlockVertices>, Vec<MeshPart>) {
    let grid = BlockGrid::new(resolved);
    let min_weight = (options.min_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16;
    let masked = MaskedField::new(resolved, &grid, min_weight);
    let filled = FilledField::new(&masked, &grid, options.close_gaps);
    let (vertices, parts) = crossings::find(&filled);
    let first = [mesh.positions.len(), mesh.triangles.len()];
    let (counts, intensities) = place_vertices(mesh, &filled, resolved, &vertices, voxel);
    connect(mesh, first[0], (&grid, voxel), (&vertices, &counts), &parts);
    let colours = colour::of_vertices(resolved.field, voxel, mesh, first);
    mesh.append_attributes(first[0], &intensities, &colours);
    (grid, vertices, parts)
}

/// Computes the positions of all vertices; returns the number of vertices of each part, and their intensities if there are any.
fn place_vertices(
    mesh: &mut Mesh,
    filled: &FilledField<'_>,
    resolved: &ResolvedBlocks<'_>,
    vertices: &[BlockVertices],
    voxel: f32,
) -> (Vec<usize>, Vec<u8>) {
    let total = vertices.last().map_or(0, |last| last.first + last.count()) as usize;
    let first = |part: usize| vertices.get(part * PART).map_or(total, |v| v.first as usize);
    let counts: Vec<usize> = (0..vertices.len().div_ceil(PART)).map(|part| first(part + 1) - first(part)).collect();
    let mut intensities = vec![0; total];
    let (positions, scales) = (grow(&mut mesh.positions, total, [0.0; 3]), grow(&mut mesh.scales, total, 0));
    let tasks = (
        vertices.par_chunks(PART),
        split_at_lengths(positions, &counts),
        split_at_lengths(scales, &counts),
        split_at_lengths(&mut intensities, &counts),
    )
        .into_par_iter();
    let has_intensity = tasks.enumerate().map(|(part, (blocks, positions, scales, intensities))| {
        let mut has_intensity = false;
        dispatch(PlaceVertices {
            filled,
            resolved,
            voxel,
            first: part * PART,
            blocks,
            positions,
            scales,
            intensities,
            has_intensity: &mut has_intensity,
        });
        has_intensity
    });
    if !has_intensity.reduce(|| false, |a, b| a | b) {
        intensities = Vec::new();
    }
    (counts, intensities)
}

/// Writes all triangles, and sets the normals of the vertices from `offset` on to the mean of their triangles' normals, weighted by area; finest voxels have
/// edges of `voxel` metres.
fn connect(mesh: &mut Mesh, offset: usize, (grid, voxel): (&BlockGrid, f32), (vertices, counts): (&[BlockVertices], &[usize]), parts: &[MeshPart]) {
    let sizes: Vec<usize> = parts.iter().map(MeshPart::triangles).collect();
    let positions = &mesh.positions[offset..];
    let triangles = grow(&mut mesh.triangles, sizes.iter().sum(), [0; 3]);
    let mut sums: Vec<NormalSum> = vec![[0; 3]; positions.len()];
    let steps = NORMAL_STEPS / (voxel * voxel);
    let tasks = (parts, split_at_lengths(triangles, &sizes), split_at_lengths(&mut sums, counts)).into_par_iter().enumerate();
    let foreign: Vec<Vec<(u32, NormalSum)>> = tasks
        .map(|(i, (part, triangles, normals))| {
            let (first, mut foreign) = (i * PART, Vec::new());
            let (first_normal, offset) = (vertices[first].first, offset as u32);
            dispatch(Connect { grid, vertices, first, part, positions, triangles, offset, normals, first_normal, foreign: &mut foreign, steps });
            foreign
        })
        .collect();
    for (vertex, normal) in foreign.into_iter().flatten() {
        let sum = &mut sums[vertex as usize];
        *sum = added(*sum, normal);
    }
    mesh.normals.extend(sums.iter().map(|sum| sum.map(|v| v as f32)));
    mesh.normalise_from(offset);
}

/// Appends `count` items and returns them.
fn grow<T: Copy>(items: &mut Vec<T>, count: usize, empty: T) -> &mut [T] {
    let first = items.len();
    items.resize(first + count, empty);
    &mut items[first..]
}

/// Splits `items` into slices of the given lengths.
fn split_at_lengths<'a, T>(mut items: &'a mut [T], lengths: &[usize]) -> Vec<&'a mut [T]> {
    let mut slices = Vec::with_capacity(lengths.len());
    for &length in lengths {
        let (slice, rest) = std::mem::take(&mut items).split_at_mut(length);
        slices.push(slice);
        items = rest;
    }
    slices
}
