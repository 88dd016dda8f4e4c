//! Marching cubes over the dual cells of all blocks, in parallel, with shared vertices.
//!
//! A vertex lies on a dual edge, between two voxels that share a face. The finer of the two owns it (the lower one among
//! equals), so (block, voxel, direction) names it, and any block can refer to any vertex without a search in space.
//!
//! Each block is loaded once: it gives its vertices, and triangles whose corners are names. When all blocks have given theirs, the
//! names become numbers (`join.rs`).

use super::cases::{CASES, EDGES};
use super::cells::{Cells, bits, case, corners, is_owned};
use super::colour;
use super::gaps;
use super::join::join;
use super::mesh::Mesh;
use super::padded::{Padded, sides};
use super::unpacked::Unpacked;
use super::view::View;
use crate::field::tsdf::{TsdfField, WEIGHT_ONE};
use crate::octree::Cursor;
use rayon::prelude::*;

/// What to extract.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshOptions {
    /// Observations that a voxel needs before it takes part.
    pub min_weight: f32,
    /// Finest scale to use: 0 for full detail, up to 3 for voxels eight times as large.
    pub lod: usize,
    /// Whether a voxel that no beam met is interpolated between two on opposite sides that were.
    pub close_gaps: bool,
}

impl Default for MeshOptions {
    fn default() -> Self {
        Self { min_weight: 1.0, lod: 0, close_gaps: true }
    }
}

/// Names a vertex within its block: between voxel `voxel` and its neighbour in `direction` (0..3 for +x +y +z, 3..6 for -x -y -z).
#[inline(always)]
fn slot(voxel: u16, direction: usize) -> u16 {
    voxel * 6 + direction as u16
}

/// Names that a block can have.
pub(super) const SLOTS: usize = 512 * 6;

/// A vertex of one of the 27 blocks around, as a triangle names it.
#[derive(Clone, Copy)]
pub(super) struct Name {
    pub neighbour: usize,
    pub slot: u16,
}

impl Name {
    #[inline(always)]
    fn pack(neighbour: u8, slot: u16) -> u32 {
        u32::from(neighbour) << 16 | u32::from(slot)
    }

    #[inline(always)]
    pub fn unpack(packed: u32) -> Self {
        Self { neighbour: (packed >> 16) as usize, slot: packed as u16 }
    }
}

/// What one block gives to a [`Part`]: where its shares of the part's arrays end.
#[derive(Clone, Copy)]
pub(super) struct Patch {
    pub id: u32,
    pub neighbours: [u32; 27],
    pub scale: u8,
    /// Whether other blocks must be asked which of its vertices are used, because some of them are finer or coarser.
    pub mixed: bool,
    pub vertices: u32,
    pub triangles: u32,
}

/// What some blocks, neighbours in space, give to the mesh.
#[derive(Default)]
pub(super) struct Part {
    pub patches: Vec<Patch>,
    /// Names of the vertices within their block, ascending.
    pub slots: Vec<u16>,
    /// In finest voxels.
    pub positions: Vec<[f32; 3]>,
    pub shades: Vec<u8>,
    pub has_shades: bool,
    /// Packed [`Name`]s.
    pub triangles: Vec<[u32; 3]>,
}

/// Extracts the zero crossings of `field`, in metres of the submap frame, with voxels of `voxel` metres.
pub fn extract(field: &TsdfField, voxel: f32, options: &MeshOptions) -> Mesh {
    /// Few enough that threads share evenly, many enough that most triangles stay among them.
    const BLOCKS_PER_PART: usize = 1024;
    if field.is_empty() {
        return Mesh::default();
    }
    let view = View::new(field, options.lod);
    let min_weight = (options.min_weight * f32::from(WEIGHT_ONE)).clamp(1.0, f32::from(u16::MAX)) as u16;
    let sides: Vec<u8> = field.ids().into_par_iter().map(|id| sides(view.held(id), min_weight)).collect();
    let parts = field
        .ids_in_morton_order()
        .par_chunks(BLOCKS_PER_PART)
        .map(|ids| {
            let (mut part, mut padded, mut cursor) = (Part::default(), Padded::new(), Cursor::new(field.tree()));
            let mut unpacked = Unpacked::new();
            for &id in ids {
                if padded.enter(&view, &sides, &mut cursor, id) {
                    padded.load(&view, &mut unpacked, min_weight);
                    if options.close_gaps {
                        gaps::close(&mut padded);
                    }
                    part.add(&padded, &view, id);
                }
            }
            part
        })
        .collect();
    let mut mesh = join(parts, field.ids().len(), voxel);
    mesh.colours = colour::of_vertices(field, voxel, &mesh);
    mesh
}

impl Part {
    fn add(&mut self, padded: &Padded, view: &View<'_>, id: u32) {
        let cells = Cells::find(padded);
        if padded.uniform {
            self.add_vertices(padded, &cells, view, id);
        } else {
            self.add_vertices_of_mixed(padded, view, id);
        }
        self.add_triangles(padded, &cells);
        self.patches.push(Patch {
            id,
            neighbours: padded.ids,
            scale: padded.scale as u8,
            mixed: !padded.uniform,
            vertices: self.slots.len() as u32,
            triangles: self.triangles.len() as u32,
        });
    }

    /// Vertices that the block owns and some cell uses, where all blocks around have the same scale.
    fn add_vertices(&mut self, padded: &Padded, cells: &Cells, view: &View<'_>, id: u32) {
        let n = padded.edge as i32;
        let (size, steps) =
            ((1 << padded.scale) as f32, [Padded::at([1, 0, 0]), Padded::at([0, 1, 0]), Padded::at([0, 0, 1])].map(|s| s - Padded::at([0; 3])));
        for z in 0..n {
            for y in 0..n {
                // The cells to the four sides of an edge, bit x for the edge from the voxel at x.
                let [low, right, up, far] = [cells.row(y, z), cells.row(y + 1, z), cells.row(y, z + 1), cells.row(y + 1, z + 1)];
                let used = [(low | right | up | far) >> 1, (right | far) | (right | far) >> 1, (up | far) | (up | far) >> 1];
                let behind = |y: i32, z: i32| padded.behind[Padded::row(y, z)] >> Padded::bit(0);
                let here = behind(y, z);
                let ahead = [here >> 1, behind(y + 1, z), behind(y, z + 1)];
                let inside = (1u16 << n) - 1;
                let crossed: [u16; 3] = std::array::from_fn(|k| used[k] & (here ^ ahead[k]) & inside);
                for x in bits(crossed[0] | crossed[1] | crossed[2]) {
                    let (at, voxel) = (Padded::at([x, y, z]), padded.corner([x, y, z]).voxel);
                    for (k, crossed) in crossed.iter().enumerate() {
                        if crossed >> x & 1 == 1 {
                            let (a, b) = (padded.distances[at], padded.distances[at + steps[k]]);
                            let mut c = [x, y, z].map(|v| v as f32 + 0.5);
                            c[k] += a / (a - b);
                            let position = std::array::from_fn(|k| padded.origin[k] as f32 + c[k] * size);
                            self.add_vertex(slot(voxel, k), position, view.shade(id, usize::from(voxel)));
                        }
                    }
                }
            }
        }
    }

    /// All vertices that the block owns, also those that no cell uses: some of the cells around them belong to finer blocks.
    fn add_vertices_of_mixed(&mut self, padded: &Padded, view: &View<'_>, id: u32) {
        let n = padded.edge as i32;
        let inside = (1u16 << n) - 1;
        let coarser = |c: [i32; 3]| usize::from(padded.scales[padded.neighbour(c)]) > padded.scale;
        for (y, z) in (0..n).flat_map(|z| (0..n).map(move |y| (y, z))) {
            let row = |y: i32, z: i32| [padded.known[Padded::row(y, z)], padded.behind[Padded::row(y, z)]];
            let here = row(y, z);
            // The neighbours in each direction, bit for bit beside `here`; backwards only where the block there is coarser.
            let there = [here.map(|m| m >> 1), row(y + 1, z), row(y, z + 1), here.map(|m| m << 1), row(y - 1, z), row(y, z - 1)];
            let first = 1u16 << Padded::bit(0);
            let owned = [
                u16::MAX,
                u16::MAX,
                u16::MAX,
                if coarser([-1, y, z]) { first } else { 0 },
                if coarser([0, y - 1, z]) { u16::MAX } else { 0 },
                if coarser([0, y, z - 1]) { u16::MAX } else { 0 },
            ];
            let crossed: [u16; 6] = std::array::from_fn(|d| (here[0] & there[d][0] & (here[1] ^ there[d][1]) & owned[d]) >> Padded::bit(0) & inside);
            for x in bits(crossed.iter().fold(0, |any, mask| any | mask)) {
                let voxel = padded.corner([x, y, z]).voxel;
                for direction in (0..6).filter(|&d| crossed[d] >> x & 1 == 1) {
                    let mut there = [x, y, z];
                    there[direction % 3] += if direction < 3 { 1 } else { -1 };
                    let position = padded.between([x, y, z], there);
                    self.add_vertex(slot(voxel, direction), position, view.shade(id, usize::from(voxel)));
                }
            }
        }
    }

    #[inline(always)]
    fn add_vertex(&mut self, slot: u16, position: [f32; 3], shade: Option<u8>) {
        self.slots.push(slot);
        self.positions.push(position);
        // A map may have blocks with and without intensity: the latter count as mid grey.
        self.shades.push(shade.unwrap_or(128));
        self.has_shades |= shade.is_some();
    }

    /// The triangles of the cells that the block owns.
    fn add_triangles(&mut self, padded: &Padded, cells: &Cells) {
        let n = padded.edge as i32;
        for z in 0..=n {
            for y in 0..=n {
                for x in bits(cells.row(y, z)) {
                    let c = [x, y, z];
                    if !is_owned(padded, c) {
                        continue;
                    }
                    let corners = corners(c);
                    for &triangle in &CASES[case(padded, c)] {
                        let [p, q, r] = triangle.map(|edge| {
                            let [a, b] = EDGES[usize::from(edge)].map(|i| corners[i]);
                            name(padded, a, b, usize::from(edge) / 4)
                        });
                        // Where scales meet, corners of a cell may be one and the same voxel.
                        if p != q && q != r && r != p {
                            self.triangles.push([p, q, r]);
                        }
                    }
                }
            }
        }
    }
}

/// Name of the vertex between the voxels at `a` and `b`, where `b` follows `a` along `axis`.
#[inline(always)]
fn name(padded: &Padded, a: [i32; 3], b: [i32; 3], axis: usize) -> u32 {
    let from = padded.corner(a);
    if !padded.uniform {
        let to = padded.corner(b);
        if padded.scales[usize::from(to.neighbour)] < padded.scales[usize::from(from.neighbour)] {
            return Name::pack(to.neighbour, slot(to.voxel, axis + 3));
        }
    }
    Name::pack(from.neighbour, slot(from.voxel, axis))
}
