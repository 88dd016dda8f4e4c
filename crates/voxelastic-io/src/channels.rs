//! What the fields of a point record mean, under the names that drivers and LIO systems give them.

use crate::colours::ColourFields;
use crate::record::{self, Column, Field, Scalar};
use crate::{Error, Position, Result, StampedCloud};
use std::path::Path;
use voxelastic::Cloud;

/// Names of return strength, the first that is present wins. `scalar_*` is CloudCompare's.
const INTENSITY: [&str; 7] = ["intensity", "reflectivity", "scalar_intensity", "i", "remission", "reflectance", "scalar_reflectivity"];
/// Names of the ring.
const RING: [&str; 8] = ["ring", "channel", "line", "laser_id", "laser", "row", "beam", "scalar_ring"];
/// Names of the time of a point: Ouster `t`, Velodyne `time`, Livox `offset_time`, Hesai and RoboSense `timestamp`.
/// FAST-LIO keeps milliseconds in the field that elsewhere is the curvature of the surface: last.
const TIME: [&str; 8] = ["t", "time", "offset_time", "timestamp", "time_offset", "time_stamp", "scalar_time", CURVATURE];
const CURVATURE: &str = "curvature";

/// A coordinate beyond this is no measurement of a lidar, and single precision could not hold it to the centimetre.
const FAR: f32 = 1e6;
/// No sweep takes longer, seconds.
const LONGEST_SWEEP: f64 = 60.0;
/// Times beyond this are not relative to the sweep they belong to, seconds.
const LARGEST_RELATIVE: f64 = 2.0;

/// Whether a field of this name holds the times of points.
pub(crate) fn is_time(name: &str) -> bool {
    TIME.iter().any(|t| name.eq_ignore_ascii_case(t))
}

/// Which field plays which part, as indices into the fields.
#[derive(Clone, Debug)]
pub(crate) struct Roles {
    pub(crate) xyz: [usize; 3],
    pub(crate) intensity: Option<usize>,
    pub(crate) ring: Option<usize>,
    pub(crate) time: Option<usize>,
    pub(crate) colour: Option<ColourFields>,
}

impl Roles {
    /// Finds the parts by name, regardless of case.
    pub(crate) fn of(fields: &[Field], path: &Path) -> Result<Self> {
        let find = |name: &str| fields.iter().position(|f| f.count == 1 && f.name.eq_ignore_ascii_case(name));
        let first = |names: &[&str]| names.iter().find_map(|n| find(n));
        let coordinate = |name: &str| {
            let at = || Position::Field(name.into());
            let k = fields.iter().position(|f| f.name.eq_ignore_ascii_case(name)).ok_or_else(|| {
                let present: Vec<&str> = fields.iter().map(|f| f.name.as_str()).collect();
                Error::content(
                    path,
                    at(),
                    format!("missing among the fields {}", present.join(" ")),
                    "a cloud needs the fields x, y and z, in metres",
                )
            })?;
            let field = &fields[k];
            if field.scalar.is_float() && field.count == 1 {
                return Ok(k);
            }
            let what = if field.count == 1 { field.scalar.name().to_owned() } else { format!("{} numbers", field.count) };
            Err(Error::content(path, at(), format!("is {what}"), "coordinates must be 32-bit or 64-bit floats, in metres"))
        };
        let xyz = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
        let colour = ColourFields::of(fields, find);
        Ok(Self { xyz, intensity: first(&INTENSITY), ring: first(&RING), time: first(&TIME), colour })
    }

    /// The fields that play a part.
    pub(crate) fn fields<'a>(&self, fields: &'a [Field]) -> Vec<&'a Field> {
        let colour = self.colour.into_iter().flat_map(ColourFields::indices);
        self.xyz.iter().copied().chain(self.intensity).chain(self.ring).chain(self.time).chain(colour).map(|k| &fields[k]).collect()
    }
}

/// The channels of a cloud as the file holds them, before units and validity.
#[derive(Default)]
pub(crate) struct Raw {
    pub(crate) points: Vec<[f32; 3]>,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) intensity: Option<Vec<f32>>,
    pub(crate) colours: Option<Vec<[u8; 3]>>,
    pub(crate) ring: Option<Rings>,
    pub(crate) time: Option<Vec<f64>>,
    /// The field that `time` came from.
    pub(crate) time_field: Option<(String, Scalar)>,
}

/// The rings of a cloud's points.
pub(crate) enum Rings {
    /// Of a type that holds ring numbers only.
    Sure(Vec<u16>),
    /// Of any other type.
    Numbers(Vec<f64>),
}

impl Rings {
    fn of(column: Column<'_>) -> Self {
        column.to_u16().map_or_else(|| Self::Numbers(column.to_f64()), Self::Sure)
    }
}

impl Raw {
    /// Gathers the channels of a cloud from the columns of its fields.
    pub(crate) fn gather<'a>(fields: &[Field], roles: &Roles, column: impl Fn(&Field) -> Column<'a>) -> Self {
        let column = |k: usize| column(&fields[k]);
        Self {
            points: record::points(roles.xyz.map(column)),
            intensity: roles.intensity.map(|k| column(k).to_f32()),
            colours: roles.colour.map(|colour| colour.read(fields, column)),
            ring: roles.ring.map(|k| Rings::of(column(k))),
            time: roles.time.map(|k| column(k).to_f64()),
            time_field: roles.time.map(|k| (fields[k].name.clone(), fields[k].scalar)),
            ..Self::default()
        }
    }

    /// Brings the channels to the units of [`Cloud`] and refuses a cloud without a return or with absurd coordinates.
    pub(crate) fn finish(self, path: &Path) -> Result<StampedCloud> {
        check_returns(&self.points, path)?;
        let ring = self.ring.and_then(|rings| match rings {
            Rings::Sure(rings) => Some(rings),
            Rings::Numbers(values) => valid_rings(&values, &self.points, path),
        });
        let (time, stamp) = match (self.time, self.time_field) {
            (Some(values), Some((name, scalar))) => relative_times(values, &self.points, &name, scalar, path),
            _ => (None, None),
        };
        let Self { points, width, height, intensity, colours, .. } = self;
        let cloud = Cloud { points, width, height, intensity, colours, ring, time, motion: None };
        Ok(StampedCloud { cloud, stamp })
    }
}

fn check_returns(points: &[[f32; 3]], path: &Path) -> Result<()> {
    let (mut returns, mut far) = (0usize, 0usize);
    for p in points {
        returns += usize::from(Cloud::is_return(p));
        far += usize::from(p.iter().fold(false, |far, c| far | (c.is_finite() & (c.abs() > FAR))));
    }
    if returns == 0 {
        return Err(Error::NoReturn { path: path.into(), points: points.len() });
    }
    if far * 10 > returns {
        let problem = format!("{far} of {} points lie more than 1000 km from the origin", points.len());
        return Err(Error::content(path, Position::File, problem, "the file is damaged or of another format, or not in the lidar frame in metres"));
    }
    Ok(())
}

/// Ring numbers, or nothing if some return has none that a ring could have.
fn valid_rings(values: &[f64], points: &[[f32; 3]], path: &Path) -> Option<Vec<u16>> {
    // A cast stops at the ends of its range, and takes what is no number for zero.
    let valid = |v: f64| f64::from(v as u16) == v;
    let mut all_valid = true;
    let ring = |&v: &f64| {
        all_valid &= valid(v);
        if valid(v) { v as u16 } else { 0 }
    };
    let rings = values.iter().map(ring).collect();
    if all_valid {
        return Some(rings);
    }
    if let Some(k) = (0..values.len()).find(|&k| !valid(values[k]) && Cloud::is_return(&points[k])) {
        tracing::warn!("{}: ring of point {k} is {}: the rings are left out", path.display(), values[k]);
        return None;
    }
    Some(rings)
}

/// Times in seconds relative to a stamp: the first return's if the file has absolute times, else the cloud's own.
fn relative_times(values: Vec<f64>, points: &[[f32; 3]], name: &str, scalar: Scalar, path: &Path) -> (Option<Vec<f32>>, Option<f64>) {
    let is_known = |&(t, p): &(&f64, &[f32; 3])| t.is_finite() & Cloud::is_return(p);
    let Some(first) = values.iter().zip(points).find(is_known).map(|(t, _)| *t) else { return (None, None) };
    let is_curvature = name.eq_ignore_ascii_case(CURVATURE);
    let unit = if is_curvature { 1e-3 } else { unit_s(scalar, first) };
    let all = bounds(&values, first);
    // Those of no returns may be anything: it takes longer to leave them out, and is hardly ever worth it.
    let (low, high) = if is_curvature || (all.1 - all.0) * unit > LONGEST_SWEEP {
        let known: Vec<f64> = values.iter().zip(points).filter(is_known).map(|(t, _)| *t).collect();
        bounds(&known, first)
    } else {
        all
    };
    // The curvature of a surface is at most 1/3; a sweep lasts longer than a third of a millisecond.
    if is_curvature && low >= 0.0 && high <= 1.0 / 3.0 {
        return (None, None);
    }
    if (high - low) * unit > LONGEST_SWEEP {
        tracing::warn!("{}: the times in field {name} span {:.0} s, which no sweep does: they are left out", path.display(), (high - low) * unit);
        return (None, None);
    }
    let stamp = Some(first * unit).filter(|s| s.abs() > LARGEST_RELATIVE);
    let origin = if stamp.is_some() { first } else { 0.0 };
    let relative = |t: f64| {
        let t = (t - origin) * unit;
        (if t.abs() <= LONGEST_SWEEP + LARGEST_RELATIVE { t } else { 0.0 }) as f32
    };
    (Some(values.iter().map(|&t| relative(t)).collect()), stamp)
}

/// The least and the largest of the finite times and of `first`. In lanes: there are many.
fn bounds(times: &[f64], first: f64) -> (f64, f64) {
    const LANES: usize = 8;
    let (whole, rest) = times.as_chunks::<LANES>();
    let mut last = [first; LANES];
    last[..rest.len()].copy_from_slice(rest);
    let (mut low, mut high) = ([first; LANES], [first; LANES]);
    for times in whole.iter().chain([&last]) {
        for ((&t, low), high) in times.iter().zip(&mut low).zip(&mut high) {
            let t = if t.is_finite() { t } else { first };
            *low = if t < *low { t } else { *low };
            *high = if t > *high { t } else { *high };
        }
    }
    (low.into_iter().fold(first, f64::min), high.into_iter().fold(first, f64::max))
}

/// Seconds per unit of a time field: integers count nanoseconds, as the drivers of Ouster and Livox do; floats are
/// seconds, unless they can only be a date (since 1970) in milliseconds, microseconds or nanoseconds.
fn unit_s(scalar: Scalar, first: f64) -> f64 {
    match first.abs() {
        _ if !scalar.is_float() => 1e-9,
        t if t >= 1e17 => 1e-9,
        t if t >= 1e14 => 1e-6,
        t if t >= 1e11 => 1e-3,
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(points: &[[f32; 3]], name: &str, scalar: Scalar, times: &[f64]) -> Raw {
        Raw {
            points: points.to_vec(),
            width: points.len(),
            height: 1,
            time: Some(times.to_vec()),
            time_field: Some((name.into(), scalar)),
            ..Raw::default()
        }
    }

    const P: [f32; 3] = [1.0, 2.0, 3.0];

    #[test]
    fn times_of_every_driver_become_seconds() {
        // name, type, first and second value, expected difference and stamp
        let epoch = 1_600_000_000.0;
        let cases = [
            ("t", Scalar::U32, [0.0, 5e7], 0.05, None),
            ("offset_time", Scalar::U32, [0.0, 1e8], 0.1, None),
            ("time", Scalar::F32, [-0.1, 0.0], 0.1, None),
            ("curvature", Scalar::F32, [0.0, 99.0], 0.099, None),
            ("timestamp", Scalar::F64, [epoch, epoch + 0.05], 0.05, Some(epoch)),
            ("timestamp", Scalar::F64, [epoch * 1e9, epoch * 1e9 + 5e7], 0.05, Some(epoch)),
            ("t", Scalar::U64, [epoch * 1e9, epoch * 1e9 + 1e8], 0.1, Some(epoch)),
        ];
        for (name, scalar, times, difference, stamp) in cases {
            let read = raw(&[P, P], name, scalar, &times).finish(Path::new("a")).unwrap();
            let t = read.cloud.time.unwrap();
            assert!((f64::from(t[1] - t[0]) - difference).abs() < 1e-5, "{name}: {t:?}");
            match (read.stamp, stamp) {
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-5),
                (a, b) => assert_eq!(a, b, "{name}"),
            }
        }
    }

    #[test]
    fn no_returns_do_not_spoil_the_times() {
        let read =
            raw(&[[f32::NAN; 3], P, [0.0; 3], P], "timestamp", Scalar::F64, &[0.0, 1e9, f64::NAN, 1e9 + 0.125]).finish(Path::new("a")).unwrap();
        assert_eq!(read.cloud.time.unwrap(), [0.0, 0.0, 0.0, 0.125]);
        assert_eq!(read.stamp, Some(1e9));
    }

    #[test]
    fn absurd_times_of_no_returns_do_not_make_a_sweep_endless() {
        let mut points = vec![P; 21];
        let mut times: Vec<f64> = (0..21).map(|i| 1000.0 + f64::from(i) * 0.005).collect();
        for k in [0, 3, 17, 20] {
            (points[k], times[k]) = ([f32::NAN; 3], [0.0, 1e12, -1e12, f64::INFINITY][k % 4]);
        }
        let read = raw(&points, "timestamp", Scalar::F64, &times).finish(Path::new("a")).unwrap();
        let t = read.cloud.time.unwrap();
        assert!((1..20).filter(|k| ![3, 17].contains(k)).all(|k| (f64::from(t[k]) - (k as f64 - 1.0) * 0.005).abs() < 1e-6), "{t:?}");
        times[19] = 2000.0;
        assert!(raw(&points, "timestamp", Scalar::F64, &times).finish(Path::new("a")).unwrap().cloud.time.is_none());
    }

    #[test]
    fn a_curvature_and_an_endless_sweep_are_not_times() {
        assert!(raw(&[P, P], "curvature", Scalar::F32, &[0.01, 0.2]).finish(Path::new("a")).unwrap().cloud.time.is_none());
        assert!(raw(&[P, P], "time", Scalar::F32, &[0.0, 1e8]).finish(Path::new("a")).unwrap().cloud.time.is_none());
    }

    #[test]
    fn rings_that_are_none_are_left_out() {
        let with =
            |ring: &[f64]| Raw { points: vec![P, [f32::NAN; 3]], width: 2, height: 1, ring: Some(Rings::Numbers(ring.to_vec())), ..Raw::default() };
        assert_eq!(with(&[63.0, -1.0]).finish(Path::new("a")).unwrap().cloud.ring, Some(vec![63, 0]));
        assert_eq!(with(&[0.5, 1.0]).finish(Path::new("a")).unwrap().cloud.ring, None);
        assert_eq!(with(&[70000.0, 1.0]).finish(Path::new("a")).unwrap().cloud.ring, None);
    }

    #[test]
    fn clouds_without_returns_or_beyond_the_horizon_are_refused() {
        let bare = |points: &[[f32; 3]]| Raw { points: points.to_vec(), width: points.len(), height: 1, ..Raw::default() }.finish(Path::new("a"));
        assert!(matches!(bare(&[[f32::NAN; 3], [0.0; 3]]), Err(Error::NoReturn { points: 2, .. })));
        assert!(matches!(bare(&[]), Err(Error::NoReturn { points: 0, .. })));
        assert!(bare(&[P, [1e7, 0.0, 0.0]]).unwrap_err().to_string().contains("1000 km"));
        assert_eq!(bare(&[[f32::NAN; 3], P]).unwrap().cloud.len(), 2);
    }
}
