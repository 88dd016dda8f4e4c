//! Where in the map of before the scans are that come after the process was restarted.
//!
//! What carries a sensor does not wait: it may have moved meanwhile, odometry begins anew, and whoever gives poses may have begun anew, too. So the first scans are
//! found in the map before they are mapped: where their poses say, near the last scan, or anywhere. Until then they wait. Where places look alike, several scans decide together.

use super::map_frames::{MapFrames, is_same};
use crate::mapping::Mapping;
use crate::surfaces::{self, SurfaceOptions};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic_slam::loops::{Localiser, LocaliserSettings, Located, Whereabouts};

/// Scans that wait at most. One that waits takes as much memory as its points.
const MAX_WAITING_SCANS: usize = 20;
/// A scan is looked for so far from where its given pose says, and from where the last one was, metres.
const SEARCH_RADII: [f64; 2] = [5.0, 10.0];

/// Finds the first scans in the map.
pub struct Relocalisation {
    localiser: Option<Localiser>,
    /// Whether the poses of scans are given, so that their frame may be that of the map.
    has_frame: bool,
    /// Where the map was observed from.
    path: Vec<(NodeId, Pose)>,
    /// Whether the scans are expected where the last one of the map was taken.
    goes_on: bool,
    max_range: f64,
    /// About where somebody says that they are.
    about: Option<Whereabouts>,
    /// Scans after which they are given up.
    most_scans: usize,
    /// What waits.
    held: Vec<Event>,
    scans: usize,
    /// Where the frame of the poses may lie in the map.
    frames: MapFrames,
}

/// Where the frame of the poses lies in the map, if it is another one.
pub struct MapFrame {
    /// The pose of that frame in the map.
    pub t_map_frame: Pose,
    /// From the nearest node of the map to the scan that was found last.
    pub edge: Option<Edge>,
    /// What waited, in the frame of its poses.
    pub held: Vec<Event>,
}

/// What becomes of the scans that wait.
pub enum Outcome {
    /// They are where their poses say.
    InFrame(Vec<Event>),
    /// The frame of their poses lies there in the map.
    InMap(Box<MapFrame>),
    /// They were not found and begin a map of their own. Why, in words.
    NotFound(String, Vec<Event>),
}

impl Relocalisation {
    /// Into the map of `mapping`, in which the scans go on: where the last one was taken, they are expected.
    pub fn new(mapping: &Mapping, has_frame: bool) -> Self {
        let (atlas, settings) = (mapping.atlas(), mapping.mapper().settings());
        let scans = atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| (submap, scan)));
        let mut path: Vec<(NodeId, Pose)> = scans.map(|(submap, scan)| (scan.node, submap.t_map_submap() * scan.t_submap_lidar)).collect();
        path.sort_by_key(|(node, _)| *node);
        let points = mapping.pool().install(|| surfaces::of_submaps(atlas, &SurfaceOptions::default())).map(|mesh| mesh.positions);
        let max_range = f64::from(settings.max_range);
        let localiser = points.ok().map(|points| {
            let mut of_map = LocaliserSettings::default();
            of_map.max_range = of_map.max_range.min(max_range);
            Localiser::new(points, path.iter().map(|(_, pose)| *pose).collect(), of_map)
        });
        Self {
            localiser,
            has_frame,
            path,
            goes_on: true,
            max_range,
            about: None,
            most_scans: MAX_WAITING_SCANS,
            held: Vec::new(),
            scans: 0,
            frames: MapFrames::default(),
        }
    }

    /// The same in a map that somebody has chosen: it tells nothing of where the scans are.
    #[must_use]
    pub fn anywhere(self) -> Self {
        Self { goes_on: false, ..self }
    }

    /// Scans that wait.
    pub fn scans(&self) -> usize {
        self.scans
    }

    /// Somebody says about where the scans that come are: they are looked for there alone, and what was found elsewhere does not count. A height of zero, which maps in two dimensions
    /// have, is taken for that of the nearest place from which the map was observed.
    pub fn look_near(&mut self, mut about: Whereabouts) -> Whereabouts {
        let off = |pose: &Pose| (pose.translation.vector - about.position).xy().norm();
        let near = self.path.iter().min_by(|a, b| off(&a.1).total_cmp(&off(&b.1)));
        if let (true, Some((_, near))) = (about.position.z == 0.0, near) {
            about.position.z = near.translation.z;
        }
        (self.about, self.most_scans) = (Some(about), self.scans + MAX_WAITING_SCANS);
        self.frames = MapFrames::default();
        about
    }

    /// Takes an event, with the pose that it came with. None if it has to wait.
    pub fn take(&mut self, event: Event, mapping: &Mapping) -> Option<Outcome> {
        let Event::Scan(scan) = &event else {
            self.held.push(event);
            return None;
        };
        self.scans += 1;
        let (pose, node) = (scan.t_map_lidar, scan.node);
        let located = mapping.pool().install(|| self.locate(scan));
        self.held.push(event);
        let is_unmapped = self.path.iter().all(|(_, seen)| seen.translation_distance(&pose) > self.max_range);
        let is_nowhere = !located.iter().any(|place| place.is_possible);
        if self.has_frame && (self.localiser.is_none() || is_nowhere && is_unmapped && self.about.is_none()) {
            tracing::info!("the scans go on in a place that was not mapped: their poses are taken as they are");
            return Some(Outcome::InFrame(std::mem::take(&mut self.held)));
        }
        let last = self.path.last().filter(|_| self.goes_on).map(|(_, last)| *last);
        let is_expected = |place: &Pose| last.is_some_and(|last| last.translation_distance(place) <= SEARCH_RADII[1]);
        self.frames.count(&pose, &located, |place| self.has_frame && is_same(place, &pose), is_expected);
        if let Some((t_map_frame, is_given)) = self.frames.decided() {
            return Some(self.found(node, &pose, &t_map_frame, is_given));
        }
        let why = if self.localiser.is_none() {
            "the map of before has no surfaces".to_owned()
        } else if self.scans >= self.most_scans {
            self.why_undecided()
        } else {
            return None;
        };
        Some(Outcome::NotFound(why, std::mem::take(&mut self.held)))
    }

    /// The scan at a node, with this pose in the frame of its poses, is found: that frame lies there in the map.
    fn found(&mut self, node: NodeId, pose: &Pose, t_map_frame: &Pose, is_given: bool) -> Outcome {
        let held = std::mem::take(&mut self.held);
        let located = t_map_frame * pose;
        if is_given {
            tracing::info!("found in the map, {:.2} m from where the pose says: mapping goes on", located.translation_distance(pose));
            return Outcome::InFrame(held);
        }
        let near = self.path.iter().min_by(|a, b| a.1.translation_distance(&located).total_cmp(&b.1.translation_distance(&located)));
        let edge = near.map(|(from, at)| Edge { from: *from, to: node, t_from_to: at.inv_mul(&located), information: None });
        let far = self.path.last().map_or(0.0, |(_, last)| last.translation_distance(&located));
        tracing::info!("found in the map, {far:.1} m from the last scan of before: mapping goes on");
        Outcome::InMap(Box::new(MapFrame { t_map_frame: *t_map_frame, edge, held }))
    }

    fn why_undecided(&self) -> String {
        let place = if self.about.is_some() { "where they were said to be" } else { "in the map of before" };
        match self.frames.rivals() {
            0 | 1 => format!("none of {} scans is surely {place}", self.scans),
            rivals => format!("{} scans are ambiguous: they may have been taken at {rivals} places {place}", self.scans),
        }
    }

    /// Where the scan may be: where somebody said, or else where its pose says, near the last scan, or anywhere.
    fn locate(&mut self, scan: &Scan) -> Vec<Located> {
        let Some(localiser) = self.localiser.as_mut() else { return Vec::new() };
        if self.about.is_some() {
            return localiser.locate_all(&scan.cloud, self.about);
        }
        let x = scan.t_map_lidar.rotation * nalgebra::Vector3::x();
        let at = |pose: &Pose, within, yaw| Whereabouts { position: pose.translation.vector, within, yaw };
        let said = self.has_frame.then(|| at(&scan.t_map_lidar, SEARCH_RADII[0], Some(x.y.atan2(x.x))));
        let last = self.path.last().map(|(_, last)| at(last, SEARCH_RADII[1], None));
        let tries: Vec<Option<Whereabouts>> = said.into_iter().chain(last).map(Some).chain([None]).collect();
        localiser.locate_among(&scan.cloud, &tries)
    }
}

/// The event in the map, in which the frame of its poses lies there.
pub fn placed(event: Event, t_map_frame: &Pose) -> Event {
    match event {
        Event::Scan(scan) => Event::Scan(Scan { t_map_lidar: t_map_frame * scan.t_map_lidar, ..scan }),
        Event::PoseUpdate(poses) => Event::PoseUpdate(poses.into_iter().map(|(node, pose)| (node, t_map_frame * pose)).collect()),
        Event::Vertical(vertical) => {
            let up = t_map_frame.rotation * nalgebra::Vector3::from(vertical.up_map);
            Event::Vertical(voxelastic::event::Vertical { up_map: up.into(), ..vertical })
        }
        other => other,
    }
}

/// The event with so much added to the numbers of its nodes.
pub fn numbered(event: Event, offset: NodeId) -> Event {
    let edge = |edge: Edge| Edge { from: edge.from + offset, to: edge.to + offset, ..edge };
    match event {
        Event::Scan(scan) => Event::Scan(Scan { node: scan.node + offset, ..scan }),
        Event::OdometryEdge(measured) => Event::OdometryEdge(edge(measured)),
        Event::LoopEdge(measured) => Event::LoopEdge(edge(measured)),
        Event::PoseUpdate(poses) => Event::PoseUpdate(poses.into_iter().map(|(node, pose)| (node + offset, pose)).collect()),
        Event::Vertical(vertical) => Event::Vertical(voxelastic::event::Vertical { node: vertical.node + offset, ..vertical }),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::sensor::preset_with_columns;
    use voxelastic::{Mapper, Settings};
    use voxelastic_sim::random::Stream;
    use voxelastic_sim::sensor::{Lidar, LidarSettings};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation, WorldBuilder};

    /// A map of the same room twice, 40 m from each other, and the scans of the room.
    fn two_rooms() -> (Mapping, Vec<Scan>, Pose) {
        let room = Simulation::new(SimOptions { scans: Some(10), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let scans: Vec<Scan> = room.scans(PoseSource::Truth).collect();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.1, ..Settings::default() }).unwrap();
        let t_map_second = Pose::translation(40.0, 0.0, 0.0);
        for (k, t_map_room) in [Pose::identity(), t_map_second].into_iter().enumerate() {
            for scan in &scans {
                let (node, t_map_lidar) = (scan.node + (k * scans.len()) as NodeId, t_map_room * scan.t_map_lidar);
                mapper.handle(Event::Scan(Scan { node, t_map_lidar, ..scan.clone() })).unwrap();
            }
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
        (Mapping::new(mapper, pool, None), scans, t_map_second)
    }

    #[test]
    fn among_rooms_that_look_alike_scans_are_where_somebody_says() {
        let (mapping, scans, t_map_second) = two_rooms();
        let found = |mut search: Relocalisation| {
            let numbered = scans.iter().enumerate().map(|(k, scan)| Scan { node: 100 + k as NodeId, ..scan.clone() });
            match numbered.map(Event::Scan).find_map(|scan| search.take(scan, &mapping)) {
                Some(Outcome::InMap(found)) => found.t_map_frame,
                _ => panic!("not found"),
            }
        };
        // The poses of the scans are those in the first room; the last scan of the map was taken in the second.
        assert!(is_same(&found(Relocalisation::new(&mapping, false)), &t_map_second));
        let mut search = Relocalisation::new(&mapping, false);
        let place = scans[0].t_map_lidar.translation.vector;
        let position = nalgebra::Vector3::new(place.x + 0.7, place.y - 0.5, 0.0);
        let about = search.look_near(Whereabouts { position, within: 4.0, yaw: None });
        assert!((about.position.z - place.z).abs() < 0.3, "the height is that of the places of the map");
        assert!(is_same(&found(search), &Pose::identity()));
    }

    #[test]
    fn rooms_that_are_the_same_stay_ambiguous() {
        let (mapping, scans, _) = two_rooms();
        let mut search = Relocalisation::new(&mapping, false).anywhere();
        let numbered = (0..).zip(scans.iter().cycle()).map(|(k, scan)| Event::Scan(Scan { node: 100 + k, ..scan.clone() }));
        let outcome = numbered.take(MAX_WAITING_SCANS).find_map(|scan| search.take(scan, &mapping));
        assert!(matches!(outcome, Some(Outcome::NotFound(words, held)) if words.contains("ambiguous") && held.len() == MAX_WAITING_SCANS));
    }

    /// A room of 9 x 6 m that looks alike by half a turn, but for a cupboard in one corner, and scans along it.
    fn half_turned_room() -> Vec<Scan> {
        let mut world = WorldBuilder::new("room", 1);
        world.cuboid([-4.7, -3.2, -0.2], [4.7, 3.2, 0.0], 0.5);
        world.cuboid([-4.7, -3.2, 2.8], [4.7, 3.2, 3.0], 0.5);
        for (x, y, to_x, to_y) in [(-4.7, -3.2, -4.5, 3.2), (-4.5, -3.2, 4.5, -3.0), (-4.0, -3.0, -3.2, -2.5), (0.5, -3.0, 1.5, -2.4)] {
            world.cuboid([x, y, 0.0], [to_x, to_y, 2.8], 0.5);
            world.cuboid([-to_x, -to_y, 0.0], [-x, -y, 2.8], 0.5);
        }
        world.cuboid([3.8, -3.0, 0.0], [4.5, -2.2, 1.9], 0.5);
        let (world, lidar) = (world.build().unwrap(), Lidar::new(preset_with_columns("os0-64", 256).unwrap(), LidarSettings::default()).unwrap());
        let scan = |k: u64| {
            let turned = Pose::rotation(nalgebra::Vector3::z() * 0.3 * k as f64);
            let t_map_lidar = Pose::translation(0.7 * k as f64 - 3.2, 0.8 * (k as f64).sin(), 1.2) * turned;
            Scan { node: k, time: k as f64, t_map_lidar, cloud: lidar.scan(&world, |_| t_map_lidar, &Stream::new(1, &[k])) }
        };
        (0..10).map(scan).collect()
    }

    #[test]
    fn a_room_alike_by_half_a_turn_is_told_by_several_scans() {
        let scans = half_turned_room();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.1, ..Settings::default() }).unwrap();
        for scan in scans.iter().step_by(2) {
            mapper.handle(Event::Scan(scan.clone())).unwrap();
        }
        let mapping = Mapping::new(mapper, rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap(), None);
        let t_map_frame = Pose::translation(3.0, -2.0, 0.0) * Pose::rotation(nalgebra::Vector3::z() * 0.7);
        let mut search = Relocalisation::new(&mapping, false).anywhere();
        let later = scans.iter().skip(1).step_by(2).chain(scans.iter().step_by(2));
        let moved =
            later.map(|scan| Event::Scan(Scan { node: 100 + scan.node, t_map_lidar: t_map_frame.inverse() * scan.t_map_lidar, ..scan.clone() }));
        let found = moved.into_iter().find_map(|scan| search.take(scan, &mapping));
        assert!(matches!(found, Some(Outcome::InMap(found)) if is_same(&found.t_map_frame, &t_map_frame)), "after {} scans", search.scans());
    }

    #[test]
    fn scans_that_are_not_where_somebody_says_are_not_found_elsewhere() {
        let (mapping, scans, _) = two_rooms();
        let mut search = Relocalisation::new(&mapping, true);
        search.look_near(Whereabouts { position: [20.0, 0.0, 1.0].into(), within: 2.0, yaw: None });
        let outcomes = (0..MAX_WAITING_SCANS)
            .filter_map(|k| search.take(Event::Scan(Scan { node: 100 + k as NodeId, ..scans[k % scans.len()].clone() }), &mapping));
        let outcomes: Vec<Outcome> = outcomes.collect();
        assert!(matches!(outcomes.as_slice(), [Outcome::NotFound(words, held)] if words.contains("said to be") && held.len() == MAX_WAITING_SCANS));
    }
}
