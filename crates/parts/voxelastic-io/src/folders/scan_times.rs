//! Time files next to clouds.
//!
//! ```text
//! velodyne_points/timestamps.txt          KITTI raw, KITTI-360: date and time of each sweep, 2011-09-26 13:02:25.594360375
//! velodyne_points/timestamps_start.txt    of the start of each sweep
//! velodyne_points/timestamps_end.txt      of its end
//! ```

use super::cloud_files::{CloudFile, scan_numbers};
use crate::text::{self, Line, check_increasing, lines};
use crate::{Error, Result};
use std::path::Path;

/// Times of the clouds of a folder, in the order of the clouds, seconds.
#[derive(Clone, Debug)]
pub(crate) struct ScanTimes {
    /// Name of the file, for people.
    pub(crate) file: String,
    /// Time of each cloud.
    pub(crate) times: Vec<f64>,
    /// Start and end of each sweep, if there are files for both.
    pub(crate) sweeps: Option<Vec<[f64; 2]>>,
}

/// Reads the timestamps files next to the folder of the clouds, as KITTI raw has them; `None` if there are none.
///
/// # Errors
/// [`Error::Content`] if a file is damaged; [`Error::Dataset`] if it does not have a time for each cloud; [`Error::Io`].
pub(crate) fn read_scan_times(clouds_folder: &Path, clouds: &[CloudFile]) -> Result<Option<ScanTimes>> {
    let Some(parent) = clouds_folder.parent() else { return Ok(None) };
    let read = |name: &str| -> Result<Option<Vec<f64>>> {
        let file = parent.join(name);
        if !file.is_file() {
            return Ok(None);
        }
        match_times(&read_dates(&file)?, clouds, &file).map(Some)
    };
    let Some(times) = read("timestamps.txt")? else { return Ok(None) };
    let sweeps = match (read("timestamps_start.txt")?, read("timestamps_end.txt")?) {
        (Some(starts), Some(ends)) => Some(starts.into_iter().zip(ends).map(|(start, end)| [start, end]).collect()),
        _ => None,
    };
    Ok(Some(ScanTimes { file: "timestamps.txt".into(), times, sweeps }))
}

/// The time of each cloud from a file of times: by order if there are as many, else by the number in the cloud's name, from 0.
///
/// # Errors
/// [`Error::Dataset`] if neither fits.
pub(crate) fn match_times(times: &[f64], clouds: &[CloudFile], file: &Path) -> Result<Vec<f64>> {
    if times.len() == clouds.len() {
        return Ok(times.to_vec());
    }
    let numbers = scan_numbers(clouds).unwrap_or_default();
    let by_number: Option<Vec<f64>> = numbers.iter().map(|n| times.get(usize::try_from(*n).ok()?).copied()).collect();
    by_number.filter(|times| times.len() == clouds.len()).ok_or_else(|| {
        let problem = format!("{} times for {} clouds", times.len(), clouds.len());
        Error::dataset(file, problem, "write the time of each cloud on a line of its own, or remove the file")
    })
}

/// Reads a file with a date and time on each line, seconds since 1970.
///
/// # Errors
/// [`Error::Content`] if a line is not a date or times do not increase; [`Error::Io`].
pub(crate) fn read_dates(path: &Path) -> Result<Vec<f64>> {
    let text = text::read(path)?;
    let (mut times, mut numbers) = (Vec::new(), Vec::new());
    for line in lines(path, &text) {
        times.push(date(&line)?);
        numbers.push(line.number);
    }
    check_increasing(path, &times, &numbers)?;
    Ok(times)
}

/// `YYYY-MM-DD hh:mm:ss.fraction` in seconds since 1970.
fn date(line: &Line<'_>) -> Result<f64> {
    let wrong = || line.field_error("date", "not a time of the form 2011-09-26 13:02:25.594360375", "download the file again, or remove it");
    let (day, time) = line.text.split_once([' ', 'T']).ok_or_else(wrong)?;
    let whole = |text: &str, separator: char| -> Option<[f64; 3]> {
        let numbers: Vec<f64> = text.split(separator).map(|n| n.parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0)).collect::<Option<_>>()?;
        numbers.try_into().ok()
    };
    let ([year, month, day], [hours, minutes, seconds]) = whole(day, '-').zip(whole(time.trim_end_matches('Z'), ':')).ok_or_else(wrong)?;
    let is_date = (1970.0..3000.0).contains(&year) && (1.0..=12.0).contains(&month) && (1.0..=31.0).contains(&day);
    if !is_date || hours > 24.0 || minutes > 60.0 || seconds > 61.0 {
        return Err(wrong());
    }
    Ok(days_since_1970(year as i64, month as i64, day as i64) as f64 * 86_400.0 + hours * 3600.0 + minutes * 60.0 + seconds)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar. Years are counted from March, so that the leap day is the last of its year.
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    let days_before_month = (153 * month + 2) / 5;
    let leap_days = year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400);
    365 * year + leap_days + days_before_month + day - 1 - 719_468
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_become_seconds() {
        let seconds = |text: &str| date(&Line { path: Path::new("t"), number: 3, text });
        assert_eq!(seconds("1970-01-01 00:00:00").unwrap(), 0.0);
        assert_eq!(seconds("2000-03-01 00:00:01").unwrap(), 951_868_801.0);
        assert!((seconds("2011-09-26 13:02:25.594360375").unwrap() - 1_317_042_145.594_360_4).abs() < 1e-6);
        assert!((seconds("2013-05-28 08:46:02.904448000").unwrap() - 1_369_730_762.904_448).abs() < 1e-6);
        for wrong in ["", "13:02:25", "2011-09-26", "2011-13-26 13:02:25", "2011-09-26 13:02", "a-b-c 1:2:3"] {
            assert!(seconds(wrong).unwrap_err().to_string().contains("line 3, field date"), "{wrong}");
        }
    }
}
