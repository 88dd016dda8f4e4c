//! The ground of a map: its storeys, each with its floor, and where they connect.

use crate::columns::Columns;
use crate::connections::{Connection, connections};
use crate::floor_cell::Known;
use crate::follow::{levels_below, reached};
use crate::grid::Grid;
use crate::levels::Levels;
use crate::storey::Storey;
use crate::storeys::storeys;
use crate::{Body, GroundError};
use voxelastic::atlas::{Atlas, Submap, SubmapScan};
use voxelastic::query::DistanceQuery;

/// The ground of a map.
#[derive(Clone, Debug)]
pub struct Ground {
    columns: Columns,
    storeys: Vec<Storey>,
    connections: Vec<Connection>,
    body: Body,
}

impl Ground {
    /// The ground of `atlas` for a robot, in cells of `resolution` metres, as far as it is connected with what is below the places where scans were taken.
    ///
    /// Heights are those of surfaces where the map has them, and else the middle of voxels.
    ///
    /// # Errors
    /// As [`Columns::of`]; [`GroundError::Robot`]; [`GroundError::NoFloor`].
    pub fn of(atlas: &Atlas, resolution: f64, body: &Body) -> Result<Self, GroundError> {
        body.check()?;
        let columns = Columns::of(&atlas.query(), resolution)?;
        let levels = Levels::of(&columns, &DistanceQuery::new(atlas));
        let cells = *columns.cells();
        let places = scan_places(atlas);
        let seeds: Vec<usize> = levels_below(&levels, &cells, &places).into_iter().flatten().collect();
        if seeds.is_empty() {
            return Err(GroundError::NoFloor { scans: places.len() });
        }
        let is_floor = reached(&levels, &cells, &seeds);
        let (of_level, count) = storeys(&levels, &cells, &is_floor, &seeds);
        let connections = connections(&levels, &cells, &of_level);
        let storeys: Vec<Storey> = (0..count).filter_map(|storey| Storey::new(&cells, &levels, &of_level, storey as u16, body)).collect();
        if storeys.is_empty() {
            return Err(GroundError::NoFloor { scans: places.len() });
        }
        Ok(Self { columns, storeys, connections, body: *body })
    }

    /// The storeys, from the lowest up.
    pub fn storeys(&self) -> &[Storey] {
        &self.storeys
    }

    /// Where the floor goes on from one storey to another.
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }

    /// The columns of the map.
    pub fn columns(&self) -> &Columns {
        &self.columns
    }

    /// The 2-D map of a storey.
    pub fn grid(&self, storey: &Storey) -> Grid {
        Grid::of(&self.columns, storey, &self.body)
    }

    /// The storey that a sensor at `p` (map frame, metres) is over: the one whose floor is nearest below it.
    pub fn storey_below(&self, p: [f64; 3]) -> Option<usize> {
        let depth = |storey: &Storey| {
            let cell = &storey.floor[storey.cells.at([p[0], p[1]])?];
            let depth = p[2] - f64::from(cell.height);
            (cell.known != Known::No && depth > -0.5).then_some(depth)
        };
        let depths = self.storeys.iter().enumerate().filter_map(|(k, storey)| Some((depth(storey)?, k)));
        depths.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, k)| k)
    }
}

/// Where the scans were taken, map frame.
fn scan_places(atlas: &Atlas) -> Vec<[f64; 3]> {
    let place = |submap: &Submap, scan: &SubmapScan| (submap.t_map_submap() * scan.t_submap_lidar).translation.vector.into();
    atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| place(submap, scan))).collect()
}
