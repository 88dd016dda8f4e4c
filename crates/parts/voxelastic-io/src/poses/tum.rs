//! TUM trajectories: `time x y z qx qy qz qw` per line.

use super::trajectory::Trajectory;
use crate::Result;
use crate::text::{check_increasing, lines};
use std::path::Path;

pub(super) fn parse(text: &str, path: &Path) -> Result<Trajectory> {
    let (mut poses, mut times, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    for line in lines(path, text) {
        let [time, pose @ ..] = line.numbers(line.words(), &["time", "x", "y", "z", "qx", "qy", "qz", "qw"])?;
        poses.push(line.pose(pose)?);
        times.push(time);
        numbers.push(line.number);
    }
    check_increasing(path, &times, &numbers)?;
    Ok(Trajectory { poses, times: Some(times), nodes: None })
}
