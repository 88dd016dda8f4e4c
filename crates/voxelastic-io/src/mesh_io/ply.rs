//! Writing PLY.

use super::MeshRef;
use crate::Result;
use crate::file::write_atomically;
use std::io::Write;
use std::path::Path;

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
        let mut record = Vec::with_capacity(32);
        let push = |record: &mut Vec<u8>, numbers: &[f32]| numbers.iter().for_each(|v| record.extend_from_slice(&v.to_le_bytes()));
        for (k, position) in mesh.positions.iter().enumerate() {
            record.clear();
            if mesh.has_origin() {
                position.iter().zip(mesh.origin).for_each(|(c, o)| record.extend_from_slice(&(f64::from(*c) + o).to_le_bytes()));
            } else {
                push(&mut record, position);
            }
            if let Some(normal) = mesh.normals.get(k) {
                push(&mut record, normal);
            }
            if let Some(colours) = mesh.colours {
                record.extend_from_slice(&colours[k]);
            }
            if let Some(intensity) = mesh.intensity {
                push(&mut record, &intensity[k..=k]);
            }
            w.write_all(&record)?;
        }
        for triangle in mesh.triangles {
            let mut record = [3u8; 13];
            for (slot, vertex) in record[1..].chunks_exact_mut(4).zip(triangle) {
                slot.copy_from_slice(&vertex.to_le_bytes());
            }
            w.write_all(&record)?;
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
