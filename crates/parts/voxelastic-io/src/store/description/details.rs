//! Settings of the mapper in the details of a stored map.

use super::piece::MapDetails;
use crate::Origin;
use std::collections::BTreeMap;
use voxelastic::settings::{SettingError, Settings};
use voxelastic_earth::{EarthError, Georeference};

/// Settings that do not change the map and are not stored, so that equal maps are equal files.
const NOT_STORED: [&str; 2] = ["memory", "threads"];

/// The entry of the settings that has the origin of a map that is far from zero.
const ORIGIN: &str = "origin";
/// The entry that has the place of a map on Earth.
const EARTH: &str = "earth";

/// The settings of a stored map.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct StoredSettings {
    /// The settings. Those that are not stored have their defaults.
    pub settings: Settings,
    /// Stored settings that this version does not know or that are out of range.
    pub refused: Vec<SettingError>,
}

impl MapDetails {
    /// The details of a map made with `settings` by this version of voxelastic, of scans of a sensor described as `sensor`.
    ///
    /// ```
    /// use voxelastic::Settings;
    /// use voxelastic_io::store::MapDetails;
    /// let made = MapDetails::describe(&Settings { voxel_size: 0.1, ..Settings::default() }, Some("os1-64"));
    /// assert_eq!(made.stored_settings().map(|stored| stored.settings.voxel_size), Some(0.1));
    /// ```
    pub fn describe(settings: &Settings, sensor: Option<&str>) -> Self {
        let stored = settings.pairs().into_iter().filter(|(key, _)| !NOT_STORED.contains(key));
        Self {
            generator: concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned(),
            settings: stored.map(|(key, value)| (key.to_owned(), value)).collect(),
            sensor: sensor.map(|words| ("description".to_owned(), words.to_owned())).into_iter().collect::<BTreeMap<_, _>>(),
        }
    }

    /// With the origin of the map, which is stored with the settings.
    #[must_use]
    pub fn with_origin(mut self, origin: Origin) -> Self {
        if !origin.is_zero() {
            self.settings.insert(ORIGIN.to_owned(), origin.to_string());
        }
        self
    }

    /// Where the coordinates of the map are counted from; zero in maps without an origin.
    ///
    /// # Errors
    /// The stored words, if they are no coordinates: all coordinates of the map would be wrong.
    pub fn origin(&self) -> Result<Origin, &str> {
        self.settings.get(ORIGIN).map_or(Ok(Origin::default()), |words| Origin::parse(words).ok_or(words.as_str()))
    }

    /// With the place of the map on Earth, which is stored with the settings.
    #[must_use]
    pub fn with_georeference(mut self, place: &Georeference) -> Self {
        self.settings.insert(EARTH.to_owned(), place.to_string());
        self
    }

    /// Where the map lies on Earth; none of a map that nobody georeferenced.
    ///
    /// # Errors
    /// Stored words that are no such place.
    pub fn georeference(&self) -> Result<Option<Georeference>, EarthError> {
        self.settings.get(EARTH).map(|words| words.parse()).transpose()
    }

    /// The settings; none if the voxel size is not among them.
    pub fn stored_settings(&self) -> Option<StoredSettings> {
        if !self.settings.contains_key("voxel_size") {
            return None;
        }
        let mut settings = Settings::default();
        let refused = self
            .settings
            .iter()
            .filter(|(key, _)| *key != ORIGIN && *key != EARTH)
            .filter_map(|(key, value)| settings.set(key, value).err())
            .collect();
        Some(StoredSettings { settings, refused })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_come_back_and_strangers_are_named() {
        let settings = Settings { voxel_size: 0.123_456_79, lambda_odom: 12.5, threads: 2, ..Settings::default() };
        let mut details = MapDetails::describe(&settings, None);
        assert!(details.sensor.is_empty() && !details.settings.contains_key("threads"));
        let stored = details.stored_settings().unwrap();
        assert_eq!((stored.settings, stored.refused), (Settings { threads: 0, ..settings }, vec![]));
        details.settings.insert("colour".to_owned(), "blue".to_owned());
        assert_eq!(details.stored_settings().unwrap().refused.len(), 1);
        details.settings.remove("voxel_size");
        assert_eq!(details.stored_settings(), None);
    }
}
