//! Places on the ellipsoid of WGS 84, as latitude, longitude and height, in the frame of the Earth, and in a plane that touches it.
//!
//! Formulas: National Imagery and Mapping Agency, TR8350.2, ch. 4; the way back is Bowring's (1976), iterated.

use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// Half the long axis of the ellipsoid, metres.
const A: f64 = 6_378_137.0;
/// Flattening.
const F: f64 = 1.0 / 298.257_223_563;
/// Square of the eccentricity.
const E2: f64 = F * (2.0 - F);

/// A place on Earth: WGS 84, which GNSS receivers give. ETRS89 and ITRF are taken for the same, from which they differ by up to a metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Degrees, north positive.
    pub latitude: f64,
    /// Degrees, east positive.
    pub longitude: f64,
    /// Metres above the ellipsoid; what heights count from is said beside (see [`Heights`](crate::Heights)).
    pub height: f64,
}

impl Geodetic {
    /// Coordinates in the frame of the Earth (ECEF), metres.
    pub fn to_ecef(&self) -> Vector3<f64> {
        let (sin, cos) = self.latitude.to_radians().sin_cos();
        let (sin_l, cos_l) = self.longitude.to_radians().sin_cos();
        let n = A / (1.0 - E2 * sin * sin).sqrt();
        let out = (n + self.height) * cos;
        Vector3::new(out * cos_l, out * sin_l, (n * (1.0 - E2) + self.height) * sin)
    }

    /// The place of coordinates in the frame of the Earth (ECEF), metres.
    pub fn of_ecef(ecef: &Vector3<f64>) -> Self {
        let out = ecef.x.hypot(ecef.y);
        let b = A * (1.0 - F);
        // The reduced latitude; three steps reach the last digit from the centre of the Earth's core to the moon.
        let mut beta = (ecef.z * A).atan2(out * b);
        let mut latitude = 0.0;
        for _ in 0..4 {
            let (sin, cos) = beta.sin_cos();
            latitude = (ecef.z + E2 / (1.0 - E2) * b * sin.powi(3)).atan2(out - E2 * A * cos.powi(3));
            beta = ((1.0 - F) * latitude.tan()).atan();
        }
        let (sin, cos) = latitude.sin_cos();
        let n = A / (1.0 - E2 * sin * sin).sqrt();
        let height = if cos > 0.1 { out / cos - n } else { ecef.z / sin - n * (1.0 - E2) };
        Self { latitude: latitude.to_degrees(), longitude: ecef.y.atan2(ecef.x).to_degrees(), height }
    }

    /// Whether all numbers are finite and within their ranges.
    pub fn is_valid(&self) -> bool {
        self.latitude.abs() <= 90.0 && self.longitude.abs() <= 360.0 && self.height.is_finite()
    }
}

/// The plane that touches the Earth at a place: east, north and up from there, metres. Up is the normal of the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalPlane {
    origin: Geodetic,
    t_ecef_plane: Pose,
}

impl LocalPlane {
    /// The plane at `origin`.
    pub fn at(origin: Geodetic) -> Self {
        let (sin, cos) = origin.latitude.to_radians().sin_cos();
        let (sin_l, cos_l) = origin.longitude.to_radians().sin_cos();
        let (east, north) = (Vector3::new(-sin_l, cos_l, 0.0), Vector3::new(-sin * cos_l, -sin * sin_l, cos));
        let up = Vector3::new(cos * cos_l, cos * sin_l, sin);
        let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[east, north, up]));
        let t_ecef_plane = Pose::from_parts(Translation3::from(origin.to_ecef()), UnitQuaternion::from_rotation_matrix(&axes));
        Self { origin, t_ecef_plane }
    }

    /// Where it touches.
    pub fn origin(&self) -> Geodetic {
        self.origin
    }

    /// Its pose in the frame of the Earth (ECEF).
    pub fn t_ecef_plane(&self) -> Pose {
        self.t_ecef_plane
    }

    /// East, north and up of a place, metres.
    pub fn of_geodetic(&self, place: &Geodetic) -> Vector3<f64> {
        // By the difference, in which the millions of metres are gone.
        self.t_ecef_plane.rotation.inverse() * (place.to_ecef() - self.t_ecef_plane.translation.vector)
    }

    /// The place of a point given as east, north and up, metres.
    pub fn to_geodetic(&self, point: &Vector3<f64>) -> Geodetic {
        Geodetic::of_ecef(&(self.t_ecef_plane.rotation * point + self.t_ecef_plane.translation.vector))
    }

    /// A covariance in east, north and up of the plane at another place, in those of this one.
    pub fn turned(&self, place: &Geodetic, covariance: &Matrix3<f64>) -> Matrix3<f64> {
        let turn = (self.t_ecef_plane.rotation.inverse() * Self::at(*place).t_ecef_plane.rotation).to_rotation_matrix();
        turn.matrix() * covariance * turn.matrix().transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// ECEF of pyproj 3.7.2 (PROJ 9.5.1), EPSG:4979 to EPSG:4978.
    #[test]
    fn frames_of_the_earth_are_those_of_proj() {
        for (latitude, longitude, height, ecef) in crate::test_values::ECEF {
            let place = Geodetic { latitude, longitude, height };
            assert!((place.to_ecef() - Vector3::from(ecef)).norm() < 1e-6, "{place:?}");
            let back = Geodetic::of_ecef(&Vector3::from(ecef));
            assert!((back.latitude - latitude).abs() < 1e-11 && (back.height - height).abs() < 1e-6, "{place:?} {back:?}");
        }
    }

    proptest! {
        #[test]
        fn places_come_back(latitude in -90.0..90.0, longitude in -180.0..180.0, height in -400.0..9000.0, east in -2e4..2e4, north in -2e4..2e4) {
            let place = Geodetic { latitude, longitude, height };
            let plane = LocalPlane::at(place);
            prop_assert!(plane.of_geodetic(&place).norm() < 1e-8);
            let point = Vector3::new(east, north, 10.0);
            let there = plane.to_geodetic(&point);
            prop_assert!((plane.of_geodetic(&there) - point).norm() < 1e-6);
            // A plane that touches lies above the curved ground: by the square of the distance over twice the radius.
            let above = there.height - height - 10.0;
            let expected = (east * east + north * north) / (2.0 * 6.371e6);
            prop_assert!((above - expected).abs() < 0.01 * expected + 1e-3, "{} {}", above, expected);
        }
    }
}
