//! Marching cubes over the dual cells of all blocks, in parallel, with shared vertices.
//!
//! A vertex lies on a dual edge, between two voxels that share a face. The finer of the two owns it (the lower one among
//! equals), so (block, voxel, direction) names it, and any block can refer to any vertex without a search in space.

use super::cases::{CASES, EDGES};
use super::cells::{CENTRE, Corner, Padded, neighbour_offset};
use super::mesh::Mesh;
use super::view::View;
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::octree::{Cursor, NONE};
use rayon::prelude::*;

/// What to extract.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshOptions {
    /// Observations that a voxel needs before it takes part.
    pub min_weight: f32,
    /// Finest scale to use: 0 for full detail, up to 3 for voxels eight times as large.
    pub lod: usize,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { min_weight: 1.0, lod: 0 }
    }
}

/// A distance between neighbouring voxels that changes faster than this many times their spacing is no surface, but the
/// place where the band in front of one surface meets the band behind another.
const MAX_SLOPE: f32 = 4.0;

/// Vertices owned by one block.
#[derive(Default)]
struct Owned {
    /// Sorted names of the vertices, see [`slot`].
    slots: Vec<u16>,
    positions: Vec<[f32; 3]>,
    shades: Vec<u8>,
    scale: u8,
}

/// Name of the vertex between voxel `voxel` of a block and its neighbour in `direction` (0..3 for +x +y +z, 3..6 for -x -y -z).
#[inline(always)]
fn slot(voxel: u16, direction: usize) -> u16 {
    voxel * 6 + direction as u16
}

/// Extracts the zero crossings of `field`, in metres of the submap frame, with voxels of `voxel` metres.
pub fn extract(field: &TsdfField, voxel: f32, options: &MeshOptions) -> Mesh {
    if field.is_empty() {
        return Mesh::default();
    }
    let view = View::new(field, options.lod);
    let min_weight = (options.min_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16;
    let ids = morton_order(field);
    let start = || (Padded::new(), Cursor::new(field.tree()));
    let owned: Vec<(u32, Owned)> = ids
        .par_iter()
        .map_init(start, |(padded, cursor), &id| padded.load(&view, cursor, id, min_weight).then(|| (id, vertices(padded, &view))))
        .flatten()
        .collect();
    let mut place = vec![NONE; field.ids().len()];
    let mut first = Vec::with_capacity(owned.len());
    let mut count = 0u32;
    for (i, (id, vertices)) in owned.iter().enumerate() {
        place[*id as usize] = i as u32;
        first.push(count);
        count += vertices.slots.len() as u32;
    }
    let find = |id: u32, slot: u16| -> Option<u32> {
        let i = *place.get(id as usize).filter(|&&i| i != NONE)? as usize;
        Some(first[i] + owned[i].1.slots.binary_search(&slot).ok()? as u32)
    };
    let triangles: Vec<Vec<[u32; 3]>> = owned
        .par_iter()
        .map_init(start, |(padded, cursor), (id, _)| {
            padded.load(&view, cursor, *id, min_weight);
            triangles(padded, &find)
        })
        .collect();
    let mut mesh = Mesh { triangles: triangles.concat(), ..Mesh::default() };
    for (_, vertices) in owned {
        let first = mesh.positions.len();
        mesh.scales.resize(mesh.scales.len() + vertices.slots.len(), vertices.scale);
        mesh.positions.extend(vertices.positions.iter().map(|p| p.map(|c| c * voxel)));
        mesh.append_shades(first, &vertices.shades);
    }
    mesh.drop_unused_vertices();
    mesh.compute_normals();
    mesh
}

/// Ids of all blocks, neighbours in space near each other.
fn morton_order(field: &TsdfField) -> Vec<u32> {
    let mut ids = Vec::with_capacity(field.len());
    field.tree().for_each(|_, level, octant| {
        if level == 0 && octant.link != NONE {
            ids.push(octant.link);
        }
    });
    ids
}

/// The vertices on the dual edges that the block's voxels own.
fn vertices(padded: &Padded, view: &View<'_>) -> Owned {
    let mut owned = Owned { scale: padded.scale as u8, ..Owned::default() };
    let n = padded.edge as i32;
    for z in 0..n {
        for y in 0..n {
            for x in 0..n {
                let here = padded.at([x, y, z]);
                if padded.distances[here].is_nan() {
                    continue;
                }
                for direction in 0..6 {
                    let mut c = [x, y, z];
                    c[direction % 3] += if direction < 3 { 1 } else { -1 };
                    let there = padded.at(c);
                    if owns(padded, here, there, direction) && crosses(padded, here, there) {
                        owned.slots.push(slot(padded.corner(here).voxel, direction));
                        owned.positions.push(between(padded, here, there));
                        owned.shades.extend(shade(padded, view, here));
                    }
                }
            }
        }
    }
    owned
}

/// Whether the voxel at sample `here` owns the dual edge to `there`, its neighbour in `direction`.
#[inline(always)]
fn owns(padded: &Padded, here: usize, there: usize, direction: usize) -> bool {
    let scale_of = |sample: usize| padded.scales[usize::from(padded.corner(sample).neighbour)];
    direction < 3 || scale_of(there) > scale_of(here)
}

/// Whether the surface passes between two observed samples.
#[inline(always)]
fn crosses(padded: &Padded, a: usize, b: usize) -> bool {
    let (a, b) = (padded.distances[a], padded.distances[b]);
    // Comparisons with NaN are false, and infinity fails the slope later on.
    (a < 0.0 && (0.0..f32::INFINITY).contains(&b)) || (b < 0.0 && (0.0..f32::INFINITY).contains(&a))
}

/// The zero crossing between two samples, in finest voxels.
fn between(padded: &Padded, a: usize, b: usize) -> [f32; 3] {
    let (p, q) = (padded.position(padded.corner(a)), padded.position(padded.corner(b)));
    let t = padded.distances[a] / (padded.distances[a] - padded.distances[b]);
    std::array::from_fn(|k| p[k] + t * (q[k] - p[k]))
}

fn shade(padded: &Padded, view: &View<'_>, sample: usize) -> Option<u8> {
    let corner = padded.corner(sample);
    view.shade(padded.ids[usize::from(corner.neighbour)], usize::from(corner.voxel))
}

/// The triangles of the dual cells that the block owns.
fn triangles(padded: &Padded, find: &impl Fn(u32, u16) -> Option<u32>) -> Vec<[u32; 3]> {
    let mut triangles = Vec::new();
    let n = padded.edge as i32;
    for z in 0..=n {
        for y in 0..=n {
            for x in 0..=n {
                cell([x, y, z], padded, find, &mut triangles);
            }
        }
    }
    triangles
}

/// The dual cell around the voxel corner `c` of the block.
#[inline(always)]
fn cell(c: [i32; 3], padded: &Padded, find: &impl Fn(u32, u16) -> Option<u32>, triangles: &mut Vec<[u32; 3]>) {
    let samples: [usize; 8] =
        std::array::from_fn(|i| padded.at([c[0] - 1 + (i & 1) as i32, c[1] - 1 + (i >> 1 & 1) as i32, c[2] - 1 + (i >> 2) as i32]));
    let mut case = 0usize;
    for (i, &sample) in samples.iter().enumerate() {
        let distance = padded.distances[sample];
        if !distance.is_finite() {
            return;
        }
        case |= usize::from(distance < 0.0) << i;
    }
    if case == 0 || case == 255 || !is_owner(padded, &samples) || too_steep(padded, &samples) {
        return;
    }
    let vertex = |edge: u8| {
        let [a, b] = EDGES[usize::from(edge)].map(|i| samples[i]);
        let axis = usize::from(edge) / 4;
        name(padded, a, b, axis).and_then(|(id, slot)| find(id, slot))
    };
    for &[a, b, c] in &CASES[case] {
        if let (Some(a), Some(b), Some(c)) = (vertex(a), vertex(b), vertex(c))
            && a != b
            && b != c
            && c != a
        {
            triangles.push([a, b, c]);
        }
    }
}

/// Owner (block id) and name of the vertex between samples `a` and `b`, where `b` follows `a` along `axis`.
#[inline(always)]
fn name(padded: &Padded, a: usize, b: usize, axis: usize) -> Option<(u32, u16)> {
    let (a, b) = (padded.corner(a), padded.corner(b));
    let scale_of = |corner: Corner| padded.scales[usize::from(corner.neighbour)];
    let (owner, direction) = if scale_of(b) < scale_of(a) { (b, axis + 3) } else { (a, axis) };
    let id = padded.ids[usize::from(owner.neighbour)];
    (id != NONE).then(|| (id, slot(owner.voxel, direction)))
}

/// Of the finest blocks that meet in a cell, the first in z, y, x order owns it. Finer neighbours were excluded before.
#[inline(always)]
fn is_owner(padded: &Padded, samples: &[usize; 8]) -> bool {
    samples.iter().all(|&sample| {
        let neighbour = usize::from(padded.corner(sample).neighbour);
        if neighbour == CENTRE || usize::from(padded.scales[neighbour]) != padded.scale {
            return true;
        }
        let [x, y, z] = neighbour_offset(neighbour);
        (z, y, x) > (0, 0, 0)
    })
}

/// Whether a crossing of the cell is too steep to be a surface, see [`MAX_SLOPE`].
#[inline(always)]
fn too_steep(padded: &Padded, samples: &[usize; 8]) -> bool {
    EDGES.iter().any(|&[a, b]| {
        let (a, b) = (samples[a], samples[b]);
        crosses(padded, a, b) && {
            let (p, q) = (padded.position(padded.corner(a)), padded.position(padded.corner(b)));
            let spacing = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>().sqrt();
            (padded.distances[a] - padded.distances[b]).abs() > MAX_SLOPE * spacing
        }
    })
}
