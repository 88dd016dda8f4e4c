//! Construction of a mapper.

use super::{IdleTask, Mapper};
use crate::sensor::BeamModel;
use crate::settings::{SettingError, Settings};

/// Builds a [`Mapper`]; see [`Mapper::builder`].
#[derive(Clone, Debug, Default)]
pub struct MapperBuilder {
    settings: Settings,
    sensor_model: Option<BeamModel>,
    idle_task: Option<IdleTask>,
}

impl Mapper {
    /// Starts building a mapper with default settings.
    ///
    /// ```
    /// use voxelastic::settings::SettingError;
    /// use voxelastic::{Mapper, Settings};
    /// let mapper = Mapper::builder().settings(Settings { voxel_size: 0.1, ..Settings::default() }).build()?;
    /// assert_eq!(mapper.atlas().voxel_size(), 0.1);
    /// let refused = Mapper::builder().settings(Settings { voxel_size: -1.0, ..Settings::default() }).build();
    /// assert!(matches!(refused, Err(SettingError::BadValue { key: "voxel_size", .. })));
    /// # Ok::<(), SettingError>(())
    /// ```
    pub fn builder() -> MapperBuilder {
        MapperBuilder::default()
    }
}

impl MapperBuilder {
    /// Sets the settings.
    #[must_use]
    pub fn settings(self, settings: Settings) -> Self {
        Self { settings, ..self }
    }

    /// Sets the sensor's beam tables, for example from the metadata of a recording. They are used for organised clouds with as many rows
    /// and columns as the model, unless the settings name a sensor.
    #[must_use]
    pub fn sensor_model(self, model: BeamModel) -> Self {
        Self { sensor_model: Some(model), ..self }
    }

    /// Sets work for idle threads; see [`Mapper::set_idle_task`].
    #[must_use]
    pub fn idle_task(self, task: IdleTask) -> Self {
        Self { idle_task: Some(task), ..self }
    }

    /// Builds the mapper, with an empty atlas.
    ///
    /// # Errors
    /// [`SettingError`] if a setting is out of range or settings contradict each other.
    pub fn build(self) -> Result<Mapper, SettingError> {
        let mut mapper = Mapper::new(self.settings)?;
        if let Some(model) = self.sensor_model {
            mapper.set_sensor_model(model);
        }
        if let Some(task) = self.idle_task {
            mapper.set_idle_task(task);
        }
        Ok(mapper)
    }
}
