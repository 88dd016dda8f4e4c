//! Files of images and their times.

use super::cameras_file::DescribedCamera;
use crate::file_names::natural;
use crate::{Error, Result, text};
use std::fs;
use std::path::{Path, PathBuf};

/// Extensions of images.
const EXTENSIONS: [&str; 3] = ["jpg", "jpeg", "png"];

/// An image on disk.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ImageFile {
    /// Seconds.
    pub(super) time: f64,
    /// Index of the camera.
    pub(super) camera: usize,
    pub(super) path: PathBuf,
}

/// The images of camera `index`, described in `file`. `folder` holds them where the description names no folder.
pub(super) fn find(folder: &Path, file: &Path, camera: &DescribedCamera, index: usize) -> Result<Vec<ImageFile>> {
    let base = file.parent().unwrap_or(Path::new(""));
    let dir = match &camera.images {
        Some(images) => base.join(images),
        None => folder.to_owned(),
    };
    let names = list(&dir)?;
    if names.is_empty() {
        let remedy = "name the folder of the images in cameras.toml (images = \"..\"), relative to that file";
        return Err(Error::dataset(&dir, format!("no image of camera {} in it (.jpg, .jpeg, .png)", camera.name), remedy));
    }
    let timed = match &camera.times {
        Some(times) => by_list(&base.join(times), &names)?,
        None => by_name(&dir, names)?,
    };
    let image = |(time, name): (f64, String)| ImageFile { time: time + camera.time_offset_s, camera: index, path: dir.join(name) };
    Ok(timed.into_iter().map(image).collect())
}

/// Names of the images in a folder, in order.
fn list(dir: &Path) -> Result<Vec<String>> {
    let fail = |e| Error::io(dir, "list", e);
    let mut names = Vec::new();
    for entry in fs::read_dir(dir).map_err(fail)? {
        let name = entry.map_err(fail)?.file_name().to_string_lossy().into_owned();
        if Path::new(&name).extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known))) {
            names.push(name);
        }
    }
    names.sort_by(|a, b| natural(a, b));
    Ok(names)
}

/// Times in the names.
fn by_name(dir: &Path, names: Vec<String>) -> Result<Vec<(f64, String)>> {
    let timed = |name: String| match time_in(&name) {
        Some(time) => Ok((time, name)),
        None => {
            let remedy = "name images by their times in seconds (12.34.jpg) or nanoseconds since 1970, or name a list of times in cameras.toml (times = \"..\")";
            Err(Error::dataset(&dir.join(name), "its name is not a time", remedy))
        }
    };
    names.into_iter().map(timed).collect()
}

/// The time that a name is: seconds with a point, or a whole number since 1970 of seconds, milli-, micro- or nanoseconds.
fn time_in(name: &str) -> Option<f64> {
    let stem = name.rsplit_once('.')?.0;
    let is_number =
        !stem.is_empty() && stem.split('.').count() <= 2 && stem.split('.').all(|w| !w.is_empty() && w.bytes().all(|b| b.is_ascii_digit()));
    let number = is_number.then(|| stem.parse().ok()).flatten().map(in_seconds)?;
    (stem.contains('.') || number >= 1e8).then_some(number)
}

/// Seconds of a number that is of another unit if it is too large for seconds.
fn in_seconds(number: f64) -> f64 {
    match number {
        n if n >= 1e17 => n * 1e-9,
        n if n >= 1e14 => n * 1e-6,
        n if n >= 1e11 => n * 1e-3,
        n => n,
    }
}

/// Times in a list: a line for each image in their order, or lines with a time and a name in any order. Images that are not named are left out.
fn by_list(path: &Path, names: &[String]) -> Result<Vec<(f64, String)>> {
    let content = text::read(path)?;
    let (mut times, mut named) = (Vec::new(), Vec::new());
    for line in text::lines(path, &content) {
        let words: Vec<&str> = line.words().collect();
        match words[..] {
            [time] => times.push(in_seconds(line.number(time, "time")?)),
            // A head names the columns.
            [first, second] if !is_image(first) && !is_image(second) && first.parse::<f64>().is_err() => {}
            [first, second] => {
                let (time, name) = if is_image(first) { (second, first) } else { (first, second) };
                if !names.iter().any(|known| known == name) {
                    return Err(line.error(format!("there is no image {:?}", text::short(name)), "correct the name, or remove the line"));
                }
                named.push((in_seconds(line.number(time, "time")?), name.to_owned()));
            }
            _ => return Err(line.error("neither a time nor a time and the name of an image", "write one time, or a time and a name, on each line")),
        }
    }
    if named.is_empty() && times.len() == names.len() {
        return Ok(times.into_iter().zip(names.iter().cloned()).collect());
    }
    if !times.is_empty() || named.is_empty() {
        let problem = format!("{} times for {} images", times.len(), names.len());
        return Err(Error::dataset(path, problem, "give one time for each image, in the order of their names, or lines with a time and a name"));
    }
    Ok(named)
}

fn is_image(word: &str) -> bool {
    Path::new(word).extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_times_in_seconds_or_nanoseconds() {
        let near = |name: &str, time: f64| time_in(name).is_some_and(|t| (t - time).abs() < 1e-6);
        assert!(near("12.340.jpg", 12.34) && near("1700000000.5.png", 1_700_000_000.5) && near("1700000000500000000.jpeg", 1_700_000_000.5));
        assert!(near("1700000000.png", 1_700_000_000.0) && near("0.0.png", 0.0));
        assert!(["000012.png", "front.png", ".png", "-1.0.png", "1.2.3.png", "front_1.5.png"].iter().all(|name| time_in(name).is_none()));
    }
}
