//! Where the robot can be in a map that drift bends: the whole map's space, those of the newest submaps, what the last scans saw, and a way out for a robot that stands where
//! it does not fit.

use crate::near_returns::NearReturns;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic_plan::{Point, Space, distance};

/// The way out is at most this long, metres.
const LONGEST: f64 = 2.0;
/// A motion that rises or falls by no more than this is level, metres.
const LEVEL: f64 = 0.05;

/// The submaps of the newest scans, the newest first.
pub(crate) fn newest_submaps(atlas: &Atlas) -> Vec<SubmapId> {
    let newest = |submap: &Submap| submap.scans().iter().map(|scan| scan.node).max();
    let mut submaps: Vec<&Submap> = atlas.submaps().iter().collect();
    submaps.sort_by_key(|submap| std::cmp::Reverse(newest(submap)));
    submaps.into_iter().map(Submap::id).collect()
}

/// The space of a robot in the whole map and in its newest submaps.
///
/// Until a loop closes, walls that an older submap saw may stand in a doorway as it is seen now. So a motion is free if the whole map says so, or the newest submap by
/// itself: it saw the place last; or the two newest, as a submap that has just begun has seen little. Steeply up and down, where the sensor does not see, the newest
/// must have it free and one of the others, too: what a submap has free above may have been seen elsewhere, some drift ago. In all it keeps clear of the last scans'
/// returns. And a robot that a correction, or a wall seen late, leaves where it does not fit may use up its margin for a motion to where it does.
#[derive(Clone, Debug)]
pub(crate) struct RobotSpace<'a, S> {
    wide: Clear<'a, S>,
    /// Of the body without its margin; none if the robot fits where it stands.
    narrow: Option<Clear<'a, S>>,
    start: Point,
}

/// The spaces of a ball in the whole map, in the two newest submaps and in the newest, without what the last scans' returns block.
#[derive(Clone, Debug)]
pub(crate) struct Clear<'a, S> {
    spaces: [S; 3],
    returns: &'a NearReturns,
    /// Of the ball, metres.
    radius: f64,
    /// The slope, height over distance, up to which the sensor sees.
    steepest: f64,
}

impl<'a, S: Space> Clear<'a, S> {
    /// `spaces` are those of the whole map, of the two newest submaps, and of the newest; `steepest` is the slope, height over distance, up to which the
    /// sensor sees.
    pub fn new(spaces: [S; 3], returns: &'a NearReturns, radius: f64, steepest: f64) -> Self {
        Self { spaces, returns, radius, steepest }
    }

    fn whole(&self) -> &S {
        &self.spaces[0]
    }

    fn any<T>(&self, ask: impl Fn(&S) -> Option<T>) -> Option<T> {
        self.spaces.iter().find_map(ask)
    }

    fn steer(&self, from: Point, to: Point) -> Option<Point> {
        let may = |arrived: &Point| self.is_clear(from, *arrived) && self.is_level_or_seen(from, *arrived);
        self.for_motion(from, to).iter().find_map(|space| space.steer(from, to).filter(may))
    }

    /// Wheels follow the floor, however steep.
    fn is_steep(&self, from: Point, to: Point) -> bool {
        let (run, rise) = ((to[0] - from[0]).hypot(to[1] - from[1]), (to[2] - from[2]).abs());
        self.whole().dimensions() == 3 && rise > self.steepest * run + LEVEL
    }

    /// The spaces one of which has to allow a motion.
    fn for_motion(&self, from: Point, to: Point) -> &[S] {
        if self.is_steep(from, to) { &self.spaces[..2] } else { &self.spaces }
    }

    /// Whether a motion is not steep, or the newest submap has it free.
    fn is_level_or_seen(&self, from: Point, to: Point) -> bool {
        !self.is_steep(from, to) || self.spaces[2].is_segment_free(from, to)
    }

    /// Whether the last scans' returns allow a motion.
    fn is_clear(&self, from: Point, to: Point) -> bool {
        // Wheels follow the floor.
        let keeps_height = self.whole().dimensions() == 2 || self.returns.keep_height(from, to, self.radius);
        keeps_height && self.returns.are_clear_of(from, to, self.radius)
    }

    fn state_at(&self, p: Point) -> Option<Point> {
        self.any(|space| space.state_at(p).filter(|state| self.returns.are_clear_of(*state, *state, self.radius)))
    }

    fn is_segment_free(&self, from: Point, to: Point) -> bool {
        let is_free = || self.for_motion(from, to).iter().any(|space| space.is_segment_free(from, to));
        self.is_clear(from, to) && is_free() && self.is_level_or_seen(from, to)
    }
}

impl<'a, S: Space> RobotSpace<'a, S> {
    /// The space of a robot at `start`, with its margin and without.
    pub fn new(wide: Clear<'a, S>, narrow: Clear<'a, S>, start: Point) -> Self {
        let fits = wide.state_at(start).is_some();
        Self { wide, narrow: (!fits).then_some(narrow), start }
    }

    /// The space without the margin, for a motion from the start.
    fn out(&self, from: Point, to: Point) -> Option<&Clear<'a, S>> {
        self.narrow.as_ref().filter(|_| distance(from, self.start) < 1e-6 && distance(from, to) <= LONGEST)
    }
}

impl<S: Space> Space for RobotSpace<'_, S> {
    fn steer(&self, from: Point, to: Point) -> Option<Point> {
        let out = || self.out(from, to)?.steer(from, to).filter(|arrived| self.wide.state_at(*arrived).is_some());
        self.wide.steer(from, to).or_else(out)
    }

    fn state_at(&self, p: Point) -> Option<Point> {
        self.wide.state_at(p).or_else(|| self.out(p, p)?.state_at(p))
    }

    fn project(&self, p: Point) -> Option<Point> {
        self.wide.any(|space| space.project(p))
    }

    fn bounds(&self) -> [Point; 2] {
        self.wide.whole().bounds()
    }

    fn is_same(&self, a: Point, b: Point) -> bool {
        self.wide.whole().is_same(a, b)
    }

    fn max_step(&self) -> f64 {
        self.wide.whole().max_step()
    }

    fn dimensions(&self) -> usize {
        self.wide.whole().dimensions()
    }

    fn trace(&self, from: Point, to: Point, path: &mut Vec<Point>) {
        let by = self.wide.spaces.iter().find(|space| space.steer(from, to).is_some());
        by.unwrap_or(self.wide.whole()).trace(from, to, path);
    }

    fn is_reversible(&self, from: Point, arrived: Point) -> bool {
        self.wide.spaces.iter().any(|space| space.is_reversible(from, arrived))
    }

    fn is_segment_free(&self, from: Point, to: Point) -> bool {
        let out = || self.out(from, to).is_some_and(|narrow| narrow.is_segment_free(from, to) && self.wide.state_at(to).is_some());
        self.wide.is_segment_free(from, to) || out()
    }

    fn neighbour_state(&self, from: Point, to: Point) -> Option<Point> {
        self.wide.any(|space| space.neighbour_state(from, to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic_plan::between;

    const STEEPEST: f64 = 0.4;

    /// Everything is free but a ball of this radius around the origin, and what is outside of a box of 10 m.
    #[derive(Clone, Debug)]
    struct Around(f64);

    impl Space for Around {
        fn steer(&self, from: Point, to: Point) -> Option<Point> {
            (0..=100).all(|i| distance(between(from, to, f64::from(i) / 100.0), [0.0; 3]) > self.0).then_some(to)
        }

        fn state_at(&self, p: Point) -> Option<Point> {
            (distance(p, [0.0; 3]) > self.0).then_some(p)
        }

        fn bounds(&self) -> [Point; 2] {
            [[-5.0; 3], [5.0; 3]]
        }
    }

    /// A robot at `start`; the pole looks wider in the whole map than in the newest submap, and half a metre less for the body.
    fn robot(start: Point, returns: &NearReturns) -> RobotSpace<'_, Around> {
        let clear = |less: f64, radius| Clear::new([2.0, 1.9, 1.0].map(|pole| Around(pole - less)), returns, radius, STEEPEST);
        RobotSpace::new(clear(0.0, 0.4), clear(0.5, 0.3), start)
    }

    #[test]
    fn the_newest_submap_opens_what_older_ones_block() {
        let returns = NearReturns::default();
        let space = robot([3.0, 0.0, 0.0], &returns);
        assert!(space.connects([-3.0, 1.5, 0.0], [3.0, 1.5, 0.0]) && space.is_segment_free([-3.0, 1.5, 0.0], [3.0, 1.5, 0.0]));
        assert!(!space.connects([-3.0, 0.5, 0.0], [3.0, 0.5, 0.0]) && !space.is_segment_free([-3.0, 0.5, 0.0], [3.0, 0.5, 0.0]));
    }

    #[test]
    fn the_newest_submap_does_not_open_what_is_above() {
        let returns = NearReturns::default();
        let space = robot([3.0, 0.0, 0.0], &returns);
        let is_free = |from: Point, to: Point| [space.connects(from, to), space.is_segment_free(from, to)];
        // Between the pole as the newest submap has it, of 1 m, and as the two newest have it, of 1.9 m; the whole map has one of 2 m.
        assert_eq!(is_free([0.0, -1.7, -0.8], [0.0, -1.7, 0.8]), [false; 2], "up");
        assert_eq!(is_free([0.0, -1.7, 0.8], [0.3, -1.7, -0.8]), [false; 2], "down a steep slope");
        assert_eq!(is_free([-1.5, -1.7, -0.3], [1.5, -1.7, 0.3]), [true; 2], "up a gentle slope");
        assert_eq!(is_free([0.0, -1.95, -0.8], [0.0, -1.95, 0.8]), [true; 2], "the two newest have it free");
    }

    #[test]
    fn a_submap_that_has_just_begun_does_not_shut_the_way() {
        let returns = NearReturns::default();
        let clear = |poles: [f64; 3]| Clear::new(poles.map(Around), &returns, 0.4, STEEPEST);
        let (from, to) = ([-3.0, 1.5, 0.0], [3.0, 1.5, 0.0]);
        let space = |poles| RobotSpace::new(clear(poles), clear(poles), from);
        assert!(space([2.0, 1.0, 9.0]).connects(from, to) && space([2.0, 1.0, 9.0]).is_segment_free(from, to));
        assert!(!space([2.0, 2.0, 9.0]).connects(from, to) && !space([2.0, 2.0, 9.0]).is_segment_free(from, to));
        // What it has not seen above, the others may have seen elsewhere.
        let (under, over) = ([-3.0, 1.5, -0.5], [-3.0, 1.5, 0.5]);
        assert!(!space([2.0, 1.0, 9.0]).connects(under, over) && !space([2.0, 1.0, 9.0]).is_segment_free(under, over));
        assert!(space([2.0, 1.0, 2.0]).connects(under, over) && space([2.0, 1.0, 2.0]).is_segment_free(under, over));
    }

    #[test]
    fn only_a_robot_that_does_not_fit_uses_up_its_margin_and_only_to_where_it_fits() {
        let returns = NearReturns::default();
        let (inside, outside) = ([0.8, 0.0, 0.0], [1.6, 0.0, 0.0]);
        let space = robot(inside, &returns);
        assert!(space.connects(inside, outside) && space.is_segment_free(inside, outside) && space.state_at(inside).is_some());
        assert!(!space.connects(inside, [0.9, 0.0, 0.0]), "it does not fit there either");
        assert!(!space.connects(inside, [4.0, 0.0, 0.0]), "too far");
        assert!(!space.connects([0.8, 0.1, 0.0], outside), "not from elsewhere");
        let space = robot([3.0, 0.0, 0.0], &returns);
        assert!(!space.connects(inside, outside) && space.state_at(inside).is_none());
    }

    #[test]
    fn the_last_scan_blocks_what_the_map_has_free() {
        let wall = voxelastic::Cloud::from_points((0..400).map(|k| [3.0, (k % 20) as f32 * 0.1 - 1.0, (k / 20) as f32 * 0.1 - 1.0]).collect());
        let returns = NearReturns::new(&voxelastic::Pose::translation(0.5, 0.0, 0.0), &wall);
        let space = robot([2.5, 0.0, 0.0], &returns);
        assert!(space.connects([2.5, 0.0, 0.0], [3.0, 0.0, 0.0]) && !space.connects([2.5, 0.0, 0.0], [3.3, 0.0, 0.0]));
        assert!(space.state_at([3.3, 0.0, 0.0]).is_none() && !space.is_segment_free([2.5, 0.0, 0.0], [4.5, 0.0, 0.0]));
        assert!(space.connects([2.5, 2.0, 0.0], [4.5, 2.0, 0.0]));
    }
}
