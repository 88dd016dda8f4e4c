//! Cloud-optimised LAZ (COPC 1.0): a LAZ file whose points are sorted into an octree, so that viewers and GIS load the part and the detail that they show.
//! Written through the crate `copc-writer`; every program that reads LAZ reads it.

use super::{SurveyCloud, check};
use crate::file::write_atomically;
use crate::{Error, Result};
use copc_core::Bounds;
use copc_writer::{CopcPointFields, CopcPointSource, CopcWriteMetadata, CopcWriterParams, write_source};
use std::fs::{self, File};
use std::io;
use std::path::Path;
use voxelastic::Cloud;
use voxelastic_files::Scratch;

/// Coordinates are written in steps of this, metres.
const STEP: f64 = 1e-4;

/// The returns of a cloud, as the writer asks for them.
struct Returns<'a> {
    survey: &'a SurveyCloud,
    /// Their places in the cloud.
    places: Vec<u32>,
}

impl CopcPointSource for Returns<'_> {
    fn len(&self) -> usize {
        self.places.len()
    }

    fn xyz(&self, index: usize) -> copc_core::Result<(f64, f64, f64)> {
        let [x, y, z] = self.point(index);
        Ok((x, y, z))
    }

    fn fields_into(&self, index: usize, out: &mut CopcPointFields) -> copc_core::Result<()> {
        let ([x, y, z], place) = (self.point(index), self.places[index] as usize);
        let intensity = self.survey.cloud.intensity.as_ref().map_or(0.0, |v| v[place]).round().clamp(0.0, 65535.0) as u16;
        let [red, green, blue] = self.survey.cloud.colours.as_ref().map_or([0; 3], |c| c[place].map(|v| u16::from(v) * 257));
        *out = CopcPointFields { x, y, z, intensity, red, green, blue, return_number: 1, number_of_returns: 1, ..CopcPointFields::default() };
        Ok(())
    }
}

impl Returns<'_> {
    fn point(&self, index: usize) -> [f64; 3] {
        let p = self.survey.cloud.points[self.places[index] as usize];
        std::array::from_fn(|k| f64::from(p[k]) + self.survey.offset[k])
    }

    fn bounds(&self) -> Bounds {
        let [x, y, z] = if self.places.is_empty() { [0.0; 3] } else { self.point(0) };
        let mut bounds = Bounds::point(x, y, z);
        for index in 1..self.places.len() {
            let [x, y, z] = self.point(index);
            bounds.extend(x, y, z);
        }
        bounds
    }
}

/// Writes a cloud as COPC, atomically. Points without a return are left out; intensities are rounded to whole numbers from 0 to 65535; coordinates to a
/// tenth of a millimetre, counted from the centre.
///
/// # Errors
/// [`Error::NoReturn`] without points, [`Error::Unwritable`] if channels differ in length or points are farther apart than LAS reaches; [`Error::Io`].
pub fn write(path: impl AsRef<Path>, survey: &SurveyCloud) -> Result<()> {
    let path = path.as_ref();
    check(path, survey)?;
    let is_return = |(_, p): &(usize, &[f32; 3])| Cloud::is_return(p);
    let places: Vec<u32> = survey.cloud.points.iter().enumerate().filter(is_return).map(|(i, _)| i as u32).collect();
    if places.is_empty() {
        return Err(Error::NoReturn { path: path.into(), points: survey.cloud.len() });
    }
    let returns = Returns { survey, places };
    let bounds = returns.bounds();
    let (x, y, z) = bounds.center();
    let mut metadata = CopcWriteMetadata::default();
    metadata.generating_software = Some("voxelastic".to_owned());
    metadata.wkt_crs.clone_from(&survey.crs_wkt);
    metadata.system_identifier = Some("voxelastic map".to_owned());
    metadata.scale = Some((STEP, STEP, STEP));
    metadata.offset = Some((x.round(), y.round(), z.round()));
    if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(parent).map_err(|e| Error::io(path, "write", e))?;
    }
    // The writer makes a file that only its owner may read, and others beside it; what others may is what they may of every new file.
    let scratch = Scratch::beside(path).map_err(|e| Error::io(path, "write", e))?;
    let own = scratch.folder().join("cloud.laz");
    let written = write_source(&own, &returns, survey.cloud.colours.is_some(), bounds, &CopcWriterParams::default(), &metadata);
    written.map_err(|e| match e {
        copc_core::Error::Io { source, .. } => Error::io(path, "write", source),
        other => Error::unwritable(path, other.to_string()),
    })?;
    let mut file = File::open(&own).map_err(|e| Error::io(path, "write", e))?;
    write_atomically(path, |w| io::copy(&mut file, w).map(drop))
}
