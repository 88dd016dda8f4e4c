//! Writing PCD.

use crate::file::write_atomically;
use crate::{Error, Result};
use std::io::Write;
use std::path::Path;
use voxelastic::Cloud;

/// Writes a cloud as binary PCD 0.7, atomically.
///
/// Fields are `x y z` (f32, metres) and, where the cloud has them, `intensity` (f32), `rgb` (packed, as PCL does), `time` (f32,
/// seconds, the name and unit of Velodyne drivers) and `ring` (u16). An organised cloud keeps its width and height, no-returns included.
///
/// # Errors
/// [`Error::Unwritable`] if a channel differs in length from the points or the grid does not match them;
/// [`Error::Io`] if the disk refuses.
pub fn write(path: impl AsRef<Path>, cloud: &Cloud) -> Result<()> {
    write_fields(path.as_ref(), cloud, None, [0.0; 3])
}

/// Writes a cloud whose points lie on a surface: as [`write()`], with the unit normal of each point as `normal_x normal_y normal_z`. What is not zero of
/// `origin` is added to all coordinates, which are f64 then.
///
/// # Errors
/// As [`write()`].
pub fn write_with_normals(path: impl AsRef<Path>, cloud: &Cloud, normals: &[[f32; 3]], origin: [f64; 3]) -> Result<()> {
    write_fields(path.as_ref(), cloud, Some(normals), origin)
}

fn write_fields(path: &Path, cloud: &Cloud, normals: Option<&[[f32; 3]]>, origin: [f64; 3]) -> Result<()> {
    let n = cloud.len();
    let lengths = [
        ("the normal", normals.map(<[_]>::len)),
        ("intensity", cloud.intensity.as_ref().map(Vec::len)),
        ("rgb", cloud.colours.as_ref().map(Vec::len)),
        ("time", cloud.time.as_ref().map(Vec::len)),
        ("ring", cloud.ring.as_ref().map(Vec::len)),
    ];
    for (name, length) in lengths {
        if let Some(length) = length.filter(|&l| l != n) {
            return Err(Error::unwritable(path, format!("{length} values of {name} for {n} points")));
        }
    }
    if cloud.width.checked_mul(cloud.height) != Some(n) {
        return Err(Error::unwritable(path, format!("a grid of {} x {} for {n} points", cloud.width, cloud.height)));
    }
    write_atomically(path, |w| {
        let is_far = origin != [0.0; 3];
        w.write_all(header(cloud, normals.is_some(), is_far).as_bytes())?;
        let mut record = Vec::with_capacity(50);
        for i in 0..n {
            record.clear();
            for (c, from) in cloud.points[i].iter().zip(origin) {
                if is_far {
                    record.extend_from_slice(&(f64::from(*c) + from).to_le_bytes());
                } else {
                    record.extend_from_slice(&c.to_le_bytes());
                }
            }
            if let Some(v) = normals {
                v[i].iter().for_each(|c| record.extend_from_slice(&c.to_le_bytes()));
            }
            if let Some(v) = &cloud.intensity {
                record.extend_from_slice(&v[i].to_le_bytes());
            }
            if let Some(v) = &cloud.colours {
                let [r, g, b] = v[i];
                record.extend_from_slice(&[b, g, r, 0]);
            }
            if let Some(v) = &cloud.time {
                record.extend_from_slice(&v[i].to_le_bytes());
            }
            if let Some(v) = &cloud.ring {
                record.extend_from_slice(&v[i].to_le_bytes());
            }
            w.write_all(&record)?;
        }
        Ok(())
    })
}

fn header(cloud: &Cloud, has_normals: bool, is_far: bool) -> String {
    let (mut fields, mut sizes, mut types, mut counts) =
        ("x y z".to_owned(), if is_far { "8 8 8" } else { "4 4 4" }.to_owned(), "F F F".to_owned(), "1 1 1".to_owned());
    let mut add = |present: bool, field: &str, size: &str, kind: &str| {
        if present {
            for (list, word) in [(&mut fields, field), (&mut sizes, size), (&mut types, kind), (&mut counts, "1")] {
                list.push(' ');
                list.push_str(word);
            }
        }
    };
    ["normal_x", "normal_y", "normal_z"].iter().for_each(|field| add(has_normals, field, "4", "F"));
    add(cloud.intensity.is_some(), "intensity", "4", "F");
    add(cloud.colours.is_some(), "rgb", "4", "F");
    add(cloud.time.is_some(), "time", "4", "F");
    add(cloud.ring.is_some(), "ring", "2", "U");
    format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {}\nHEIGHT {}\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {}\nDATA binary\n",
        cloud.width,
        cloud.height,
        cloud.len()
    )
}
