//! Times of clouds and poses besides those of the trajectory.

use super::folder::Folder;
use crate::folders::{match_times, name_of, read_scan_times};
use crate::{Error, Result, Trajectory, poses};

/// Times from files and names, seconds.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// The time of each cloud.
    pub(super) of_clouds: Option<Vec<f64>>,
    /// The time of each pose.
    pub(super) of_poses: Option<Vec<f64>>,
    /// Name of the file, unless they come from the clouds' names.
    pub(super) file: Option<String>,
}

/// Times from `times.txt` or KITTI's timestamps, else from the clouds' names.
///
/// # Errors
/// [`Error::Dataset`] if there are several such files, or the number of times fits neither clouds nor poses; those of reading the file.
pub(super) fn read(folder: &Folder, trajectory: &Trajectory) -> Result<Times> {
    let clouds = &folder.clouds.clouds;
    let of_clouds: Option<Vec<f64>> = clouds.iter().map(|c| c.stamp).collect();
    let file = match folder.times.as_slice() {
        [] => {
            let next_to_clouds = read_scan_times(&folder.path.join(&folder.clouds.relative), clouds)?;
            return Ok(match next_to_clouds {
                Some(found) => Times { of_clouds: Some(found.times), of_poses: None, file: Some(found.file) },
                None => Times { of_clouds, of_poses: None, file: None },
            });
        }
        [file] => file,
        several => {
            let names: Vec<String> = several.iter().map(|f| name_of(f)).collect();
            let problem = format!("several files hold times: {}", names.join(", "));
            return Err(Error::dataset(&folder.path, problem, "leave the one with the clouds' times"));
        }
    };
    let times = poses::read_times(file)?;
    if times.len() == clouds.len() {
        return Ok(Times { of_clouds: Some(times), of_poses: None, file: Some(name_of(file)) });
    }
    if times.len() == trajectory.len() && trajectory.times.is_none() {
        return Ok(Times { of_clouds, of_poses: Some(times), file: Some(name_of(file)) });
    }
    // With the wrong number of times, the numbers in the clouds' names decide.
    match match_times(&times, clouds, file) {
        Ok(of_clouds) => Ok(Times { of_clouds: Some(of_clouds), of_poses: None, file: Some(name_of(file)) }),
        Err(_) => {
            let problem = format!("{} times for {} clouds and {} poses", times.len(), clouds.len(), trajectory.len());
            Err(Error::dataset(file, problem, "write the time of each cloud on a line of its own, or remove the file"))
        }
    }
}
