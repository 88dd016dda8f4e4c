//! Loop closures and corrected poses, inserted into a registered cloud list.

use crate::error::SlamError;
use crate::graph::LiveOptimiser;
use crate::loops::{Closure, LoopFinder, Searches};
use std::time::{Duration, Instant};
use voxelastic::event::Event;

/// The stage between scans with poses and the mapper: finds loop closures, optimises the pose graph after them, and inserts the loop edges and
/// pose updates into the events (paper Sec. IV). Without a finder and an optimiser it passes on what comes.
///
/// ```
/// use voxelastic::event::{Event, Scan};
/// use voxelastic::{Cloud, Pose};
/// use voxelastic_slam::Corrector;
/// use voxelastic_slam::graph::{LiveOptimiser, Options};
/// use voxelastic_slam::loops::{LoopFinder, LoopSettings};
///
/// let mut corrector = Corrector::default()
///     .with_finder(LoopFinder::new(LoopSettings::default()))
///     .with_optimiser(LiveOptimiser::new(Options::default()));
/// let cloud = Cloud::from_points(vec![[2.0, 0.0, 0.0]]);
/// let scan = Scan { node: 0, time: 0.0, t_map_lidar: Pose::identity(), cloud };
/// assert_eq!(corrector.take(Event::Scan(scan))?.len(), 1);
/// assert!(corrector.finish()?.is_empty());
/// # Ok::<(), voxelastic_slam::SlamError>(())
/// ```
#[derive(Debug, Default)]
pub struct Corrector {
    finder: Option<LoopFinder>,
    optimiser: Option<LiveOptimiser>,
    /// Time of the last optimisation that nobody asked for yet.
    optimised_in: Option<Duration>,
}

impl Corrector {
    /// Looks for loop closures with `finder`.
    #[must_use]
    pub fn with_finder(self, finder: LoopFinder) -> Self {
        Self { finder: Some(finder), ..self }
    }

    /// Corrects poses with `optimiser`.
    #[must_use]
    pub fn with_optimiser(self, optimiser: LiveOptimiser) -> Self {
        Self { optimiser: Some(optimiser), ..self }
    }

    /// Takes an event. Returns those for the mapper, in order.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    pub fn take(&mut self, event: Event) -> Result<Vec<Event>, SlamError> {
        let found = self.finder.as_mut().map_or_else(Vec::new, |finder| finder.take(&event));
        self.corrected(found.into_iter().map(Event::LoopEdge).chain([event]))
    }

    /// The last loop edges and the last correction, after the last event.
    ///
    /// # Errors
    /// When the pose graph cannot be optimised.
    pub fn finish(&mut self) -> Result<Vec<Event>, SlamError> {
        let found = self.finder.as_mut().map_or_else(Vec::new, LoopFinder::finish);
        let mut out = self.corrected(found.into_iter().map(Event::LoopEdge))?;
        if let Some(optimiser) = &mut self.optimiser {
            out.extend(timed(optimiser, &mut self.optimised_in, LiveOptimiser::finish)?);
        }
        Ok(out)
    }

    /// The closures that were tried, if they are looked for.
    pub fn closures(&self) -> Option<&[Closure]> {
        self.finder.as_ref().map(LoopFinder::closures)
    }

    /// The outcomes of the searches for closures, if they are looked for. One that sees the same events again with a finder that
    /// [knows](LoopFinder::with_searches) them ends in the same state without searching.
    pub fn searches(&self) -> Option<Searches> {
        self.finder.as_ref().map(LoopFinder::searches)
    }

    /// What is used of the points of the last scan to find closures, lidar frame, metres: one that takes a scan of these points alone does the same.
    pub fn last_points(&self) -> Option<&[[f32; 3]]> {
        self.finder.as_ref().and_then(LoopFinder::last_points)
    }

    /// The edge of the voxels in which closures are looked for, metres, once a scan has come.
    pub fn voxel_size(&self) -> Option<f64> {
        self.finder.as_ref().and_then(LoopFinder::voxel_size)
    }

    /// Whether it passes on what comes, and nothing else.
    pub fn is_idle(&self) -> bool {
        self.finder.is_none() && self.optimiser.is_none()
    }

    /// Wall time of the last optimisation, once after each.
    pub fn take_optimisation_time(&mut self) -> Option<Duration> {
        self.optimised_in.take()
    }

    fn corrected(&mut self, events: impl Iterator<Item = Event>) -> Result<Vec<Event>, SlamError> {
        let Some(optimiser) = &mut self.optimiser else { return Ok(events.collect()) };
        let mut out = Vec::new();
        for event in events {
            out.extend(timed(optimiser, &mut self.optimised_in, |optimiser| optimiser.handle(event))?);
        }
        Ok(out)
    }
}

/// Runs a step of the optimiser, and notes its time if the graph was optimised in it.
fn timed<T>(optimiser: &mut LiveOptimiser, took: &mut Option<Duration>, step: impl FnOnce(&mut LiveOptimiser) -> T) -> T {
    let (runs, clock) = (optimiser.runs(), Instant::now());
    let result = step(optimiser);
    if optimiser.runs() > runs {
        *took = Some(clock.elapsed());
    }
    result
}
