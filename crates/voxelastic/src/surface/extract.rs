//! Marching cubes over the dual cells of all blocks, in parallel, with shared vertices.
//!
//! Every step goes over all blocks in Morton order, a part at a time, and leaves what the next one needs to know of the blocks around:
//! what was measured, which gaps are closed, which edges and cells are crossed. Then all vertices have numbers, and positions and
//! triangles are written where they belong.

use super::colour;
use super::crossings::{self, Part, Vertices};
use super::detail::coarsen;
use super::gaps::Closed;
use super::layout::{Layout, PART};
use super::mesh::Mesh;
use super::samples::Field;
use super::triangles::Connect;
use super::vertices::PlaceAll;
use super::view::View;
use crate::dispatch::dispatch;
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use rayon::prelude::*;

/// What to extract.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshOptions {
    /// Observations that a voxel needs before it takes part.
    pub min_weight: f32,
    /// Level of detail: 0 for all detail; with 1 to 3, what lies in one cell of two to eight finest voxels becomes one vertex.
    pub lod: usize,
    /// Whether a voxel that no beam met is interpolated between two on opposite sides that were.
    pub close_gaps: bool,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { min_weight: 1.0, lod: 0, close_gaps: true }
    }
}

/// Extracts the zero crossings of `field`, in metres of the submap frame, with voxels of `voxel` metres.
pub fn extract(field: &TsdfField, voxel: f32, options: &MeshOptions) -> Mesh {
    let mut mesh = Mesh::default();
    extract_onto(&mut mesh, field, voxel, options, None);
    mesh
}

/// Appends to `mesh` what [`extract`] gives, moved by `t`. For a large mesh of many fields this costs less than to append their meshes.
pub fn extract_onto(mesh: &mut Mesh, field: &TsdfField, voxel: f32, options: &MeshOptions, t: Option<&Rigid>) {
    if field.is_empty() {
        return;
    }
    let view = View::new(field);
    let layout = Layout::new(&view);
    let min_weight = (options.min_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16;
    let measured = Field::take(&view, &layout, min_weight);
    let closed = Closed::new(&measured, &layout, options.close_gaps);
    let (vertices, parts) = crossings::find(&closed);
    let first = [mesh.positions.len(), mesh.triangles.len()];
    let (counts, shades) = place(mesh, &closed, &view, &vertices, voxel);
    connect(mesh, first[0], &layout, &vertices, &parts, &counts);
    let colours = colour::of_vertices(field, voxel, mesh, first);
    mesh.append_marks(first[0], &shades, &colours);
    coarsen(mesh, first, voxel, options.lod);
    if let Some(t) = t {
        mesh.transform_from(first[0], t);
    }
}

/// Places all vertices; returns how many each part has, and their intensities if there are any.
fn place(mesh: &mut Mesh, closed: &Closed<'_>, view: &View<'_>, vertices: &[Vertices], voxel: f32) -> (Vec<usize>, Vec<u8>) {
    let total = vertices.last().map_or(0, |last| last.first + last.count()) as usize;
    let first = |part: usize| vertices.get(part * PART).map_or(total, |v| v.first as usize);
    let counts: Vec<usize> = (0..vertices.len().div_ceil(PART)).map(|part| first(part + 1) - first(part)).collect();
    let mut shades = vec![0; total];
    let (positions, scales) = (grow(&mut mesh.positions, total, [0.0; 3]), grow(&mut mesh.scales, total, 0));
    let tasks = (vertices.par_chunks(PART), cut(positions, &counts), cut(scales, &counts), cut(&mut shades, &counts)).into_par_iter();
    let shaded = tasks.enumerate().map(|(part, (blocks, positions, scales, shades))| {
        let mut shaded = false;
        dispatch(PlaceAll { closed, view, voxel, first: part * PART, blocks, positions, scales, shades, shaded: &mut shaded });
        shaded
    });
    if !shaded.reduce(|| false, |a, b| a | b) {
        shades = Vec::new();
    }
    (counts, shades)
}

/// Makes all triangles and sets each vertex normal to the mean of its triangles' normals, weighted by their areas, for the vertices of the mesh from
/// `offset` on.
fn connect(mesh: &mut Mesh, offset: usize, layout: &Layout, vertices: &[Vertices], parts: &[Part], counts: &[usize]) {
    let sizes: Vec<usize> = parts.iter().map(Part::triangles).collect();
    let positions = &mesh.positions[offset..];
    let triangles = grow(&mut mesh.triangles, sizes.iter().sum(), [0; 3]);
    let normals = grow(&mut mesh.normals, positions.len(), [0.0; 3]);
    let tasks = (parts, cut(triangles, &sizes), cut(normals, counts)).into_par_iter().enumerate();
    let spilt: Vec<Vec<(u32, [f32; 3])>> = tasks
        .map(|(i, (part, triangles, normals))| {
            let (first, mut spilt) = (i * PART, Vec::new());
            let (first_normal, offset) = (vertices[first].first, offset as u32);
            dispatch(Connect { layout, vertices, first, part, positions, triangles, offset, normals, first_normal, spilt: &mut spilt });
            spilt
        })
        .collect();
    mesh.add_to_normals(offset, spilt.into_iter().flatten());
    mesh.normalise_from(offset);
}

/// Makes room for `count` more items and returns it.
fn grow<T: Copy>(items: &mut Vec<T>, count: usize, empty: T) -> &mut [T] {
    let first = items.len();
    items.resize(first + count, empty);
    &mut items[first..]
}

/// Cuts `items` into pieces of the given lengths.
fn cut<'a, T>(mut items: &'a mut [T], lengths: &[usize]) -> Vec<&'a mut [T]> {
    let mut pieces = Vec::with_capacity(lengths.len());
    for &length in lengths {
        let (piece, rest) = std::mem::take(&mut items).split_at_mut(length);
        pieces.push(piece);
        items = rest;
    }
    pieces
}
