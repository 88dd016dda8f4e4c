//! Before mapping: whether the poses that came with the scans belong to them.

use crate::Result;
use crate::source::Source;
use crate::source::sample::Examination;
use crate::source::times_check;
use crate::warning::{Code, Warnings};
use std::path::Path;
use std::str::FromStr;
use voxelastic::Pose;
use voxelastic::geometry::PoseChange;
use voxelastic_io::OpenOptions;
use voxelastic_slam::pose_check::{PoseCheck, Reading, Verdict, check};

/// What is done about poses that do not fit the scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum PosesCheck {
    /// They are read as the scans tell, and it is said.
    Fix,
    /// It is said.
    #[default]
    Warn,
    /// They are not compared.
    Off,
}

impl FromStr for PosesCheck {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        match text {
            "fix" => Ok(Self::Fix),
            "warn" => Ok(Self::Warn),
            "off" => Ok(Self::Off),
            _ => Err(format!("{text:?} is none of: fix, warn, off")),
        }
    }
}

/// So many times as many scans are compared where the first ones do not agree.
const MORE: usize = 2;

impl Source {
    /// Opens data as [`open`](Self::open) does, looks at some of them, and compares their poses with the scans. What is doubtful is a warning.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_checked(
        path: &Path,
        options: &OpenOptions,
        slam: Option<bool>,
        what: PosesCheck,
        warnings: &mut Warnings,
    ) -> Result<(Self, Option<Examination>)> {
        if what == PosesCheck::Off {
            return Ok((Self::open_decided(path, options, slam, warnings)?.0, None));
        }
        let mut source = Self::open(path, options, slam)?;
        let mut found = source.examine(options);
        let mut options = options.clone();
        if let Some(point_times) = times_check::decide(&found.sample, path, &options, warnings) {
            options.point_times = point_times;
            source = Self::open(path, &options, slam)?;
            found = source.examine(&options);
        }
        let options = &options;
        let Some(check) = &found.poses else { return Ok((source, Some(found))) };
        let change = remedy(check, options);
        let Some((change, flags)) = change.filter(|_| what == PosesCheck::Fix) else {
            tell(check, options, warnings);
            return Ok((source, Some(found)));
        };
        let fixed = Self::open(path, &change, slam)?;
        warnings.add(Code::PosesChanged, format!("{}; they are read with {flags}", pose_problem(check)), "");
        let again = fixed.examine(&change);
        again.poses.iter().for_each(|check| tell(check, &change, warnings));
        Ok((fixed, Some(again)))
    }

    /// Looks at some of the data, and at more of them where poses and scans do not agree.
    pub fn examine(&self, options: &OpenOptions) -> Examination {
        let examined = |times: usize| {
            let sample = self.sample(times);
            let poses = (!sample.pairs.is_empty()).then(|| check(&sample.track, sample.has_times, options.t_base_lidar.as_ref(), &sample.pairs));
            Examination { poses, sample }
        };
        let found = examined(1);
        let is_settled = found.poses.as_ref().is_none_or(|check| matches!(check.verdict, Verdict::Agree));
        if is_settled { found } else { examined(MORE) }
    }
}

/// Says what was found.
fn tell(found: &PoseCheck, options: &OpenOptions, warnings: &mut Warnings) {
    let PoseCheck { pairs, agreeing, .. } = found;
    match &found.verdict {
        Verdict::Undecided => {
            tracing::info!("whether poses and scans agree is not known: {agreeing} of {pairs} pairs of scans do that tell how the lidar moved")
        }
        Verdict::Agree => tracing::info!("poses agree with the scans: {agreeing} of {pairs} pairs, {} apart in the middle", apart(found.median)),
        Verdict::AgreeBetter(_) => warnings.add(Code::MountingOff, pose_problem(found), remedy_words(found, options)),
        Verdict::Disagree(_) => warnings.add(Code::PosesDisagree, pose_problem(found), remedy_words(found, options)),
    }
}

fn remedy_words(found: &PoseCheck, options: &OpenOptions) -> String {
    match (remedy(found, options), &found.verdict) {
        (Some((_, flags)), _) => format!("map again with {flags}, or with --poses-check fix"),
        _ => "check that they are of these scans, in metres, of the lidar, in the same order and clock; --slam estimates them instead".to_owned(),
    }
}

/// What is wrong, in words; empty if nothing is.
pub fn pose_problem(found: &PoseCheck) -> String {
    let PoseCheck { pairs, agreeing, .. } = found;
    match &found.verdict {
        Verdict::AgreeBetter(offset) => format!(
            "poses and scans agree best with the lidar moved by {:.0} cm and turned by {:.1} degrees on what the poses are of",
            offset.t_base_lidar.translation.vector.norm() * 100.0,
            offset.t_base_lidar.rotation.angle().to_degrees(),
        ),
        Verdict::Disagree(Some(reading)) if found.is_rough() => {
            format!(
                "the poses fit the scans, but roughly: the two are {} apart in the middle of {pairs} pairs, and {} if {}",
                apart(found.median),
                apart(reading.median),
                meaning(reading)
            )
        }
        Verdict::Disagree(reading) => {
            let fits = reading.as_ref().map_or("no other reading of them was found that does".to_owned(), |reading| {
                format!("{} of {} do, {} apart, if {}", reading.agreeing, reading.pairs, apart(reading.median), meaning(reading))
            });
            format!(
                "the poses do not fit the scans: {agreeing} of {pairs} pairs of scans agree, and in the middle the two are {} apart; {fits}",
                apart(found.median)
            )
        }
        _ => String::new(),
    }
}

/// A distance and an angle, in words.
fn apart((metres, radians): (f64, f64)) -> String {
    if metres < 1.0 {
        format!("{:.0} cm and {:.1} degrees", metres * 100.0, radians.to_degrees())
    } else {
        format!("{metres:.1} m and {:.1} degrees", radians.to_degrees())
    }
}

/// What a reading means, in words.
fn meaning(reading: &Reading) -> String {
    let PoseChange { inverse, w_first, scale, rows, seconds } = reading.change;
    let mut parts = Vec::new();
    w_first.then(|| parts.push("the quaternions have w first".to_owned()));
    inverse.then(|| parts.push("they are the inverse: the map in the lidar's frame".to_owned()));
    (scale != 1.0).then(|| parts.push(format!("their lengths are multiplied by {scale}")));
    (rows != 0).then(|| parts.push(format!("each scan has the pose {} rows {}", rows.abs(), if rows > 0 { "later" } else { "earlier" })));
    (seconds != 0.0)
        .then(|| parts.push(format!("each scan has the pose of {:.2} s {}", seconds.abs(), if seconds > 0.0 { "later" } else { "earlier" })));
    reading.is_other_frame.then(|| parts.push(frame(&reading.mounting.t_base_lidar)));
    parts.join(", and ")
}

/// The frame that poses are of, by where the lidar is in it.
fn frame(t_base_lidar: &Pose) -> String {
    let z_forward = t_base_lidar.rotation * nalgebra::Vector3::x();
    let y_down = t_base_lidar.rotation * nalgebra::Vector3::z();
    let is_camera = z_forward.z > 0.99 && y_down.y < -0.99;
    let what = if is_camera { "a camera (z forward, y down), as KITTI has them" } else { "another frame on the same body" };
    format!("they are those of {what}")
}

/// The flags that mend what is wrong, if it is known.
pub fn pose_flags(found: &PoseCheck, options: &OpenOptions) -> Option<String> {
    remedy(found, options).map(|(_, flags)| flags)
}

/// The options that mend it, and their flags.
fn remedy(found: &PoseCheck, options: &OpenOptions) -> Option<(OpenOptions, String)> {
    let mut changed = options.clone();
    let mut flags = Vec::new();
    match &found.verdict {
        Verdict::AgreeBetter(mounting) => {
            changed.t_base_lidar = Some(options.t_base_lidar.unwrap_or_default() * mounting.t_base_lidar);
        }
        Verdict::Disagree(Some(reading)) => {
            if !reading.change.is_none() {
                changed.pose_change = combined(&options.pose_change, &reading.change);
                flags.push(format!("--pose-change {}", changed.pose_change));
            }
            if reading.is_other_frame {
                changed.t_base_lidar = Some(reading.mounting.t_base_lidar);
            }
        }
        _ => return None,
    }
    if let Some(t) = changed.t_base_lidar.filter(|t| Some(*t) != options.t_base_lidar) {
        let (v, q) = (t.translation.vector, t.rotation.coords);
        flags.push(format!("--t-base-lidar \"{:.3} {:.3} {:.3} {:.5} {:.5} {:.5} {:.5}\"", v.x, v.y, v.z, q.x, q.y, q.z, q.w));
    }
    Some((changed, flags.join(" ")))
}

/// A change of poses that were changed already.
fn combined(first: &PoseChange, second: &PoseChange) -> PoseChange {
    PoseChange {
        inverse: first.inverse != second.inverse,
        w_first: first.w_first != second.w_first,
        scale: first.scale * second.scale,
        rows: first.rows + second.rows,
        seconds: first.seconds + second.seconds,
    }
}

#[cfg(all(test, unix))]
mod tests;
