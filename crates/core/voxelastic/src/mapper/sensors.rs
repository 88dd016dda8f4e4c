//! What a mapper keeps for each sensor of a run: two LiDARs of one robot have different beams, and an image of one says nothing about pixels of the other.

use super::frontend::Frontend;
use super::moving::MovingDetector;
use crate::Cloud;
use crate::event::NodeId;
use crate::sensor::{BeamModel, SensorError};
use crate::settings::Settings;

/// A sensor that has been recognised.
#[derive(Debug)]
pub(super) struct Sensor {
    pub frontend: Frontend,
    /// The node whose cloud showed which sensor it is.
    pub first_node: NodeId,
    pub moving: MovingDetector,
}

/// The sensors, in the order in which they delivered their first cloud, with their [`Cloud::sensor`].
#[derive(Debug, Default)]
pub(super) struct Sensors {
    all: Vec<(u16, Sensor)>,
    description: String,
}

impl Sensors {
    /// The sensor of a cloud; recognised from the cloud if it is the first.
    ///
    /// # Errors
    /// As [`Frontend::open`].
    pub fn of(&mut self, settings: &Settings, known: Option<&BeamModel>, cloud: &Cloud, node: NodeId) -> Result<&mut Sensor, SensorError> {
        let at = match self.all.iter().position(|(index, _)| *index == cloud.sensor) {
            Some(at) => at,
            None => {
                // Tables that come with the data are those of the first sensor.
                let frontend = Frontend::open(settings, known.filter(|_| cloud.sensor == 0), cloud)?;
                self.all.push((cloud.sensor, Sensor { frontend, first_node: node, moving: MovingDetector::default() }));
                self.describe();
                self.all.len() - 1
            }
        };
        Ok(&mut self.all[at].1)
    }

    fn describe(&mut self) {
        self.description = match self.all.as_slice() {
            [(_, one)] => one.frontend.description().to_owned(),
            several => {
                let numbered = |(index, sensor): &(u16, Sensor)| format!("sensor {}: {}", u32::from(*index) + 1, sensor.frontend.description());
                several.iter().map(numbered).collect::<Vec<_>>().join("; ")
            }
        };
    }

    /// All of them in words; none before the first cloud.
    pub fn description(&self) -> Option<&str> {
        (!self.all.is_empty()).then_some(&self.description)
    }

    /// Number of sensors so far.
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// The first sensor.
    pub fn first(&self) -> Option<&Sensor> {
        self.all.first().map(|(_, sensor)| sensor)
    }

    /// The sensors with their indices.
    pub fn iter(&self) -> impl Iterator<Item = (u16, &Sensor)> {
        self.all.iter().map(|(index, sensor)| (*index, sensor))
    }

    /// The sensors.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Sensor> {
        self.all.iter_mut().map(|(_, sensor)| sensor)
    }
}
