//! The columns and levels of a map that changes, in tiles of its grid: only those that are out of date are made again.

use crate::GroundError;
use crate::changes::{Box3, Looked};
use crate::columns::{Bounds, Columns, Lattice, MOST_CELLS};
use crate::grid::Grid;
use crate::levels::Levels;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::atlas::{Atlas, Submap, SubmapScan};
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, Cube, DistanceQuery, Resampling};

/// log2 of the edge of a tile in cells, for all of a map, and for what is near a robot: there most of a large tile would be made in vain, with each scan.
const SHIFT: u32 = 6;
const NEAR_SHIFT: u32 = 4;
/// Tiles that are made before the time is looked at.
const AT_ONCE: usize = 16;
/// [`Cube::corner`] of a cube at the origin, and beyond the last.
const ORIGIN: i32 = 1 << 20;

/// What an atlas knows above and below each cell of a grid, tile by tile, for [`Ground::of_tiles`](crate::Ground::of_tiles). However the map came to be, the tiles are those that
/// a map of that state has when all are made at once.
#[derive(Clone, Debug)]
pub struct GroundTiles {
    lattice: Lattice,
    looked: Looked,
    /// By y and x.
    stale: BTreeSet<[i32; 2]>,
    tiles: BTreeMap<[i32; 2], Arc<Tile>>,
}

/// A tile in which something is known.
#[derive(Debug)]
pub(crate) struct Tile {
    /// Of what is known, in cubes.
    pub bounds: Bounds,
    pub columns: Columns,
    pub levels: Levels,
}

/// A copy of the tiles of a map, and where its scans were taken: cheap, as tiles are shared.
#[derive(Clone, Debug)]
pub struct TilesCopy {
    pub(crate) lattice: Lattice,
    /// By y and x.
    pub(crate) tiles: Vec<Arc<Tile>>,
    /// Map frame.
    pub(crate) places: Vec<[f64; 3]>,
}

impl GroundTiles {
    /// Of nothing yet, for cells of `resolution` metres over maps with finest voxels of `finest` metres.
    ///
    /// # Errors
    /// [`GroundError::Resolution`].
    pub fn new(resolution: f64, finest: f64) -> Result<Self, GroundError> {
        Self::with_tiles(resolution, finest, SHIFT)
    }

    /// The same in small tiles, for [`make_near`](Self::make_near).
    ///
    /// # Errors
    /// [`GroundError::Resolution`].
    pub fn near_robot(resolution: f64, finest: f64) -> Result<Self, GroundError> {
        Self::with_tiles(resolution, finest, NEAR_SHIFT)
    }

    fn with_tiles(resolution: f64, finest: f64, shift: u32) -> Result<Self, GroundError> {
        let lattice = Lattice::new(resolution, finest, shift)?;
        Ok(Self { lattice, looked: Looked::default(), stale: BTreeSet::new(), tiles: BTreeMap::new() })
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f64 {
        self.lattice.resolution
    }

    /// Finds out which tiles are out of date, after anything changed in the map, which must be the same as before.
    ///
    /// # Errors
    /// [`GroundError::NoOccupancy`]; [`GroundError::TooLarge`].
    pub fn note(&mut self, atlas: &Atlas) -> Result<(), GroundError> {
        let query = AtlasQuery::new(atlas);
        if query.is_empty() {
            return Err(GroundError::NoOccupancy);
        }
        let lattice = self.lattice;
        let size = query.bounds().size().map(|c| f64::from(c) / lattice.resolution);
        // The box around all may be larger than that around what is known in the map frame.
        if size[0] * size[1] > 4.0 * MOST_CELLS as f64 {
            return Err(GroundError::TooLarge { size: [0, 1].map(|k| size[k] as usize), high: (size[2] * lattice.side as f64) as usize });
        }
        let (stale, mut last) = (&mut self.stale, None);
        self.looked.look(atlas, |changed| {
            // Mostly the same as the last.
            let [low, high] = lattice.tiles_of(changed);
            if last.replace([low, high]) != Some([low, high]) {
                stale.extend((low[1]..=high[1]).flat_map(|y| (low[0]..=high[0]).map(move |x| [y, x])));
            }
        });
        Ok(())
    }

    /// Whether tiles are out of date.
    pub fn is_stale(&self) -> bool {
        !self.stale.is_empty()
    }

    /// Makes tiles that are out of date, those nearest to `focus` (metres, map frame) first, until all are made or the time is over; at least some. The map is that of the last
    /// [`note`](Self::note), or changed since by corrections of poses alone, which the next one finds.
    ///
    /// # Errors
    /// [`GroundError::TooLarge`].
    pub fn make(&mut self, atlas: &Atlas, focus: [f64; 2], time: Duration) -> Result<(), GroundError> {
        let begin = Instant::now();
        let tile = self.lattice.tile();
        let distance = |at: &[i32; 2]| (f64::from(at[1]) - focus[0] / tile + 0.5).hypot(f64::from(at[0]) - focus[1] / tile + 0.5);
        let mut order: Vec<[i32; 2]> = self.stale.iter().copied().collect();
        order.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then(a.cmp(b)));
        for some in order.chunks(if time == Duration::MAX { order.len().max(1) } else { AT_ONCE }) {
            self.make_some(atlas, some)?;
            if begin.elapsed() >= time {
                break;
            }
        }
        Ok(())
    }

    /// Makes those that are out of date within `reach` metres of `centre` to the sides (map frame), and gives up those that are far from there.
    ///
    /// # Errors
    /// [`GroundError::TooLarge`].
    pub fn make_near(&mut self, atlas: &Atlas, centre: [f64; 2], reach: f64) -> Result<(), GroundError> {
        let (near, far) = (self.lattice.tiles_within(centre, reach), self.lattice.tiles_within(centre, 4.0 * reach));
        self.stale.extend(self.tiles.keys().filter(|at| !is_within(&far, at)));
        self.tiles.retain(|at, _| is_within(&far, at));
        let rows = [near[0][1], i32::MIN]..=[near[1][1], i32::MAX];
        let some: Vec<[i32; 2]> = self.stale.range(rows).filter(|at| is_within(&near, at)).copied().collect();
        self.make_some(atlas, &some)
    }

    fn make_some(&mut self, atlas: &Atlas, some: &[[i32; 2]]) -> Result<(), GroundError> {
        let (query, surfaces) = (AtlasQuery::new(atlas), DistanceQuery::new(atlas));
        let made: Vec<Option<Tile>> = some.par_iter().map(|at| Tile::rough(&query, &self.lattice, *at)).collect::<Result<_, _>>()?;
        let mut made: Vec<([i32; 2], Option<Tile>)> = some.iter().copied().zip(made).collect();
        let mut parts: Vec<(&Columns, &mut Levels)> =
            made.iter_mut().filter_map(|(_, tile)| tile.as_mut()).map(|tile| (&tile.columns, &mut tile.levels)).collect();
        Levels::refine(&mut parts, &surfaces);
        for (at, tile) in made {
            self.stale.remove(&at);
            match tile {
                Some(tile) => drop(self.tiles.insert(at, Arc::new(tile))),
                None => drop(self.tiles.remove(&at)),
            }
        }
        Ok(())
    }

    /// The tiles as they are, also those that are out of date.
    pub fn copy(&self, atlas: &Atlas) -> TilesCopy {
        TilesCopy { lattice: self.lattice, tiles: self.tiles.values().cloned().collect(), places: scan_places(atlas) }
    }

    /// The tiles as they are within `reach` metres of `centre` to the sides, and the places of scans there.
    pub fn copy_near(&self, atlas: &Atlas, centre: [f64; 2], reach: f64) -> TilesCopy {
        let near = self.lattice.tiles_within(centre, reach);
        let tiles = self.tiles.iter().filter(|(at, _)| is_within(&near, at)).map(|(_, tile)| tile.clone()).collect();
        let mut places = scan_places(atlas);
        places.retain(|p| (0..2).all(|k| (p[k] - centre[k]).abs() <= reach));
        TilesCopy { lattice: self.lattice, tiles, places }
    }

    /// The tiles, without a copy that takes memory.
    pub(crate) fn into_copy(self, atlas: &Atlas) -> TilesCopy {
        TilesCopy { lattice: self.lattice, tiles: self.tiles.into_values().collect(), places: scan_places(atlas) }
    }
}

impl TilesCopy {
    /// Where something is between two heights, map frame, metres: such cells are occupied, and of the others nothing is said. For where no floor was found.
    ///
    /// # Errors
    /// [`GroundError::NoOccupancy`] if nothing is known in the tiles; [`GroundError::TooLarge`].
    pub fn obstacles_between(self, [low, high]: [f64; 2]) -> Result<Grid, GroundError> {
        let (columns, _) = self.joined()?;
        let is_occupied = |cell: usize| columns.spans(cell).any(|span| span.occupied && span.high > low && span.low < high);
        let cells = *columns.cells();
        let states = (0..cells.count()).map(|cell| if is_occupied(cell) { State::Occupied } else { State::Unknown }).collect();
        Ok(Grid { cells, states, costs: vec![0; cells.count()] })
    }

    /// The columns and levels of all tiles, which are dropped on the way.
    pub(crate) fn joined(self) -> Result<(Columns, Levels), GroundError> {
        let all = self.tiles.iter().map(|tile| tile.bounds).reduce(|all, bounds| all.with(&bounds));
        let (Some(all), side) = (all, self.lattice.side) else { return Err(GroundError::NoOccupancy) };
        let (cells, high) = (all.cells(self.lattice.resolution, side as i32), all.high[2] - all.low[2]);
        if cells.count() > MOST_CELLS / (side * side) || high > i32::from(u16::MAX) {
            return Err(GroundError::TooLarge { size: cells.size, high: high as usize });
        }
        let shift = self.lattice.shift;
        let (mut columns, mut levels) = (Columns::empty(cells, self.lattice.cube, all.low[2]), Levels::empty());
        let mut waiting = self.tiles.into_iter().peekable();
        // The tiles of a row of cells.
        let mut row: Vec<Arc<Tile>> = Vec::new();
        for y in (cells.low[1]..).take(cells.size[1]) {
            row.retain(|tile| tile.first_row() >> shift == y >> shift);
            while let Some(tile) = waiting.next_if(|tile| tile.first_row() <= y) {
                row.push(tile);
            }
            let mut part = 0;
            for x in (cells.low[0]..).take(cells.size[0]) {
                while row.get(part).is_some_and(|tile| tile.columns.cells().low[0] + (1 << shift) <= x) {
                    part += 1;
                }
                let cell = row.get(part).and_then(|tile| Some((&**tile, tile.columns.cells().index([x, y])?)));
                columns.push(cell.map(|(tile, cell)| (&tile.columns, cell)));
                levels.push(cell.map_or(&[], |(tile, cell)| &tile.levels.all()[tile.levels.of_cell(cell)]));
            }
        }
        Ok((columns, levels))
    }
}

impl Lattice {
    /// Edge of a tile, metres.
    fn tile(&self) -> f64 {
        f64::from(1 << self.shift) * self.resolution
    }

    /// The first and the last tile, x and y, that a box of the map frame touches.
    fn tiles_of(&self, [low, high]: Box3) -> [[i32; 2]; 2] {
        let tile = self.tile();
        // States are looked up at points within cubes; rounding may take one over its face.
        let at = |c: f64| ((c / tile).floor() as i32).clamp(-ORIGIN, ORIGIN);
        [[0, 1].map(|k| at(low[k] - self.cube)), [0, 1].map(|k| at(high[k] + self.cube))]
    }

    /// The first and the last tile, x and y, within `reach` metres of a point to the sides.
    fn tiles_within(&self, [x, y]: [f64; 2], reach: f64) -> [[i32; 2]; 2] {
        self.tiles_of([[x - reach, y - reach, 0.0], [x + reach, y + reach, 0.0]])
    }
}

/// Whether a tile, by y and x, is among those from the first to the last, by x and y.
fn is_within([low, high]: &[[i32; 2]; 2], at: &[i32; 2]) -> bool {
    (low[0]..=high[0]).contains(&at[1]) && (low[1]..=high[1]).contains(&at[0])
}

impl Tile {
    /// Its first row of cells.
    fn first_row(&self) -> i32 {
        self.columns.cells().low[1]
    }

    /// With heights that are those of voxels.
    fn rough(query: &AtlasQuery<'_>, lattice: &Lattice, [y, x]: [i32; 2]) -> Result<Option<Self>, GroundError> {
        let to = Resampling { voxel: lattice.cube, states_only: true };
        let (side, shift) = (lattice.side as i32, lattice.shift);
        let bounds = query.bounds();
        let [lowest, highest] = [bounds.min[2], bounds.max[2]].map(|z| (f64::from(z) / lattice.cube).floor());
        // Beyond that the map ends.
        let [lowest, highest] = [lowest - 1.0, highest + 1.0].map(|z| (z as i32).clamp(-ORIGIN, ORIGIN - 1) >> shift);
        let mut cubes: Vec<Cube> = Vec::new();
        for k in 0..side * side {
            let corner = [x * side + k % side, y * side + k / side].map(|c| c << shift);
            for z in lowest..=highest {
                let corner = [corner[0], corner[1], z << shift];
                if corner.iter().all(|c| (-ORIGIN..ORIGIN).contains(c)) {
                    cubes.extend(query.resample_cube(&to, corner.map(|c| (c + ORIGIN) as u32), shift));
                }
            }
        }
        let Some(bounds) = Bounds::of(&cubes) else { return Ok(None) };
        let columns = Columns::of_part(cubes, lattice, ([x, y].map(|c| c << shift), 1 << shift), &bounds)?;
        let levels = Levels::rough(&columns);
        Ok(Some(Self { bounds, columns, levels }))
    }
}

/// Where the scans were taken, map frame.
fn scan_places(atlas: &Atlas) -> Vec<[f64; 3]> {
    let place = |submap: &Submap, scan: &SubmapScan| (submap.t_map_submap() * scan.t_submap_lidar).translation.vector.into();
    atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| place(submap, scan))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Body, Ground};
    use proptest::prelude::*;
    use voxelastic::event::{Edge, Event, Scan};
    use voxelastic::settings::{FieldKind, Settings};
    use voxelastic::{Mapper, Pose};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    /// What may happen between two looks at a map: scans, some of its poses corrected, a loop that is closed.
    #[derive(Clone, Debug)]
    enum Step {
        Scans(usize),
        Correct(u64, [f64; 3]),
        Close(u64, u64),
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            3 => (1..4usize).prop_map(Step::Scans),
            2 => (2..9u64, prop::array::uniform3(-0.6..0.6f64)).prop_map(|(every, by)| Step::Correct(every, by)),
            1 => (any::<u64>(), any::<u64>()).prop_map(|(a, b)| Step::Close(a, b)),
        ]
    }

    fn take(mapper: &mut Mapper, scans: &mut impl Iterator<Item = Scan>, step: &Step) {
        let count = mapper.atlas().scan_count() as u64;
        match *step {
            Step::Scans(count) => {
                for scan in scans.take(count) {
                    mapper.handle(Event::Scan(scan)).unwrap();
                }
            }
            Step::Correct(every, [x, y, turn]) => {
                let by = Pose::new([x, y, 0.1 * x].into(), [0.0, 0.0, 0.1 * turn].into());
                let moved = (0..count).filter(|node| node % every > 0).map(|node| (node, by * mapper.pose(node).unwrap())).collect();
                mapper.handle(Event::PoseUpdate(moved)).unwrap();
            }
            Step::Close(a, b) if count > 1 && a % count != b % count => {
                let [from, to] = [a % count, b % count].map(|node| node.min(count - 1));
                let t_from_to = mapper.pose(from).unwrap().inverse() * mapper.pose(to).unwrap();
                mapper.handle(Event::LoopEdge(Edge { from, to, t_from_to, information: None })).unwrap();
            }
            Step::Close(..) => {}
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn a_ground_that_is_kept_up_is_that_of_the_whole_map(steps in prop::collection::vec(step(), 3..9), coarse in any::<bool>(), both in any::<bool>()) {
            let field = if both { FieldKind::Both } else { FieldKind::Occupancy };
            let settings = Settings { voxel_size: 0.2, max_range: 15.0, field, lambda_odom: 3.0, ..Settings::default() };
            let sim = Simulation::new(SimOptions { scans: Some(24), columns: Some(128), spacing: 1.0, ..SimOptions::of("street") }).unwrap();
            let (mut mapper, mut scans) = (Mapper::new(settings).unwrap(), sim.scans(PoseSource::Truth));
            let resolution = if coarse { 0.5 } else { 0.2 };
            let mut tiles = GroundTiles::new(resolution, mapper.atlas().query().unwrap().voxel_size()).unwrap();
            let mut made = Vec::new();
            for step in [Step::Scans(2)].iter().chain(&steps) {
                take(&mut mapper, &mut scans, step);
                let atlas = mapper.atlas();
                tiles.note(atlas).unwrap();
                made.push((tiles.stale.len(), tiles.tiles.len()));
                while tiles.is_stale() {
                    tiles.make(atlas, [0.0; 2], Duration::ZERO).unwrap();
                }
                let copy = tiles.copy(atlas);
                // In words, as heights that are not known are not equal to themselves.
                let [kept, whole] = [Ground::of_tiles(copy.clone(), &Body::default()), Ground::of(atlas, resolution, &Body::default())];
                prop_assert!(format!("{kept:?}") == format!("{whole:?}"), "{step:?} of {steps:?}");
                // And as all cubes of the map give them, without tiles.
                let (columns, _) = copy.joined().unwrap();
                let cubes = atlas.query().unwrap().resample(&Resampling { voxel: tiles.lattice.cube, states_only: true });
                let (bounds, cells) = (Bounds::of(&cubes).unwrap(), *columns.cells());
                let all = Columns::of_part(cubes, &tiles.lattice, (cells.low, cells.size[0].max(cells.size[1])), &bounds).unwrap();
                for cell in 0..cells.count() {
                    let other = all.cells().at(cells.centre(cell)).unwrap();
                    prop_assert!(columns.spans(cell).eq(all.spans(other)), "{:?}", cells.centre(cell));
                }
            }
            prop_assert!(made[0].1 == 0 && made.iter().any(|(stale, _)| *stale > 0));
        }
    }

    #[test]
    fn only_what_a_scan_has_changed_is_made_again() {
        let settings = Settings { voxel_size: 0.2, max_range: 10.0, field: FieldKind::Both, ..Settings::default() };
        let sim = Simulation::new(SimOptions { scans: Some(12), columns: Some(128), spacing: 8.0, ..SimOptions::of("street") }).unwrap();
        let mut mapper = Mapper::new(settings).unwrap();
        let mut tiles = GroundTiles::new(0.2, mapper.atlas().query().unwrap().voxel_size()).unwrap();
        let mut stale = 0;
        for scan in sim.scans(PoseSource::Truth) {
            mapper.handle(Event::Scan(scan)).unwrap();
            tiles.note(mapper.atlas()).unwrap();
            stale = tiles.stale.len();
            tiles.make(mapper.atlas(), [0.0; 2], Duration::MAX).unwrap();
        }
        assert!(stale > 0 && 2 * stale < tiles.tiles.len(), "{stale} of {}", tiles.tiles.len());
        tiles.note(mapper.atlas()).unwrap();
        assert!(!tiles.is_stale(), "nothing has changed");
    }

    #[test]
    fn tiles_near_a_robot_are_those_of_all() {
        let settings = Settings { voxel_size: 0.2, max_range: 20.0, field: FieldKind::Both, ..Settings::default() };
        let sim = Simulation::new(SimOptions { scans: Some(9), columns: Some(128), spacing: 8.0, ..SimOptions::of("street") }).unwrap();
        let mut mapper = Mapper::new(settings).unwrap();
        let finest = mapper.atlas().query().unwrap().voxel_size();
        let (mut some, reach) = (GroundTiles::near_robot(0.2, finest).unwrap(), 6.0);
        for scan in sim.scans(PoseSource::Truth) {
            let place = scan.t_map_lidar.translation.vector;
            let centre = [place.x, place.y];
            mapper.handle(Event::Scan(scan)).unwrap();
            let (atlas, mut all) = (mapper.atlas(), GroundTiles::new(0.2, finest).unwrap());
            for tiles in [&mut some, &mut all] {
                tiles.note(atlas).unwrap();
            }
            some.make_near(atlas, centre, reach).unwrap();
            all.make(atlas, [0.0; 2], Duration::MAX).unwrap();
            let ((columns, levels), (of_all, levels_of_all)) =
                (some.copy_near(atlas, centre, reach).joined().unwrap(), all.copy(atlas).joined().unwrap());
            let mut known = 0;
            for cell in 0..columns.cells().count() {
                let other = of_all.cells().at(columns.cells().centre(cell)).unwrap();
                assert!(columns.spans(cell).eq(of_all.spans(other)), "{centre:?}");
                let [one, two] =
                    [&levels.all()[levels.of_cell(cell)], &levels_of_all.all()[levels_of_all.of_cell(other)]].map(|of| format!("{of:?}"));
                assert_eq!(one, two);
                known += columns.spans(cell).count();
            }
            assert!(known > 1000, "{known}");
            let far = some.lattice.tiles_within(centre, 4.0 * reach);
            assert!(some.tiles.keys().all(|at| is_within(&far, at)), "what is far was given up");
        }
    }
}
