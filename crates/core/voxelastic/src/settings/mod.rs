//! Every setting of the mapper, defined once: struct field, text key, unit, range, default and help.
//!
//! The table below is the only definition. Command-line flags, configuration files, stored maps and the documentation are made from
//! [`table`], and [`Settings::set`] is the one way in for text.
//!
//! ```
//! use voxelastic::settings::{Settings, table};
//! let mut settings = Settings::default();
//! settings.set("voxel_size", "0.1")?;
//! assert_eq!(settings.voxel_size, 0.1);
//! let refused = settings.set("voxel_size", "50").unwrap_err().to_string();
//! assert!(refused.contains("0.005 to 5 m"), "{refused}");
//! assert!(table().iter().all(|setting| !setting.help.is_empty()));
//! # Ok::<(), voxelastic::settings::SettingError>(())
//! ```

mod error;
mod value;

pub use error::SettingError;
pub use value::{Allowed, Dynamic, FieldKind, Laps, NoReturn, RobotRadius};

use crate::memory::{MemoryError, MemorySize};
use crate::sensor::{preset, preset_names};
use Allowed::{Between, OneOf, Text};
use std::sync::LazyLock;
use value::Value;

/// Whether a setting is one that most people touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Group {
    /// Shown in the short help.
    Basic,
    /// Shown in the long help only.
    Advanced,
}

/// What a setting is, for help texts and configuration files.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Its key in configuration files; as a flag, `_` becomes `-`.
    pub key: &'static str,
    /// Unit of its value; empty when it has none.
    pub unit: &'static str,
    /// Its default, as text that [`Settings::set`] takes.
    pub default: String,
    /// What it may be.
    pub allowed: Allowed,
    /// Where it is shown.
    pub group: Group,
    /// What it does.
    pub help: &'static str,
}

impl Setting {
    /// What it may be, with the unit: `0.005 to 5 m`.
    pub fn range(&self) -> String {
        match self.allowed {
            Between(..) if !self.unit.is_empty() => format!("{} {}", self.allowed, self.unit),
            _ => self.allowed.to_string(),
        }
    }

    /// Whether its values are written as text, and not as numbers, in files that tell the two apart.
    pub fn is_text(&self) -> bool {
        !matches!(self.allowed, Between(..))
    }
}

macro_rules! settings {
    ($($key:ident : $kind:ty = $default:expr, $unit:literal, $allowed:expr, $group:ident, $help:literal;)*) => {
        /// All settings of the mapper. [`Settings::default`] suits a 64-beam LiDAR outdoors.
        #[derive(Clone, Debug, PartialEq)]
        pub struct Settings {
            $(#[doc = concat!($help, " Default `", stringify!($default), "`; allowed: `", stringify!($allowed), "` ", $unit, ".")] pub $key: $kind,)*
        }

        impl Default for Settings {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }

        /// The settings in the order in which they are shown.
        static TABLE: LazyLock<Vec<Setting>> = LazyLock::new(|| {
            let defaults = Settings::default();
            vec![$(Setting {
                key: stringify!($key),
                unit: $unit,
                default: Value::text(&defaults.$key),
                allowed: $allowed,
                group: Group::$group,
                help: $help,
            },)*]
        });

        impl Settings {
            /// Sets `key`, from text.
            ///
            /// # Errors
            /// [`SettingError::UnknownKey`] and [`SettingError::BadValue`]; the settings are then unchanged.
            pub fn set(&mut self, key: &str, text: &str) -> Result<(), SettingError> {
                match key {
                    $(stringify!($key) => {
                        let parsed = <$kind as Value>::parse(text.trim()).filter(|v| v.is_within(&$allowed));
                        self.$key = parsed.ok_or_else(|| bad_value(stringify!($key), text))?;
                    })*
                    _ => return Err(SettingError::UnknownKey { key: key.to_owned(), nearest: nearest_key(key) }),
                }
                Ok(())
            }

            /// The value of `key` as text that [`set`](Self::set) takes back to the same bits; none for an unknown key.
            pub fn get(&self, key: &str) -> Option<String> {
                match key {
                    $(stringify!($key) => Some(Value::text(&self.$key)),)*
                    _ => None,
                }
            }

            fn check_ranges(&self) -> Result<(), SettingError> {
                $(if !self.$key.is_within(&$allowed) {
                    return Err(bad_value(stringify!($key), &Value::text(&self.$key)));
                })*
                Ok(())
            }
        }
    };
}

settings! {
    field: FieldKind = FieldKind::Tsdf, "", OneOf(&["tsdf", "occupancy", "both"]), Basic,
        "What the map stores: tsdf (surfaces, meshes), occupancy (free, occupied and unknown space), or both.";
    voxel_size: f32 = 0.065, "m", Between(0.005, 5.0), Basic,
        "Edge of the finest voxel.";
    max_range: f32 = 60.0, "m", Between(0.5, 1000.0), Basic,
        "Returns farther than this from the sensor are ignored.";
    min_range: f32 = 0.5, "m", Between(0.0, 20.0), Basic,
        "Returns nearer than this are ignored: they are usually the vehicle or the person that carries the sensor.";
    sensor: String = "auto".to_owned(), "", Text("auto | name of a preset, such as os1-64, vlp-16, hdl-64e"), Basic,
        "Beam model of the sensor; auto estimates it from the first scan and reports the result.";
    lambda_odom: f64 = 30.0, "m", Between(0.1, 100_000.0), Basic,
        "Distance travelled from a submap's root pose after which the next submap is started.";
    threads: usize = 0, "", Between(0.0, 1024.0), Basic,
        "Number of threads; 0 for all cores. The map does not depend on it.";
    memory: MemorySize = MemorySize(0), "", Text("a size such as 500MB or 2GB | none"), Basic,
        "Memory that the program may have: what of the map is beyond it is kept in a file in TMPDIR or /var/tmp. The map does not depend on it.";
    lambda_cluster: f64 = 15.0, "m", Between(0.0, 100_000.0), Advanced,
        "Distance along the pose graph from a loop edge's nodes within which submaps are fused. No node of a submap is ever farther than lambda_odom + lambda_cluster from its root.";
    loop_tolerance: f64 = 3.0, "voxels", Between(0.1, 100.0), Advanced,
        "A loop edge counts as closed, and may fuse submaps, when the poses of its nodes agree with it within this distance and within loop_angle_tolerance.";
    loop_angle_tolerance: f64 = 2.5, "degrees", Between(0.0, 180.0), Advanced,
        "A loop edge counts as closed only if the poses of its nodes agree with its rotation within this angle.";
    min_overlap: f64 = 0.6, "", Between(0.0, 1.0), Advanced,
        "A scan that would start a new submap is integrated into an older nearby submap instead if that one already contains at least this share of its returns; 1 to disable.";
    revisit_radius: f64 = 2.5, "m", Between(0.0, 100.0), Advanced,
        "When closed loops show that a scan was taken within this distance of a scan of an earlier pass, it updates surfaces only where they are new; 0 to integrate everything.";
    update_distance: f64 = 0.1, "m", Between(0.0, 100.0), Advanced,
        "A submap follows a correction of its root pose that is larger than this, or than update_angle.";
    update_angle: f64 = 2.5, "degrees", Between(0.0, 180.0), Advanced,
        "A submap follows a correction of its root pose that turns it by more than this.";
    deform_tolerance: f64 = 2.0, "voxels", Between(0.0, 1000.0), Advanced,
        "A submap counts as deformed when a correction moves one of its scans relative to its root by more than this, or turns it by more than deform_angle_tolerance.";
    deform_angle_tolerance: f64 = 2.5, "degrees", Between(0.0, 180.0), Advanced,
        "A submap counts as deformed when a correction turns one of its scans relative to its root by more than this.";
    truncation: f32 = 3.0, "voxels", Between(1.0, 8.0), Advanced,
        "Limit of the update along a beam, in front of its point and behind it, in voxels of the integration scale.";
    truncation_front: f32 = 1.5, "voxels", Between(1.5, 8.0), Advanced,
        "New TSDF voxels are created up to this far in front of a surface, in voxels of the integration scale; existing voxels are updated up to half a voxel farther.";
    truncation_behind: f32 = 1.5, "voxels", Between(1.0, 8.0), Advanced,
        "The TSDF is updated up to this far behind a surface, in voxels of the integration scale, but along a beam no farther than truncation.";
    max_weight: f32 = 100.0, "observations", Between(1.0, 1000.0), Advanced,
        "Cap of a voxel's weight. Beyond it the mean becomes a moving average, so that changes of the scene show.";
    max_scale: usize = 3, "", Between(0.0, 3.0), Advanced,
        "Coarsest integration scale: the edge of the largest voxels is 2^max_scale finest voxels; 0 for a single resolution.";
    dynamic: Dynamic = Dynamic::Keep, "", OneOf(&["keep", "remove"]), Advanced,
        "What becomes of things that move: keep (they leave traces), or remove (points in space that was observed free before are set aside, and surfaces in space that is free before or after are removed at the end).";
    laps: Laps = Laps::Fused, "", OneOf(&["fused", "apart"]), Advanced,
        "What becomes of the laps of a run, each of which ends where the sensor comes back after 10 m or more: fused (what is seen again goes into the submaps that are there), or apart (each lap has submaps of its own, so that changes between them can be told, at the price of memory).";
    no_return: NoReturn = NoReturn::Unknown, "", OneOf(&["unknown", "free"]), Advanced,
        "How a beam without return is interpreted: unknown (it is ignored), or free (the space along it is free up to max_range; only for sensors that report every surface in range).";
    robot_radius: RobotRadius = RobotRadius::Auto, "m", Text("auto | 0 to 5 m"), Advanced,
        "Where the sensor stood, space within this radius is free, unless it was observed occupied or is hidden behind what was: a robot can start where it was. auto: min_range, at most 0.5 m; 0 for none.";
    robot_height: RobotRadius = RobotRadius::Auto, "m", Text("auto | 0 to 5 m"), Advanced,
        "Half the height of the space of robot_radius, along the axis of the sensor. A robot that sees nothing above and below it needs much free space beside it to set off, and little above and below. auto: robot_radius.";
    scale_hysteresis: f32 = 1.5, "", Between(1.0, 10.0), Advanced,
        "A block switches to a coarser scale only beyond this factor times the distance at which the coarser scale starts to fit the beams.";
}

/// What every setting is, basic ones first.
pub fn table() -> &'static [Setting] {
    &TABLE
}

/// Most finest voxels between the sensor and a return that one scan's update can address.
const MAX_REACH_VOXELS: f32 = 32_000.0;

/// Largest radius of the robot's own space, finest voxels.
const MAX_ROBOT_RADIUS_VOXELS: f32 = 128.0;

impl Settings {
    /// Radius around the sensor that counts as free, metres: `robot_radius`, or what it is by itself.
    pub fn robot_radius_metres(&self) -> f32 {
        match self.robot_radius {
            RobotRadius::Auto => self.min_range.min(RobotRadius::MOST_BY_ITSELF).min(MAX_ROBOT_RADIUS_VOXELS * self.voxel_size),
            RobotRadius::Metres(radius) => radius,
        }
    }

    /// How far that space reaches along the axis of the sensor, metres: `robot_height`, or as far as the radius.
    pub fn robot_height_metres(&self) -> f32 {
        match self.robot_height {
            RobotRadius::Auto => self.robot_radius_metres(),
            RobotRadius::Metres(height) => height,
        }
    }

    /// All (key, value as text) pairs in the order of [`table`].
    pub fn pairs(&self) -> Vec<(&'static str, String)> {
        table().iter().filter_map(|s| Some((s.key, self.get(s.key)?))).collect()
    }

    /// Sets the [memory budget](crate::memory::limit) of the process, if there is one.
    ///
    /// # Errors
    /// [`SettingError::Contradiction`] if there is no place for what is beyond it.
    pub fn limit_memory(&self) -> Result<(), SettingError> {
        let refused = |error: MemoryError| SettingError::Contradiction { key: "memory", value: self.memory.to_string(), reason: error.to_string() };
        self.memory.set_budget().map_err(refused)
    }

    /// Checks every range, and the settings against each other. Settings that were filled field by field need it.
    ///
    /// # Errors
    /// [`SettingError::BadValue`] and [`SettingError::Contradiction`].
    pub fn validate(&self) -> Result<(), SettingError> {
        self.check_ranges()?;
        if self.sensor != "auto" && preset(&self.sensor).is_err() {
            let allowed = format!("auto, or one of {}", preset_names().collect::<Vec<_>>().join(", "));
            return Err(SettingError::BadValue { key: "sensor", value: self.sensor.clone(), allowed });
        }
        if self.min_range >= self.max_range {
            let reason = format!("must be less than max_range, which is {} m", self.max_range);
            return Err(SettingError::Contradiction { key: "min_range", value: self.min_range.to_string(), reason });
        }
        if self.robot_radius_metres() / self.voxel_size > MAX_ROBOT_RADIUS_VOXELS {
            let reason = format!("at most {MAX_ROBOT_RADIUS_VOXELS} voxels, or {} m", MAX_ROBOT_RADIUS_VOXELS * self.voxel_size);
            return Err(SettingError::Contradiction { key: "robot_radius", value: self.robot_radius_metres().to_string(), reason });
        }
        if self.max_range / self.voxel_size > MAX_REACH_VOXELS {
            let reason = format!(
                "at most {MAX_REACH_VOXELS} voxels fit between the sensor and a return, but max_range is {} m; use larger voxels",
                self.max_range
            );
            return Err(SettingError::Contradiction { key: "voxel_size", value: self.voxel_size.to_string(), reason });
        }
        Ok(())
    }
}

fn bad_value(key: &'static str, value: &str) -> SettingError {
    let allowed = table().iter().find(|s| s.key == key).map(Setting::range).unwrap_or_default();
    SettingError::BadValue { key, value: value.to_owned(), allowed }
}

/// The key that shares most letter pairs with `key`.
fn nearest_key(key: &str) -> &'static str {
    let pairs = |word: &str| word.as_bytes().windows(2).map(<[u8]>::to_vec).collect::<Vec<_>>();
    let given = pairs(&key.to_lowercase().replace('-', "_"));
    let likeness = |candidate: &str| {
        let own = pairs(candidate);
        let shared = own.iter().filter(|pair| given.contains(pair)).count();
        200 * shared / (own.len() + given.len()).max(1)
    };
    table().iter().rev().max_by_key(|s| likeness(s.key)).map_or("voxel_size", |s| s.key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_default_is_allowed_and_survives_as_text() {
        let defaults = Settings::default();
        defaults.validate().unwrap();
        let mut again = Settings { voxel_size: 1.0, max_range: 2.0, threads: 7, sensor: "x".into(), ..Settings::default() };
        for (key, text) in defaults.pairs() {
            again.set(key, &text).unwrap();
        }
        assert_eq!(again, defaults);
        assert!(table().iter().zip(defaults.pairs()).all(|(s, (key, text))| s.key == key && s.default == text));
        assert!(table().is_sorted_by_key(|s| s.group == Group::Advanced), "basic ones first");
        assert!(table().iter().filter(|s| s.group == Group::Basic).count() <= 9);
    }

    #[test]
    fn refusals_name_key_value_and_range() {
        let mut settings = Settings::default();
        let message = |settings: &mut Settings, key: &str, text: &str| settings.set(key, text).unwrap_err().to_string();
        assert_eq!(message(&mut settings, "voxel_size", "0"), "voxel_size = 0: must be 0.005 to 5 m");
        assert_eq!(message(&mut settings, "voxel_size", "NaN"), "voxel_size = NaN: must be 0.005 to 5 m");
        assert_eq!(message(&mut settings, "voxel_size", "ten"), "voxel_size = ten: must be 0.005 to 5 m");
        assert_eq!(message(&mut settings, "threads", "-1"), "threads = -1: must be 0 to 1024");
        assert_eq!(message(&mut settings, "field", "colour"), "field = colour: must be tsdf | occupancy | both");
        assert_eq!(message(&mut settings, "voxel_siz", "1"), "there is no setting `voxel_siz`; did you mean `voxel_size`?");
        assert_eq!(message(&mut settings, "lambda", "1"), "there is no setting `lambda`; did you mean `lambda_odom`?");
        assert_eq!(settings, Settings::default(), "refused values change nothing");
        settings.set("voxel_size", "0.005").unwrap();
        assert!(matches!(settings.validate(), Ok(())), "12,000 voxels");
        settings.set("max_range", "1000").unwrap();
        assert!(settings.validate().unwrap_err().to_string().contains("use larger voxels"));
        let crossed = Settings { min_range: 20.0, max_range: 10.0, ..Settings::default() };
        assert!(crossed.validate().unwrap_err().to_string().contains("less than max_range"));
        let unknown = Settings { sensor: "os1-63".into(), ..Settings::default() };
        assert!(unknown.validate().unwrap_err().to_string().contains("os1-64"));
        let filled_by_hand = Settings { truncation: f32::NAN, ..Settings::default() };
        assert!(matches!(filled_by_hand.validate(), Err(SettingError::BadValue { key: "truncation", .. })));
    }

    #[test]
    fn fields_have_names() {
        for (name, kind) in FieldKind::ALL {
            let mut settings = Settings::default();
            settings.set("field", name).unwrap();
            assert_eq!((settings.field, kind.name()), (kind, name));
            assert!(kind.has_tsdf() || kind.has_occupancy());
        }
    }

    proptest! {
        #[test]
        fn numbers_come_back_from_text_bit_for_bit(voxel_size in 0.005f32..=5.0, lambda in 0.1f64..=1e5) {
            let settings = Settings { voxel_size, lambda_odom: lambda, ..Settings::default() };
            let mut again = Settings::default();
            for (key, text) in settings.pairs() {
                again.set(key, &text).unwrap();
            }
            prop_assert_eq!(again.voxel_size.to_bits(), voxel_size.to_bits());
            prop_assert_eq!(again.lambda_odom.to_bits(), lambda.to_bits());
        }

        #[test]
        fn no_text_can_panic(key in "[a-z_-]{0,12}", text in ".{0,12}") {
            let mut settings = Settings::default();
            for s in table() {
                let _ = settings.set(s.key, &text);
            }
            let _ = settings.set(&key, &text);
            prop_assert!(settings.check_ranges().is_ok());
        }
    }
}
