//! What a capture is of, and how it is read.

use super::recognise::{Recognised, SpinningSensor, known, recognise};
use super::spinning_capture::SpinningCapture;
use super::stream::{CaptureStream, CapturedScans};
use crate::playback::MessageStream;
use crate::{Error, OpenOptions, Result, ouster};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::sensor::BeamModel;

/// How a capture is read.
#[derive(Clone, Debug)]
pub(crate) enum CaptureKind {
    /// Packets of an Ouster sensor, with its metadata file.
    Ouster(PathBuf),
    /// Packets of another sensor.
    Spinning(SpinningSensor),
}

impl CaptureKind {
    /// Recognises the sensor by its packets, or by the metadata that the user names; also what was found, in words.
    ///
    /// # Errors
    /// [`Error::Dataset`] if it is none that can be read; [`Error::Content`] if a file is damaged; [`Error::Io`].
    pub(crate) fn of(path: &Path, options: &OpenOptions) -> Result<(Self, Vec<String>)> {
        let is_json = |file: &PathBuf| file.extension().is_some_and(|x| x.eq_ignore_ascii_case("json"));
        let given = options.metadata.as_ref();
        if given.is_none_or(|file| !is_json(file)) {
            match recognise(path, given.map(PathBuf::as_path))? {
                Recognised::Sensor(sensor, notes) => return Ok((Self::Spinning(sensor), notes)),
                Recognised::Unreadable(name, remedy) => {
                    return Err(Error::dataset(path, format!("packets of a {name}, which are not read"), remedy));
                }
                Recognised::Nothing => {}
            }
        }
        let metadata = match given {
            Some(metadata) => metadata.clone(),
            None => ouster::find_metadata(path).map_err(|_| nothing_known(path))?,
        };
        ouster::Capture::open(path, &metadata)?;
        let note = format!("the sensor is described by {}", metadata.display());
        Ok((Self::Ouster(metadata), vec![note]))
    }

    /// Its messages, from the beginning.
    pub(crate) fn stream(&self, path: &Path) -> Result<Box<dyn MessageStream>> {
        let scans: Box<dyn CapturedScans> = match self {
            Self::Ouster(metadata) => Box::new(ouster::Capture::open(path, metadata)?),
            Self::Spinning(sensor) => Box::new(SpinningCapture::open(path, sensor)?),
        };
        Ok(Box::new(CaptureStream::new(scans, path)))
    }

    /// The sensor's own tables of beams, where the scans are images.
    pub(crate) fn model(&self, path: &Path) -> Option<BeamModel> {
        match self {
            Self::Ouster(metadata) => ouster::Capture::open(path, metadata).ok()?.model().ok(),
            Self::Spinning(_) => None,
        }
    }

    /// Pose of the inertial measurement unit in the sensor's frame, if there is one.
    pub(crate) fn t_sensor_imu(&self, path: &Path) -> Result<Option<Pose>> {
        match self {
            Self::Ouster(metadata) => Ok(Some(ouster::Capture::open(path, metadata)?.t_sensor_imu())),
            Self::Spinning(_) => Ok(None),
        }
    }
}

/// The error about a capture of which nothing is known.
fn nothing_known(path: &Path) -> Error {
    let problem = format!("no packets of a sensor that is known ({}), and no metadata of an Ouster sensor beside it", known().join(", "));
    let remedy = "put the Ouster sensor's .json there under the same name; of other sensors, have the driver make clouds and record those";
    Error::dataset(path, problem, remedy)
}
