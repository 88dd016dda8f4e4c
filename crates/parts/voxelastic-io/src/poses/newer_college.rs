//! `registered_poses.csv` of the Newer College Dataset: `sec,nsec,x,y,z,qx,qy,qz,qw`.

use super::trajectory::Trajectory;
use crate::Result;
use crate::text::{check_increasing, lines};
use std::path::Path;

pub(super) fn parse(text: &str, path: &Path) -> Result<Trajectory> {
    let (mut poses, mut times, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    let mut is_first = true;
    for line in lines(path, text) {
        let is_heading = std::mem::take(&mut is_first) && line.words().all(|w| w.starts_with(|c: char| c.is_ascii_alphabetic()));
        if is_heading {
            continue;
        }
        let mut words = line.words();
        let seconds = line.integer(words.next(), "sec")?;
        let nanoseconds = line.integer(words.next(), "nsec")?;
        if nanoseconds >= 1_000_000_000 {
            return Err(line.field_error("nsec", format!("{nanoseconds} is a second or more"), "correct it or write the file again"));
        }
        poses.push(line.pose(line.numbers(words, &["x", "y", "z", "qx", "qy", "qz", "qw"])?)?);
        times.push(seconds as f64 + nanoseconds as f64 * 1e-9);
        numbers.push(line.number);
    }
    check_increasing(path, &times, &numbers)?;
    Ok(Trajectory { poses, times: Some(times), nodes: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_and_nanoseconds_make_a_time() {
        let text = "#sec,nsec,x,y,z,qx,qy,qz,qw\n1583836591,182590976,1,2,3,0,0,0,1\n1583836591,282592512, 1,2,3.5,0,0,1,0\n";
        let read = parse(text, Path::new("p.csv")).unwrap();
        assert!((read.times.unwrap()[1] - 1_583_836_591.282_592_5).abs() < 1e-6);
        assert_eq!(read.poses[1].translation.z, 3.5);
        let error = parse("1,5000000000,1,2,3,0,0,0,1\n", Path::new("p.csv")).unwrap_err();
        assert!(error.to_string().contains("line 1, field nsec"), "{error}");
    }
}
