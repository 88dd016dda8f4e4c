//! The 2-D map of the storey that the robot is on, and what has changed in it.

use crate::ros::messages::{Grid, GridPart};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;
use voxelastic_ground::{Body, Ground, GroundError, GroundTiles, TilesCopy};

/// Longest side, cells; beyond it, cells are twice, four times, .. as large.
const MOST_CELLS: f64 = 4000.0;
/// It ends at multiples of this many cells, so that its origin seldom moves as it grows. What has changed is told by squares of so many.
const BLOCK: usize = 128;
/// With more parts than this, one around them all is told.
const MOST_PARTS: usize = 16;
/// Without a floor, obstacles are those in this layer, metres above the sensor.
const SENSOR_LAYER: [f64; 2] = [-0.2, 0.3];

/// What the 2-D map is made for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GridSettings {
    /// Edge of a cell, metres; `None`: the finest voxel of the map.
    pub resolution: Option<f64>,
    /// The robot.
    pub body: Body,
}

impl GridSettings {
    /// As parameters of a node; the edge of a cell is `finest` metres unless it is set.
    pub fn pairs(&self, finest: f64) -> [(&'static str, f64); 4] {
        let resolution = self.resolution.unwrap_or_else(|| decimal(finest));
        [("grid_resolution", resolution), ("body_height", self.body.height), ("step", self.body.step), ("slope", self.body.slope.to_degrees())]
    }

    /// Checks the numbers for a map with finest voxels of `finest` metres.
    ///
    /// # Errors
    /// [`GroundError::Resolution`]; [`GroundError::Robot`].
    pub fn check(&self, finest: f64) -> Result<(), GroundError> {
        self.body.check()?;
        self.resolution.map_or(Ok(()), |resolution| GroundTiles::new(resolution, finest).map(drop))
    }

    /// Edge of a cell for a map, metres.
    pub fn resolution(&self, atlas: &Atlas) -> f64 {
        let mut resolution = self.resolution.unwrap_or_else(|| decimal(f64::from(atlas.voxel_size())));
        let size = AtlasQuery::new(atlas).bounds().size();
        while f64::from(size[0].max(size[1])) > MOST_CELLS * resolution {
            resolution *= 2.0;
        }
        resolution
    }
}

/// The decimal number that a setting was, not the float that it became.
fn decimal(voxel: f64) -> f64 {
    (voxel as f32).to_string().parse().unwrap_or(voxel)
}

/// A 2-D map in the map frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FloorPlan {
    resolution: f64,
    width: usize,
    origin: [f64; 3],
    cells: Vec<i8>,
}

/// A rectangle of cells of a 2-D map.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanPart {
    /// Its first cell.
    low: [usize; 2],
    width: usize,
    cells: Vec<i8>,
}

impl PlanPart {
    /// As the content of a message.
    pub fn as_message(&self) -> GridPart<'_> {
        GridPart { low: self.low, width: self.width, cells: &self.cells }
    }
}

impl FloorPlan {
    /// The 2-D map of the storey below `robot`, where the sensor is in the map frame, metres.
    ///
    /// # Errors
    /// As of [`Ground::of_tiles`], but where there is no floor.
    pub fn of(tiles: TilesCopy, body: &Body, robot: [f64; 3]) -> Result<Self, GroundError> {
        let (grid, height) = match Ground::of_tiles(tiles.clone(), body) {
            // As at the beginning: obstacles at the height of the sensor. Nothing is free, as nobody knows what a robot would stand on.
            Err(GroundError::NoFloor { .. }) => (tiles.obstacles_between(SENSOR_LAYER.map(|z| robot[2] + z))?, robot[2] + SENSOR_LAYER[0]),
            ground => {
                let ground = ground?;
                let storey = &ground.storeys()[ground.storey_below(robot).unwrap_or(0)];
                (ground.grid(storey), storey.height)
            }
        };
        let grid = grid.padded(BLOCK as i32);
        let cell = |state: &State| match state {
            State::Free => 0,
            State::Occupied => 100,
            State::Unknown => -1,
        };
        let [x, y] = grid.cells.origin();
        let (resolution, width) = (grid.cells.edge, grid.cells.size[0]);
        Ok(Self { resolution, width, origin: [x, y, height], cells: grid.states.iter().map(cell).collect() })
    }

    /// As the content of a message.
    pub fn as_message(&self) -> Grid<'_> {
        Grid { resolution: self.resolution, width: self.width, origin: self.origin, cells: &self.cells }
    }

    /// Whether both have the same cells; their heights may differ.
    fn has_cells_of(&self, other: &Self) -> bool {
        let place = |plan: &Self| ([plan.resolution, plan.origin[0], plan.origin[1]], plan.width, plan.cells.len());
        place(self) == place(other)
    }

    /// Rectangles that contain all cells that differ from those of another; none if the whole must be told: it is not of the same size at the same place.
    pub fn parts_since(&self, before: &Self) -> Option<Vec<PlanPart>> {
        if !self.has_cells_of(before) || self.width == 0 {
            return None;
        }
        let rows = self.cells.len() / self.width;
        let squares = (0..rows).step_by(BLOCK).flat_map(|y| (0..self.width).step_by(BLOCK).map(move |x| [x, y]));
        let around = |[x, y]: [usize; 2]| {
            let (columns, rows) = (x..(x + BLOCK).min(self.width), y..(y + BLOCK).min(rows));
            let changed = rows.flat_map(|y| columns.clone().map(move |x| [x, y])).filter(|[x, y]| {
                let k = y * self.width + x;
                self.cells[k] != before.cells[k]
            });
            changed.fold(None, |found: Option<[[usize; 2]; 2]>, at| {
                let [low, high] = found.unwrap_or([at, at]);
                Some([[0, 1].map(|k| low[k].min(at[k])), [0, 1].map(|k| high[k].max(at[k]))])
            })
        };
        let mut found: Vec<[[usize; 2]; 2]> = squares.filter_map(around).collect();
        if found.len() > MOST_PARTS {
            let all = found.into_iter().reduce(|[low, high], [l, h]| [[0, 1].map(|k| low[k].min(l[k])), [0, 1].map(|k| high[k].max(h[k]))]);
            found = all.into_iter().collect();
        }
        Some(found.into_iter().map(|[low, high]| self.part(low, high)).collect())
    }

    fn part(&self, low: [usize; 2], high: [usize; 2]) -> PlanPart {
        let cells = (low[1]..=high[1]).flat_map(|y| self.cells[y * self.width + low[0]..=y * self.width + high[0]].iter().copied());
        PlanPart { low, width: high[0] - low[0] + 1, cells: cells.collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(width: usize, cells: Vec<i8>) -> FloorPlan {
        FloorPlan { resolution: 0.1, width, origin: [0.0; 3], cells }
    }

    /// Changes at random places of random plans, few and many, in one corner or all over.
    #[test]
    fn parts_lead_from_one_plan_to_the_next() {
        let mut state = 7u64;
        let mut random = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        for case in 0..200 {
            let size = [1 + random(700), 1 + random(600)];
            let before = plan(size[0], (0..size[0] * size[1]).map(|_| random(3) as i8 - 1).collect());
            let mut after = before.clone();
            let within = if case % 2 == 0 { size } else { size.map(|n| n.min(40)) };
            for _ in 0..random(60) {
                let at = random(within[0]) + size[0] * random(within[1]);
                after.cells[at] = 100;
            }
            let parts = after.parts_since(&before).unwrap();
            assert!(parts.len() <= MOST_PARTS);
            let mut applied = before.clone();
            for part in &parts {
                for (k, cell) in part.cells.iter().enumerate() {
                    applied.cells[(part.low[1] + k / part.width) * size[0] + part.low[0] + k % part.width] = *cell;
                }
            }
            assert_eq!(applied, after);
            assert_eq!(parts.is_empty(), before == after);
            assert_eq!(plan(size[0], vec![0; size[0] * (size[1] + 1)]).parts_since(&before), None, "of another size");
        }
    }
}
