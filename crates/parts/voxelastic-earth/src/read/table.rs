//! Tables: a line of names of columns and a line for each fix; or numbers without names, `time x y z`, with three standard deviations or a quaternion after them.

use crate::fix::covariance_of;
use crate::{EarthError, Fix, Fixes, Geodetic, Heights, Place};
use nalgebra::Vector3;

const NAMES: &str = "name the columns in the first line: time or name; latitude, longitude, height, or east, north, up; sigma, or sigma_east, sigma_north, sigma_up; \
    and map_x, map_y, map_z of a control point that was picked";

/// What a column may be called.
const COLUMNS: [(&str, &[&str]); 14] = [
    ("time", &["time", "timestamp", "t", "stamp", "time_s", "seconds"]),
    ("name", &["name", "id", "point", "label"]),
    ("latitude", &["latitude", "lat", "latitude_deg"]),
    ("longitude", &["longitude", "lon", "lng", "long", "longitude_deg"]),
    ("height", &["height", "altitude", "alt", "up", "z", "h", "elevation", "ellipsoidal_height"]),
    ("east", &["east", "easting", "x", "e"]),
    ("north", &["north", "northing", "y", "n"]),
    ("sigma", &["sigma", "std", "accuracy", "sd"]),
    ("sigma_east", &["sigma_east", "sigma_e", "sde", "std_x", "sigma_x"]),
    ("sigma_north", &["sigma_north", "sigma_n", "sdn", "std_y", "sigma_y"]),
    ("sigma_up", &["sigma_up", "sigma_u", "sdu", "std_z", "sigma_z"]),
    ("map_x", &["map_x", "mx"]),
    ("map_y", &["map_y", "my"]),
    ("map_z", &["map_z", "mz"]),
];

pub(super) fn read(text: &str) -> Result<Fixes, EarthError> {
    let mut lines = text.lines().enumerate().map(|(k, line)| (k + 1, line.trim())).filter(|(_, line)| !line.is_empty()).peekable();
    let Some((number, first)) = lines.peek().copied() else { return Err(EarthError::new("the file is empty", NAMES)) };
    let columns = match named(first) {
        Some(columns) => {
            lines.next();
            columns
        }
        None => unnamed(number, words(first).count())?,
    };
    let mut out = Fixes::default();
    for (number, line) in lines.filter(|(_, line)| !line.starts_with('#')) {
        out.all.push(Row { number, words: words(line).collect(), columns: &columns }.fix()?);
    }
    let known = |column: &str| columns.contains(&Some(column));
    if known("ellipsoidal_height") {
        out.heights = Heights::Ellipsoid;
    }
    if out.all.iter().any(|fix| fix.covariance.is_none()) {
        out.notes.push("standard deviations are missing or 0".into());
    }
    Ok(out)
}

fn words(line: &str) -> impl Iterator<Item = &str> {
    let separators: &[char] = if line.contains(';') {
        &[';']
    } else if line.contains(',') {
        &[',']
    } else {
        &[' ', '\t']
    };
    let keeps_empty = separators.len() == 1;
    line.split(separators).map(str::trim).filter(move |word| keeps_empty || !word.is_empty())
}

/// The columns of a line of names; none of a line of numbers.
fn named(line: &str) -> Option<Vec<Option<&'static str>>> {
    let line = line.trim_start_matches('#').trim();
    if words(line).next()?.parse::<f64>().is_ok() {
        return None;
    }
    let column = |word: &str| {
        let word = word.to_ascii_lowercase();
        COLUMNS.iter().find(|(_, names)| names.contains(&word.as_str())).map(|(name, _)| *name)
    };
    let columns: Vec<_> = words(line).map(column).collect();
    (columns.iter().flatten().count() >= 3).then_some(columns)
}

/// The columns of numbers without names.
fn unnamed(line: usize, count: usize) -> Result<Vec<Option<&'static str>>, EarthError> {
    let mut columns = vec![Some("time"), Some("east"), Some("north"), Some("height")];
    match count {
        4 => {}
        7 => columns.extend([Some("sigma_east"), Some("sigma_north"), Some("sigma_up")]),
        // TUM: the quaternion of a trajectory of RTK says nothing of where it was.
        8 => columns.extend([None; 4]),
        _ => return Err(EarthError::line(line, format!("{count} columns without names"), NAMES)),
    }
    Ok(columns)
}

struct Row<'a> {
    number: usize,
    words: Vec<&'a str>,
    columns: &'a [Option<&'static str>],
}

impl Row<'_> {
    fn word(&self, name: &str) -> Option<&str> {
        let column = self.columns.iter().position(|c| *c == Some(name))?;
        self.words.get(column).copied().filter(|word| !word.is_empty())
    }

    fn number(&self, name: &str) -> Result<Option<f64>, EarthError> {
        let parse = |word: &str| word.parse().map_err(|_| EarthError::line(self.number, format!("{name} is {word:?}, which is no number"), NAMES));
        self.word(name).map(parse).transpose()
    }

    fn three(&self, names: [&str; 3]) -> Result<Option<[f64; 3]>, EarthError> {
        let [a, b, c] = [self.number(names[0])?, self.number(names[1])?, self.number(names[2])?];
        Ok(a.zip(b).zip(c).map(|((a, b), c)| [a, b, c]))
    }

    fn fix(&self) -> Result<Fix, EarthError> {
        let place = match (self.three(["latitude", "longitude", "height"])?, self.three(["east", "north", "height"])?) {
            (Some([latitude, longitude, height]), _) => Place::Geodetic(Geodetic { latitude, longitude, height }),
            (None, Some(point)) => Place::Projected(point),
            (None, None) => return Err(EarthError::line(self.number, "no place: three coordinates are needed", NAMES)),
        };
        let sigmas = match (self.three(["sigma_east", "sigma_north", "sigma_up"])?, self.number("sigma")?) {
            (Some(three), _) => Some(three),
            (None, one) => one.map(|s| [s; 3]),
        };
        let time = self.number("time")?.map(|time| if time > 1e17 { time * 1e-9 } else { time });
        let seen_at = self.three(["map_x", "map_y", "map_z"])?.map(Vector3::from);
        Ok(Fix { time, place, covariance: sigmas.and_then(covariance_of), name: self.word("name").map(str::to_owned), seen_at })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_with_and_without_names() {
        let control = "name, easting, northing, height, sigma, map_x, map_y, map_z\nP1, 691650.37, 5334754.25, 519.3, 0.01, 1, 2, 3\nP2,691660.37,5334754.25,519.3,0.01,,,\n";
        let fixes = read(control).unwrap().all;
        assert_eq!((fixes[0].name.as_deref(), fixes[0].seen_at, fixes[1].seen_at), (Some("P1"), Some(Vector3::new(1.0, 2.0, 3.0)), None));
        assert_eq!((fixes[0].place, fixes[0].time), (Place::Projected([691_650.37, 5_334_754.25, 519.3]), None));
        let seven = read("1746076987.99 -269.5 -260.7 34.7 0 0 0\n1746076988.99 -269.5 -260.7 34.7 0.1 0.1 0.2\n").unwrap();
        assert_eq!((seven.all[0].covariance, seven.all[1].sigmas().map(|s| s[2])), (None, Some(0.2)));
        assert!(seven.notes[0].contains("missing"));
        let tum = read("# time x y z qx qy qz qw\n1.5 10 20 30 0 0 0 1\n").unwrap();
        assert_eq!((tum.all[0].time, tum.all[0].place), (Some(1.5), Place::Projected([10.0, 20.0, 30.0])));
        let wrong = |text: &str| read(text).unwrap_err().to_string();
        assert!(wrong("1 2 3\n").contains("3 columns") && wrong("").contains("empty"));
        assert!(wrong("time,lat,lon,height\n1,48,x,5\n").contains("line 2") && wrong("time,lat,lon\n1,48,11\n").contains("no place"));
    }
}
