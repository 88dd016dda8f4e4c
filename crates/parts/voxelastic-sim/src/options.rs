//! Options of a simulation.

use crate::camera::Lens;
use crate::drift::LoopSettings;
use crate::imu::ImuSettings;
use crate::route::Carrier;
use crate::sensor::{LidarSettings, Pattern};
use crate::{Scene, SimError};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use voxelastic::Pose;

/// A second sensor on the same carrier.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecondLidar {
    /// Name of the sensor, as [`SimOptions::sensor`].
    pub sensor: String,
    /// Columns per revolution; that of the sensor preset if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<usize>,
    /// Its place in the frame of the first, metres.
    pub position: [f64; 3],
    /// How it is turned there, a unit quaternion, x y z w.
    pub rotation: [f64; 4],
}

impl SecondLidar {
    /// Its pose in the frame of the first.
    pub fn t_lidar_second(&self) -> Pose {
        let ([x, y, z], [qx, qy, qz, qw]) = (self.position, self.rotation);
        Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz)))
    }

    fn check(&self) -> Result<(), SimError> {
        let far = self.position.iter().fold(0.0f64, |far, v| if v.is_finite() { far.max(v.abs()) } else { f64::INFINITY });
        if far > 100.0 {
            return Err(SimError::Setting { setting: "second lidar", value: far, allowed: "at most 100 metres from the first" });
        }
        let norm = self.rotation.iter().map(|v| v * v).sum::<f64>().sqrt();
        if (norm - 1.0).is_nan() || (norm - 1.0).abs() > 1e-2 {
            return Err(SimError::Setting { setting: "second lidar", value: norm, allowed: "turned by a unit quaternion" });
        }
        Ok(())
    }
}

/// Options of a simulation: the same options give the same scans, bit for bit on one machine.
///
/// They are stored as `world.toml` in a simulated folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimOptions {
    /// Name of the world, see [`crate::scenes::names`].
    pub world: String,
    /// Seed of all random numbers: furniture of the world, noise and drift.
    pub seed: u64,
    /// Name of the sensor, see [`voxelastic::sensor::preset_names`] and [`Pattern::names`](crate::sensor::Pattern::names).
    pub sensor: String,
    /// Columns per revolution; that of the sensor preset if absent. Sensors whose beams never repeat have none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub columns: Option<usize>,
    /// Thins clouds: the returns in each cube of this edge are replaced by their mean, as SLAM systems do; metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub thin: Option<f64>,
    /// Number of scans; that of the world ([`crate::Scene::default_scans`]) if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scans: Option<usize>,
    /// Path length between scans, metres. Ignored if `rate` is given.
    pub spacing: f64,
    /// Scans per second, instead of `spacing`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rate: Option<f64>,
    /// Name of the sensor's carrier, see [`Carrier::names`]; that of the world if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub carrier: Option<String>,
    /// Seconds for which the carrier stands still at first.
    #[serde(skip_serializing_if = "is_zero")]
    pub rest: f64,
    /// Number of cars and walkers that move through the world, see [`Traffic::along`](crate::traffic::Traffic::along).
    #[serde(skip_serializing_if = "is_none")]
    pub traffic: usize,
    /// Drift of the odometry, metres in 100 m of path, on average over the trajectory (paper Sec. IV: about 1); 0 for none.
    pub drift: f64,
    /// The lens of a camera beside the sensor, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<Lens>,
    /// Settings and noise of the sensor.
    pub lidar: LidarSettings,
    /// Loop closures.
    pub loops: LoopSettings,
    /// The inertial measurement unit, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<ImuSettings>,
    /// A second sensor, whose clouds only a recording has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second: Option<SecondLidar>,
}

impl Default for SimOptions {
    fn default() -> Self {
        Self {
            world: "campus".into(),
            seed: 1,
            sensor: "os1-64".into(),
            columns: None,
            thin: None,
            scans: None,
            spacing: 2.0,
            rate: None,
            carrier: None,
            rest: 0.0,
            traffic: 0,
            drift: 1.0,
            lidar: LidarSettings::default(),
            loops: LoopSettings::default(),
            imu: None,
            second: None,
            camera: None,
        }
    }
}

fn unknown_carrier(name: &str) -> SimError {
    SimError::UnknownCarrier { name: name.into(), known: Carrier::names().collect::<Vec<_>>().join(", ") }
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

fn is_none(count: &usize) -> bool {
    *count == 0
}

/// Most scans of a simulation.
const MAX_SCANS: usize = 10_000_000;
/// Most bodies that move.
const MAX_TRAFFIC: usize = 1_000;

impl SimOptions {
    /// The default simulation of a world.
    pub fn of(world: impl Into<String>) -> Self {
        Self { world: world.into(), ..Self::default() }
    }

    /// The world, and the trajectory of the carrier through it.
    ///
    /// # Errors
    /// [`SimError::UnknownWorld`] and [`SimError::UnknownCarrier`].
    pub fn scene(&self) -> Result<Scene, SimError> {
        let mut scene = Scene::named(&self.world, self.seed)?;
        if let Some(name) = &self.carrier {
            scene.trajectory.carrier = Carrier::named(name).ok_or_else(|| unknown_carrier(name))?;
        }
        scene.trajectory.rest = self.rest;
        Ok(scene)
    }

    pub(crate) fn check(&self) -> Result<(), SimError> {
        let bad = |setting, value, allowed| Err(SimError::Setting { setting, value, allowed });
        if !(1e-3..=1e6).contains(&self.spacing) {
            return bad("spacing", self.spacing, "from 0.001 to 1000000 metres");
        }
        if let Some(rate) = self.rate.filter(|r| !(1e-3..=1e4).contains(r)) {
            return bad("rate", rate, "from 0.001 to 10000 scans per second");
        }
        if let Some(scans) = self.scans.filter(|n| !(1..=MAX_SCANS).contains(n)) {
            return bad("scans", scans as f64, "from 1 to 10000000");
        }
        if let Some(cell) = self.thin.filter(|cell| !(0.01..=10.0).contains(cell)) {
            return bad("thin", cell, "from 0.01 to 10 metres");
        }
        if let Some(columns) = self.columns.filter(|_| Pattern::named(&self.sensor).is_some()) {
            return bad("columns", columns as f64, "absent: the beams of this sensor never repeat");
        }
        if !(0.0..=50.0).contains(&self.drift) {
            return bad("drift", self.drift, "from 0 to 50 metres in 100 m");
        }
        if let Some(name) = self.carrier.as_ref().filter(|name| Carrier::named(name).is_none()) {
            return Err(unknown_carrier(name));
        }
        if !(0.0..=1e4).contains(&self.rest) {
            return bad("rest", self.rest, "from 0 to 10000 seconds");
        }
        if self.traffic > MAX_TRAFFIC {
            return bad("traffic", self.traffic as f64, "from 0 to 1000");
        }
        if let Some(second) = &self.second {
            second.check()?;
        }
        if let Some(imu) = &self.imu {
            imu.check()?;
        }
        // TOML holds integers of 63 bits.
        if self.seed > i64::MAX as u64 {
            return bad("seed", self.seed as f64, "below 2^63");
        }
        self.loops.check()
    }
}
