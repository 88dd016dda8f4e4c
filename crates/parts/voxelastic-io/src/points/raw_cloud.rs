//! Columns of a point record to a checked cloud.

use super::record::{self, Column, Field, Scalar};
use super::roles::{CURVATURE, FieldRoles};
use super::times::{TimesOfPoints, relative_times};
use crate::stamped_cloud::StampedCloud;
use crate::{Error, Position, Result};
use std::path::Path;
use voxelastic::Cloud;

/// A coordinate beyond this is no lidar measurement, and single precision could not hold it to the centimetre.
const FAR: f32 = 1e6;

/// The channels of a cloud as the file holds them, before units and validity.
#[derive(Default)]
pub(crate) struct RawCloud {
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
    /// From a type that can only hold ring numbers.
    Valid(Vec<u16>),
    /// From any other type; not yet checked.
    Numbers(Vec<f64>),
}

impl Rings {
    fn of(column: Column<'_>) -> Self {
        column.to_u16().map_or_else(|| Self::Numbers(column.to_f64()), Self::Valid)
    }
}

impl RawCloud {
    /// Gathers the channels of a cloud from the columns of its fields.
    pub(crate) fn gather<'a>(fields: &[Field], roles: &FieldRoles, column: impl Fn(&Field) -> Column<'a>) -> Self {
        let column = |k: usize| column(&fields[k]);
        Self {
            points: record::points(roles.xyz.map(column)),
            intensity: roles.intensity.map(|k| column(k).to_f32()),
            colours: roles.colour.and_then(|colour| colour.read(fields, column)),
            ring: roles.ring.map(|k| Rings::of(column(k))),
            time: roles.time.map(|k| column(k).to_f64()),
            time_field: roles.time.map(|k| (fields[k].name.clone(), fields[k].scalar)),
            ..Self::default()
        }
    }

    /// Takes the rings from a column of numbers.
    pub(crate) fn set_rings(&mut self, column: Column<'_>) {
        self.ring = Some(Rings::of(column));
    }

    /// Converts the channels to the units of [`Cloud`].
    ///
    /// # Errors
    /// A cloud without a return, or with coordinates that cannot be metres.
    pub(crate) fn finish(self, path: &Path) -> Result<StampedCloud> {
        check_returns(&self.points, path)?;
        let ring = self.ring.and_then(|rings| match rings {
            Rings::Valid(rings) => Some(rings),
            Rings::Numbers(values) => valid_rings(&values, &self.points, path),
        });
        let times_in_curvature = self.time_field.as_ref().is_some_and(|(name, _)| name.eq_ignore_ascii_case(CURVATURE));
        let TimesOfPoints { time, stamp, has_shares } = match (self.time, self.time_field) {
            (Some(values), Some((name, scalar))) => relative_times(values, &self.points, &name, scalar, path),
            _ => TimesOfPoints::default(),
        };
        let Self { points, width, height, intensity, colours, .. } = self;
        let cloud = Cloud { points, width, height, intensity, colours, ring, time, motion: None, sensor: 0 };
        Ok(StampedCloud { times_in_curvature: times_in_curvature && cloud.time.is_some(), cloud, stamp, has_shares })
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

/// Ring numbers; `None` if the number of some return is not a valid ring.
fn valid_rings(values: &[f64], points: &[[f32; 3]], path: &Path) -> Option<Vec<u16>> {
    // The cast saturates and turns NaN into 0.
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
        tracing::warn!("{}: ring of point {k} is {}: rings are ignored", path.display(), values[k]);
        return None;
    }
    Some(rings)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(points: &[[f32; 3]], name: &str, scalar: Scalar, times: &[f64]) -> RawCloud {
        RawCloud {
            points: points.to_vec(),
            width: points.len(),
            height: 1,
            time: Some(times.to_vec()),
            time_field: Some((name.into(), scalar)),
            ..RawCloud::default()
        }
    }

    const P: [f32; 3] = [1.0, 2.0, 3.0];

    #[test]
    fn times_of_all_drivers_become_seconds() {
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
            // A counter that begins anew within the sweep.
            ("t", Scalar::U32, [4_284_967_296.0, 4e7], 0.05, Some(4.284_967_296)),
            // Other units than the type stands for: a sweep cannot last 0.1 ms, nor 100 s.
            ("t", Scalar::U32, [0.0, 1e5], 0.1, None),
            ("time", Scalar::F32, [0.0, 1e5], 0.1, None),
            ("time", Scalar::F32, [0.0, 99.0], 0.099, None),
            ("point_time_offset", Scalar::F32, [0.0, 5e7], 0.05, None),
            ("stamps", Scalar::F64, [epoch, epoch + 0.05], 0.05, Some(epoch)),
            ("timestamp", Scalar::U64, [epoch * 1e6, epoch * 1e6 + 1e5], 0.1, Some(epoch)),
        ];
        for (name, scalar, times, difference, stamp) in cases {
            let read = raw(&[P, P], name, scalar, &times).finish(Path::new("a")).unwrap();
            assert_eq!(read.times_in_curvature, name == "curvature");
            let t = read.cloud.time.unwrap();
            assert!((f64::from(t[1] - t[0]) - difference).abs() < 1e-5, "{name}: {t:?}");
            match (read.stamp, stamp) {
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-5),
                (a, b) => assert_eq!(a, b, "{name}"),
            }
        }
    }

    #[test]
    fn points_without_a_return_do_not_affect_times() {
        let read =
            raw(&[[f32::NAN; 3], P, [0.0; 3], P], "timestamp", Scalar::F64, &[0.0, 1e9, f64::NAN, 1e9 + 0.125]).finish(Path::new("a")).unwrap();
        assert_eq!(read.cloud.time.unwrap(), [0.0, 0.0, 0.0, 0.125]);
        assert_eq!(read.stamp, Some(1e9));
    }

    #[test]
    fn invalid_times_of_missing_returns_are_ignored() {
        let mut points = vec![P; 21];
        let mut times: Vec<f64> = (0..21).map(|i| 1000.0 + f64::from(i) * 0.005).collect();
        for k in [0, 3, 17, 20] {
            (points[k], times[k]) = ([f32::NAN; 3], [0.0, 1e12, -1e12, f64::INFINITY][k % 4]);
        }
        let read = raw(&points, "timestamp", Scalar::F64, &times).finish(Path::new("a")).unwrap();
        let t = read.cloud.time.unwrap();
        assert!((1..20).filter(|k| ![3, 17].contains(k)).all(|k| (f64::from(t[k]) - (k as f64 - 1.0) * 0.005).abs() < 1e-6), "{t:?}");
        // Ring by ring, the first ring begins late.
        (times[1], times[5]) = (times[5], times[1]);
        let read = raw(&points, "timestamp", Scalar::F64, &times).finish(Path::new("a")).unwrap();
        assert!((read.stamp.unwrap() - 1000.005).abs() < 1e-9 && read.cloud.time.unwrap()[5] == 0.0, "the earliest point is the origin");
        // One time is wrong: the others still say that they are seconds.
        times[19] = 2000.0;
        assert!(raw(&points, "timestamp", Scalar::F64, &times).finish(Path::new("a")).unwrap().cloud.time.is_none());
    }

    #[test]
    fn curvatures_and_too_long_sweeps_are_not_times() {
        assert!(raw(&[P, P], "curvature", Scalar::F32, &[0.01, 0.2]).finish(Path::new("a")).unwrap().cloud.time.is_none());
        let shares = raw(&[P, P], "timestamp", Scalar::F64, &[0.0, 0.999]).finish(Path::new("a")).unwrap();
        assert!(shares.has_shares && shares.cloud.time.unwrap()[1] == 0.999);
        assert!(raw(&[P, P], "time", Scalar::F32, &[0.0, 1e12]).finish(Path::new("a")).unwrap().cloud.time.is_none());
    }

    #[test]
    fn invalid_rings_are_ignored() {
        let with = |ring: &[f64]| RawCloud {
            points: vec![P, [f32::NAN; 3]],
            width: 2,
            height: 1,
            ring: Some(Rings::Numbers(ring.to_vec())),
            ..RawCloud::default()
        };
        assert_eq!(with(&[63.0, -1.0]).finish(Path::new("a")).unwrap().cloud.ring, Some(vec![63, 0]));
        assert_eq!(with(&[0.5, 1.0]).finish(Path::new("a")).unwrap().cloud.ring, None);
        assert_eq!(with(&[70000.0, 1.0]).finish(Path::new("a")).unwrap().cloud.ring, None);
    }

    #[test]
    fn clouds_without_returns_or_with_absurd_coordinates_are_refused() {
        let bare =
            |points: &[[f32; 3]]| RawCloud { points: points.to_vec(), width: points.len(), height: 1, ..RawCloud::default() }.finish(Path::new("a"));
        assert!(matches!(bare(&[[f32::NAN; 3], [0.0; 3]]), Err(Error::NoReturn { points: 2, .. })));
        assert!(matches!(bare(&[]), Err(Error::NoReturn { points: 0, .. })));
        assert!(bare(&[P, [1e7, 0.0, 0.0]]).unwrap_err().to_string().contains("1000 km"));
        assert_eq!(bare(&[[f32::NAN; 3], P]).unwrap().cloud.len(), 2);
    }
}
