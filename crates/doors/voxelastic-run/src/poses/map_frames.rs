//! Where the frame of the poses that come may lie in a map: hypotheses, among which several scans decide together.
//!
//! One scan may fit several places that look alike, each a hypothesis of where the frame lies. A scan from elsewhere makes those more probable that it fits, and the others less.

use voxelastic::Pose;
use voxelastic::geometry::PoseExt;
use voxelastic_slam::loops::Located;

/// Two scans say the same, and a scan says what its pose says, if that differs by no more than this: metres, and radians.
const AGREEMENT: (f64, f64) = (0.5, 0.05);
/// A scan nearer than this to one before sees what that saw, and is no new evidence, metres.
const APART: f64 = 0.5;
/// Probability of a hypothesis that is believed.
const CERTAIN: f64 = 0.99;
/// How probable a scan's place is that it was not found at: the search can have missed it.
const MISSED: f64 = 0.01;
/// How much more probable a place is at which scans are expected than another.
const EXPECTED: f64 = 100.0;

/// The hypotheses, and the scans by which they were judged.
#[derive(Default)]
pub(super) struct MapFrames {
    hypotheses: Vec<Hypothesis>,
    /// Logarithm of the weight of the hypothesis that the frame is nowhere in the map.
    nowhere: f64,
    /// Where scans that counted were taken, in the frame of the poses.
    counted: Vec<Pose>,
}

/// A place of the frame in the map.
struct Hypothesis {
    t_map_frame: Pose,
    /// Logarithm of its weight among the others.
    weight: f64,
    /// Scans that say so.
    scans: usize,
    /// Whether the poses were given in this frame.
    is_given: bool,
}

impl MapFrames {
    /// Counts a scan with this pose in the frame of the poses, which may be at some places of the map; one that is nowhere does not count. `is_given` and `is_expected` tell of a pose in the map whether the
    /// scan's own pose says so, and whether scans are expected there.
    pub(super) fn count(&mut self, pose: &Pose, located: &[Located], is_given: impl Fn(&Pose) -> bool, is_expected: impl Fn(&Pose) -> bool) {
        let possible: Vec<&Located> = located.iter().filter(|l| l.is_possible).collect();
        if possible.is_empty() {
            return;
        }
        let is_new = self.counted.iter().all(|other| other.translation_distance(pose) >= APART);
        let before = self.counted.len() as f64;
        let probable = |pose: &Pose| possible.iter().find(|l| is_same(&l.t_map_lidar, pose)).map(|l| (l.t_map_lidar, l.probability.max(MISSED).ln()));
        let mut fits: Vec<Pose> = Vec::new();
        for hypothesis in &mut self.hypotheses {
            let found = probable(&(hypothesis.t_map_frame * pose));
            if is_new {
                hypothesis.weight += found.map_or(MISSED.ln(), |(_, weight)| weight);
            }
            if let Some((t_map_lidar, _)) = found {
                hypothesis.scans += 1;
                hypothesis.is_given |= is_given(&t_map_lidar);
                hypothesis.t_map_frame = t_map_lidar * pose.inverse();
                fits.push(t_map_lidar);
            }
        }
        if !is_new {
            return;
        }
        self.counted.push(*pose);
        self.nowhere += (1.0 - located.iter().map(|l| l.probability).sum::<f64>()).max(MISSED).ln();
        for place in possible {
            let t_map_lidar = &place.t_map_lidar;
            if fits.iter().any(|other| is_same(other, t_map_lidar)) {
                continue;
            }
            fits.push(*t_map_lidar);
            let is_given = is_given(t_map_lidar);
            let prior = if is_given || is_expected(t_map_lidar) { EXPECTED.ln() } else { 0.0 };
            let weight = prior + before * MISSED.ln() + place.probability.max(MISSED).ln();
            self.hypotheses.push(Hypothesis { t_map_frame: t_map_lidar * pose.inverse(), weight, scans: 1, is_given });
        }
    }

    /// Where the frame lies, if that is certain, and whether it is the one in which the poses were given: two scans say so, or one and its pose.
    pub(super) fn decided(&self) -> Option<(Pose, bool)> {
        let best = self.hypotheses.iter().max_by(|a, b| a.weight.total_cmp(&b.weight))?;
        let all = self.hypotheses.iter().map(|h| h.weight).chain([self.nowhere]);
        let is_certain = all.map(|weight| (weight - best.weight).exp()).sum::<f64>() <= 1.0 / CERTAIN;
        (is_certain && (best.scans > 1 || best.is_given)).then_some((best.t_map_frame, best.is_given))
    }

    /// How many places there are that are not much less probable than the best, or than none.
    pub(super) fn rivals(&self) -> usize {
        let most = self.hypotheses.iter().map(|h| h.weight).fold(self.nowhere, f64::max);
        self.hypotheses.iter().filter(|h| h.weight - most > (1.0 - CERTAIN).ln()).count()
    }
}

/// Whether two poses in the map are the same.
pub(super) fn is_same(a: &Pose, b: &Pose) -> bool {
    a.translation_distance(b) <= AGREEMENT.0 && a.rotation_distance(b) <= AGREEMENT.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn located(t_map_lidar: Pose, probability: f64) -> Located {
        Located {
            t_map_lidar,
            probability,
            is_possible: true,
            is_certain: false,
            overlap: 0.9,
            score: 0.8,
            contradiction: 0.0,
            fine_contradiction: 0.0,
            beside: 0.0,
            spread: 0.02,
            information: None,
        }
    }

    /// Counts scans along a path, which fit where the frame lies at one of these places with these probabilities, until it is decided: after how many scans, and where.
    fn decided(places: &[(Pose, f64)], is_given: bool, expected: Option<&Pose>) -> Option<(usize, Pose)> {
        let mut frames = MapFrames::default();
        (1..=50).find_map(|k| {
            let pose = Pose::translation(0.6 * k as f64, 0.0, 0.0);
            let all: Vec<Located> = places.iter().map(|(place, probability)| located(place * pose, *probability)).collect();
            let is_expected = |at: &Pose| expected.is_some_and(|expected| at.translation_distance(&(expected * pose)) < 1.0);
            frames.count(&pose, &all, |at| is_given && is_same(at, &pose), is_expected);
            frames.decided().map(|(t_map_frame, _)| (k, t_map_frame))
        })
    }

    #[test]
    fn several_scans_decide_where_one_cannot() {
        let (here, there) = (Pose::identity(), Pose::translation(40.0, 0.0, 0.0));
        assert_eq!(decided(&[(here, 0.995)], false, None).map(|found| found.0), Some(2), "two say the same");
        assert_eq!(decided(&[(here, 0.995)], true, None).map(|found| found.0), Some(1), "one, and its pose");
        assert_eq!(decided(&[(here, 0.5), (there, 0.5)], false, None), None, "equal places stay equal");
        let (scans, place) = decided(&[(here, 0.2), (there, 0.8)], false, None).unwrap();
        assert!(scans == 4 && is_same(&place, &there), "{scans}");
        // Who is expected somewhere is there, if scans do not tell.
        let (scans, place) = decided(&[(here, 0.5), (there, 0.5)], false, Some(&there)).unwrap();
        assert!(scans == 2 && is_same(&place, &there), "{scans}");
        assert_eq!(decided(&[(here, 0.3)], false, None), None, "it is rather nowhere");
    }

    #[test]
    fn who_stands_still_learns_nothing_new() {
        let mut frames = MapFrames::default();
        for _ in 0..50 {
            frames.count(&Pose::identity(), &[located(Pose::identity(), 0.8), located(Pose::translation(9.0, 0.0, 0.0), 0.2)], |_| false, |_| false);
        }
        assert!(frames.decided().is_none() && frames.rivals() == 2);
    }
}
