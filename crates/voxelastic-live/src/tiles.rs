//! Which tiles of the surface viewers have to be told about, and when.

use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::time::{Duration, Instant};
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::surface::{Mesh, MeshOptions, TILE_EDGE, Tile, changed_tiles, extract_tiles};

/// Edge of a block, finest voxels.
const BLOCK_EDGE: i32 = 8;
/// A tile that viewers have is not sent again earlier than this: each scan changes all tiles that it sees, a little.
const AGAIN: Duration = Duration::from_secs(1);
/// But those around the robot are, as what is near is looked at: a scan is to be visible before the next.
const AGAIN_NEAR: Duration = Duration::from_millis(50);
/// What a step may take. It lies between two scans, so it is short.
const STEP: Duration = Duration::from_millis(25);
/// Tiles of a step: fewer cost hardly less, because a step looks at all blocks of a submap; many are for a map that is there already.
const TILES: [f64; 2] = [16.0, 512.0];

/// The tiles of all submaps that changed since viewers were told about them.
#[derive(Debug)]
pub struct ChangedTiles {
    options: MeshOptions,
    submaps: BTreeMap<SubmapId, Changes>,
    /// Tiles that a step can do.
    pace: f64,
    /// Where the robot is: what is near is made first.
    focus: Option<(SubmapId, Tile)>,
}

#[derive(Debug, Default)]
struct Changes {
    /// The time of the field up to which changes are known.
    known: Option<u32>,
    blocks: usize,
    waiting: BTreeSet<Tile>,
    made: HashMap<Tile, Made>,
}

/// A tile that was made.
#[derive(Clone, Copy, Debug)]
struct Made {
    at: Instant,
    /// Whether it had a surface, and viewers were told.
    is_shown: bool,
}

impl ChangedTiles {
    /// None yet. `lod` is the level of detail of the surface, 0 to 3.
    pub fn new(lod: usize) -> Self {
        Self { options: MeshOptions { lod, ..MeshOptions::default() }, submaps: BTreeMap::new(), pace: TILES[0], focus: None }
    }

    /// The level of detail.
    pub fn lod(&self) -> usize {
        self.options.lod
    }

    /// Notes what has changed in the map. `merged` says that a fusion of submaps was completed or goes on, which changes submaps that no scan entered.
    pub fn note(&mut self, atlas: &Atlas, merged: bool) {
        let all: Vec<&Submap> = all_submaps(atlas).collect();
        self.submaps.retain(|id, _| all.iter().any(|submap| submap.id() == *id));
        for submap in all {
            let changes = self.submaps.entry(submap.id()).or_default();
            // A fusion adds blocks, and changes those that are there without counting as a scan.
            let since = if merged && submap.tsdf().len() != changes.blocks { None } else { changes.known };
            let (tiles, now) = changed_tiles(submap.tsdf(), since);
            changes.waiting.extend(tiles);
            (changes.known, changes.blocks) = (Some(now), submap.tsdf().len());
        }
    }

    /// What is near a position in the frame of a submap, metres, is made first.
    pub fn focus(&mut self, submap: &Submap, position: [f32; 3]) {
        let edge = submap.voxel_size() * (TILE_EDGE * BLOCK_EDGE) as f32;
        self.focus = Some((submap.id(), position.map(|c| (c / edge).floor() as i32)));
    }

    /// Extracts some of the tiles that changed: first those that viewers do not have yet, then those that they have, the longest ago first. Returns what
    /// `make` makes of each, which is done in parallel; a tile without a surface is left out if viewers had none. None if none is due.
    pub fn step<T: Send>(&mut self, atlas: &Atlas, make: impl Fn(&Submap, Tile, Mesh) -> T + Sync) -> Option<Vec<T>> {
        let clock = Instant::now();
        let chosen = self.choose(clock);
        if chosen.is_empty() {
            return None;
        }
        let mut results = Vec::new();
        for submap in all_submaps(atlas) {
            let Some((tiles, changes)) = chosen.get(&submap.id()).zip(self.submaps.get_mut(&submap.id())) else { continue };
            let meshes = extract_tiles(submap.tsdf(), submap.voxel_size(), &self.options, tiles);
            let made = tiles.par_iter().zip(meshes).map(|(tile, mesh)| {
                let is_empty = mesh.triangles.is_empty();
                (*tile, is_empty, make(submap, *tile, mesh))
            });
            for (tile, is_empty, result) in made.collect::<Vec<_>>() {
                changes.waiting.remove(&tile);
                let before = changes.made.insert(tile, Made { at: clock, is_shown: !is_empty });
                if !is_empty || before.is_some_and(|before| before.is_shown) {
                    results.push(result);
                }
            }
        }
        let count: usize = chosen.values().map(Vec::len).sum();
        // No slower than half, no faster than twice as many as in this step.
        let possible = count as f64 * STEP.as_secs_f64() / clock.elapsed().as_secs_f64().max(1e-6);
        self.pace = possible.clamp(self.pace / 2.0, self.pace * 2.0).clamp(TILES[0], TILES[1]);
        Some(results)
    }

    /// Has all tiles of the submaps for which `which` holds made again.
    pub fn repeat(&mut self, which: impl Fn(SubmapId) -> bool) {
        for (_, changes) in self.submaps.iter_mut().filter(|(id, _)| which(**id)) {
            let shown = changes.made.iter().filter(|(_, made)| made.is_shown).map(|(tile, _)| *tile);
            changes.waiting.extend(shown);
        }
    }

    /// Whether tiles wait, due or not.
    pub fn is_behind(&self) -> bool {
        self.submaps.values().any(|changes| !changes.waiting.is_empty())
    }

    /// Tiles for a step, by submap.
    fn choose(&self, now: Instant) -> BTreeMap<SubmapId, Vec<Tile>> {
        let is_due = |at: &Option<Instant>, distance: i64| {
            let pause = if distance <= 1 { AGAIN_NEAR } else { AGAIN };
            at.is_none_or(|at| now.duration_since(at) >= pause)
        };
        let mut due: Vec<(Option<Instant>, i64, SubmapId, Tile)> = Vec::new();
        for (id, changes) in &self.submaps {
            let made = changes.waiting.iter().map(|tile| (changes.made.get(tile).map(|made| made.at), self.distance(*id, *tile), *id, *tile));
            due.extend(made.filter(|(at, distance, ..)| is_due(at, *distance)));
        }
        // What has not been made at all comes first: `None` is less than any time.
        let most = self.pace as usize;
        if due.len() > most {
            due.select_nth_unstable(most);
            due.truncate(most);
        }
        due.sort_unstable();
        let mut chosen: BTreeMap<SubmapId, Vec<Tile>> = BTreeMap::new();
        due.into_iter().for_each(|(.., id, tile)| chosen.entry(id).or_default().push(tile));
        chosen
    }

    /// Square of the distance of a tile from the robot, tiles; other submaps come after the robot's, the newest first.
    fn distance(&self, id: SubmapId, tile: Tile) -> i64 {
        match self.focus {
            Some((submap, at)) if submap == id => (0..3).map(|k| i64::from(tile[k] - at[k]).pow(2)).sum(),
            _ => i64::MAX - i64::from(id),
        }
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

    #[test]
    fn tiles_around_the_robot_are_due_again_before_the_others() {
        let room = Simulation::new(SimOptions { scans: Some(2), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        let mut mapper = Mapper::new(Settings { voxel_size: 0.05, ..Settings::default() }).unwrap();
        let mut tiles = ChangedTiles::new(0);
        let mut scans = room.scans(PoseSource::Truth);
        let mut integrate = |tiles: &mut ChangedTiles| {
            mapper.handle(Event::Scan(scans.next().unwrap())).unwrap();
            let submap = &mapper.atlas().submaps()[0];
            let robot = submap.scans().last().unwrap().t_submap_lidar.translation.vector;
            tiles.focus(submap, <[f64; 3]>::from(robot).map(|c| c as f32));
            tiles.note(mapper.atlas(), false);
        };
        integrate(&mut tiles);
        let clock = Instant::now();
        let all: Vec<Tile> = tiles.submaps[&0].waiting.iter().copied().collect();
        for tile in all {
            tiles.submaps.get_mut(&0).unwrap().made.insert(tile, Made { at: clock, is_shown: true });
        }
        tiles.submaps.get_mut(&0).unwrap().waiting.clear();
        integrate(&mut tiles);
        let due = |after: Duration| {
            tiles.choose(clock + after).into_values().flatten().filter(|tile| tiles.submaps[&0].made.contains_key(tile)).collect::<Vec<_>>()
        };
        assert!(due(AGAIN_NEAR / 2).is_empty());
        let (near, later) = (due(AGAIN_NEAR), due(AGAIN));
        assert!(!near.is_empty() && near.iter().all(|tile| tiles.distance(0, *tile) <= 1), "{near:?}");
        assert!(later.len() > near.len(), "{later:?}");
    }
}
