//! Writing PLY.

use super::mesh_ref::MeshRef;
use crate::Result;
use crate::file::write_atomically;
use std::io::Write;
use std::path::Path;

/// Vertices or triangles that are encoded at a time.
const RECORDS_AT_ONCE: usize = 4096;

/// Writes a mesh as binary little-endian PLY, atomically: `x y z`, then where present `nx ny nz`, `red green blue`
/// and `intensity`; triangles as lists of `uint`. A mesh without triangles is a cloud. With an origin, positions are in double precision, and a
/// comment has the origin.
///
/// # Errors
/// [`crate::Error::Unwritable`] if array lengths differ, a position is not finite or a triangle names a missing vertex;
/// [`crate::Error::Io`] if the disk refuses.
pub fn write_ply(path: impl AsRef<Path>, mesh: &MeshRef<'_>) -> Result<()> {
    let path = path.as_ref();
    mesh.check(path)?;
    write_atomically(path, |w| {
        w.write_all(header(mesh).as_bytes())?;
        let mut records = Vec::with_capacity(RECORDS_AT_ONCE * 48);
        let numbers = |records: &mut Vec<u8>, numbers: &[f32]| numbers.iter().for_each(|v| records.extend_from_slice(&v.to_le_bytes()));
        for first in (0..mesh.positions.len()).step_by(RECORDS_AT_ONCE) {
            records.clear();
            for k in first..mesh.positions.len().min(first + RECORDS_AT_ONCE) {
                if mesh.has_origin() {
                    mesh.positions[k].iter().zip(mesh.origin).for_each(|(c, o)| records.extend_from_slice(&(f64::from(*c) + o).to_le_bytes()));
                } else {
                    numbers(&mut records, &mesh.positions[k]);
                }
                if let Some(normal) = mesh.normals.get(k) {
                    numbers(&mut records, normal);
                }
                if let Some(colours) = mesh.colours {
                    records.extend_from_slice(&colours[k]);
                }
                if let Some(intensity) = mesh.intensity {
                    numbers(&mut records, &intensity[k..=k]);
                }
            }
            w.write_all(&records)?;
        }
        for triangles in mesh.triangles.chunks(RECORDS_AT_ONCE) {
            records.clear();
            for triangle in triangles {
                let mut record = [3u8; 13];
                for (slot, vertex) in record[1..].as_chunks_mut::<4>().0.iter_mut().zip(triangle) {
                    *slot = vertex.to_le_bytes();
                }
                records.extend_from_slice(&record);
            }
            w.write_all(&records)?;
        }
        Ok(())
    })
}

fn header(mesh: &MeshRef<'_>) -> String {
    let mut header = format!("ply\nformat binary_little_endian 1.0\ncomment metres, z up\n{}element vertex {}\n", origin(mesh), mesh.positions.len());
    let mut properties = |present: bool, kind: &str, names: &[&str]| {
        for name in names.iter().filter(|_| present) {
            header.push_str(&format!("property {kind} {name}\n"));
        }
    };
    properties(true, if mesh.has_origin() { "double" } else { "float" }, &["x", "y", "z"]);
    properties(!mesh.normals.is_empty(), "float", &["nx", "ny", "nz"]);
    properties(mesh.colours.is_some(), "uchar", &["red", "green", "blue"]);
    properties(mesh.intensity.is_some(), "float", &["intensity"]);
    header.push_str(&format!("element face {}\nproperty list uchar uint vertex_indices\nend_header\n", mesh.triangles.len()));
    header
}

fn origin(mesh: &MeshRef<'_>) -> String {
    let [x, y, z] = mesh.origin;
    if mesh.has_origin() { format!("comment origin of the map {x} {y} {z}, which is added to all positions\n") } else { String::new() }
}
