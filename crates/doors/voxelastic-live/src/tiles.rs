//! Which tiles of the surface viewers have to be told about, and when.

use crate::tile_thread::{Delivery, Finish, TileThread};
use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::meshing::{SurfaceChanges, TileKey};
use voxelastic::surface::{Mesh, MeshOptions};

/// A tile that viewers have is not sent again earlier than this: each scan changes all tiles that it sees, a little.
const AGAIN: Duration = Duration::from_secs(1);
/// But those around the robot are, as what is near is looked at: a scan is to be visible before the next.
const AGAIN_NEAR: Duration = Duration::from_millis(50);
/// What an order may take. A scan's change waits for the end of the order before it, and for its own.
const ORDER: Duration = Duration::from_millis(25);
/// Tiles of an order: few while scans come, as each waits for the order before it; many are for a map that is there already.
const TILES: [f64; 2] = [2.0, 256.0];

/// Tiles of the order that follows a scan: those around the robot by themselves, so that what the scan has changed there is sent before all else.
const NEAREST: usize = 2;

/// The tiles of the one surface that changed since viewers were told about them, and the thread that makes them. `T` is what is made of a tile.
#[derive(Debug)]
pub struct ChangedTiles<T> {
    options: MeshOptions,
    changes: SurfaceChanges,
    /// Once there is something to make.
    thread: Option<TileThread<T>>,
    made: HashMap<TileKey, Made>,
    /// What was ordered last.
    ordered: HashMap<TileKey, OrderedTile>,
    /// Tiles of an order.
    pace: f64,
    /// The tile with the robot: what is near is made first.
    focus: Option<[i32; 3]>,
    /// Whether a scan came since the last order.
    has_new_scan: bool,
    /// Whether the last order followed a scan.
    follows_scan: bool,
}

/// A tile that is made.
#[derive(Clone, Copy, Debug)]
pub struct OrderedTile {
    /// Its place among all, in tiles.
    pub place: [i32; 3],
    /// The submap that has most of it: it is to move with it until it is made again.
    pub carrier: Option<SubmapId>,
}

/// A tile that was made.
#[derive(Clone, Copy, Debug)]
struct Made {
    /// None if it is known to be wrong since.
    at: Option<Instant>,
    /// The submap that it moves with, if it has a surface and viewers were told.
    carrier: Option<SubmapId>,
    is_shown: bool,
}

impl<T: Send + 'static> ChangedTiles<T> {
    /// None yet. `lod` is the level of detail of the surface, 0 to 3.
    pub fn new(lod: usize) -> Self {
        Self {
            options: MeshOptions { lod, ..MeshOptions::default() },
            changes: SurfaceChanges::default(),
            thread: None,
            made: HashMap::new(),
            ordered: HashMap::new(),
            pace: TILES[0],
            focus: None,
            has_new_scan: false,
            follows_scan: false,
        }
    }

    /// The level of detail.
    pub fn lod(&self) -> usize {
        self.options.lod
    }

    /// Notes what has changed in the map.
    pub fn note(&mut self, atlas: &Atlas) {
        self.changes.note(atlas);
    }

    /// A scan came from a position in the map frame, metres: what is near is made first. The tile that it is in.
    pub fn focus(&mut self, position: [f32; 3]) -> Option<[i32; 3]> {
        self.focus = self.changes.tile_at(position).map(|tile| self.changes.place(tile));
        self.has_new_scan = true;
        self.focus
    }

    /// Takes the tiles that were made since the last call, and orders others that changed: after a scan some around the robot, then those that viewers do not have yet, then
    /// those that they have, the longest ago first. Waits for nothing: tiles are made on another thread. Returns what `finish` makes of each of their meshes, metres in the map frame; a tile without
    /// a surface is left out if viewers had none. None if nothing was made.
    pub fn step(&mut self, atlas: &Atlas, finish: impl Fn(&OrderedTile, Mesh) -> T + Send + Sync + 'static) -> Option<Vec<T>> {
        let delivery = self.thread.as_mut().and_then(TileThread::delivery);
        let result = delivery.map(|delivery| self.take(delivery));
        if self.is_busy() {
            return result;
        }
        self.follows_scan = self.has_new_scan;
        let tiles = self.choose(Instant::now());
        if !tiles.is_empty() {
            self.has_new_scan = false;
            let ordered = |tile: &TileKey| (*tile, OrderedTile { place: self.changes.place(*tile), carrier: self.changes.carrier(*tile) });
            self.ordered = tiles.iter().map(ordered).collect();
            let ordered = self.ordered.clone();
            let finish: Finish<T> = Arc::new(move |tile, mesh| finish(&ordered[&tile], mesh));
            let work = self.changes.gather(atlas, &tiles);
            let start = || TileThread::start(self.options.clone(), rayon::current_num_threads());
            self.thread.get_or_insert_with(start).order(work, finish);
        }
        result
    }

    fn take(&mut self, delivery: Delivery<T>) -> Vec<T> {
        let at = Some(Instant::now());
        if !self.follows_scan {
            // No slower than half, no faster than twice as many as in this order.
            let possible = delivery.tiles.len() as f64 * ORDER.as_secs_f64() / delivery.took.as_secs_f64().max(1e-6);
            self.pace = possible.clamp(self.pace / 2.0, self.pace * 2.0).clamp(TILES[0], TILES[1]);
        }
        self.changes.wait_for(&delivery.again);
        // A piece of theirs is missing: they are due at once.
        for tile in &delivery.again {
            if let Some(made) = self.made.get_mut(tile) {
                made.at = None;
            }
        }
        let mut results = Vec::new();
        for (tile, is_shown, result) in delivery.tiles {
            let carrier = self.ordered.get(&tile).and_then(|ordered| ordered.carrier).filter(|_| is_shown);
            let before = self.made.insert(tile, Made { at, carrier, is_shown });
            if is_shown || before.is_some_and(|before| before.is_shown) {
                results.push(result);
            }
        }
        results
    }

    /// Has all tiles made again.
    pub fn repeat(&mut self) {
        let shown: Vec<TileKey> = self.made.iter().filter(|(_, made)| made.is_shown).map(|(tile, _)| *tile).collect();
        self.changes.wait_for(&shown);
    }

    /// Has submaps bent onto each other, as they are for a mesh of the whole map. That takes its time: it is for a map that does not change any more.
    pub fn settle(&mut self, atlas: &Atlas) {
        self.changes.settle(atlas);
    }

    /// Whether tiles that viewers have move with a submap.
    pub fn has_carried(&self, submap: SubmapId) -> bool {
        self.made.values().any(|made| made.carrier == Some(submap)) || self.ordered.values().any(|ordered| ordered.carrier == Some(submap))
    }

    /// Whether tiles wait, due or not, or are being made.
    pub fn is_behind(&self) -> bool {
        self.is_busy() || self.changes.waiting().next().is_some()
    }

    /// Whether tiles are being made.
    pub fn is_busy(&self) -> bool {
        self.thread.as_ref().is_some_and(TileThread::is_busy)
    }

    /// Tiles for an order, ascending.
    fn choose(&self, now: Instant) -> Vec<TileKey> {
        let is_due = |at: &Option<Instant>, distance: i64| {
            let pause = if distance <= 1 { AGAIN_NEAR } else { AGAIN };
            at.is_none_or(|at| now.duration_since(at) >= pause)
        };
        let waiting = self.changes.waiting().map(|tile| (self.made.get(&tile).and_then(|made| made.at), self.distance(tile), tile));
        // What has not been made at all comes first: `None` is less than any time.
        let mut due: Vec<(Option<Instant>, i64, TileKey)> = waiting.filter(|(at, distance, _)| is_due(at, *distance)).collect();
        let most = if self.follows_scan { NEAREST } else { self.pace as usize };
        if due.len() > most {
            if self.follows_scan {
                due.select_nth_unstable_by_key(most, |(at, distance, tile)| (*distance, *at, *tile));
            } else {
                due.select_nth_unstable(most);
            }
            due.truncate(most);
        }
        let mut tiles: Vec<TileKey> = due.into_iter().map(|(.., tile)| tile).collect();
        tiles.sort_unstable();
        tiles
    }

    /// Square of the distance of a tile from the robot, tiles.
    fn distance(&self, tile: TileKey) -> i64 {
        let place = self.changes.place(tile);
        self.focus.map_or(i64::MAX, |at| (0..3).map(|k| i64::from(place[k] - at[k]).pow(2)).sum())
    }
}

/// All submaps, and the source of a fusion in progress.
pub fn all_submaps(atlas: &Atlas) -> impl Iterator<Item = &Submap> {
    atlas.submaps().iter().chain(atlas.merging().map(|merging| merging.submap))
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Mapper;
    use voxelastic::event::Event;
    use voxelastic::settings::Settings;
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};
    use voxelastic_testing::PATIENCE;

    fn robot(atlas: &Atlas) -> [f32; 3] {
        let submap = &atlas.submaps()[0];
        let t_map_lidar = submap.t_map_submap() * submap.scans().last().unwrap().t_submap_lidar;
        <[f64; 3]>::from(t_map_lidar.translation.vector).map(|c| c as f32)
    }

    fn triangles(tile: &OrderedTile, mesh: Mesh) -> ([i32; 3], usize) {
        (tile.place, mesh.triangles.len())
    }

    /// Takes and orders until nothing is being made, which must be soon. Returns the numbers of triangles.
    fn made(tiles: &mut ChangedTiles<([i32; 3], usize)>, atlas: &Atlas) -> HashMap<[i32; 3], usize> {
        let (begin, mut all) = (Instant::now(), HashMap::new());
        loop {
            all.extend(tiles.step(atlas, triangles).into_iter().flatten());
            if !tiles.is_busy() {
                return all;
            }
            assert!(begin.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn tiles_around_the_robot_are_due_again_before_the_others() {
        let room = Simulation::new(SimOptions { scans: Some(2), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.05, ..Settings::default() }).unwrap();
        let mut tiles = ChangedTiles::<([i32; 3], usize)>::new(0);
        let mut scans = room.scans(PoseSource::Truth);
        let mut integrate = |tiles: &mut ChangedTiles<([i32; 3], usize)>| {
            mapper.handle(Event::Scan(scans.next().unwrap())).unwrap();
            tiles.note(mapper.atlas());
            tiles.focus(robot(mapper.atlas()));
            mapper.atlas().clone()
        };
        let atlas = integrate(&mut tiles);
        let first = made(&mut tiles, &atlas);
        assert!(first.values().filter(|triangles| **triangles > 0).count() > 8, "{first:?}");
        // The second scan changes them all; none is due at once. How many an order takes depends on the machine.
        let clock = Instant::now();
        tiles.pace = TILES[1];
        tiles.made.values_mut().for_each(|made| made.at = Some(clock));
        integrate(&mut tiles);
        let due =
            |after: Duration| -> Vec<TileKey> { tiles.choose(clock + after).into_iter().filter(|tile| tiles.made.contains_key(tile)).collect() };
        assert!(due(AGAIN_NEAR / 2).is_empty());
        let (near, later) = (due(AGAIN_NEAR), due(AGAIN));
        assert!(!near.is_empty() && near.iter().all(|tile| tiles.distance(*tile) <= 1), "{near:?}");
        assert!(later.len() > near.len(), "{later:?}");
    }

    #[test]
    fn the_order_that_follows_a_scan_has_the_nearest_tiles_alone() {
        let room = Simulation::new(SimOptions { scans: Some(2), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.05, ..Settings::default() }).unwrap();
        let mut tiles = ChangedTiles::<([i32; 3], usize)>::new(0);
        for scan in room.scans(PoseSource::Truth) {
            mapper.handle(Event::Scan(scan)).unwrap();
            tiles.note(mapper.atlas());
            tiles.focus(robot(mapper.atlas()));
        }
        let distances = |tiles: &ChangedTiles<_>, chosen: &[TileKey]| -> Vec<i64> {
            let mut all: Vec<i64> = chosen.iter().map(|tile| tiles.distance(*tile)).collect();
            all.sort_unstable();
            all
        };
        let waiting: Vec<TileKey> = tiles.changes.waiting().collect();
        let all = distances(&tiles, &waiting);
        assert!(all.len() > 2 * NEAREST, "{all:?}");
        // Also of tiles that were made before, where farther ones never were.
        let now = Instant::now();
        let nearest = *waiting.iter().min_by_key(|tile| tiles.distance(**tile)).unwrap();
        tiles.made.insert(nearest, Made { at: Some(now), carrier: None, is_shown: true });
        (tiles.follows_scan, tiles.pace) = (true, TILES[1]);
        let first = tiles.choose(now + AGAIN);
        assert!(first.contains(&nearest) && first.is_sorted());
        assert_eq!(distances(&tiles, &first), all[..NEAREST]);
        // All others come in the next order, which does not follow a scan.
        tiles.changes.gather(mapper.atlas(), &first);
        tiles.follows_scan = false;
        assert_eq!(distances(&tiles, &tiles.choose(now + AGAIN)), all[NEAREST..]);
    }

    #[test]
    fn an_order_follows_each_scan_once() {
        let room = Simulation::new(SimOptions { scans: Some(1), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.05, ..Settings::default() }).unwrap();
        let mut tiles = ChangedTiles::<([i32; 3], usize)>::new(0);
        mapper.handle(Event::Scan(room.scans(PoseSource::Truth).next().unwrap())).unwrap();
        tiles.note(mapper.atlas());
        tiles.focus(robot(mapper.atlas()));
        tiles.pace = TILES[1];
        let mut orders = Vec::new();
        while tiles.is_behind() {
            tiles.step(mapper.atlas(), triangles);
            if tiles.is_busy() && orders.last() != Some(&tiles.ordered.len()) {
                orders.push(tiles.ordered.len());
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(orders.len() >= 2 && orders[0] == NEAREST && orders[1] > NEAREST, "{orders:?}");
    }

    #[test]
    fn tiles_are_made_while_the_map_goes_on_and_end_as_the_surface_of_the_map() {
        let room = Simulation::new(SimOptions { scans: Some(6), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.05, ..Settings::default() }).unwrap();
        let (mut tiles, mut shown) = (ChangedTiles::<([i32; 3], usize)>::new(0), HashMap::new());
        // Which small components stay may depend on what was there before.
        tiles.options.keep_all = true;
        for scan in room.scans(PoseSource::Truth) {
            // A step between scans does not wait for what was ordered.
            mapper.handle(Event::Scan(scan)).unwrap();
            tiles.note(mapper.atlas());
            shown.extend(tiles.step(mapper.atlas(), triangles).into_iter().flatten());
        }
        assert!(tiles.is_behind());
        while tiles.is_behind() {
            shown.extend(made(&mut tiles, mapper.atlas()));
        }
        let mut whole = SurfaceChanges::default();
        whole.note(mapper.atlas());
        let all: Vec<TileKey> = whole.waiting().collect();
        let made = voxelastic::meshing::TileMaker::new(tiles.options.clone()).make(&whole.gather(mapper.atlas(), &all));
        let expected = made.meshes.into_iter().map(|(tile, mesh)| (whole.place(tile), mesh.triangles.len()));
        let expected: HashMap<[i32; 3], usize> = expected.filter(|(_, triangles)| *triangles > 0).collect();
        let shown: HashMap<[i32; 3], usize> = shown.into_iter().filter(|(_, triangles)| *triangles > 0).collect();
        assert_eq!(shown, expected);
        assert!(tiles.made.values().all(|made| made.is_shown == (made.carrier == Some(0))) && tiles.has_carried(0) && !tiles.has_carried(1));
    }
}
