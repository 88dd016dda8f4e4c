//! Where in the map of before the scans are that come after the process was restarted.
//!
//! What carries a sensor does not wait: it may have moved meanwhile, odometry begins anew, and whoever gives poses may have begun anew, too. So the first scans are
//! found in the map before they are mapped: where their poses say, near the last scan, or anywhere. Until then they wait. What is said once may be a place that
//! only looks alike, so two scans have to say the same.

use crate::mapping::Mapping;
use crate::surfaces::{self, SurfaceOptions};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic_slam::loops::{Localiser, LocaliserSettings, Whereabouts};

/// Scans that wait at most. One that waits takes as much memory as its points.
const MAX_WAITING_SCANS: usize = 20;
/// A scan is looked for so far from where its given pose says, and from where the last one was, metres.
const SEARCH_RADII: [f64; 2] = [5.0, 10.0];
/// Two scans say the same, and a scan says what its pose says, if that differs by no more than this: metres, and radians.
const AGREEMENT: (f64, f64) = (0.5, 0.05);

/// Finds the first scans in the map.
pub struct Relocalisation {
    localiser: Option<Localiser>,
    /// Whether the poses of scans are given, so that their frame may be that of the map.
    has_frame: bool,
    /// Where the map was observed from.
    path: Vec<(NodeId, Pose)>,
    max_range: f64,
    /// About where somebody says that they are.
    about: Option<Whereabouts>,
    /// Scans after which they are given up.
    most_scans: usize,
    /// What waits.
    held: Vec<Event>,
    scans: usize,
    /// Where the frame of the poses lies in the map, by each scan that was found.
    t_map_frames: Vec<Pose>,
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
    /// Into the map of `mapping`.
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
            max_range,
            about: None,
            most_scans: MAX_WAITING_SCANS,
            held: Vec::new(),
            scans: 0,
            t_map_frames: Vec::new(),
        }
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
        self.t_map_frames.clear();
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
        let is_unmapped = self.path.iter().all(|(_, seen)| seen.translation_distance(&pose) > self.max_range);
        self.held.push(event);
        let give = |held: &mut Vec<Event>| std::mem::take(held);
        if self.has_frame && (self.localiser.is_none() || located.is_none() && is_unmapped && self.about.is_none()) {
            tracing::info!("the scans go on in a place that was not mapped: their poses are taken as they are");
            return Some(Outcome::InFrame(give(&mut self.held)));
        }
        if let Some(located) = located {
            if self.has_frame && is_same(&located, &pose) {
                tracing::info!("found in the map, {:.2} m from where the pose says: mapping goes on", located.translation_distance(&pose));
                return Some(Outcome::InFrame(give(&mut self.held)));
            }
            let t_map_frame = located * pose.inverse();
            if self.t_map_frames.iter().any(|t_map_frame| is_same(&(t_map_frame * pose), &located)) {
                let near = self.path.iter().min_by(|a, b| a.1.translation_distance(&located).total_cmp(&b.1.translation_distance(&located)));
                let edge = near.map(|(from, at)| Edge { from: *from, to: node, t_from_to: at.inv_mul(&located), information: None });
                let far = self.path.last().map_or(0.0, |(_, last)| last.translation_distance(&located));
                tracing::info!("found in the map, {far:.1} m from the last scan of before: mapping goes on");
                return Some(Outcome::InMap(Box::new(MapFrame { t_map_frame, edge, held: give(&mut self.held) })));
            }
            self.t_map_frames.push(t_map_frame);
        }
        if self.localiser.is_none() {
            return Some(Outcome::NotFound("the map of before has no surfaces".to_owned(), give(&mut self.held)));
        }
        let place = if self.about.is_some() { "where they were said to be" } else { "in the map of before" };
        (self.scans >= self.most_scans).then(|| Outcome::NotFound(format!("none of {} scans is surely {place}", self.scans), give(&mut self.held)))
    }

    /// Where the scan surely is, if that is found: where somebody said, or else where its pose says, near the last scan, or anywhere.
    fn locate(&mut self, scan: &Scan) -> Option<Pose> {
        let localiser = self.localiser.as_mut()?;
        let mut find = |about| localiser.locate(&scan.cloud, about).filter(|found| found.is_certain).map(|found| found.t_map_lidar);
        if self.about.is_some() {
            return find(self.about);
        }
        let x = scan.t_map_lidar.rotation * nalgebra::Vector3::x();
        let at = |pose: &Pose, within, yaw| Whereabouts { position: pose.translation.vector, within, yaw };
        let said = self.has_frame.then(|| at(&scan.t_map_lidar, SEARCH_RADII[0], Some(x.y.atan2(x.x))));
        let last = self.path.last().map(|(_, last)| at(last, SEARCH_RADII[1], None));
        let mut tries = said.into_iter().chain(last).map(Some).chain([None]);
        tries.find_map(find)
    }
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    a.translation_distance(b) <= AGREEMENT.0 && a.rotation_distance(b) <= AGREEMENT.1
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
    use voxelastic::{Mapper, Settings};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

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
