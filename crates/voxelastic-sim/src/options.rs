//! What a simulation is made of.

use crate::SimError;
use crate::drift::LoopSettings;
use crate::sensor::LidarSettings;
use serde::{Deserialize, Serialize};

/// Everything that a simulation follows from: the same options give the same scans, bit for bit on one machine.
///
/// `world.toml` in a simulated folder holds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimOptions {
    /// Which world: see [`crate::scenes::names`].
    pub world: String,
    /// Seed of everything that is random: the world's furniture, noise and drift.
    pub seed: u64,
    /// Which sensor: see [`voxelastic::sensor::preset_names`].
    pub sensor: String,
    /// Columns to a turn; the sensor's usual number if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<usize>,
    /// Number of scans; what the world takes to be seen whole, and again in part, if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scans: Option<usize>,
    /// Path between scans, metres. Ignored when `rate` is given.
    pub spacing: f64,
    /// Scans a second, instead of `spacing`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// Drift of the odometry, metres in 100 m of path, on average over this trajectory (paper Sec. IV: about 1). 0: none.
    pub drift: f64,
    /// How the sensor is run, and its noise.
    pub lidar: LidarSettings,
    /// When a place counts as seen again.
    pub loops: LoopSettings,
}

impl Default for SimOptions {
    fn default() -> Self {
        Self {
            world: "campus".into(),
            seed: 1,
            sensor: "os1-64".into(),
            columns: None,
            scans: None,
            spacing: 2.0,
            rate: None,
            drift: 1.0,
            lidar: LidarSettings::default(),
            loops: LoopSettings::default(),
        }
    }
}

/// Most scans of a simulation.
const MOST_SCANS: usize = 10_000_000;

impl SimOptions {
    /// The usual simulation of a world.
    pub fn of(world: impl Into<String>) -> Self {
        Self { world: world.into(), ..Self::default() }
    }

    pub(crate) fn check(&self) -> Result<(), SimError> {
        let bad = |setting, value, allowed| Err(SimError::Setting { setting, value, allowed });
        if !(1e-3..=1e6).contains(&self.spacing) {
            return bad("spacing", self.spacing, "from 0.001 to 1000000 metres");
        }
        if let Some(rate) = self.rate.filter(|r| !(1e-3..=1e4).contains(r)) {
            return bad("rate", rate, "from 0.001 to 10000 scans a second");
        }
        if let Some(scans) = self.scans.filter(|n| !(1..=MOST_SCANS).contains(n)) {
            return bad("scans", scans as f64, "from 1 to 10000000");
        }
        if !(0.0..=50.0).contains(&self.drift) {
            return bad("drift", self.drift, "from 0 to 50 metres in 100 m");
        }
        // TOML holds integers of 63 bits.
        if self.seed > i64::MAX as u64 {
            return bad("seed", self.seed as f64, "below 2^63");
        }
        self.loops.check()
    }
}
