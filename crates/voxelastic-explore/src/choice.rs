//! Which viewpoint is the next target.

use crate::roadmap::Roadmap;
use crate::settings::{ExploreSettings, Strategy};
use crate::tour::{self, Lengths};
use crate::viewpoints::Viewpoint;
use voxelastic_plan::Space;

/// A viewpoint that shows less is not worth a stop on the way, cubic metres: most such volumes are gaps in what was seen, not places behind a corner.
const LEAST_STOP: f64 = 30.0;
/// A stop is worth this much of a detour for a cubic metre that it shows, metres.
const DETOUR: f64 = 0.05;

/// The next target of the viewpoints that are worth a visit, by the strategy.
pub(crate) fn choose<S: Space>(settings: &ExploreSettings, space: &S, roadmap: &Roadmap, worth: &[Viewpoint]) -> Option<Viewpoint> {
    let rate = |v: &Viewpoint| v.volume / (v.length / settings.speed + 1.0);
    let nearest = || worth.iter().min_by(|a, b| a.length.total_cmp(&b.length)).copied();
    let best = || worth.iter().max_by(|a, b| rate(a).total_cmp(&rate(b))).copied();
    match settings.strategy {
        Strategy::Nearest => nearest(),
        Strategy::NextBest => best(),
        Strategy::Tour => best().map(|target| first_stop(space, roadmap, worth, target)),
    }
}

/// The first stop of a tour to the target.
fn first_stop<S: Space>(space: &S, roadmap: &Roadmap, worth: &[Viewpoint], target: Viewpoint) -> Viewpoint {
    let mut stops: Vec<Viewpoint> = worth.iter().filter(|v| v.volume >= LEAST_STOP && v.node != target.node).copied().collect();
    stops.sort_by(|a, b| b.volume.total_cmp(&a.volume).then(a.node.cmp(&b.node)));
    let ends: Vec<u32> = stops.iter().chain([&target]).map(|to| to.node).collect();
    let from = |from: &Viewpoint| -> Vec<f64> {
        let ways = roadmap.ways_to(space, from.place, &ends);
        stops.iter().chain([&target]).map(|to| ways.length(to.node)).collect()
    };
    let between = stops.iter().map(from).collect();
    let lengths = Lengths { first: stops.iter().chain([&target]).map(|v| v.length).collect(), between };
    let most: Vec<f64> = stops.iter().map(|v| DETOUR * v.volume).collect();
    tour::stops(&lengths, &most).first().map_or(target, |first| stops[*first])
}
