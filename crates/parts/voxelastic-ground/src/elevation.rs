//! The floor of a storey as layers of numbers: elevation, and what it takes to drive on it.

use crate::cells::Cells;
use crate::floor_cell::{FloorCell, Known};
use crate::grid::Grid;
use crate::slope::Plane;
use crate::storey::Storey;
use rayon::prelude::*;
use voxelastic::field::occupancy::State;

/// Names of the layers, in their order.
pub const LAYERS: [&str; 7] = ["elevation", "sigma", "slope", "roughness", "step", "headroom", "traversability"];
/// A step is the difference of heights within this distance, metres.
const STRIDE: f64 = 0.125;

/// Layers of a storey, each with a number for each cell in the order of [`Cells::index`]; NaN where it is not known.
#[derive(Clone, Debug)]
pub struct Elevation {
    /// The cells.
    pub cells: Cells,
    /// See [`LAYERS`]: height of the floor in the map frame and its standard deviation (metres), slope (radians), root mean square of the heights around it off their plane
    /// (metres), largest difference of heights within an eighth of a metre (metres), room above the floor (metres; infinite under the sky), and traversability: 1 where the
    /// floor takes nothing of what the robot climbs, 0 where the robot cannot be.
    pub layers: [Vec<f32>; 7],
}

impl Elevation {
    /// The layers of a storey and its 2-D map, for a robot whose footprint is a disc of `radius` metres around its middle.
    pub fn of(storey: &Storey, grid: &Grid, radius: f64) -> Self {
        let (cells, floor) = (storey.cells, &storey.floor);
        let all = |value: &(dyn Fn(usize) -> f32 + Sync)| -> Vec<f32> { (0..cells.count()).into_par_iter().map(value).collect() };
        let seen = |cell: usize| floor[cell].known == Known::Seen;
        let is_floor = |cell: usize| matches!(floor[cell].known, Known::Seen | Known::Between);
        let of_floor = |value: &(dyn Fn(&FloorCell) -> f32 + Sync)| all(&|cell| if is_floor(cell) { value(&floor[cell]) } else { f32::NAN });
        let planes: Vec<Option<Plane>> = (0..cells.count()).into_par_iter().map(|cell| if seen(cell) { Plane::around(&cells, floor, cell) } else { None }).collect();
        let of_plane = |value: &(dyn Fn(&Plane) -> f64 + Sync)| all(&|cell| planes[cell].as_ref().map_or(f32::NAN, |plane| value(plane) as f32));
        let stride = disc(&cells, STRIDE);
        let step = |cell: usize| {
            let others = stride.iter().filter_map(|by| cells.beside(cell, *by)).filter(|at| seen(*at));
            if seen(cell) { others.map(|at| (floor[at].height - floor[cell].height).abs()).fold(0.0, f32::max) } else { f32::NAN }
        };
        let footprint = disc(&cells, radius);
        let traversability = |cell: usize| match grid.states[cell] {
            State::Unknown => f32::NAN,
            State::Occupied => 0.0,
            State::Free => {
                let under = || footprint.iter().filter_map(|by| cells.beside(cell, *by));
                let is_blocked = under().any(|at| grid.states[at] == State::Occupied);
                let hardest = under().filter(|at| is_floor(*at)).map(|at| floor[at].difficulty).fold(floor[cell].difficulty, f32::max);
                if is_blocked { 0.0 } else { 1.0 - hardest.clamp(0.0, 1.0) }
            }
        };
        let layers = [
            of_floor(&|cell| cell.height),
            of_floor(&|cell| cell.sigma),
            of_plane(&Plane::slope),
            of_plane(&|plane| plane.roughness),
            all(&step),
            of_floor(&|cell| cell.headroom),
            all(&traversability),
        ];
        Self { cells, layers }
    }
}

/// Offsets of the cells whose middles are no farther than `radius` metres.
fn disc(cells: &Cells, radius: f64) -> Vec<[i32; 2]> {
    let reach = (radius / cells.edge).floor() as i32;
    let all = (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| [x, y]));
    all.filter(|c| f64::from(c[0] * c[0] + c[1] * c[1]).sqrt() * cells.edge <= radius && *c != [0, 0]).collect()
}
