//! What is published while a map is made.

use super::*;
use std::sync::mpsc::{Sender, channel};
use voxelastic::event::Event;
use voxelastic::settings::Settings;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

struct Collected(Option<Sender<Vec<u8>>>);

impl Sink for Collected {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.0.iter().for_each(|sender| sender.send(message.to_vec()).unwrap());
        Ok(())
    }

    fn subscribers(&self) -> usize {
        0
    }
}

/// The clouds of moving points that are published while a street is mapped, and how many points the mapper set aside of each scan.
fn published(dynamic: &str) -> (Vec<Vec<u8>>, Vec<usize>) {
    let mut settings = Settings { voxel_size: 0.3, max_range: 30.0, ..Settings::default() };
    settings.set("dynamic", dynamic).unwrap();
    let (sender, messages) = channel();
    let mut outputs = Outputs::new(OutputOptions::default());
    let advertise = |profile: &TopicProfile| -> Result<Box<dyn Sink>, MiddlewareError> {
        let sender = (profile.name == "/robot/moving_points").then(|| sender.clone());
        Ok(Box::new(Collected(sender)))
    };
    outputs.add_sinks(&Names::of_node("robot"), advertise).unwrap();
    let options = SimOptions { traffic: 24, rate: Some(10.0), scans: Some(14), columns: Some(512), drift: 0.0, ..SimOptions::of("street") };
    let simulation = Simulation::new(options).unwrap();
    let (mut mapper, mut counts) = (Mapper::new(settings).unwrap(), Vec::new());
    for scan in simulation.scans(PoseSource::Truth) {
        outputs.add_scan(scan.node, scan.time);
        let correction = Event::PoseUpdate(vec![(scan.node, scan.t_map_lidar)]);
        mapper.handle(Event::Scan(scan)).unwrap();
        outputs.note(&mapper, None);
        counts.push(mapper.moving_points().len());
        mapper.handle(correction).unwrap();
        outputs.note(&mapper, None);
    }
    (messages.try_iter().collect(), counts)
}

#[test]
fn moving_points_are_published_once_for_each_scan() {
    let (messages, counts) = published("remove");
    assert!(counts.len() == 14 && counts.iter().sum::<usize>() > 400, "{counts:?}");
    // Twelve bytes a point, and a header that is always the same.
    let empty = messages[0].len() - 12 * counts[0];
    assert_eq!(messages.iter().map(|message| (message.len() - empty) / 12).collect::<Vec<_>>(), counts);
    assert!(published("keep").0.is_empty());
}
