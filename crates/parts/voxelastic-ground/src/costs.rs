//! Costs of a 2-D map: what it takes a robot to be in a cell, by its distance from obstacles.

use crate::GroundError;
use crate::grid::Grid;
use rayon::prelude::*;
use voxelastic::field::occupancy::State;

/// Of a cell in which there is an obstacle.
const OBSTACLE: i8 = 100;
/// Of a cell in which the middle of a robot cannot be: it would touch an obstacle.
const TOUCHES: i8 = 99;
/// The largest of a cell in which it can be.
const FREE: f64 = 98.0;
/// Of a cell of which nothing is known.
const UNKNOWN: i8 = -1;

/// How costs fall with the distance from obstacles, as the inflation layer of Nav2 has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inflation {
    /// Radius of the largest circle around the middle of the robot within its footprint, metres.
    pub radius: f64,
    /// Beyond this distance from obstacles there are no costs, metres.
    pub reach: f64,
    /// Between the two they fall by e in 1 / `falloff` metres.
    pub falloff: f64,
}

impl Default for Inflation {
    fn default() -> Self {
        Self { radius: 0.3, reach: 0.8, falloff: 3.0 }
    }
}

impl Inflation {
    /// Checks the numbers.
    ///
    /// # Errors
    /// [`GroundError::Robot`] for the first that is out of range.
    pub fn check(&self) -> Result<(), GroundError> {
        let bad = |what, value, must| Err(GroundError::Robot { what, value, must });
        if !(0.0..=5.0).contains(&self.radius) {
            return bad("radius of its footprint", self.radius, "0 to 5 m");
        }
        if !(self.radius..=10.0).contains(&self.reach) {
            return bad("distance from obstacles up to which there are costs", self.reach, "the radius of the footprint to 10 m");
        }
        if !(0.0..=1000.0).contains(&self.falloff) {
            return bad("falloff of costs", self.falloff, "0 to 1000 / m");
        }
        Ok(())
    }

    /// The cost at a distance from the nearest obstacle, metres: from the middle of a cell to that of another.
    fn cost(&self, distance: f64) -> i8 {
        match distance {
            0.0 => OBSTACLE,
            d if d <= self.radius => TOUCHES,
            d if d > self.reach => 0,
            d => (FREE * (-self.falloff * (d - self.radius)).exp()).round() as i8,
        }
    }
}

impl Grid {
    /// The costs of its cells, as `nav_msgs/OccupancyGrid` has them: 100 where there is an obstacle, 99 where a robot would touch one, then less with the distance from the nearest one,
    /// and never less than what the floor takes ([`Grid::costs`], at most 98); -1 where nothing is known, unless a robot would touch an obstacle there.
    pub fn inflated(&self, inflation: &Inflation) -> Vec<i8> {
        let width = self.cells.size[0];
        if width == 0 {
            return Vec::new();
        }
        let cells = inflation.reach / self.cells.edge;
        let reach = cells as usize;
        let in_row: Vec<u32> = self.states.par_chunks(width).flat_map_iter(|row| squares_in_row(row, reach)).collect();
        let of_square: Vec<i8> = (0..=(cells * cells) as usize).map(|square| inflation.cost((square as f64).sqrt() * self.cells.edge)).collect();
        let cost_of = |k: usize, square: u32| {
            let near = of_square.get(square as usize).copied().unwrap_or(0);
            match self.states[k] {
                State::Unknown => {
                    if near >= TOUCHES {
                        near
                    } else {
                        UNKNOWN
                    }
                }
                _ => near.max(self.costs[k].min(FREE as u8) as i8),
            }
        };
        let mut costs = vec![UNKNOWN; self.states.len()];
        costs.par_chunks_mut(width).enumerate().for_each(|(y, costs)| {
            let mut nearest = vec![u32::MAX; width];
            let rows = y.saturating_sub(reach)..=(y + reach).min(self.cells.size[1] - 1);
            for row in rows {
                let down = (row.abs_diff(y) * row.abs_diff(y)) as u32;
                for (nearest, square) in nearest.iter_mut().zip(&in_row[row * width..][..width]) {
                    *nearest = (*nearest).min(square.saturating_add(down));
                }
            }
            for (x, (cost, square)) in costs.iter_mut().zip(nearest).enumerate() {
                *cost = cost_of(y * width + x, square);
            }
        });
        costs
    }
}

/// Of each cell of a row, the squared distance in cells to the nearest obstacle of that row; the largest number if that is farther than `reach`.
fn squares_in_row(row: &[State], reach: usize) -> Vec<u32> {
    let mut steps = vec![usize::MAX; row.len()];
    let mut pass = |cells: &mut dyn Iterator<Item = usize>| {
        let mut since = usize::MAX;
        for k in cells {
            since = if row[k] == State::Occupied { 0 } else { since.saturating_add(1) };
            steps[k] = steps[k].min(since);
        }
    };
    pass(&mut (0..row.len()));
    pass(&mut (0..row.len()).rev());
    steps.into_iter().map(|steps| if steps <= reach { (steps * steps) as u32 } else { u32::MAX }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::Cells;
    use proptest::prelude::*;

    /// By looking at all obstacles from each cell.
    fn slow(grid: &Grid, inflation: &Inflation) -> Vec<i8> {
        let centres: Vec<[f64; 2]> = (0..grid.cells.count()).map(|k| [k % grid.cells.size[0], k / grid.cells.size[0]].map(|c| c as f64)).collect();
        let distance = |a: [f64; 2], b: [f64; 2]| grid.cells.edge * (a[0] - b[0]).hypot(a[1] - b[1]);
        let cost = |k: usize| {
            let obstacles = (0..centres.len()).filter(|other| grid.states[*other] == State::Occupied);
            let nearest = obstacles.map(|other| distance(centres[k], centres[other])).min_by(f64::total_cmp);
            let near = nearest.map_or(0, |nearest| inflation.cost(nearest));
            match grid.states[k] {
                State::Unknown if near < TOUCHES => UNKNOWN,
                State::Unknown => near,
                _ => near.max(grid.costs[k] as i8),
            }
        };
        (0..centres.len()).map(cost).collect()
    }

    proptest! {
        #[test]
        fn costs_are_those_of_the_nearest_obstacle(
            size in [1..40usize, 1..30usize],
            radius in 0.0..0.5f64,
            more in 0.0..1.0f64,
            obstacles in 0..6u32,
            seed in any::<u64>(),
        ) {
            let mut state = seed | 1;
            let mut random = |below: u32| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                ((state >> 33) % u64::from(below)) as u32
            };
            let cells = Cells { edge: 0.1, low: [-3, 4], size };
            let states = (0..cells.count()).map(|_| match random(60) {
                k if k < obstacles => State::Occupied,
                k if k < 20 => State::Unknown,
                _ => State::Free,
            });
            let grid = Grid { cells, states: states.collect(), costs: (0..cells.count()).map(|_| random(40) as u8).collect() };
            let inflation = Inflation { radius, reach: radius + more, falloff: 2.0 };
            prop_assert_eq!(grid.inflated(&inflation), slow(&grid, &inflation));
        }
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let usual = Inflation::default();
        assert!(usual.check().is_ok());
        for bad in [Inflation { radius: -0.1, ..usual }, Inflation { reach: 0.2, ..usual }, Inflation { falloff: f64::NAN, ..usual }] {
            assert!(matches!(bad.check(), Err(GroundError::Robot { .. })), "{bad:?}");
        }
    }
}
