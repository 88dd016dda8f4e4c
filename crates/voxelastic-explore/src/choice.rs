//! Which viewpoint is the next target.

use crate::roadmap::Roadmap;
use crate::settings::{ExploreSettings, Strategy};
use crate::tour;
use crate::viewpoints::Viewpoint;
use voxelastic_plan::Space;

/// Viewpoints of a tour.
const STOPS: usize = 8;
/// Worth falls to a third in this time, seconds.
const HORIZON: f64 = 40.0;

/// The next target of the viewpoints that are worth a visit, by the strategy.
pub(crate) fn choose<S: Space>(settings: &ExploreSettings, space: &S, roadmap: &Roadmap, mut worth: Vec<Viewpoint>) -> Option<Viewpoint> {
    let seconds = |metres: f64| metres / settings.speed;
    let rate = |v: &Viewpoint| v.volume / (seconds(v.length) + 1.0);
    match settings.strategy {
        Strategy::Nearest => worth.into_iter().min_by(|a, b| a.length.total_cmp(&b.length)),
        Strategy::NextBest => worth.into_iter().max_by(|a, b| rate(a).total_cmp(&rate(b))),
        Strategy::Tour => {
            worth.sort_by(|a, b| rate(b).total_cmp(&rate(a)).then(a.node.cmp(&b.node)));
            worth.truncate(STOPS);
            let times = |from: &Viewpoint| -> Vec<f64> {
                let ways = roadmap.ways(space, from.place);
                worth.iter().map(|to| seconds(ways.length(to.node))).collect()
            };
            let between: Vec<Vec<f64>> = worth.iter().map(times).collect();
            let volumes: Vec<f64> = worth.iter().map(|v| v.volume).collect();
            let first: Vec<f64> = worth.iter().map(|v| seconds(v.length)).collect();
            tour::order(&volumes, &first, &between, HORIZON).first().map(|best| worth[*best])
        }
    }
}
