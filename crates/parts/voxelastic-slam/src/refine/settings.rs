//! How poses are refined.

/// How poses are refined.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefineSettings {
    /// Rounds, each with a narrower gate.
    pub gates: Vec<f64>,
    /// Edge of the largest cubes that hold a plane, in cells of the scans.
    pub cube: f64,
    /// How often a cube may be halved.
    pub halvings: u32,
    /// Standard deviation of a point of a plane, metres: what planes count beside edges.
    pub sigma: f64,
    /// A surfel counts as many points, at most.
    pub most_points: f64,
    /// Roughness from which a plane counts less, metres (one standard deviation).
    pub roughness: f64,
    /// Each pose is held where it was with these standard deviations, radians and metres.
    pub held: [f64; 2],
    /// Poses that are farther than this from where they were are not kept, metres: what led them there was not what they saw.
    pub most_moved: f64,
    /// Steps of Gauss-Newton in a round.
    pub steps: usize,
    /// One of so many surfels is held out, to judge.
    pub hold_out: usize,
    /// The score must fall by this much for poses to be kept.
    pub least_gain: f64,
}

impl Default for RefineSettings {
    fn default() -> Self {
        Self {
            gates: vec![0.6, 0.4, 0.25, 0.15, 0.12, 0.12],
            cube: 10.0,
            halvings: 2,
            sigma: 0.02,
            most_points: 5.0,
            roughness: 0.005,
            held: [0.01, 0.1],
            most_moved: 1.0,
            steps: 3,
            hold_out: 10,
            least_gain: 0.001,
        }
    }
}

/// What holds in a round.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// Surfels farther than this from a plane are not on it, metres.
    pub(super) gate: f64,
    /// The largest thickness of a plane, one standard deviation, metres.
    pub(super) thickness: f64,
    /// Edge of the largest cubes, metres.
    pub(super) cube: f64,
    pub(super) halvings: u32,
    pub(super) most_points: f64,
    pub(super) hold_out: usize,
    pub(super) roughness: f64,
}

impl Round {
    /// The round of a gate, for scans with cells of an edge.
    pub(super) fn new(settings: &RefineSettings, gate: f64, cell: f64) -> Self {
        Self {
            gate,
            thickness: (0.3 * gate).max(0.03),
            cube: settings.cube * cell,
            halvings: settings.halvings,
            most_points: settings.most_points,
            hold_out: settings.hold_out,
            roughness: settings.roughness,
        }
    }

    /// What a point counts on a plane whose surfels have a variance across it.
    pub(super) fn flatness_weight(&self, variance: f64) -> f64 {
        1.0 / (1.0 + variance / (self.roughness * self.roughness))
    }

    /// Whether a surfel is held out.
    pub(super) fn holds_out(&self, scan: u32, surfel: u32) -> bool {
        let mixed = (u64::from(scan) << 32 | u64::from(surfel)).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        (mixed as usize).is_multiple_of(self.hold_out)
    }
}
