//! Where a map lies on Earth, as it is stored with it.

use crate::{Crs, EarthError, Geodetic, Heights, LocalPlane};
use nalgebra::{Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use std::fmt;
use std::str::FromStr;
use voxelastic::Pose;

/// The place of a map: a plane that touches the Earth, the map frame in it, and the system in which people want coordinates.
///
/// As text, it is one line of names with values; numbers are written so that they come back to the last bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Georeference {
    /// Where the plane touches; none of a map that was aligned to metres of a place that nobody named.
    pub anchor: Option<Geodetic>,
    /// The map frame in the plane: east, north, up.
    pub t_plane_map: Pose,
    /// EPSG code of the system for what is exported; none for that of the plane.
    pub crs: Option<u16>,
    /// What heights count from.
    pub heights: Heights,
}

impl Georeference {
    /// The plane.
    pub fn plane(&self) -> Option<LocalPlane> {
        self.anchor.map(LocalPlane::at)
    }

    /// A point of the map in the plane: east, north, up, metres.
    pub fn in_plane(&self, point: [f64; 3]) -> Vector3<f64> {
        (self.t_plane_map * Point3::from(point)).coords
    }

    /// Where a point of the map is on Earth.
    pub fn to_earth(&self, point: [f64; 3]) -> Option<Geodetic> {
        self.plane().map(|plane| plane.to_geodetic(&self.in_plane(point)))
    }

    /// The map frame in the frame of the Earth (ECEF).
    pub fn t_ecef_map(&self) -> Option<Pose> {
        self.plane().map(|plane| plane.t_ecef_plane() * self.t_plane_map)
    }

    /// What takes points of the map to coordinates of its system.
    ///
    /// # Errors
    /// A code that this version does not know; a system of a map that is nowhere on Earth.
    pub fn projector(&self) -> Result<Projector, EarthError> {
        let remedy = "georeference the map with fixes of latitude and longitude, or of a system named by --crs";
        let crs = self.crs.map(Crs::of_code).transpose()?;
        match (crs, self.plane()) {
            (Some(_), None) => Err(EarthError::new("nothing says where on Earth the map is", remedy)),
            (crs, plane) => Ok(Projector { t_plane_map: self.t_plane_map, to: crs.zip(plane) }),
        }
    }
}

/// Takes points of a map to coordinates of a system, or of the plane.
#[derive(Clone, Debug)]
pub struct Projector {
    t_plane_map: Pose,
    to: Option<(Crs, LocalPlane)>,
}

impl Projector {
    /// The system; none for the plane.
    pub fn crs(&self) -> Option<&Crs> {
        self.to.as_ref().map(|(crs, _)| crs)
    }

    /// A point of the map: easting, northing, height, metres.
    ///
    /// # Errors
    /// A point that the system does not reach.
    pub fn point(&self, point: [f64; 3]) -> Result<[f64; 3], EarthError> {
        let in_plane = (self.t_plane_map * Point3::from(point)).coords;
        match &self.to {
            Some((crs, plane)) => crs.of_geodetic(&plane.to_geodetic(&in_plane)),
            None => Ok(in_plane.into()),
        }
    }
}

impl fmt::Display for Georeference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(Geodetic { latitude, longitude, height }) = self.anchor {
            write!(f, "anchor={latitude},{longitude},{height} ")?;
        }
        let (t, q) = (self.t_plane_map.translation.vector, self.t_plane_map.rotation.coords);
        write!(f, "t_plane_map={},{},{},{},{},{},{}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)?;
        if let Some(code) = self.crs {
            write!(f, " crs=EPSG:{code}")?;
        }
        write!(f, " heights={}", self.heights.name())
    }
}

impl FromStr for Georeference {
    type Err = EarthError;

    fn from_str(text: &str) -> Result<Self, EarthError> {
        let wrong = || EarthError::new(format!("{text:?} is no place of a map"), "georeference the map again");
        let value = |key: &str| text.split_whitespace().find_map(|word| word.strip_prefix(key)?.strip_prefix('='));
        let numbers = |words: &str| words.split(',').map(|n| n.parse().ok().filter(|v: &f64| v.is_finite())).collect::<Option<Vec<f64>>>();
        let anchor = match value("anchor").map(numbers) {
            None => None,
            Some(Some(n)) if n.len() == 3 => Some(Geodetic { latitude: n[0], longitude: n[1], height: n[2] }),
            Some(_) => return Err(wrong()),
        };
        let n = value("t_plane_map").and_then(numbers).filter(|n| n.len() == 7).ok_or_else(wrong)?;
        let quaternion = Quaternion::new(n[6], n[3], n[4], n[5]);
        if (quaternion.norm() - 1.0).abs() > 1e-9 || anchor.is_some_and(|place| !place.is_valid()) {
            return Err(wrong());
        }
        let t_plane_map = Pose::from_parts(Translation3::new(n[0], n[1], n[2]), UnitQuaternion::new_unchecked(quaternion));
        let crs = value("crs").map(|code| code.strip_prefix("EPSG:").and_then(|n| n.parse().ok()).ok_or_else(wrong)).transpose()?;
        let heights = value("heights").and_then(Heights::named).ok_or_else(wrong)?;
        Ok(Self { anchor, t_plane_map, crs, heights })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_comes_back_to_the_last_bit_and_points_go_where_proj_has_them() {
        let rotation = UnitQuaternion::from_euler_angles(0.01, -0.02, 2.0);
        let anchor = Geodetic { latitude: 48.137_154, longitude: 11.576_124, height: 519.3 };
        let there = Georeference {
            anchor: Some(anchor),
            t_plane_map: Pose::from_parts(Translation3::new(0.1, 0.2, 0.3), rotation),
            crs: Some(25832),
            heights: Heights::Ellipsoid,
        };
        assert_eq!(there.to_string().parse(), Ok(there));
        let nowhere = Georeference { anchor: None, crs: None, heights: Heights::Unknown, ..there };
        assert_eq!(nowhere.to_string().parse(), Ok(nowhere));
        assert!(nowhere.to_earth([0.0; 3]).is_none() && Georeference { anchor: None, ..there }.projector().is_err());
        for wrong in [
            "",
            "t_plane_map=1,2,3 heights=unknown",
            "anchor=1,2 t_plane_map=0,0,0,0,0,0,1 heights=unknown",
            "t_plane_map=0,0,0,0,0,0,2 heights=unknown",
        ] {
            assert!(wrong.parse::<Georeference>().is_err(), "{wrong}");
        }
        // The map's origin is the anchor: pyproj has it there in UTM 32.
        let here = Georeference { t_plane_map: Pose::identity(), ..there };
        let [east, north, up] = here.projector().unwrap().point([0.0; 3]).unwrap();
        assert!((east - 691_650.366_851_7).abs() < 1e-3 && (north - 5_334_754.246_450_7).abs() < 1e-3 && (up - 519.3).abs() < 1e-6);
    }
}
