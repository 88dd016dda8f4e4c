//! The 2-D map, and its costs, while the map changes: what changed is looked up between scans, and the floor is followed on a thread of its own.

use super::floor_plan::{FloorPlan, GridSettings, PlanPart};
use crate::worker::{Priority, Worker};
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic_ground::{GroundError, GroundTiles, Inflation, TilesCopy};

/// It is made at most this often, and no more than half of the time: robots steer by it, so it has the priority of scans.
const PERIOD: Duration = Duration::from_secs(1);
/// Columns that are out of date are made for no longer than this at a time: a scan may wait for it.
const SLICE: Duration = Duration::from_millis(20);
/// After this time it is made of what there is, as more goes out of date meanwhile.
const LONGEST: Duration = Duration::from_secs(2);

/// So often all of it is published, if it has changed: for those who missed something.
const WHOLE_PERIOD: Duration = Duration::from_secs(30);

/// What to make a 2-D map of, where the robot is, and by what there are to be costs.
type Order = (TilesCopy, [f64; 3], Option<Inflation>);
type Made = Result<(FloorPlan, Option<FloorPlan>), GroundError>;

/// What is to be published.
#[derive(Debug)]
pub struct GridNews<'a> {
    /// The map as it is.
    pub whole: &'a FloorPlan,
    /// What has changed since it was published last, if that is told by parts; the others get the whole map anyway.
    pub parts: Option<Vec<PlanPart>>,
}

/// A 2-D map as it was published last, and who listens to it.
#[derive(Debug, Default)]
struct Shown {
    last: Option<FloorPlan>,
    /// When all of it was published.
    whole: Option<Instant>,
    listeners: usize,
    has_come: bool,
}

impl Shown {
    /// Notes how many listen; whether somebody has come and there is nothing for them.
    fn listen(&mut self, listeners: usize) -> bool {
        self.has_come = listeners > std::mem::replace(&mut self.listeners, listeners);
        if listeners == 0 {
            // Nobody keeps it up.
            self.last = None;
        }
        self.has_come && self.last.is_none()
    }

    /// What is to be published, of a new map or for somebody who has come.
    fn news(&mut self, plan: Option<FloorPlan>) -> Option<GridNews<'_>> {
        if self.listeners == 0 {
            return None;
        }
        let Some(plan) = plan else {
            let whole = self.last.as_ref().filter(|_| self.has_come)?;
            self.whole = Some(Instant::now());
            return Some(GridNews { whole, parts: None });
        };
        let before = self.last.replace(plan);
        let whole = self.last.as_ref()?;
        let parts = before.and_then(|before| whole.parts_since(&before));
        let is_same = parts.as_ref().is_some_and(Vec::is_empty);
        // Where nothing changed, nothing is told.
        let is_told = self.has_come || !is_same;
        let is_due = self.has_come || self.whole.is_none_or(|at| at.elapsed() >= WHOLE_PERIOD);
        let parts = parts.filter(|_| !is_due);
        if is_told && parts.is_none() {
            self.whole = Some(Instant::now());
        }
        is_told.then_some(GridNews { whole, parts })
    }
}

/// The 2-D map, and its costs.
#[derive(Debug)]
pub struct LiveGrid {
    settings: GridSettings,
    /// Of the map, for the cells that it has now.
    tiles: Option<GroundTiles>,
    has_changed: bool,
    /// Since when columns are being made for the next one.
    since: Option<Instant>,
    /// When the last one was ordered.
    last: Option<Instant>,
    /// How long it took to make the last one.
    took: Duration,
    /// Follows the floor.
    thread: Option<Worker<Order, Made>>,
    plan: Shown,
    costs: Shown,
    /// One that somebody has asked for, to be published.
    asked: Option<FloorPlan>,
    /// Whether it was said that there is no 2-D map.
    has_warned: bool,
}

impl LiveGrid {
    /// Of nothing yet.
    pub fn new(settings: GridSettings) -> Self {
        Self {
            settings,
            tiles: None,
            has_changed: false,
            since: None,
            last: None,
            took: Duration::ZERO,
            thread: None,
            plan: Shown::default(),
            costs: Shown::default(),
            asked: None,
            has_warned: false,
        }
    }

    /// Notes that the map has changed.
    pub fn note(&mut self) {
        self.has_changed = true;
    }

    /// Has it made again as soon as may be.
    pub fn hurry(&mut self) {
        self.last = None;
    }

    /// Does some of the work that is due, and returns what is to be published of the map and of its costs, to each of which so many `listeners` listen. `robot` is where the sensor is in the map
    /// frame, metres. To be called in the mapper's threads; where nobody listens, nothing is done.
    pub fn step(&mut self, atlas: &Atlas, listeners: [usize; 2], robot: [f64; 3]) -> [Option<GridNews<'_>>; 2] {
        self.has_changed |= self.plan.listen(listeners[0]) | self.costs.listen(listeners[1]);
        if listeners == [0, 0] {
            return [None, None];
        }
        let made = self.thread.as_mut().and_then(Worker::made);
        if let (Some(_), Some(ordered)) = (&made, self.last) {
            self.took = ordered.elapsed();
        }
        // What was asked for is newer than what was ordered before.
        let made = self.asked.take().map(|plan| Ok((plan, None))).or(made);
        if made.is_none() {
            let prepared = self.prepare(atlas, robot);
            prepared.unwrap_or_else(|why| self.warn(&why));
        }
        match made.transpose() {
            Ok(made) => {
                let (plan, costs) = made.unzip();
                [self.plan.news(plan), self.costs.news(costs.flatten())]
            }
            Err(why) => {
                self.warn(&why);
                [None, None]
            }
        }
    }

    /// Whether there is more to do at once.
    pub fn is_busy(&self) -> bool {
        self.plan.listeners + self.costs.listeners > 0 && (self.since.is_some() || self.thread.as_ref().is_some_and(Worker::is_busy))
    }

    /// Looks up what has changed, for no longer than a scan may wait, and orders the next one.
    fn prepare(&mut self, atlas: &Atlas, robot: [f64; 3]) -> Result<(), GroundError> {
        if atlas.submaps().is_empty() {
            return Ok(());
        }
        let is_busy = self.thread.as_ref().is_some_and(Worker::is_busy);
        let is_due = self.has_changed && self.last.is_none_or(|last| last.elapsed() >= PERIOD.max(2 * self.took));
        if is_busy || (self.since.is_none() && !is_due) {
            return Ok(());
        }
        let since = *self.since.get_or_insert_with(Instant::now);
        // If it fails, it is tried again once the map has changed.
        let has_changed = std::mem::take(&mut self.has_changed);
        let resolution = self.settings.resolution(atlas);
        let tiles = match up_to_date(&mut self.tiles, resolution, atlas, has_changed, (robot, SLICE)) {
            Ok(tiles) => tiles,
            Err(why) => {
                (self.since, self.last) = (None, Some(Instant::now()));
                return Err(why);
            }
        };
        if tiles.is_stale() && since.elapsed() < LONGEST {
            return Ok(());
        }
        self.has_changed |= tiles.is_stale();
        (self.since, self.last) = (None, Some(Instant::now()));
        let order = (tiles.copy(atlas), robot, Some(self.settings.inflation).filter(|_| self.costs.listeners > 0));
        let body = self.settings.body;
        let make = move |(tiles, robot, inflation): Order| FloorPlan::of(tiles, &body, robot, inflation.as_ref());
        let start = || Worker::start("2-D map", 1, Priority::Usual, make);
        self.thread.get_or_insert_with(start).order(order);
        Ok(())
    }

    /// The map as it is now, all of it.
    ///
    /// # Errors
    /// As [`FloorPlan::of`].
    pub fn now(&mut self, atlas: &Atlas, robot: [f64; 3]) -> Result<FloorPlan, GroundError> {
        let body = self.settings.body;
        let resolution = self.settings.resolution(atlas);
        let tiles = up_to_date(&mut self.tiles, resolution, atlas, true, (robot, Duration::MAX))?;
        let (made, _) = FloorPlan::of(tiles.copy(atlas), &body, robot, None)?;
        self.asked = Some(made.clone());
        Ok(made)
    }

    /// Says once why there is no 2-D map.
    fn warn(&mut self, why: &GroundError) {
        let is_first = !std::mem::replace(&mut self.has_warned, true);
        if is_first && *why == GroundError::NoOccupancy {
            // What is recorded has no grid then, and nobody asked for one.
            tracing::info!("no 2-D map is published: {why}");
        } else if is_first {
            tracing::warn!("no 2-D map is published: {why}; {}", why.remedy());
        }
    }
}

/// Tiles of a map, made anew where they are out of date, those near `robot` first, for no longer than `time`.
fn up_to_date<'a>(
    kept: &'a mut Option<GroundTiles>,
    resolution: f64,
    atlas: &Atlas,
    has_changed: bool,
    (robot, time): ([f64; 3], Duration),
) -> Result<&'a GroundTiles, GroundError> {
    let before = kept.take().filter(|tiles| tiles.resolution() == resolution);
    let is_new = before.is_none();
    let mut tiles = before.map_or_else(|| GroundTiles::new(resolution, f64::from(atlas.voxel_size())), Ok)?;
    if has_changed || is_new {
        tiles.note(atlas)?;
    }
    if tiles.is_stale() {
        tiles.make(atlas, [robot[0], robot[1]], time)?;
    }
    Ok(kept.insert(tiles))
}
