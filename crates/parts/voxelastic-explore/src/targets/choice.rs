//! Which viewpoint is the next target.

use crate::routes::roadmap::Roadmap;
use crate::settings::ExploreSettings;
use crate::targets::tour::{self, Lengths};
use crate::targets::viewpoints::Viewpoint;
use voxelastic_plan::{Point, Space, distance};

/// A viewpoint that shows less is not worth a stop on the way, cubic metres: most such volumes are gaps in what was seen, not places behind a corner.
pub(crate) const LEAST_STOP: f64 = 30.0;
/// A stop is worth this much of a detour for a cubic metre that it shows, metres.
const DETOUR: f64 = 0.05;

/// The robot goes on to the viewpoint that it is on its way to unless another one shows more for its time by this factor: with each plan the next one may look better, and it
/// would turn around for ever.
const BETTER: f64 = 1.5;

/// The next target of the viewpoints that are worth a visit: the first stop of a tour to the one with the largest unknown volume per second of travel, over those whose detour is
/// worth what they show; for a robot that is on its way to `current`.
pub(crate) fn choose<S: Space>(
    settings: &ExploreSettings,
    space: &S,
    roadmap: &Roadmap,
    worth: &[Viewpoint],
    current: Option<Point>,
) -> Option<Viewpoint> {
    let best = best(settings, worth)?;
    Some(steady(settings, worth, current, first_stop(space, roadmap, worth, best)))
}

/// The one with the largest unknown volume per second of travel.
fn best(settings: &ExploreSettings, worth: &[Viewpoint]) -> Option<Viewpoint> {
    let rate = |v: &Viewpoint| rate(v.volume.likely, v.length, settings.speed);
    worth.iter().max_by(|a, b| rate(a).total_cmp(&rate(b))).copied()
}

/// The one that the robot is on its way to, unless `chosen` is much better.
fn steady(settings: &ExploreSettings, worth: &[Viewpoint], current: Option<Point>, chosen: Viewpoint) -> Viewpoint {
    let rate = |v: &Viewpoint| rate(v.volume.likely, v.length, settings.speed);
    let off = |v: &Viewpoint| current.map_or(f64::INFINITY, |end| distance(v.place, end));
    let ahead = worth.iter().min_by(|a, b| off(a).total_cmp(&off(b))).filter(|v| off(v) < settings.spacing);
    ahead.filter(|ahead| rate(&chosen) < BETTER * rate(ahead)).copied().unwrap_or(chosen)
}

/// Unknown volume for a second of the way there and a second of looking: of `volume` cubic metres, `length` metres away, at `speed` metres a second.
pub(crate) fn rate(volume: f64, length: f64, speed: f64) -> f64 {
    volume / (length / speed + 1.0)
}

/// The first stop of a tour to the target.
fn first_stop<S: Space>(space: &S, roadmap: &Roadmap, worth: &[Viewpoint], target: Viewpoint) -> Viewpoint {
    let mut stops: Vec<Viewpoint> = worth.iter().filter(|v| v.volume.likely >= LEAST_STOP && v.node != target.node).copied().collect();
    stops.sort_by(|a, b| b.volume.likely.total_cmp(&a.volume.likely).then(a.node.cmp(&b.node)));
    let ends: Vec<u32> = stops.iter().chain([&target]).map(|to| to.node).collect();
    let from = |from: &Viewpoint| -> Vec<f64> {
        let ways = roadmap.ways_to(space, from.place, &ends);
        stops.iter().chain([&target]).map(|to| ways.length(to.node)).collect()
    };
    let between = stops.iter().map(from).collect();
    let lengths = Lengths { first: stops.iter().chain([&target]).map(|v| v.length).collect(), between };
    let most: Vec<f64> = stops.iter().map(|v| DETOUR * v.volume.likely).collect();
    tour::stops(&lengths, &most).first().map_or(target, |first| stops[*first])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::targets::gain::UnknownVolume;
    use voxelastic_plan::Robot;

    #[test]
    fn a_robot_between_two_viewpoints_does_not_turn_around_with_each_plan() {
        let settings = ExploreSettings::new(Robot::flying(0.3), [[-9.0; 3], [9.0; 3]]);
        // One 4 m to the left and one to the right, of a robot at x.
        let choice = |x: f64, right: f64, current: Option<f64>| {
            let view = |node, at: f64, likely| Viewpoint {
                node,
                place: [at, 0.0, 0.0],
                length: (at - x).abs(),
                volume: UnknownVolume { possible: likely, likely },
            };
            let worth = [view(0, -4.0, 100.0), view(1, 4.0, right)];
            best(&settings, &worth).map(|best| steady(&settings, &worth, current.map(|at| [at, 0.0, 0.0]), best).node)
        };
        assert_eq!([-0.4, 0.4].map(|x| choice(x, 100.0, None)), [Some(0), Some(1)]);
        assert_eq!([-0.4, 0.4].map(|x| choice(x, 100.0, Some(4.0))), [Some(1), Some(1)]);
        assert_eq!([-0.4, 0.4].map(|x| choice(x, 100.0, Some(-4.0))), [Some(0), Some(0)]);
        assert_eq!(choice(0.0, 160.0, Some(-4.0)), Some(1), "that is much more");
        assert_eq!(choice(0.4, 100.0, Some(-2.0)), Some(1), "it went to where nothing is left");
    }
}
