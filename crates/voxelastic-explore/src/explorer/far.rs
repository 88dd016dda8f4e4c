//! Far away: where little is left to see around the robot and the frontier has much of it elsewhere, the robot goes there along its track, as it has come from there.

use super::{EXTENDED, Explorer, Situation};
use crate::choice::LEAST_STOP;
use crate::clusters::FrontierCluster;
use crate::leg::Leg;
use crate::retreat;
use crate::settings::Strategy;
use crate::shortcuts::short_way;
use crate::viewpoints::Viewpoint;
use voxelastic::field::occupancy::State;
use voxelastic_plan::{Effort, Point, Space, anchor_path, distance, recheck, shorten};

/// Farther away than the roadmap reaches, metres.
const FAR: f64 = 2.0 * EXTENDED;
/// So many clusters are looked at: those with the largest area for their distance.
const LOOKED_AT: usize = 16;
/// They are looked at from so far in front of them, metres.
const IN_FRONT: f64 = 1.5;
/// A cluster is seen from a place of the track within this distance, metres.
const NEAR_TRACK: f64 = 30.0;
/// Clusters within this distance of each other, metres, are one place to go to ...
const SAME: f64 = 15.0;
/// ... and the robot sets out for each so often: from there the roadmap leads on, or nothing does.
const MOST_TRIALS: usize = 2;

/// A view of a cluster that is far away.
struct FarView {
    place: Point,
    /// Unknown volume that the sensor is likely to see, cubic metres.
    volume: f64,
}

impl Explorer {
    /// Goes to where the most is to be seen for its time, if that is far away and more than `near` shows; returns whether it does.
    pub(super) fn goes_far<S: Space>(&mut self, now: &Situation<'_, S>, frontier: &[FrontierCluster], near: Option<&Viewpoint>) -> bool {
        let has_enough = near.is_some_and(|near| near.volume.likely >= LEAST_STOP);
        if self.settings.strategy != Strategy::Tour || has_enough {
            return false;
        }
        let Some(view) = self.best_far_view(now, frontier) else { return false };
        let track: Vec<Point> = self.track.iter().map(|(place, _)| *place).collect();
        let off = |k: &usize| distance(track[*k], view.place);
        let Some(nearest) = (0..track.len()).min_by(|a, b| off(a).total_cmp(&off(b))).filter(|k| off(k) < NEAR_TRACK) else { return false };
        let way = short_way(now.space, &retreat::track(&track[nearest..], now.robot));
        let length = way.length + off(&nearest);
        if near.is_some_and(|near| self.rate(view.volume, length) <= self.rate(near.volume.likely, near.length)) {
            return false;
        }
        let home = short_way(now.space, &retreat::track(&track[..nearest], track[nearest])).length + off(&nearest);
        if now.seconds_left.is_some_and(|left| self.seconds_for(length + home) > left) {
            return false;
        }
        self.gone_to.push((view.place, anchor_path(now.atlas, &[view.place])));
        let path = Leg::trace(now.space, &shorten(now.space, way.path, Effort::Quick));
        let is_free = recheck(now.space, now.map, &path).is_empty();
        // Without a volume: nothing that it sees on its way is the target before it is there.
        self.leg = is_free.then(|| Leg::new(now.atlas, path, None));
        is_free
    }

    /// Of the clusters far away that the robot has not gone to, the one that shows the most for its distance.
    fn best_far_view<S: Space>(&self, now: &Situation<'_, S>, frontier: &[FrontierCluster]) -> Option<FarView> {
        let (robot, [low, high]) = (now.robot, now.viewpoint_box);
        let is_gone_to = |p: Point| self.gone_to.iter().filter(|(place, _)| distance(*place, p) < SAME).count() >= MOST_TRIALS;
        let worth = |cluster: &FrontierCluster| cluster.area / distance(cluster.centre, robot);
        let mut far: Vec<&FrontierCluster> =
            frontier.iter().filter(|cluster| distance(cluster.centre, robot) > FAR && !is_gone_to(cluster.centre)).collect();
        far.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        let view = |cluster: &FrontierCluster| {
            let place: Point = std::array::from_fn(|k| cluster.centre[k] - IN_FRONT * cluster.normal[k]);
            let is_inside = (0..3).all(|k| (low[k]..=high[k]).contains(&place[k]));
            (is_inside && now.map.state(place) == State::Free)
                .then(|| FarView { place, volume: self.settings.view.unknown(now.map, place, self.settings.bounds).likely })
        };
        let rate = |view: &FarView| self.rate(view.volume, distance(view.place, robot));
        let views = far.into_iter().take(LOOKED_AT).filter_map(view).filter(|view| view.volume >= LEAST_STOP);
        views.max_by(|a, b| rate(a).total_cmp(&rate(b)))
    }

    /// Unknown volume for a second of the way there, cubic metres.
    fn rate(&self, volume: f64, length: f64) -> f64 {
        volume / (length / self.settings.speed + 1.0)
    }
}
