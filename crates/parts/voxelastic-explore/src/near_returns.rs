//! What the last scans saw near the robot: a map that drift has shifted, or that many earlier scans saw free, may not show yet what is there now.

use hashbrown::HashMap;
use hashbrown::hash_map::Entry;
use voxelastic_plan::{Point, distance};

/// Returns within this distance of the sensor are kept along every axis, metres: motions beyond it are decided again before the robot gets there.
pub(crate) const REACH: f64 = 4.0;
/// Edge of the cells that returns are sorted into, metres.
const CELL: f64 = 0.5;
/// One return is kept of those in a cube of this edge, metres.
pub(crate) const THINNED: f64 = 0.05;

/// Returns around a robot, map frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct NearReturns {
    low: Point,
    high: Point,
    /// Of the lowest and of the highest return; no limit above where none is above the robot on some side, as under the sky: what is above it on the others is a wall.
    heights: [f64; 2],
    cells: HashMap<[i32; 3], Vec<Point>>,
}

impl NearReturns {
    /// Those of one scan.
    #[cfg(test)]
    pub fn new(t_map_lidar: &voxelastic::Pose, cloud: &voxelastic::Cloud) -> Self {
        let mut scans = crate::last_scans::LastScans::default();
        scans.push(t_map_lidar, cloud);
        scans.returns(f64::INFINITY)
    }

    /// Those of `points` (map frame, metres) that are near `centre`.
    pub fn of(centre: Point, points: impl Iterator<Item = Point>) -> Self {
        let [low, high] = [-REACH, REACH].map(|reach| centre.map(|c| c + reach));
        let mut near = Self { low, high, heights: [f64::INFINITY, f64::NEG_INFINITY], cells: HashMap::new() };
        let mut taken = HashMap::new();
        // By quadrants of the horizontal plane.
        let mut is_above = [false; 4];
        for p in points {
            let is_near = (0..3).all(|k| p[k] >= near.low[k] && p[k] <= near.high[k]);
            if is_near && let Entry::Vacant(cube) = taken.entry(p.map(|c| (c / THINNED).floor() as i32)) {
                cube.insert(());
                near.heights = [near.heights[0].min(p[2]), near.heights[1].max(p[2])];
                is_above[usize::from(p[0] > centre[0]) + 2 * usize::from(p[1] > centre[1])] |= p[2] >= centre[2];
                near.cells.entry(p.map(cell)).or_default().push(p);
            }
        }
        if is_above.contains(&false) {
            near.heights[1] = f64::INFINITY;
        }
        near
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }

    /// Distance from `p` to the nearest of them, metres.
    pub fn nearest(&self, p: Point) -> f64 {
        self.cells.values().flatten().map(|q| distance(*q, p)).fold(f64::INFINITY, f64::min)
    }

    /// Whether a ball of `radius` metres that moves from `from` to `to` stays between the heights of what was seen around the robot, or comes nearer to that: a sensor sees
    /// neither the floor below it nor the ceiling above, and a map that has drifted has them elsewhere.
    pub fn keep_height(&self, from: Point, to: Point, radius: f64) -> bool {
        let is_beside = (0..2).all(|k| (self.low[k]..=self.high[k]).contains(&to[k]));
        let off = |p: Point| (self.heights[0] - (p[2] - radius)).max(p[2] + radius - self.heights[1]).max(0.0);
        self.is_empty() || !is_beside || off(to) <= off(from) + 1e-9
    }

    /// Whether a ball of `radius` metres that moves straight from `from` to `to` touches none of the returns.
    pub fn are_clear_of(&self, from: Point, to: Point, radius: f64) -> bool {
        let low: Point = std::array::from_fn(|k| (from[k].min(to[k]) - radius).max(self.low[k]));
        let high: Point = std::array::from_fn(|k| (from[k].max(to[k]) + radius).min(self.high[k]));
        if (0..3).any(|k| low[k] > high[k]) {
            return true;
        }
        let [x, y, z]: [_; 3] = std::array::from_fn(|k| cell(low[k])..=cell(high[k]));
        let keys = x.flat_map(|x| {
            y.clone().flat_map({
                let z = z.clone();
                move |y| z.clone().map(move |z| [x, y, z])
            })
        });
        keys.filter_map(|key| self.cells.get(&key)).flatten().all(|p| squared_distance(*p, from, to) >= radius * radius)
    }
}

fn cell(c: f64) -> i32 {
    (c / CELL).floor() as i32
}

/// Squared distance of `p` from the segment between `a` and `b`, square metres.
pub(crate) fn squared_distance(p: Point, a: Point, b: Point) -> f64 {
    let (along, off): (Point, Point) = (std::array::from_fn(|k| b[k] - a[k]), std::array::from_fn(|k| p[k] - a[k]));
    let dot = |u: Point, v: Point| (0..3).map(|k| u[k] * v[k]).sum::<f64>();
    let share = (dot(along, off) / dot(along, along).max(1e-12)).clamp(0.0, 1.0);
    (0..3).map(|k| (off[k] - share * along[k]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use voxelastic::{Cloud, Pose};
    use voxelastic_plan::between;

    fn places(n: usize) -> impl Strategy<Value = Vec<Point>> {
        prop::collection::vec(prop::array::uniform3(-6.0f64..6.0), n)
    }

    proptest! {
        #[test]
        fn near_returns_block_what_all_returns_block(points in places(60), ends in places(2), radius in 0.05f64..1.0) {
            let cloud = Cloud::from_points(points.iter().map(|p| p.map(|c| c as f32)).collect());
            let pose = Pose::translation(0.5, -0.3, 0.2);
            let near = NearReturns::new(&pose, &cloud);
            let placed = cloud.points.iter().map(|p| -> Point { [f64::from(p[0]) + 0.5, f64::from(p[1]) - 0.3, f64::from(p[2]) + 0.2] });
            let in_reach: Vec<Point> = placed.filter(|p| (0..3).all(|k| (p[k] - [0.5, -0.3, 0.2][k]).abs() <= REACH)).collect();
            // The slow way: many balls along the segment. Close calls depend on where they are, and are left out.
            let [from, to] = [ends[0], ends[1]];
            let balls: Vec<Point> = (0..=4000).map(|i| between(from, to, f64::from(i) / 4000.0)).collect();
            let least = in_reach.iter().flat_map(|p| balls.iter().map(|ball| distance(*p, *ball))).fold(f64::INFINITY, f64::min);
            prop_assume!((least - radius).abs() > 0.01);
            prop_assert_eq!(near.are_clear_of(from, to, radius), least > radius);
        }
    }

    #[test]
    fn dense_returns_are_thinned_and_nothing_blocks_without_returns() {
        let wall = Cloud::from_points((0..10_000).map(|k| [2.0, k as f32 * 1e-4, 0.0]).collect());
        let near = NearReturns::new(&Pose::identity(), &wall);
        assert!(near.cells.values().map(Vec::len).sum::<usize>() <= 22);
        assert!(!near.are_clear_of([1.0, 0.5, 0.0], [3.0, 0.5, 0.0], 0.3) && near.are_clear_of([1.0, 0.5, 0.0], [1.6, 0.5, 0.0], 0.3));
        assert!(NearReturns::default().are_clear_of([0.0; 3], [9.0; 3], 1.0));
    }

    #[test]
    fn a_ball_stays_between_the_heights_that_were_seen() {
        let sides = [[2.0, 1.0], [-2.0, 1.0], [2.0, -1.0], [-2.0, -1.0]];
        let cloud =
            |sides: &[[f32; 2]], heights: &[f32]| Cloud::from_points(sides.iter().flat_map(|[x, y]| heights.iter().map(|z| [*x, *y, *z])).collect());
        let near = NearReturns::new(&Pose::translation(0.0, 0.0, 1.0), &cloud(&sides, &[-1.0, 1.5]));
        let may = |near: &NearReturns, from: f64, to: f64| near.keep_height([0.0, 0.0, from], [0.5, 0.0, to], 0.4);
        assert!(may(&near, 1.0, 0.5) && may(&near, 1.0, 2.0) && !may(&near, 1.0, 0.3) && !may(&near, 1.0, 2.2));
        assert!(may(&near, 0.2, 0.3) && !may(&near, 0.3, 0.2), "out of them it may only come nearer");
        assert!(near.keep_height([0.0; 3], [9.0, 0.0, -3.0], 0.4), "far away nothing was seen");
        // Under the sky, alone and in a corner between two walls.
        for below_the_sky in [cloud(&sides, &[-1.0]), cloud(&sides[..3], &[-1.0, 1.5])] {
            let near = NearReturns::new(&Pose::translation(0.0, 0.0, 1.0), &below_the_sky);
            assert!(may(&near, 1.0, 30.0) && !may(&near, 1.0, 0.3));
        }
        assert!(may(&NearReturns::default(), 1.0, -9.0));
        assert!((near.nearest([2.0, 1.0, 0.5]) - 0.5).abs() < 1e-6 && NearReturns::default().nearest([0.0; 3]).is_infinite());
    }
}
