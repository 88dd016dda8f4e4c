//! Coordinate systems of maps by their EPSG codes: parameters by `crs-definitions`, projections by `proj4rs`.

use crate::{EarthError, Geodetic};
use proj4rs::Proj;
use std::fmt;
use std::str::FromStr;

const CODES: &str = "name a projected system in metres by its EPSG code, such as EPSG:25832 or EPSG:32632 (UTM zone 32), or `utm`";

/// A projected coordinate system in metres: easting, northing, and the height as it is.
#[derive(Clone, Debug)]
pub struct Crs {
    code: u16,
    projection: Proj,
    geographic: Proj,
    wkt: String,
    is_shifted: bool,
}

impl Crs {
    /// The system of an EPSG code.
    ///
    /// # Errors
    /// A code that is unknown, that is no projection, whose unit is not the metre, whose heights need a model of the geoid, or whose datum needs a grid.
    pub fn of_code(code: u16) -> Result<Self, EarthError> {
        let unknown = || EarthError::new(format!("EPSG:{code} is not among the systems that are known"), CODES);
        let refuse = |why: String, remedy| Err(EarthError::new(format!("EPSG:{code} {why}"), remedy));
        let definition = crs_definitions::from_code(code).ok_or_else(unknown)?;
        if definition.wkt.starts_with("COMPD_CS") || definition.wkt.starts_with("VERT_CS") {
            let remedy = "name its horizontal part; heights stay those of the fixes, and a program with geoid models converts them";
            return refuse("has heights above the geoid or a datum, of which no model is built in".into(), remedy);
        }
        if !definition.wkt.starts_with("PROJCS") {
            return refuse("is no projection in metres".into(), CODES);
        }
        let word = |key: &str| definition.proj4.split_whitespace().find_map(|word| word.strip_prefix(key));
        if word("+units=").is_some_and(|unit| unit != "m") || word("+to_meter=").is_some() {
            let unit =
                word("+units=").map_or_else(|| "an own unit".to_owned(), |unit| if unit == "us-ft" { "US survey feet".into() } else { unit.into() });
            return refuse(
                format!("counts in {unit}, not in metres"),
                "name the system in metres of the same place, and convert what is exported with PDAL",
            );
        }
        if word("+nadgrids=").is_some_and(|grids| grids != "@null") {
            return refuse("has a datum that needs a grid, of which none is built in".into(), "name a system on WGS 84, ETRS89 or NAD83");
        }
        let broken = |e: proj4rs::errors::Error| EarthError::new(format!("EPSG:{code} cannot be computed: {e}"), CODES);
        let projection = Proj::from_proj_string(definition.proj4).map_err(broken)?;
        let geographic = Proj::from_proj_string("+proj=longlat +datum=WGS84 +no_defs").map_err(broken)?;
        let shift = word("+towgs84=").unwrap_or("0");
        let is_named = word("+datum=").is_some_and(|datum| !matches!(datum, "WGS84" | "NAD83"));
        let is_shifted = is_named || shift.split(',').any(|number| number.parse::<f64>().is_ok_and(|v| v != 0.0));
        Ok(Self { code, projection, geographic, wkt: without_shift(definition.wkt), is_shifted })
    }

    /// The UTM zone of a place, on WGS 84.
    ///
    /// # Errors
    /// Beyond 84 degrees north and 80 degrees south, where UTM ends.
    pub fn utm(place: &Geodetic) -> Result<Self, EarthError> {
        if !(-80.0..=84.0).contains(&place.latitude) {
            return Err(EarthError::new(format!("UTM has no zone at latitude {:.3}", place.latitude), CODES));
        }
        Self::of_code(if place.latitude < 0.0 { 32_700 } else { 32_600 } + zone(place.longitude))
    }

    /// Its EPSG code.
    pub fn code(&self) -> u16 {
        self.code
    }

    /// Its definition as text (OGC 01-009, as LAS 1.4 asks for).
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// Its name.
    pub fn name(&self) -> &str {
        self.wkt.split('"').nth(1).unwrap_or_default()
    }

    /// Whether its datum is not that of the fixes, so that coordinates are good to some metres only.
    pub fn is_shifted(&self) -> bool {
        self.is_shifted
    }

    /// If it is a UTM zone and the place is in another: the number of that.
    pub fn other_zone(&self, place: &Geodetic) -> Option<u16> {
        let own: u16 =
            self.name().split("UTM zone ").nth(1)?.trim_end_matches(['N', 'S']).split(' ').next()?.trim_end_matches(['N', 'S']).parse().ok()?;
        Some(zone(place.longitude)).filter(|zone| *zone != own)
    }

    /// Easting, northing and height of a place, metres.
    ///
    /// # Errors
    /// A place that the projection does not reach.
    pub fn of_geodetic(&self, place: &Geodetic) -> Result<[f64; 3], EarthError> {
        let mut point = (place.longitude.to_radians(), place.latitude.to_radians(), place.height);
        let moved = proj4rs::transform::transform(&self.geographic, &self.projection, &mut point);
        let finite = moved.is_ok() && point.0.is_finite() && point.1.is_finite();
        // A shift between datums is between their surfaces; heights stay what they are.
        finite.then_some([point.0, point.1, place.height]).ok_or_else(|| self.unreached(format!("{:.6}, {:.6}", place.latitude, place.longitude)))
    }

    /// The place of easting, northing and height, metres.
    ///
    /// # Errors
    /// Coordinates that the projection does not have.
    pub fn to_geodetic(&self, [x, y, z]: [f64; 3]) -> Result<Geodetic, EarthError> {
        let mut point = (x, y, z);
        let moved = proj4rs::transform::transform(&self.projection, &self.geographic, &mut point);
        let place = Geodetic { latitude: point.1.to_degrees(), longitude: point.0.to_degrees(), height: z };
        if moved.is_ok() && place.is_valid() { Ok(place) } else { Err(self.unreached(format!("{x:.3} {y:.3}"))) }
    }

    fn unreached(&self, what: String) -> EarthError {
        EarthError::new(format!("{what} is beyond what {self} reaches"), "name the system of the place where the map is")
    }
}

/// A definition without the parameters of a way to WGS 84, with which PROJ takes it for another system than that of its code.
fn without_shift(wkt: &str) -> String {
    let parts = wkt.split_once(",TOWGS84[").and_then(|(before, rest)| Some((before, rest.split_once(']')?.1)));
    parts.map_or_else(|| wkt.to_owned(), |(before, after)| format!("{before}{after}"))
}

/// The UTM zone of a longitude, by six degrees each; the exceptions of Norway and Svalbard are not made.
fn zone(longitude: f64) -> u16 {
    (((longitude + 180.0).rem_euclid(360.0) / 6.0).floor() as u16).min(59) + 1
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "EPSG:{} ({})", self.code, self.name())
    }
}

impl FromStr for Crs {
    type Err = EarthError;

    /// `EPSG:25832`, or the number alone.
    fn from_str(text: &str) -> Result<Self, EarthError> {
        let number = text.trim().to_ascii_uppercase();
        let number = number.strip_prefix("EPSG:").unwrap_or(&number);
        let code = number.parse().map_err(|_| EarthError::new(format!("{text:?} is no EPSG code"), CODES))?;
        Self::of_code(code)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Easting and northing of pyproj 3.7.2 (PROJ 9.5.1), from EPSG:4979.
    #[test]
    fn projections_are_those_of_proj() {
        for (code, latitude, longitude, [x, y]) in crate::test_values::PROJECTED {
            let crs = Crs::of_code(code).unwrap();
            let place = Geodetic { latitude, longitude, height: 123.0 };
            let [east, north, height] = crs.of_geodetic(&place).unwrap();
            assert!((east - x).hypot(north - y) < 1e-3 && height == 123.0, "{crs}: {east} {north} against {x} {y}");
            let back = crs.to_geodetic([x, y, 5.0]).unwrap();
            assert!((back.latitude - latitude).abs() < 1e-8 && (back.longitude - longitude).abs() < 1e-8 && back.height == 5.0, "{crs}: {back:?}");
        }
    }

    #[test]
    fn systems_that_cannot_be_used_say_why() {
        for (code, words) in
            [("EPSG:1", "not among"), ("4326", "no projection"), ("EPSG:2263", "feet"), ("EPSG:5555", "geoid"), ("x", "no EPSG code")]
        {
            let error = code.parse::<Crs>().unwrap_err();
            assert!(error.to_string().contains(words) && !error.remedy().is_empty(), "{code}: {error}");
        }
        let kiel = Geodetic { latitude: 54.3, longitude: 10.1, height: 0.0 };
        assert_eq!(Crs::utm(&kiel).unwrap().code(), 32632);
        assert_eq!(Crs::utm(&Geodetic { latitude: -33.9, longitude: 151.2, height: 0.0 }).unwrap().code(), 32756);
        assert!(Crs::utm(&Geodetic { latitude: 87.0, ..kiel }).is_err());
        let dresden = Geodetic { latitude: 51.05, longitude: 13.74, height: 0.0 };
        assert_eq!((Crs::of_code(25832).unwrap().other_zone(&kiel), Crs::of_code(25832).unwrap().other_zone(&dresden)), (None, Some(33)));
        assert!(
            Crs::of_code(25832).unwrap().wkt().starts_with("PROJCS[\"ETRS89 / UTM zone 32N\"")
                && !Crs::of_code(25832).unwrap().wkt().contains("TOWGS84")
        );
        assert!(Crs::of_code(31467).unwrap().is_shifted() && !Crs::of_code(25832).unwrap().is_shifted());
        assert!(Crs::of_code(32632).unwrap().of_geodetic(&Geodetic { latitude: f64::NAN, ..kiel }).is_err());
    }
}
