//! Triangle meshes out of PLY files.

use super::header::{self, Element, Encoding, Header, Property};
use super::vertices::{Cursor, Rows, TRUNCATED, fields, rows};
use crate::points::{Column, Field, FieldRoles, points};
use crate::{Error, Result, file};
use std::path::Path;

/// A triangle mesh as read from a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshData {
    /// Vertex positions, metres.
    pub positions: Vec<[f32; 3]>,
    /// Normals per vertex (`nx ny nz`).
    pub normals: Option<Vec<[f32; 3]>>,
    /// Red, green and blue per vertex.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Strength of return per vertex.
    pub intensity: Option<Vec<f32>>,
    /// Vertex indices of each triangle; all below the number of vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// Reads a mesh. Faces with more than three corners become fans of triangles; a file without faces gives none.
///
/// # Errors
/// [`Error::Content`] if the file breaks the format, is shorter than its header claims or has a face of a vertex that does
/// not exist; [`Error::Io`].
pub fn read_mesh(path: impl AsRef<Path>) -> Result<MeshData> {
    parse_mesh(&file::read(path.as_ref())?, path.as_ref())
}

/// Decodes a mesh from the bytes of a file; `path` is for messages only.
///
/// # Errors
/// As [`read_mesh`], without [`Error::Io`].
pub fn parse_mesh(bytes: &[u8], path: &Path) -> Result<MeshData> {
    let header = header::parse(bytes, path)?;
    let mut cursor = Cursor::after(&header, bytes, path);
    let mut elements = header.elements.iter();
    let vertex = cursor.seek(&header, &mut elements, "vertex")?;
    let fields = fields(vertex, path)?;
    let mut mesh = MeshData::default();
    if let Some(vertex) = vertex {
        mesh = vertices(&mut cursor, vertex, &header, &fields)?;
    }
    if let Some(face) = cursor.seek(&header, &mut elements, "face")? {
        faces(&mut cursor, face, header.encoding, &mut mesh)?;
    }
    Ok(mesh)
}

fn vertices(cursor: &mut Cursor<'_>, vertex: &Element, header: &Header, fields: &[Field]) -> Result<MeshData> {
    let roles = FieldRoles::of(fields, cursor.path)?;
    let find = |names: [&str; 3]| -> Option<[&Field; 3]> {
        let [a, b, c] = names.map(|n| fields.iter().find(|f| f.name == n));
        Some([a?, b?, c?])
    };
    let normals = find(["nx", "ny", "nz"]);
    let wanted: Vec<&Field> = roles.fields(fields).into_iter().chain(normals.into_iter().flatten()).collect();
    let rows: Rows<'_> = rows(cursor, vertex, header.encoding, &wanted)?;
    Ok(MeshData {
        positions: points(roles.xyz.map(|k| rows.column(&fields[k]))),
        normals: normals.map(|n| points(n.map(|f| rows.column(f)))),
        colours: roles.colour.and_then(|colour| colour.read(fields, |k| rows.column(&fields[k]))),
        intensity: roles.intensity.map(|k| rows.column(&fields[k]).to_f32()),
        triangles: Vec::new(),
    })
}

fn faces(cursor: &mut Cursor<'_>, face: &Element, encoding: Encoding, mesh: &mut MeshData) -> Result<()> {
    let is_corners = |p: &Property| p.list.is_some() && (p.name == "vertex_indices" || p.name == "vertex_index");
    let mut corners: Vec<f64> = Vec::new();
    if face.properties.is_empty() {
        return Ok(()); // rows of nothing, of which a header can claim any number
    }
    for row in 0..face.count {
        let at = cursor.position(encoding);
        corners.clear();
        match encoding {
            Encoding::Binary { big_endian } => {
                for property in &face.properties {
                    let taken = match property.list {
                        None => cursor.take(property.scalar.size()).map(|_| ()),
                        Some(length) => cursor.take_list(length, property, big_endian).map(|(len, bytes)| {
                            if is_corners(property) {
                                corners.extend(Column { bytes, stride: property.scalar.size(), len, scalar: property.scalar, big_endian }.to_f64());
                            }
                        }),
                    };
                    taken.ok_or_else(|| cursor.ends(encoding, face, row))?;
                }
            }
            Encoding::Text => {
                let line = cursor.take_line().ok_or_else(|| cursor.ends(encoding, face, row))?;
                let numbers = text_corners(line, face, is_corners);
                corners = numbers.ok_or_else(|| Error::content(cursor.path, at.clone(), "the line does not hold what the header says", TRUNCATED))?;
            }
        }
        let vertices = mesh.positions.len();
        if let Some(bad) = corners.iter().find(|c| !(**c >= 0.0 && **c < vertices as f64 && c.fract() == 0.0)) {
            let problem = format!("face {row} names vertex {bad}, but there are {vertices} vertices");
            return Err(Error::content(cursor.path, at, problem, TRUNCATED));
        }
        mesh.triangles.extend(corners.windows(2).skip(1).map(|pair| [corners[0] as u32, pair[0] as u32, pair[1] as u32]));
    }
    Ok(())
}

/// The corners on a line of a text file.
fn text_corners(line: &[u8], face: &Element, is_corners: impl Fn(&Property) -> bool) -> Option<Vec<f64>> {
    let mut words = std::str::from_utf8(line).ok()?.split_ascii_whitespace();
    let mut corners = Vec::new();
    for property in &face.properties {
        let count: usize = if property.list.is_some() { words.next()?.parse().ok()? } else { 1 };
        for _ in 0..count {
            let word = words.next()?;
            if is_corners(property) {
                corners.push(word.parse().ok()?);
            }
        }
    }
    Some(corners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Position;

    const SQUARE: &str = "ply\nformat ascii 1.0\nelement camera 1\nproperty float f\nelement vertex 4\nproperty double x\nproperty double y\nproperty double z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n\
        9\n0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0 255 0 9\n7 4 0 1 2 3\n";

    #[test]
    fn a_quad_becomes_two_triangles() {
        let mesh = parse_mesh(SQUARE.as_bytes(), Path::new("a.ply")).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[2], [1.0, 1.0, 0.0]);
        assert_eq!(mesh.colours.unwrap()[3], [255, 0, 9]);
        assert_eq!(mesh.normals, None);
    }

    #[test]
    fn a_face_of_a_missing_vertex_is_located() {
        let error = parse_mesh(SQUARE.replace("7 4 0 1 2 3", "7 4 0 1 2 4").as_bytes(), Path::new("a.ply")).unwrap_err();
        assert!(error.to_string().contains("face 0 names vertex 4"), "{error}");
        assert_eq!(error.position(), Position::line(21));
    }
}
