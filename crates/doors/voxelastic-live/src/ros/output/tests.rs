//! What is published while a map is made.

use super::*;
use crate::link::Link;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use voxelastic::event::Event;
use voxelastic::settings::Settings;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

struct Collected(Option<Sender<Vec<u8>>>);

/// Counts the bytes that somebody gets.
struct Counted(String, Sender<(String, Instant, usize)>);

impl Sink for Counted {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.1.send((self.0.clone(), Instant::now(), message.len())).unwrap();
        Ok(())
    }

    fn subscribers(&self) -> usize {
        1
    }
}

/// A robot that drives for six seconds, as fast as it can be mapped, with everything subscribed.
#[test]
fn over_a_link_no_more_goes_out_than_it_carries() {
    let rate = 40_000.0;
    let link = Arc::new(Link::new(rate));
    let (sender, counted) = channel();
    let mut outputs = Outputs::new(OutputOptions { link: Some(Arc::clone(&link)), ..OutputOptions::default() });
    outputs.add_sinks(&Names::of_node("robot"), |profile| Ok(Box::new(Counted(profile.name.clone(), sender.clone())))).unwrap();
    let settings = Settings { voxel_size: 0.2, max_range: 20.0, field: voxelastic::settings::FieldKind::Both, ..Settings::default() };
    let simulation = Simulation::new(SimOptions { columns: Some(256), spacing: 1.0, drift: 0.0, ..SimOptions::of("street") }).unwrap();
    let mut mapper = Mapper::new(settings).unwrap();
    let begin = Instant::now();
    for scan in simulation.scans(PoseSource::Truth).take_while(|_| begin.elapsed() < Duration::from_secs(6)) {
        outputs.take_scan(&scan, 0.5);
        mapper.handle(Event::Scan(scan)).unwrap();
        outputs.note(&mapper, None);
        let until = Instant::now() + Duration::from_millis(100);
        while Instant::now() < until {
            if !outputs.step(mapper.atlas()) {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        if outputs.is_time_for_diagnostics() {
            outputs.diagnostics("robot", (Health::Ok, "mapping".to_owned(), Vec::new()));
        }
    }
    let seconds = begin.elapsed().as_secs_f64();
    let all: Vec<(String, Instant, usize)> = counted.try_iter().collect();
    let of = |name: &str| all.iter().filter(|(topic, ..)| topic == name).map(|(.., bytes)| bytes).sum::<usize>();
    let sent: usize = all.iter().map(|(.., bytes)| bytes).sum();
    // Two messages may be owed, of those that take the longest: the whole grid and its costs.
    let largest = all.iter().map(|(.., bytes)| *bytes).max().unwrap();
    assert!((sent as f64) < rate * (seconds + 0.5) + 2.0 * largest as f64, "{sent} bytes in {seconds} s");
    assert!(largest as f64 <= 3.0 * rate, "{largest}");
    assert_eq!(link.sent(), sent as u64);
    for name in ["/robot/grid", "/robot/global_costmap", "/robot/local_costmap", "/robot/path", "/robot/submaps", "/diagnostics"] {
        assert!(of(name) > 0, "nothing of {name}");
    }
    assert!(of("/robot/local_costmap") as f64 <= 0.25 * rate * (seconds + 2.0), "{}", of("/robot/local_costmap"));
    for name in ["surface", "surface_points", "octomap", "moving_points", "distance_slice"] {
        assert_eq!(of(&format!("/robot/{name}")), 0, "{name}");
    }
}

/// A node that is so late that it steps once a scan, each time with a costmap that is ready.
#[test]
fn what_is_urgent_does_not_keep_the_rest_waiting() {
    let (sender, counted) = channel();
    let mut outputs = Outputs::new(OutputOptions::default());
    outputs.add_sinks(&Names::of_node("robot"), |profile| Ok(Box::new(Counted(profile.name.clone(), sender.clone())))).unwrap();
    let settings = Settings { voxel_size: 0.2, max_range: 20.0, field: voxelastic::settings::FieldKind::Both, ..Settings::default() };
    let simulation =
        Simulation::new(SimOptions { columns: Some(256), spacing: 1.0, drift: 0.0, scans: Some(60), ..SimOptions::of("street") }).unwrap();
    let mut mapper = Mapper::new(settings).unwrap();
    // What is published by steps that publish a costmap, too.
    let mut with_costmaps = BTreeSet::new();
    let are_all =
        |with_costmaps: &BTreeSet<String>| ["/robot/surface", "/robot/grid", "/robot/octomap"].iter().all(|topic| with_costmaps.contains(*topic));
    for scan in simulation.scans(PoseSource::Truth) {
        if are_all(&with_costmaps) {
            break;
        }
        outputs.take_scan(&scan, 0.5);
        mapper.handle(Event::Scan(scan)).unwrap();
        outputs.note(&mapper, None);
        outputs.step_urgent(mapper.atlas());
        for attempt in 0.. {
            assert!(attempt < 600, "no costmap is made");
            // Made on threads meanwhile.
            std::thread::sleep(Duration::from_millis(100));
            counted.try_iter().for_each(drop);
            outputs.step(mapper.atlas());
            let published: Vec<String> = counted.try_iter().map(|(topic, ..)| topic).collect();
            if published.iter().any(|topic| topic == "/robot/local_costmap") {
                with_costmaps.extend(published);
                break;
            }
        }
    }
    assert!(are_all(&with_costmaps), "{with_costmaps:?}");
}

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
