//! Fixes of a receiver and control points: where something was on Earth, how surely, and when.

use crate::{Crs, EarthError, Geodetic};
use nalgebra::{Matrix3, Vector3};

/// What heights count from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Heights {
    /// The ellipsoid: what receivers compute.
    Ellipsoid,
    /// The sea level of some model of the geoid, or a datum of a survey.
    SeaLevel,
    /// Nobody says.
    #[default]
    Unknown,
}

impl Heights {
    /// Its name in files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ellipsoid => "ellipsoid",
            Self::SeaLevel => "sea-level",
            Self::Unknown => "unknown",
        }
    }

    /// That of a name.
    pub fn named(name: &str) -> Option<Self> {
        [Self::Ellipsoid, Self::SeaLevel, Self::Unknown].into_iter().find(|heights| heights.name() == name)
    }
}

/// Where a fix is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// Latitude, longitude and height.
    Geodetic(Geodetic),
    /// Easting, northing and height in a system that somebody else names, metres.
    Projected([f64; 3]),
}

impl Place {
    /// Latitude, longitude and height; none of metres without a system.
    ///
    /// # Errors
    /// Coordinates that the system does not have.
    pub fn geodetic(&self, crs: Option<&Crs>) -> Result<Option<Geodetic>, EarthError> {
        match (self, crs) {
            (Self::Geodetic(place), _) => Ok(Some(*place)),
            (Self::Projected(point), Some(crs)) => crs.to_geodetic(*point).map(Some),
            (Self::Projected(_), None) => Ok(None),
        }
    }
}

/// A measured place.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// Seconds, of the clock that the file has; none for a control point that was not visited at a time.
    pub time: Option<f64>,
    /// Where it is.
    pub place: Place,
    /// Its covariance in east, north and up, square metres, if it is known.
    pub covariance: Option<Matrix3<f64>>,
    /// What tells it from others: the name of a control point.
    pub name: Option<String>,
    /// Where it was seen in the map, map frame, metres: of a control point that was picked.
    pub seen_at: Option<Vector3<f64>>,
}

impl Fix {
    /// Standard deviations in east, north and up, metres.
    pub fn sigmas(&self) -> Option<[f64; 3]> {
        self.covariance.map(|c| [c[(0, 0)].sqrt(), c[(1, 1)].sqrt(), c[(2, 2)].sqrt()])
    }
}

/// A covariance of standard deviations in east, north and up; none unless all are positive.
pub fn covariance_of(sigmas: [f64; 3]) -> Option<Matrix3<f64>> {
    sigmas.iter().all(|s| *s > 0.0 && s.is_finite()).then(|| Matrix3::from_diagonal(&Vector3::from(sigmas).map(|s| s * s)))
}

/// What a file of fixes holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fixes {
    /// Those with a position, in the order of the file.
    pub all: Vec<Fix>,
    /// What their heights count from.
    pub heights: Heights,
    /// Lines or messages of the receiver that say that it had no position.
    pub without_position: usize,
    /// What was assumed, for people.
    pub notes: Vec<String>,
}

/// Something about fixes that is not as it should be.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What it is about: a stable name.
    pub code: &'static str,
    /// What it is.
    pub text: String,
    /// What helps.
    pub remedy: &'static str,
    /// How many fixes it concerns.
    pub count: usize,
}

/// From the middle of all fixes, metres: nobody maps so far in one go.
const FARTHEST_M: f64 = 200_000.0;

impl Fixes {
    /// Leaves out what is no place: numbers that are not finite, 0,0, and places hundreds of kilometres from the others. What was left out is said.
    ///
    /// # Errors
    /// A latitude beyond 90 degrees, which is a longitude; no fix that is left.
    pub fn sifted(mut self) -> Result<(Self, Vec<Finding>), EarthError> {
        let mut findings = Vec::new();
        let mut leave_out = |code, text: &str, remedy, is_bad: &dyn Fn(&Fix) -> bool| {
            let before = self.all.len();
            self.all.retain(|fix| !is_bad(fix));
            let count = before - self.all.len();
            if count > 0 {
                findings.push(Finding { code, text: format!("{count} fixes are left out: {text}"), remedy, count });
            }
        };
        leave_out("fix-not-finite", "their numbers are not finite", "the receiver had no position there", &|fix| match fix.place {
            Place::Geodetic(p) => !(p.latitude.is_finite() && p.longitude.is_finite() && p.height.is_finite()),
            Place::Projected(p) => !p.iter().all(|c| c.is_finite()),
        });
        leave_out("fix-at-zero", "they are at latitude 0, longitude 0", "the receiver had no position there", &|fix| match fix.place {
            Place::Geodetic(p) => p.latitude.abs() < 1e-6 && p.longitude.abs() < 1e-6,
            Place::Projected(p) => p == [0.0; 3],
        });
        let beyond = self.all.iter().find_map(|fix| match fix.place {
            Place::Geodetic(p) if p.latitude.abs() > 90.0 || p.longitude.abs() > 360.0 => Some(p),
            _ => None,
        });
        if let Some(p) = beyond {
            let problem = format!("latitude {}, longitude {} is no place on Earth", p.latitude, p.longitude);
            return Err(EarthError::new(problem, "latitude and longitude may be swapped, or be metres: name the columns, or the system with --crs"));
        }
        if let Some(middle) = self.middle() {
            let far = |fix: &Fix| (metres(&fix.place) - middle).amax() > FARTHEST_M;
            let (text, remedy) =
                ("they are more than 200 km from the others", "check the sign of latitude and longitude: south and west are negative");
            let before = self.all.len();
            self.all.retain(|fix| !far(fix));
            let count = before - self.all.len();
            if count > 0 {
                findings.push(Finding { code: "fix-far-away", text: format!("{count} fixes are left out: {text}"), remedy, count });
            }
        }
        if self.without_position > 0 {
            let (count, text) = (self.without_position, format!("the receiver had no position {} times", self.without_position));
            findings.push(Finding { code: "no-position", text, remedy: "", count });
        }
        if self.all.is_empty() {
            return Err(EarthError::new("there is no fix with a position", "record with the antenna under the open sky, or give another file"));
        }
        Ok((self, findings))
    }

    fn middle(&self) -> Option<Vector3<f64>> {
        let all: Vec<Vector3<f64>> = self.all.iter().map(|fix| metres(&fix.place)).collect();
        if all.is_empty() {
            return None;
        }
        Some(Vector3::from_fn(|k, _| {
            let mut column: Vec<f64> = all.iter().map(|p| p[k]).collect();
            column.sort_by(f64::total_cmp);
            column[column.len() / 2]
        }))
    }
}

fn metres(place: &Place) -> Vector3<f64> {
    match place {
        Place::Geodetic(p) => p.to_ecef(),
        Place::Projected(p) => Vector3::from(*p),
    }
}
