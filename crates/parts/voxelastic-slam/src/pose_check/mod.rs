//! Whether poses belong to scans: neighbouring scans are registered, and how the sensor moved by their surfaces is compared with how it moved by the poses.
//!
//! Where the two disagree by more than drift explains, other readings of the poses are tried ([`PoseChange`](voxelastic::geometry::PoseChange), another frame on the same body), and the one under
//! which they agree is named. Nothing is changed here.

mod conventions;
mod hand_eye;
mod motions;
mod readings;

pub use hand_eye::Mounting;
pub use motions::CheckScan;
pub use readings::Reading;

use hand_eye::mounting;
pub(crate) use motions::middle;
use motions::{Motion, discrepancy, measure, measure_from_anywhere};
use rayon::prelude::*;
use voxelastic::geometry::{Pose, PoseExt};

/// Fewer pairs than this decide nothing.
const LEAST_PAIRS: usize = 3;
/// The share of pairs that may disagree: people walk by, a registration fails.
const MOST_DISAGREEING: f64 = 0.25;
/// Without a reading under which they agree, poses are wrong only if no more than this share of the pairs agrees: elsewhere surfaces that repeat mislead some.
const LEAST_DISAGREEING: f64 = 0.4;
/// Scans are compared that are farther apart than this, if there are some: metres, radians.
const APART: (f64, f64) = (0.5, 0.1);
/// A sensor that moves less than this between two scans tells nothing: metres, radians.
const LEAST_MOTION: (f64, f64) = (0.25, 0.05);
/// Offsets of the lidar's frame are said from this size on, metres and radians ..
const LEAST_OFFSET: (f64, f64) = (0.04, 0.009);
/// .. and if they are so many standard deviations.
const LEAST_SIGMAS: f64 = 5.0;

/// What a comparison of poses with scans has shown.
#[derive(Clone, Debug)]
pub struct PoseCheck {
    /// Pairs of scans whose surfaces tell how the sensor moved.
    pub pairs: usize,
    /// Of these, pairs for which the poses say the same.
    pub agreeing: usize,
    /// How far apart the two are in the middle of all pairs: metres, radians.
    pub median: (f64, f64),
    /// What follows.
    pub verdict: Verdict,
}

/// What follows from a comparison of poses with scans.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// The sensor hardly moves, or too few pairs of scans can be registered.
    Undecided,
    /// They agree.
    Agree,
    /// They agree, and agree better if the lidar is mounted a little otherwise than is said.
    AgreeBetter(Box<Mounting>),
    /// They do not agree as they are; perhaps under another reading.
    Disagree(Option<Box<Reading>>),
}

/// Whether the lidar moved enough between two poses for their scans to be a pair that tells something.
pub fn is_apart(a: &Pose, b: &Pose) -> bool {
    a.translation_distance(b) > APART.0 || a.rotation_distance(b) > APART.1
}

/// Compares poses with scans. `track` are times (seconds) and poses of the lidar in the map; the index of each scan is that of its pose there. `t_base_lidar` is what the
/// poses were multiplied with, if they were those of a vehicle.
pub fn check(track: &[(f64, Pose)], has_times: bool, t_base_lidar: Option<&Pose>, pairs: &[(CheckScan, CheckScan)]) -> PoseCheck {
    let said = t_base_lidar.copied().unwrap_or_default();
    let motions: Vec<Motion> = pairs.par_iter().filter_map(|(first, second)| measure(first, second, track)).filter(is_telling).collect();
    let found = judged(&motions);
    if motions.len() >= LEAST_PAIRS && found.is_rough() {
        let verdict = match readings::find(track, has_times, &said, &motions, true) {
            Some(reading) => Verdict::Disagree(Some(Box::new(reading))),
            None => offset(&motions).map_or(Verdict::Agree, |offset| Verdict::AgreeBetter(Box::new(offset))),
        };
        return PoseCheck { verdict, ..found };
    }
    let motions: Vec<Motion> =
        pairs.par_iter().filter_map(|(first, second)| measure_from_anywhere(first, second, track)).filter(is_telling).collect();
    let found = judged(&motions);
    if motions.len() < LEAST_PAIRS || found.is_rough() {
        return found;
    }
    let reading = readings::find(track, has_times, &said, &motions, false);
    if reading.is_none() && found.agreeing as f64 > LEAST_DISAGREEING * found.pairs as f64 {
        return found;
    }
    PoseCheck { verdict: Verdict::Disagree(reading.map(Box::new)), ..found }
}

impl PoseCheck {
    /// The motion between two rows of the track under the reading that was found, if one was; both in the lidar's frame.
    pub fn motion_under_best_reading(&self, track: &[(f64, Pose)], t_base_lidar: Option<&Pose>, rows: (usize, usize)) -> Option<Pose> {
        let said = t_base_lidar.copied().unwrap_or_default();
        match &self.verdict {
            Verdict::Disagree(Some(reading)) => reading.motion(track, &said, rows),
            Verdict::AgreeBetter(offset) => {
                let given = track.get(rows.0)?.1.inv_mul(&track.get(rows.1)?.1);
                Some(offset.t_base_lidar.inverse() * given * offset.t_base_lidar)
            }
            _ => None,
        }
    }

    /// Whether most pairs agree, as far as odometry that drifts does.
    pub fn is_rough(&self) -> bool {
        self.agreeing as f64 >= (1.0 - MOST_DISAGREEING) * self.pairs as f64
    }
}

fn judged(motions: &[Motion]) -> PoseCheck {
    let off: Vec<_> = motions.iter().map(|motion| discrepancy(&motion.given, &motion.measured)).collect();
    let agreeing = off.iter().filter(|off| off.is_small()).count();
    let median = (middle(off.iter().map(|off| off.metres)), middle(off.iter().map(|off| off.radians)));
    PoseCheck { pairs: motions.len(), agreeing, median, verdict: Verdict::Undecided }
}

/// Whether the sensor moved, and not only by its poses: its own pattern on smooth surfaces looks as if it stood still.
fn is_telling(motion: &Motion) -> bool {
    let moves = |motion: &Pose| motion.translation.vector.norm() > LEAST_MOTION.0 || motion.rotation.angle() > LEAST_MOTION.1;
    moves(&motion.measured)
}

/// How far the lidar is from where it is said to be, as far as the motions that agree tell.
fn offset(motions: &[Motion]) -> Option<Mounting> {
    let agreeing: Vec<Motion> = motions.iter().filter(|m| discrepancy(&m.given, &m.measured).is_small()).cloned().collect();
    let given: Vec<Pose> = agreeing.iter().map(|motion| motion.given).collect();
    mounting(&given, &agreeing, &Pose::identity())?.significant(LEAST_OFFSET, LEAST_SIGMAS)
}
