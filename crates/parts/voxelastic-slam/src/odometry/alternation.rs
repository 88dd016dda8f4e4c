//! Whether every second scan comes from another place: two sensors whose scans are in one stream.

use serde::{Deserialize, Serialize};
use voxelastic::geometry::stored::StoredPose;
use voxelastic::geometry::{Pose, PoseExt};

/// A motion there and back counts if it is at least so long, metres, or turns at least so far, radians ..
const LEAST: (f64, f64) = (0.3, 0.2);
/// .. and if both together lead no farther than this share of it.
const MOST_LEFT: f64 = 0.4;
/// So many in turn are no shaking.
const IN_TURN: usize = 5;

/// Motions there and back again, so far.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct Alternation {
    last: Option<StoredPose>,
    in_turn: usize,
    sure: bool,
}

impl Alternation {
    /// Adds the motion from the last scan to this one.
    pub(super) fn add(&mut self, moved: &Pose) {
        let size = |pose: &Pose| pose.translation_distance(&Pose::identity()) + LEAST.0 / LEAST.1 * pose.rotation.angle();
        let returns = self.last.is_some_and(|StoredPose(last)| {
            let both = last * moved;
            size(moved).min(size(&last)) > LEAST.0 && size(&both) < MOST_LEFT * size(moved)
        });
        self.in_turn = if returns { self.in_turn + 1 } else { 0 };
        self.sure |= self.in_turn >= IN_TURN;
        self.last = Some(StoredPose(*moved));
    }

    /// Whether it is sure.
    pub(super) fn is_sure(&self) -> bool {
        self.sure
    }
}
