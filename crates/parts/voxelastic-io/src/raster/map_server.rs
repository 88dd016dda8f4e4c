//! 2-D maps as ROS' `map_server` and Nav2 load them: an image, and a file of YAML with its resolution and origin.
//!
//! The rules are those of `map_server` (<https://wiki.ros.org/map_server>): with `negate: 0`, a pixel of brightness x is occupied with p = (255 - x) / 255.
//!
//! | mode | image | occupied | free | unknown | costs |
//! | --- | --- | --- | --- | --- | --- |
//! | `trinary` | PGM | 0: p above `occupied_thresh` | 254: p below `free_thresh` | 205: between them | none |
//! | `scale` | PNG, grey with alpha | 0 | 255 | transparent | between the thresholds |
//! | `raw` | PGM | 100 | 0 | 255 | 1 to 99 |

use super::Raster;
use crate::Result;
use crate::file::write_atomically;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// How values become pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Occupied, free or unknown.
    #[default]
    Trinary,
    /// With costs, as shades between.
    Scale,
    /// With costs, as they are.
    Raw,
}

impl Mode {
    /// All, by name.
    pub const ALL: [(&'static str, Self); 3] = [("trinary", Self::Trinary), ("scale", Self::Scale), ("raw", Self::Raw)];

    fn name(self) -> &'static str {
        Self::ALL.iter().find(|(_, mode)| *mode == self).map_or("", |(name, _)| name)
    }

    /// Ending of the image.
    fn ending(self) -> &'static str {
        if self == Self::Scale { "png" } else { "pgm" }
    }
}

/// Value of an unknown cell; others are costs: 0 free, 100 occupied.
pub const UNKNOWN: i8 = -1;
const OCCUPIED_THRESHOLD: f64 = 0.65;
const FREE_THRESHOLD: f64 = 0.196;

/// Writes a map: the YAML at `yaml`, and the image beside it, whose path it returns. Both have the same stem; the image is there before the YAML is.
///
/// `values` are row by row from the smallest y, as in `nav_msgs/OccupancyGrid`: 0 free, 100 occupied, costs between, [`UNKNOWN`].
///
/// # Errors
/// [`Error::Io`](crate::Error::Io) if the disk refuses.
pub fn write(yaml: &Path, raster: &Raster, values: &[i8], mode: Mode) -> Result<PathBuf> {
    let image = yaml.with_extension(mode.ending());
    write_atomically(&image, |out| match mode {
        Mode::Trinary => write_pgm(out, raster, values, trinary),
        Mode::Raw => write_pgm(out, raster, values, |value| if value < 0 { 255 } else { value as u8 }),
        Mode::Scale => write_png(out, raster, values),
    })?;
    let name = image.file_name().unwrap_or_default().to_string_lossy();
    let [x, y] = raster.origin;
    write_atomically(yaml, |out| {
        writeln!(out, "image: {}\nmode: {}\nresolution: {}\norigin: [{x}, {y}, 0]", quoted(&name), mode.name(), raster.pixel)?;
        writeln!(out, "negate: 0\noccupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}")
    })?;
    Ok(image)
}

/// A name as a string of YAML.
fn quoted(name: &str) -> String {
    let is_plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c)) && name.starts_with(|c: char| c.is_ascii_alphabetic());
    if is_plain { name.to_owned() } else { format!("\"{}\"", name.replace('\\', "\\\\").replace('"', "\\\"")) }
}

fn trinary(value: i8) -> u8 {
    match value {
        100.. => 0,
        0.. => 254,
        _ => 205,
    }
}

fn write_pgm(out: &mut impl Write, raster: &Raster, values: &[i8], pixel: impl Fn(i8) -> u8) -> io::Result<()> {
    write!(out, "P5\n# made by voxelastic\n{} {}\n255\n", raster.size[0], raster.size[1])?;
    for row in raster.rows_down(values) {
        let pixels: Vec<u8> = row.iter().map(|value| pixel(*value)).collect();
        out.write_all(&pixels)?;
    }
    Ok(())
}

/// Brightness of a cost: `map_server` reads costs 1 to 99 from the shades between the thresholds.
fn shade(value: i8) -> u8 {
    match value {
        100.. => 0,
        1.. => {
            let share = (f64::from(value) - 1.0) / 98.0;
            let p = FREE_THRESHOLD + (share * 0.98 + 0.01) * (OCCUPIED_THRESHOLD - FREE_THRESHOLD);
            (255.0 * (1.0 - p)).round() as u8
        }
        _ => 255,
    }
}

fn write_png(out: &mut impl Write, raster: &Raster, values: &[i8]) -> io::Result<()> {
    let pixels: Vec<u8> = raster.rows_down(values).flatten().flat_map(|value| if *value < 0 { [205, 0] } else { [shade(*value), 255] }).collect();
    let [width, height] = raster.size.map(|n| n as u32);
    PngEncoder::new(out).write_image(&pixels, width, height, ExtendedColorType::La8).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_quoted_where_yaml_needs_it() {
        assert_eq!(quoted("map_0.pgm"), "map_0.pgm");
        assert_eq!(quoted("my \"map\": 1.pgm"), "\"my \\\"map\\\": 1.pgm\"");
        assert_eq!(quoted("0.pgm"), "\"0.pgm\"");
    }

    #[test]
    fn rows_are_written_from_the_top() {
        let folder = tempfile::tempdir().unwrap();
        let raster = Raster { size: [2, 3], pixel: 0.5, origin: [-1.0, 2.0] };
        let image = write(&folder.path().join("m.yaml"), &raster, &[0, 100, UNKNOWN, 7, 99, 100], Mode::Raw).unwrap();
        let bytes = std::fs::read(image).unwrap();
        assert!(bytes.ends_with(b"\n2 3\n255\n\x63\x64\xff\x07\x00\x64"), "{bytes:?}");
    }
}
