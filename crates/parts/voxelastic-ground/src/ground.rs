//! The ground of a map: its storeys, each with its floor, and where they connect.

use crate::columns::Columns;
use crate::connections::{Connection, connections};
use crate::floor_cell::Known;
use crate::follow::{levels_below, reached};
use crate::grid::Grid;
use crate::storey::Storey;
use crate::storeys::storeys;
use crate::tiles::{GroundTiles, TilesCopy};
use crate::{Body, GroundError};
use std::time::Duration;
use voxelastic::atlas::Atlas;
use voxelastic::query::AtlasQuery;

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
    /// [`GroundError::NoOccupancy`]; [`GroundError::Resolution`]; [`GroundError::TooLarge`] for a grid of more than 400 million cells, or 65,535 voxels high; [`GroundError::Robot`];
    /// [`GroundError::NoFloor`].
    pub fn of(atlas: &Atlas, resolution: f64, body: &Body) -> Result<Self, GroundError> {
        body.check()?;
        if AtlasQuery::new(atlas).is_empty() {
            return Err(GroundError::NoOccupancy);
        }
        let mut tiles = GroundTiles::new(resolution, AtlasQuery::new(atlas).voxel_size())?;
        tiles.note(atlas)?;
        tiles.make(atlas, [0.0; 2], Duration::MAX)?;
        Self::of_tiles(tiles.into_copy(atlas), body)
    }

    /// The same of tiles that were made before.
    ///
    /// # Errors
    /// [`GroundError::NoOccupancy`] if nothing is known in the tiles; [`GroundError::TooLarge`]; [`GroundError::Robot`]; [`GroundError::NoFloor`].
    pub fn of_tiles(tiles: TilesCopy, body: &Body) -> Result<Self, GroundError> {
        body.check()?;
        let places = tiles.places.clone();
        let (columns, levels) = tiles.joined()?;
        let cells = *columns.cells();
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
