//! From the parts that blocks gave to one mesh: unused vertices go, names of vertices become numbers, all in parallel.

use super::extract::{Name, Part, Patch, SLOTS};
use super::mesh::Mesh;
use super::padded::CENTRE;
use crate::octree::NONE;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// Joins `parts` of a field with block ids below `ids`; finest voxels have an edge of `voxel` metres.
pub(super) fn join(mut parts: Vec<Part>, ids: usize, voxel: f32) -> Mesh {
    drop_unused(&mut parts, ids);
    let places = Places::of(&parts, ids);
    let vertices: Vec<usize> = parts.iter().map(|part| part.slots.len()).collect();
    let triangles: Vec<usize> = parts.iter().map(|part| part.triangles.len()).collect();
    let (count, triangle_count) = (vertices.iter().sum(), triangles.iter().sum());
    let mut mesh = Mesh { positions: vec![[0.0; 3]; count], scales: vec![0; count], triangles: vec![[0; 3]; triangle_count], ..Mesh::default() };
    let names: Vec<Vec<[u32; 3]>> = parts.iter_mut().map(|part| std::mem::take(&mut part.triangles)).collect();
    (&parts, names, cut(&mut mesh.triangles, &triangles))
        .into_par_iter()
        .for_each(|(part, names, numbers)| places.number(part, &parts, &names, numbers));
    let shaded: Vec<usize> = if parts.iter().any(|part| part.has_shades) { vertices.clone() } else { vec![0; parts.len()] };
    mesh.shades = vec![0; shaded.iter().sum()];
    let (positions, scales, shades) = (cut(&mut mesh.positions, &vertices), cut(&mut mesh.scales, &vertices), cut(&mut mesh.shades, &shaded));
    (parts, positions, scales, shades).into_par_iter().for_each(|(part, positions, scales, shades)| {
        positions.iter_mut().zip(&part.positions).for_each(|(to, from)| *to = from.map(|c| c * voxel));
        part.patches.iter().zip(vertex_ranges(&part.patches)).for_each(|(patch, range)| scales[range].fill(patch.scale));
        if !shades.is_empty() {
            shades.copy_from_slice(&part.shades);
        }
    });
    mesh.compute_normals(&vertices, &triangles);
    mesh
}

/// Cuts `items` into pieces of the given lengths.
pub(super) fn cut<'a, T>(mut items: &'a mut [T], lengths: &[usize]) -> Vec<&'a mut [T]> {
    let mut pieces = Vec::with_capacity(lengths.len());
    for &length in lengths {
        let (piece, rest) = std::mem::take(&mut items).split_at_mut(length);
        pieces.push(piece);
        items = rest;
    }
    pieces
}

fn ranges(ends: impl Iterator<Item = u32>) -> impl Iterator<Item = Range<usize>> {
    ends.scan(0, |start, end| Some(std::mem::replace(start, end as usize)..end as usize))
}

/// Each patch's share of its part's vertices.
fn vertex_ranges(patches: &[Patch]) -> impl Iterator<Item = Range<usize>> {
    ranges(patches.iter().map(|patch| patch.vertices))
}

/// Each patch's share of its part's triangles.
fn triangle_ranges(patches: &[Patch]) -> impl Iterator<Item = Range<usize>> {
    ranges(patches.iter().map(|patch| patch.triangles))
}

/// Drops the vertices that no triangle names. Only blocks among finer or coarser ones have any.
fn drop_unused(parts: &mut [Part], ids: usize) {
    const WORDS: usize = SLOTS / 64;
    let mut mixed = vec![NONE; ids];
    let mut count = 0;
    for patch in parts.iter().flat_map(|part| &part.patches).filter(|patch| patch.mixed) {
        mixed[patch.id as usize] = count;
        count += 1;
    }
    let used: Vec<AtomicU64> = (0..count as usize * WORDS).map(|_| AtomicU64::new(0)).collect();
    parts.par_iter().for_each(|part| {
        for (patch, triangles) in part.patches.iter().zip(triangle_ranges(&part.patches)) {
            let places = patch.neighbours.map(|id| if id == NONE { NONE } else { mixed[id as usize] });
            if places.iter().any(|&place| place != NONE) {
                for name in part.triangles[triangles].iter().flatten().map(|&packed| Name::unpack(packed)) {
                    let place = places[name.neighbour];
                    if place != NONE {
                        let word = place as usize * WORDS + usize::from(name.slot) / 64;
                        used[word].fetch_or(1 << (name.slot % 64), Ordering::Relaxed);
                    }
                }
            }
        }
    });
    parts.par_iter_mut().filter(|part| part.patches.iter().any(|patch| patch.mixed)).for_each(|part| {
        let Part { patches, slots, positions, shades, .. } = part;
        let before: Vec<Range<usize>> = vertex_ranges(patches).collect();
        let mut kept = 0;
        for (patch, range) in patches.iter_mut().zip(before) {
            let words = patch.mixed.then(|| &used[mixed[patch.id as usize] as usize * WORDS..][..WORDS]);
            for v in range {
                let slot = usize::from(slots[v]);
                if words.is_none_or(|words| words[slot / 64].load(Ordering::Relaxed) >> (slot % 64) & 1 == 1) {
                    (slots[kept], positions[kept], shades[kept]) = (slots[v], positions[v], shades[v]);
                    kept += 1;
                }
            }
            patch.vertices = kept as u32;
        }
        slots.truncate(kept);
        positions.truncate(kept);
        shades.truncate(kept);
    });
}

/// Where the vertices of a block are.
#[derive(Clone, Copy)]
struct Place {
    part: u32,
    /// Its share of the part's vertices.
    start: u32,
    end: u32,
    /// Number of its first vertex in the mesh.
    first: u32,
}

/// Where the vertices of each block are, by id.
struct Places {
    of_block: Vec<Place>,
}

impl Places {
    fn of(parts: &[Part], ids: usize) -> Self {
        let mut of_block = vec![Place { part: 0, start: 0, end: 0, first: 0 }; ids];
        let mut before = 0;
        for (i, part) in parts.iter().enumerate() {
            for (patch, range) in part.patches.iter().zip(vertex_ranges(&part.patches)) {
                let first = before + range.start as u32;
                of_block[patch.id as usize] = Place { part: i as u32, start: range.start as u32, end: range.end as u32, first };
            }
            before += part.slots.len() as u32;
        }
        Self { of_block }
    }

    /// Writes the triangles of `part` with numbers instead of `names`.
    fn number(&self, part: &Part, parts: &[Part], names: &[[u32; 3]], numbers: &mut [[u32; 3]]) {
        let mut own = vec![NONE; SLOTS];
        for (patch, triangles) in part.patches.iter().zip(triangle_ranges(&part.patches)) {
            let place = self.of_block[patch.id as usize];
            let slots = &part.slots[place.start as usize..place.end as usize];
            slots.iter().enumerate().for_each(|(i, &slot)| own[usize::from(slot)] = place.first + i as u32);
            let number = |packed: u32| {
                let name = Name::unpack(packed);
                if name.neighbour == CENTRE {
                    return own[usize::from(name.slot)];
                }
                let place = self.of_block[patch.neighbours[name.neighbour] as usize];
                let slots = &parts[place.part as usize].slots[place.start as usize..place.end as usize];
                let found = slots.binary_search(&name.slot);
                debug_assert!(found.is_ok(), "blocks disagree about a vertex");
                place.first + found.unwrap_or_else(|near| near) as u32
            };
            for (names, numbers) in names[triangles.clone()].iter().zip(&mut numbers[triangles]) {
                *numbers = names.map(number);
            }
        }
    }
}
