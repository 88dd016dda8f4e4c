//! The space that a robot could know: what is connected with its start and empty, in the box that it explores.

use crate::World;
use crate::random::Stream;
use rayon::prelude::*;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;

/// A place in the map frame, metres.
type Point = [f64; 3];

/// Edge of a cell, metres.
const CELL: f64 = 0.4;
/// A cell is empty if its centre is farther from every surface than this, metres: gaps that are narrower than twice as much are closed.
const CLEAR: f64 = 0.25;
/// So many cells at most are compared with a map, evenly taken from all: a square kilometre has 20 million.
const COMPARED: usize = 1 << 20;

/// Cells of empty space that are connected with the start.
#[derive(Clone, Debug)]
pub struct ReachableSpace {
    cells: usize,
    /// Centres of the cells that are compared with a map.
    compared: Vec<Point>,
}

impl ReachableSpace {
    /// The cells with centres in the box with the corners `bounds`, map frame.
    pub fn new(world: &World, start: Point, bounds: [Point; 2]) -> Self {
        Self::comparing(world, start, bounds, COMPARED)
    }

    /// As [`new`](Self::new), with at most about `most` cells that are compared with a map.
    fn comparing(world: &World, start: Point, [low, high]: [Point; 2], most: usize) -> Self {
        // As many as have their centres in the box.
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]) / CELL + 0.5).floor().max(1.0) as usize);
        let centre = |c: [usize; 3]| -> Point { std::array::from_fn(|k| low[k] + (c[k] as f64 + 0.5) * CELL) };
        let of_index = |i: usize| [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
        let empty: Vec<bool> =
            (0..size.iter().product()).into_par_iter().with_min_len(1024).map(|i| world.distance(centre(of_index(i))) > CLEAR).collect();
        let index = |c: [usize; 3]| c[0] + size[0] * (c[1] + size[1] * c[2]);
        let first = [0, 1, 2].map(|k| (((start[k] - low[k]) / CELL).max(0.0) as usize).min(size[k] - 1));
        let mut reached = vec![false; empty.len()];
        let mut stack = Vec::new();
        if empty[index(first)] {
            reached[index(first)] = true;
            stack.push(first);
        }
        while let Some(cell) = stack.pop() {
            for axis in 0..3 {
                for step in [-1isize, 1] {
                    let mut next = cell;
                    let Some(c) = cell[axis].checked_add_signed(step).filter(|c| *c < size[axis]) else { continue };
                    next[axis] = c;
                    if empty[index(next)] && !std::mem::replace(&mut reached[index(next)], true) {
                        stack.push(next);
                    }
                }
            }
        }
        let cells = reached.iter().filter(|reached| **reached).count();
        // One of each group of cells, at random: one in so many would be in line with streets and walls.
        let group = cells.div_ceil(most.max(1)).max(1);
        let mut random = Stream::new(0, &[group as u64]);
        let (mut taken, mut compared) = (0, Vec::with_capacity(cells.div_ceil(group)));
        for (k, i) in (0..empty.len()).filter(|i| reached[*i]).enumerate() {
            if k % group == 0 {
                taken = k + random.index(group.min(cells - k));
            }
            if k == taken {
                compared.push(centre(of_index(i)));
            }
        }
        Self { cells, compared }
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.cells
    }

    /// Volume, cubic metres.
    pub fn volume(&self) -> f64 {
        self.cells as f64 * CELL.powi(3)
    }

    /// Share of the cells whose centres a map knows, as free or as occupied; of a million of them in larger spaces.
    pub fn known_share(&self, map: &AtlasQuery<'_>) -> f64 {
        let known = map.states(&self.compared).into_iter().filter(|state| *state != State::Unknown).count();
        known as f64 / self.compared.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};

    #[test]
    fn what_lies_behind_a_wall_that_the_box_does_not_lead_over_is_no_part_of_it() {
        let mut b = crate::WorldBuilder::new("two yards", 1);
        b.ground(0.0, 0.3);
        // Cells are in layers at 1.1, 1.5, 1.9 and 2.3 m; a fifth layer at 2.7 m would be above the box, and lead over the wall.
        b.cuboid([-0.2, -20.0, -0.5], [0.2, 20.0, 2.2], 0.5);
        let world = b.build().unwrap();
        let volume = |top: f64| ReachableSpace::new(&world, [-5.0, 0.0, 1.6], [[-10.0, -10.0, 0.9], [10.0, 10.0, top]]).volume();
        let layer = 10.0 * 20.0 * CELL;
        let [one_side, both] = [2.6, 3.4].map(volume);
        assert!((0.9..1.01).contains(&(one_side / (4.0 * layer))), "{one_side} m3");
        assert!(both > 2.0 * one_side, "{both} m3");
    }

    #[test]
    fn some_of_the_cells_tell_nearly_the_same_share_as_all() {
        let options = crate::SimOptions { scans: Some(6), columns: Some(256), ..crate::SimOptions::of("maze") };
        let settings = Settings { voxel_size: 0.2, field: FieldKind::Occupancy, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let simulated = crate::Simulation::new(options).unwrap();
        simulated.scans(crate::PoseSource::Truth).for_each(|scan| {
            mapper.handle(Event::Scan(scan)).unwrap();
        });
        let Scene { world, trajectory, .. } = Scene::named("maze", 1).unwrap();
        let start: Point = trajectory.pose(0.0).translation.vector.into();
        let bounds = [[start[0] - 6.0, start[1] - 6.0, 0.0], [start[0] + 6.0, start[1] + 6.0, 2.8]];
        let spaces = [usize::MAX, 2000].map(|most| ReachableSpace::comparing(&world, start, bounds, most));
        assert_eq!(spaces[0].compared.len(), spaces[0].cells());
        assert!(spaces[1].compared.len() <= 2000 && spaces[1].compared.len() > 1000 && spaces[1].cells() == spaces[0].cells());
        let map = mapper.atlas().query().unwrap();
        let shares = spaces.map(|space| space.known_share(&map));
        // Four standard deviations of a sample of a thousand at random.
        assert!((0.1..0.9).contains(&shares[0]) && (shares[0] - shares[1]).abs() < 0.06, "{shares:?}");
    }
}
