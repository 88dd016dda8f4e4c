//! A tile with its mesh and all tiles below it, on the way to the next level.

use super::Cell;
use super::tileset::Node;
use crate::{Error, Position, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;
use voxelastic::surface::Mesh;

const MAGIC: &[u8; 8] = b"VXTPART1";
/// Compression level of stored parts.
const LEVEL: i32 = 3;

/// A tile whose file, and those of all tiles below it, are written: what the next level is made of. It can be stored, so that the parts of a large map are made by
/// different processes.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    pub(super) cell: Cell,
    pub(super) mesh: Mesh,
    pub(super) node: Node,
    pub(super) files: Vec<String>,
}

/// What comes before the arrays.
#[derive(Serialize, Deserialize)]
struct Head {
    level: u8,
    coordinates: [u32; 3],
    vertices: usize,
    triangles: usize,
    has_colours: bool,
    node: Node,
    files: Vec<String>,
}

impl Part {
    /// Its place in the octree.
    pub fn cell(&self) -> Cell {
        self.cell
    }

    /// Names of all its files in the folder `content` of the tiles.
    pub fn files(&self) -> &[String] {
        &self.files
    }

    /// The part as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let Mesh { positions, normals, colours, triangles, .. } = &self.mesh;
        let has_colours = !colours.is_empty();
        let (vertices, count) = (positions.len(), triangles.len());
        let (node, files) = (self.node.clone(), self.files.clone());
        let head = Head { level: self.cell.level, coordinates: self.cell.coordinates(), vertices, triangles: count, has_colours, node, files };
        let head = serde_json::to_vec(&head).unwrap_or_default();
        let mut content = (head.len() as u64).to_le_bytes().to_vec();
        content.extend(head);
        let arrays: [&[u8]; 4] =
            [bytemuck::cast_slice(positions), bytemuck::cast_slice(normals), bytemuck::cast_slice(triangles), bytemuck::cast_slice(colours)];
        arrays.iter().for_each(|array| content.extend_from_slice(array));
        let mut bytes = MAGIC.to_vec();
        bytes.extend(crc32fast::hash(&content).to_le_bytes());
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend(zstd::bulk::compress(&content, LEVEL).unwrap_or_default());
        bytes
    }

    /// A part from bytes; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Content`] if they are damaged.
    pub fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self> {
        Self::parse(bytes).ok_or_else(|| {
            Error::content(path, Position::File, "no tiles that a map was being made of, or damaged".to_owned(), "remove it and run again")
        })
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        let rest = bytes.strip_prefix(MAGIC)?;
        let (crc32, rest) = rest.split_first_chunk::<4>()?;
        let (length, packed) = rest.split_first_chunk::<8>()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        // No packing of such arrays is a thousand times smaller.
        let content = zstd::bulk::decompress(packed, length.min(packed.len().saturating_mul(1000))).ok()?;
        if content.len() != length || crc32fast::hash(&content) != u32::from_le_bytes(*crc32) {
            return None;
        }
        let (head, mut rest) = content.split_first_chunk::<8>()?;
        let head = rest.split_off(..usize::try_from(u64::from_le_bytes(*head)).ok()?)?;
        let head: Head = serde_json::from_slice(head).ok()?;
        let positions = take::<[f32; 3]>(&mut rest, head.vertices)?;
        let normals = take::<[f32; 3]>(&mut rest, head.vertices)?;
        let triangles = take::<[u32; 3]>(&mut rest, head.triangles)?;
        let colours = take::<[u8; 3]>(&mut rest, if head.has_colours { head.vertices } else { 0 })?;
        let is_whole = rest.is_empty() && triangles.iter().flatten().all(|v| (*v as usize) < head.vertices);
        let mesh = Mesh { positions, normals, triangles, colours, ..Mesh::default() };
        let cell = Cell::new(head.level, head.coordinates)?;
        is_whole.then_some(Self { cell, mesh, node: head.node, files: head.files })
    }
}

fn take<T: bytemuck::AnyBitPattern>(rest: &mut &[u8], count: usize) -> Option<Vec<T>> {
    let bytes = rest.split_off(..count.checked_mul(size_of::<T>())?)?;
    Some(bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect())
}
