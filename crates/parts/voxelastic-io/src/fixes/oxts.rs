//! The fixes of a KITTI raw drive: `oxts/data/NNNNNNNNNN.txt` with `oxts/timestamps.txt`. Layout from the development kit's `dataformat.txt`.

use crate::file_names::natural;
use crate::folders::read_dates;
use crate::text::{self, lines};
use crate::{Error, Position, Result};
use std::path::{Path, PathBuf};
use voxelastic_earth::{Fix, Fixes, Geodetic, Place, covariance_of};

/// Place of `pos_accuracy` among the numbers of a line.
const ACCURACY: usize = 23;

pub(super) fn read(folder: &Path) -> Result<Fixes> {
    let data = folder.join("data");
    let entries = std::fs::read_dir(&data).map_err(|e| Error::io(&data, "list", e))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|e| e.ok().map(|e| e.path())).filter(|p| p.extension().is_some_and(|e| e == "txt")).collect();
    files.sort_by(|a, b| natural(&a.to_string_lossy(), &b.to_string_lossy()));
    let times = read_dates(&folder.join("timestamps.txt"))?;
    let mut out = Fixes::default();
    for file in &files {
        let read = text::read(file)?;
        let wrong = |problem: &str| Error::content(file, Position::line(1), problem, "download the drive again");
        let number: usize = file.file_stem().and_then(|s| s.to_str()?.parse().ok()).ok_or_else(|| wrong("the file's name is not a number"))?;
        let time = times.get(number).ok_or_else(|| wrong("timestamps.txt has no time of it"))?;
        let line = lines(file, &read).next().ok_or_else(|| wrong("the file is empty"))?;
        let [latitude, longitude, height] = line.numbers(line.words().take(3), &["latitude", "longitude", "altitude"])?;
        let accuracy = line.words().nth(ACCURACY).and_then(|word| word.parse::<f64>().ok()).unwrap_or(0.0);
        let place = Place::Geodetic(Geodetic { latitude, longitude, height });
        out.all.push(Fix { time: Some(*time), place, covariance: covariance_of([accuracy, accuracy, 2.0 * accuracy]), name: None, seen_at: None });
    }
    out.notes.push("KITTI does not say what its heights count from, nor in which time zone its times are: they are those of its clouds".into());
    Ok(out)
}
