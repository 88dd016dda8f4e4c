//! Fixes as they are read, and what they are measured in.

use super::request::Request;
use crate::error::{Error, Result};
use crate::warning::{Code, Warnings};
use std::path::Path;
use voxelastic_earth::{Crs, EarthError, Fixes, Geodetic, Heights, LocalPlane, Place};

/// An error of a file of fixes.
pub(super) fn of_earth(file: &Path) -> impl Fn(EarthError) -> Error + '_ {
    move |error| Error::new(format!("{}: {error}", file.display()), error.remedy())
}

/// What fixes are measured in, and where the plane is.
pub(super) struct Frame {
    pub(super) crs: Option<Crs>,
    pub(super) plane: Option<LocalPlane>,
    pub(super) heights: Heights,
    pub(super) has_degrees: bool,
}

impl Frame {
    pub(super) fn anchor(&self) -> Option<Geodetic> {
        self.plane.map(|plane| plane.origin())
    }
}

/// Reads the fixes, leaves out what is none, and finds the plane that they are in.
pub(super) fn read(request: &Request, warnings: &mut Warnings) -> Result<(Fixes, Frame)> {
    let fail = of_earth(&request.file);
    let read = voxelastic_io::fixes::read(&request.file, request.topic.as_deref())?;
    read.notes.iter().for_each(|note| tracing::info!("{}: {note}", request.file.display()));
    let (mut fixes, findings) = read.sifted().map_err(&fail)?;
    findings.into_iter().for_each(|finding| warnings.add(Code::FixesLeftOut, finding.text, finding.remedy));
    let has_degrees = fixes.all.iter().any(|fix| matches!(fix.place, Place::Geodetic(_)));
    let wants_utm = request.crs.as_deref().is_some_and(|crs| crs.eq_ignore_ascii_case("utm"));
    let named = request
        .crs
        .as_deref()
        .filter(|_| !wants_utm)
        .map(str::parse::<Crs>)
        .transpose()
        .map_err(|e| Error::usage(format!("--crs: {e}"), e.remedy()))?;
    let first = fixes.all[0].place.geodetic(named.as_ref()).map_err(&fail)?;
    let crs = match (named, first) {
        (None, Some(place)) if wants_utm => Some(Crs::utm(&place).map_err(&fail)?),
        (named, _) => named,
    };
    if first.is_none() {
        let text = format!(
            "{}: nothing says which system its metres are in: the map is put among them, and nobody knows where on Earth that is",
            request.file.display()
        );
        warnings.add(Code::NowhereOnEarth, text, "name the system with --crs EPSG:n");
    }
    if let (Some(crs), Some(place)) = (&crs, first) {
        if let Some(zone) = crs.other_zone(&place) {
            let text = format!(
                "the map is in UTM zone {zone}, and {crs} is another: lengths there are distorted by more than UTM's own 0.4 m in a kilometre"
            );
            warnings.add(Code::OtherZone, text, "`--crs utm` takes the zone of the place");
        }
        if crs.is_shifted() {
            let text = format!(
                "{crs} has a datum other than that of the fixes: coordinates in it are good to some metres only, without the grids of its survey"
            );
            warnings.add(Code::OtherZone, text, "choose a system on WGS 84, ETRS89 or NAD83");
        }
    }
    fixes.heights = match (fixes.heights, request.heights) {
        (Heights::Unknown, Some(given)) => given,
        (known, Some(given)) if known != given => {
            warnings.add(Code::Heights, format!("heights are taken as {}, though the fixes say {}", given.name(), known.name()), "");
            given
        }
        (known, _) => known,
    };
    if fixes.heights != Heights::Ellipsoid {
        let what =
            if fixes.heights == Heights::SeaLevel { "heights are above the sea level of a geoid" } else { "nothing says what heights count from" };
        let text = format!(
            "{what}: they are kept as they are, and places in the frame of the Earth are off by the height of the geoid (up to 100 m, up or down)"
        );
        warnings.add(Code::Heights, text, "--heights says what they are");
    }
    let heights = fixes.heights;
    Ok((fixes, Frame { crs, plane: first.map(LocalPlane::at), heights, has_degrees }))
}
