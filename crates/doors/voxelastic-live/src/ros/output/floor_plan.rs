//! The 2-D map of the storey that the robot is on, and what has changed in it.

use crate::ros::messages::{self, GridPart};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::AtlasQuery;
use voxelastic_ground::{Body, Grid, Ground, GroundError, GroundTiles, Inflation, Storey, TilesCopy};

/// Longest side by itself, cells.
const MOST_CELLS: f64 = 4000.0;
/// It ends at multiples of this many cells, so that its origin seldom moves as it grows. What has changed is told by squares of so many.
const BLOCK: usize = 128;
/// With more parts than this, one around them all is told.
const MOST_PARTS: usize = 16;
/// Without a floor, obstacles are those in this layer, metres above the sensor.
const SENSOR_LAYER: [f64; 2] = [-0.2, 0.3];

/// Longest side of the local costmap, metres.
const LARGEST_COSTMAP: f64 = 60.0;

/// What the 2-D map and the costmaps are made for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridSettings {
    /// Edge of a cell, metres; `None`: the finest voxel of the map.
    pub resolution: Option<f64>,
    /// The robot.
    pub body: Body,
    /// How costs fall with the distance from obstacles.
    pub inflation: Inflation,
    /// Side of the local costmap, metres.
    pub costmap_size: f64,
    /// Longest side of the whole map, cells; beyond it, cells are twice, four times, .. as large.
    pub most_cells: f64,
}

impl Default for GridSettings {
    fn default() -> Self {
        Self { resolution: None, body: Body::default(), inflation: Inflation::default(), costmap_size: 10.0, most_cells: MOST_CELLS }
    }
}

impl GridSettings {
    /// As parameters of a node; the edge of a cell is `finest` metres unless it is set.
    pub fn pairs(&self, finest: f64) -> [(&'static str, f64); 8] {
        let Self { resolution, body, inflation, costmap_size, .. } = *self;
        [
            ("grid_resolution", resolution.unwrap_or_else(|| decimal(finest))),
            ("body_height", body.height),
            ("step", body.step),
            ("slope", body.slope.to_degrees()),
            ("footprint_radius", inflation.radius),
            ("inflation_radius", inflation.reach),
            ("cost_scaling", inflation.falloff),
            ("costmap_size", costmap_size),
        ]
    }

    /// Checks the numbers for a map with finest voxels of `finest` metres.
    ///
    /// # Errors
    /// [`GroundError::Resolution`]; [`GroundError::Robot`].
    pub fn check(&self, finest: f64) -> Result<(), GroundError> {
        self.body.check()?;
        self.inflation.check()?;
        if !(1.0..=LARGEST_COSTMAP).contains(&self.costmap_size) {
            return Err(GroundError::Robot { what: "size of its costmap", value: self.costmap_size, must: "1 to 60 m" });
        }
        self.resolution.map_or(Ok(()), |resolution| GroundTiles::new(resolution, finest).map(drop))
    }

    /// Edge of a cell for a map of any size, metres.
    pub fn finest_resolution(&self, atlas: &Atlas) -> f64 {
        self.resolution.unwrap_or_else(|| decimal(f64::from(atlas.voxel_size())))
    }

    /// Edge of a cell for all of a map, metres.
    pub fn resolution(&self, atlas: &Atlas) -> f64 {
        let mut resolution = self.finest_resolution(atlas);
        let size = AtlasQuery::new(atlas).bounds().size();
        while f64::from(size[0].max(size[1])) > self.most_cells * resolution {
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

/// The storey that the robot is on.
pub struct Surroundings {
    /// Its 2-D map.
    pub grid: Grid,
    /// Its floor; none if there is none yet.
    storey: Option<Storey>,
    /// Height of the floor, or of the lowest of what is taken for obstacles without one, map frame, metres.
    height: f64,
    /// Edge of the voxels that the floor was found in, metres.
    voxel: f64,
}

impl Surroundings {
    /// The storey below `robot`, where the sensor is in the map frame, metres.
    ///
    /// # Errors
    /// As of [`Ground::of_tiles`], but where there is no floor.
    pub fn of(tiles: TilesCopy, body: &Body, robot: [f64; 3]) -> Result<Self, GroundError> {
        match Ground::of_tiles(tiles.clone(), body) {
            // As at the beginning: obstacles at the height of the sensor. Nothing is free, as nobody knows what a robot would stand on.
            Err(GroundError::NoFloor { .. }) => {
                let grid = tiles.obstacles_between(SENSOR_LAYER.map(|z| robot[2] + z))?;
                Ok(Self { grid, storey: None, height: robot[2] + SENSOR_LAYER[0], voxel: 0.0 })
            }
            ground => {
                let ground = ground?;
                let storey = ground.storeys()[ground.storey_below(robot).unwrap_or(0)].clone();
                Ok(Self { grid: ground.grid(&storey), height: storey.height, voxel: ground.columns().voxel(), storey: Some(storey) })
            }
        }
    }

    /// Marks what a scan has just seen in the robot's way; `returns` in the map frame, metres.
    pub fn mark(&mut self, body: &Body, returns: &[[f64; 3]]) {
        match &self.storey {
            Some(storey) => self.grid.mark(storey, body, self.voxel, returns),
            None => {
                let layer = self.height..self.height + SENSOR_LAYER[1] - SENSOR_LAYER[0];
                for p in returns.iter().filter(|p| layer.contains(&p[2])) {
                    self.grid.cells.at([p[0], p[1]]).into_iter().for_each(|cell| self.grid.states[cell] = State::Occupied);
                }
            }
        }
    }

    /// The 2-D map as it is published.
    pub fn plan(&self) -> FloorPlan {
        let cell = |state: &State| match state {
            State::Free => 0,
            State::Occupied => 100,
            State::Unknown => -1,
        };
        self.plan_of(self.grid.states.iter().map(cell).collect())
    }

    /// Its costs.
    pub fn costs(&self, inflation: &Inflation) -> FloorPlan {
        self.plan_of(self.grid.inflated(inflation))
    }

    fn plan_of(&self, cells: Vec<i8>) -> FloorPlan {
        let [x, y] = self.grid.cells.origin();
        FloorPlan { resolution: self.grid.cells.edge, width: self.grid.cells.size[0], origin: [x, y, self.height], cells }
    }
}

impl FloorPlan {
    /// The 2-D map of the storey below `robot`, where the sensor is in the map frame, metres, and its costs if asked for.
    ///
    /// # Errors
    /// As of [`Surroundings::of`].
    pub fn of(tiles: TilesCopy, body: &Body, robot: [f64; 3], inflation: Option<&Inflation>) -> Result<(Self, Option<Self>), GroundError> {
        let mut all = Surroundings::of(tiles, body, robot)?;
        all.grid = all.grid.padded(BLOCK as i32);
        Ok((all.plan(), inflation.map(|inflation| all.costs(inflation))))
    }

    /// Number of cells.
    pub fn count(&self) -> usize {
        self.cells.len()
    }

    /// Without the outermost `margin` cells; what is left has a size along x and y.
    pub fn without_margin(&self, margin: usize) -> Self {
        let rows = self.cells.chunks(self.width.max(1));
        let count = rows.len().saturating_sub(2 * margin);
        let width = self.width.saturating_sub(2 * margin);
        let cells = rows.skip(margin).take(count).flat_map(|row| row[margin..][..width].iter().copied()).collect();
        let [x, y] = [0, 1].map(|k| self.origin[k] + margin as f64 * self.resolution);
        Self { width, origin: [x, y, self.origin[2]], cells, ..*self }
    }

    /// As the content of a message.
    pub fn as_message(&self) -> messages::Grid<'_> {
        messages::Grid { resolution: self.resolution, width: self.width, origin: self.origin, cells: &self.cells }
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
