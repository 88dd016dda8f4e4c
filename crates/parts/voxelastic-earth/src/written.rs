//! A trajectory on Earth as files of other programs: GPX 1.1, GeoJSON (RFC 7946), KML 2.2. Heights are written as they are.

use crate::Geodetic;
use chrono::DateTime;
use std::fmt::Write;

/// A form of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// For receivers and hikers.
    Gpx,
    /// For web maps and GIS.
    GeoJson,
    /// For Google Earth.
    Kml,
}

impl Form {
    /// By the extension of a file.
    pub fn of(extension: &str) -> Option<Self> {
        match extension.to_ascii_lowercase().as_str() {
            "gpx" => Some(Self::Gpx),
            "geojson" | "json" => Some(Self::GeoJson),
            "kml" => Some(Self::Kml),
            _ => None,
        }
    }
}

/// The file of a trajectory: places by time, seconds since 1970 UTC. A GPX has times only if they can be such.
pub fn trajectory(form: Form, name: &str, places: &[(f64, Geodetic)]) -> String {
    let name: String = name.chars().filter(|c| !matches!(c, '<' | '>' | '&' | '"' | '\\') && !c.is_control()).collect();
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = match form {
        Form::Gpx => gpx(&mut out, &name, places),
        Form::GeoJson => geojson(&mut out, &name, places),
        Form::Kml => kml(&mut out, &name, places),
    };
    out
}

/// Times before this are those of a clock that does not know the date.
const YEAR_2000: f64 = 946_684_800.0;

fn gpx(out: &mut String, name: &str, places: &[(f64, Geodetic)]) -> std::fmt::Result {
    writeln!(
        out,
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<gpx version=\"1.1\" creator=\"Voxelastic\" xmlns=\"http://www.topografix.com/GPX/1/1\">"
    )?;
    writeln!(out, "<trk><name>{name}</name><trkseg>")?;
    for (time, place) in places {
        write!(out, "<trkpt lat=\"{:.9}\" lon=\"{:.9}\"><ele>{:.3}</ele>", place.latitude, place.longitude, place.height)?;
        let moment = (*time > YEAR_2000).then(|| DateTime::from_timestamp_micros((time * 1e6) as i64)).flatten();
        if let Some(moment) = moment {
            write!(out, "<time>{}</time>", moment.format("%Y-%m-%dT%H:%M:%S%.3fZ"))?;
        }
        writeln!(out, "</trkpt>")?;
    }
    writeln!(out, "</trkseg></trk></gpx>")
}

fn geojson(out: &mut String, name: &str, places: &[(f64, Geodetic)]) -> std::fmt::Result {
    let list = |of: &dyn Fn(&(f64, Geodetic)) -> String| places.iter().map(of).collect::<Vec<_>>().join(",\n");
    let points = list(&|(_, p)| format!("[{:.9},{:.9},{:.3}]", p.longitude, p.latitude, p.height));
    let times = list(&|(time, _)| format!("{time:.6}"));
    writeln!(
        out,
        "{{\"type\":\"FeatureCollection\",\"features\":[{{\"type\":\"Feature\",\"properties\":{{\"name\":\"{name}\",\"times\":[{times}]}},"
    )?;
    writeln!(out, "\"geometry\":{{\"type\":\"LineString\",\"coordinates\":[{points}]}}}}]}}")
}

fn kml(out: &mut String, name: &str, places: &[(f64, Geodetic)]) -> std::fmt::Result {
    writeln!(out, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<kml xmlns=\"http://www.opengis.net/kml/2.2\"><Document><name>{name}</name>")?;
    writeln!(out, "<Placemark><name>{name}</name><LineString><altitudeMode>clampToGround</altitudeMode><coordinates>")?;
    for (_, p) in places {
        writeln!(out, "{:.9},{:.9},{:.3}", p.longitude, p.latitude, p.height)?;
    }
    writeln!(out, "</coordinates></LineString></Placemark></Document></kml>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_form_has_longitude_and_latitude_where_it_wants_them() {
        let places = [(1_795_942_800.25, Geodetic { latitude: 48.5, longitude: -11.25, height: 519.3 })];
        let gpx = trajectory(Form::Gpx, "a<b", &places);
        assert!(
            gpx.contains("lat=\"48.500000000\" lon=\"-11.250000000\"><ele>519.300</ele><time>2026-11-29T09:00:00.250Z</time>")
                && gpx.contains("<name>ab</name>")
        );
        assert!(trajectory(Form::GeoJson, "x", &places).contains("[-11.250000000,48.500000000,519.300]"));
        assert!(trajectory(Form::Kml, "x", &places).contains("-11.250000000,48.500000000,519.300"));
        assert!(!trajectory(Form::Gpx, "x", &[(12.0, places[0].1)]).contains("<time>"));
    }
}
