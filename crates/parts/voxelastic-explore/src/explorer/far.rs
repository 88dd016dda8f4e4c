//! Far away: where little is left to see around the robot and the frontier has much of it elsewhere, the robot goes there along its track, as it has come from there.

use super::{EXTENDED, Explorer, Situation};
use crate::routes::leg::Leg;
use crate::routes::shortcuts::short_way;
use crate::targets::choice::{LEAST_STOP, rate};
use crate::targets::clusters::FrontierCluster;
use crate::targets::viewpoints::Viewpoint;
use voxelastic_plan::{Effort, Point, Space, anchor_path, distance, length, recheck, shorten};

/// Farther away than the roadmap reaches, metres.
const FAR: f64 = 2.0 * EXTENDED;
/// So many clusters are looked at: those with the largest area for their distance.
const MOST_CLUSTERS: usize = 16;
/// They are looked at from so far in front of them, metres.
const IN_FRONT: f64 = 1.5;
/// The robot leaves its track for a view at most so far from it, metres, straight ...
const NEAR_TRACK: f64 = 30.0;
/// ... from one of so many places of it, this far apart, metres.
const MOST_TRACK_PLACES: usize = 8;
const TRACK_PLACE_SPACING: f64 = 2.0;
/// Clusters within this distance of each other, metres, are one place to go to ...
const CLUSTER_MERGE_DISTANCE: f64 = 15.0;
/// ... and the robot sets out for each so often: from there the roadmap leads on, or nothing does.
const MOST_TRIALS: usize = 2;

/// A view of a cluster that is far away.
#[derive(Clone, Copy, Debug)]
struct FarView {
    place: Point,
    /// Unknown volume that the sensor is likely to see, cubic metres.
    volume: f64,
}

impl Explorer {
    /// Goes to where the most is to be seen for its time, if that is far away and more than `near` shows; returns whether it does.
    pub(super) fn goes_far<S: Space>(&mut self, now: &Situation<'_, S>, frontier: &[FrontierCluster], near: Option<&Viewpoint>) -> bool {
        let has_enough = near.is_some_and(|near| near.volume.likely >= LEAST_STOP);
        if has_enough {
            return false;
        }
        let track = self.places_of_track();
        let views = self.far_views(now, frontier);
        let seen_from = |view: &FarView| Some((*view, seen_from(now.space, &track, view.place)?));
        let Some((view, from)) = views.iter().find_map(seen_from) else { return false };
        let mut way = short_way(now.space, &track[from..], now.robot).path;
        way.push(view.place);
        let way_length = length(&way);
        let speed = self.settings.speed;
        if near.is_some_and(|near| rate(view.volume, way_length, speed) <= rate(near.volume.likely, near.length, speed)) {
            return false;
        }
        let way_home = short_way(now.space, &track[..from], track[from]).path;
        if now.seconds_left.is_some_and(|left| self.seconds_for(way_length + distance(view.place, track[from]) + length(&way_home)) > left) {
            return false;
        }
        self.gone_to.push((view.place, anchor_path(now.atlas, &[view.place])));
        let path = Leg::trace(now.space, &shorten(now.space, way, Effort::Quick));
        let is_free = recheck(now.space, now.map, &path).is_empty();
        // Without a volume: nothing that it sees on its way is the target before it is there.
        self.leg = is_free.then(|| Leg::new(now.atlas, path, None));
        is_free
    }

    /// Views of clusters far away that the robot has not gone to, those first that show the most for their distance.
    fn far_views<S: Space>(&self, now: &Situation<'_, S>, frontier: &[FrontierCluster]) -> Vec<FarView> {
        let (robot, [low, high]) = (now.robot, now.viewpoint_box);
        let is_gone_to = |p: Point| self.gone_to.iter().filter(|(place, _)| distance(*place, p) < CLUSTER_MERGE_DISTANCE).count() >= MOST_TRIALS;
        let worth = |cluster: &FrontierCluster| cluster.area / distance(cluster.centre, robot);
        let mut far: Vec<&FrontierCluster> =
            frontier.iter().filter(|cluster| distance(cluster.centre, robot) > FAR && !is_gone_to(cluster.centre)).collect();
        far.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        let view = |cluster: &FrontierCluster| {
            let place: Point = std::array::from_fn(|k| cluster.centre[k] - IN_FRONT * cluster.normal[k]);
            let is_inside = (0..3).all(|k| (low[k]..=high[k]).contains(&place[k]));
            (is_inside && now.space.state_at(place).is_some())
                .then(|| FarView { place, volume: self.settings.view.unknown(now.map, place, self.settings.bounds).likely })
        };
        let rate = |view: &FarView| rate(view.volume, distance(view.place, robot), self.settings.speed);
        let mut views: Vec<FarView> = far.into_iter().take(MOST_CLUSTERS).filter_map(view).filter(|view| view.volume >= LEAST_STOP).collect();
        views.sort_by(|a, b| rate(b).total_cmp(&rate(a)));
        views
    }
}

/// The place of the track, by its number, from which a straight motion to a view is free; of some, the nearest.
fn seen_from<S: Space>(space: &S, track: &[Point], view: Point) -> Option<usize> {
    let off = |k: &usize| distance(track[*k], view);
    let mut near: Vec<usize> = (0..track.len()).filter(|k| off(k) < NEAR_TRACK).collect();
    near.sort_by(|a, b| off(a).total_cmp(&off(b)));
    let mut tried: Vec<Point> = Vec::with_capacity(MOST_TRACK_PLACES);
    near.into_iter().find(|k| {
        let is_tried = tried.len() < MOST_TRACK_PLACES && tried.iter().all(|other| distance(*other, track[*k]) > TRACK_PLACE_SPACING);
        is_tried && {
            tried.push(track[*k]);
            space.connects(track[*k], view)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::ExploreSettings;
    use voxelastic::Pose;
    use voxelastic::event::{Event, Scan};
    use voxelastic::mapper::Mapper;
    use voxelastic::sensor::preset_with_columns;
    use voxelastic::settings::{FieldKind, RobotRadius, Settings};
    use voxelastic_plan::Robot;
    use voxelastic_sim::WorldBuilder;
    use voxelastic_sim::random::Stream;
    use voxelastic_sim::sensor::{Lidar, LidarSettings};

    /// The map of a corridor of 60 m, and of the beginning of a hall of 30 x 31 m at its end.
    fn corridor_and_hall() -> Mapper {
        let mut b = WorldBuilder::new("hall", 1);
        b.ground(0.0, 0.3);
        let walls = [
            ([-3.0, -2.0], [60.0, -1.5]),
            ([-3.0, 1.5], [60.0, 2.0]),
            ([-3.0, -2.0], [-2.5, 2.0]),
            ([59.5, -16.0], [60.0, -1.5]),
            ([59.5, 1.5], [60.0, 16.0]),
            ([59.5, -16.0], [90.0, -15.5]),
            ([59.5, 15.5], [90.0, 16.0]),
            ([89.5, -16.0], [90.0, 16.0]),
        ];
        for (low, high) in walls {
            b.cuboid([low[0], low[1], -0.5], [high[0], high[1], 3.0], 0.5);
        }
        b.cuboid([-3.0, -16.0, 2.6], [90.0, 16.0, 3.0], 0.7);
        let world = b.build().unwrap();
        let model = preset_with_columns("os0-64", 512).unwrap();
        let robot_radius = RobotRadius::Metres(0.9);
        let mut mapper = Mapper::new(Settings { max_range: 15.0, field: FieldKind::Occupancy, robot_radius, ..Settings::default() }).unwrap();
        mapper.set_sensor_model(model.clone());
        let lidar = Lidar::new(model, LidarSettings::default()).unwrap();
        for node in 0..=30 {
            let t_map_lidar = Pose::translation(2.0 * node as f64, 0.0, 1.0);
            let cloud = lidar.scan(&world, |_| t_map_lidar, &Stream::new(node, &[]));
            mapper.handle(Event::Scan(Scan { node, time: node as f64, t_map_lidar, cloud })).unwrap();
        }
        mapper
    }

    #[test]
    fn it_goes_along_its_track_to_where_much_is_left_if_there_is_time() {
        let mapper = corridor_and_hall();
        let settings = ExploreSettings::new(Robot::flying(0.35), [[-2.0, -15.5, 0.3], [89.5, 15.5, 1.6]]);
        let path = |seconds_left| {
            let mut explorer = Explorer::new(ExploreSettings { least_volume: 1.0, ..settings }).unwrap();
            // It came home from the hall.
            explorer.track = (0..=30).chain((0..30).rev()).map(|k| ([2.0 * f64::from(k), 0.0, 1.0], Vec::new())).collect();
            let decision = explorer.decide(mapper.atlas(), [0.0, 0.0, 1.0], Some(seconds_left)).unwrap();
            (decision.path.last().map_or(0.0, |end| end[0]), decision.is_unfinished)
        };
        let ends = [200.0, 70.0].map(path);
        assert!(ends[0].0 > 50.0 && !ends[0].1 && ends[1].0 < 50.0, "{ends:?}");
    }
}
