//! Where to go next, while the map grows: an explorer beside the mapper, on a thread of low priority.
//!
//! | file | contents |
//! | --- | --- |
//! | `copy` | a copy of the occupancy of the map, kept up from what changes |
//! | `plan` | what it says, and what it may be asked |
//! | `settings` | the robot, and where it is to explore |
//! | `worker` | what the thread does |
//!
//! The thread has its own copy of the map, so that no scan waits for a plan. The mapper's thread makes the copy between two scans, while none waits, of the submaps that changed, and spends no
//! more than a twentieth of its time on it. While the thread plans, nothing is copied, and the map grows: the next plan is about all that has come meanwhile.

mod copy;
mod plan;
mod settings;
mod worker;

use crate::near_scans::NearScans;
use crate::worker::lower_priority;
use copy::Copied;
pub use plan::{Command, Plan, PlanState};
pub use settings::PlannerSettings;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::event::Scan;
use voxelastic_explore::{ExploreError, Explorer};
use worker::{Order, Worker};

/// The map is copied at most this often ...
const PERIOD: Duration = Duration::from_millis(200);
/// ... and that takes no more than this share of the time.
const SHARE: f64 = 0.05;

/// An explorer that works beside a mapper. It ends with its owner.
#[derive(Debug)]
pub struct LivePlanner {
    settings: PlannerSettings,
    orders: Sender<Order>,
    plans: Receiver<Option<Result<Plan, String>>>,
    is_busy: bool,
    copied: Copied,
    scans: NearScans,
    /// Time stamps of the first scan and of the last, seconds.
    times: Option<[f64; 2]>,
    /// Whether the map has changed since the last copy.
    has_changed: bool,
    is_paused: bool,
    command: Option<Command>,
    /// When the map was copied last, and how long that took.
    last: Option<(Instant, Duration)>,
}

impl LivePlanner {
    /// Starts it, with `threads` threads of low priority.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn start(settings: PlannerSettings, threads: usize) -> Result<Self, ExploreError> {
        Explorer::new(settings.before())?;
        let mut worker = Worker::new(settings);
        Ok(Self::with(settings, threads, move |order| worker.work(order)))
    }

    /// One whose thread does `work`.
    fn with(settings: PlannerSettings, threads: usize, mut work: impl FnMut(Order) -> Option<Result<Plan, String>> + Send + 'static) -> Self {
        let (orders, to_do) = channel::<Order>();
        let (done, plans) = channel();
        let run = move || {
            lower_priority();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|_| "planner".to_owned());
            let pool = pool.start_handler(|_| lower_priority()).build();
            while let Ok(order) = to_do.recv() {
                let plan = match &pool {
                    Ok(pool) => pool.install(|| work(order)),
                    // Without threads of its own it shares those of others.
                    Err(_) => work(order),
                };
                if done.send(plan).is_err() {
                    return;
                }
            }
        };
        // If it does not start, orders are lost, and nothing is planned.
        if let Err(problem) = std::thread::Builder::new().name("planner".to_owned()).spawn(run) {
            tracing::warn!("nothing is planned: {problem}");
        }
        Self {
            settings,
            orders,
            plans,
            is_busy: false,
            copied: Copied::default(),
            scans: NearScans::default(),
            times: None,
            has_changed: false,
            is_paused: false,
            command: None,
            last: None,
        }
    }

    /// Its settings.
    pub fn settings(&self) -> &PlannerSettings {
        &self.settings
    }

    /// Keeps what is near of a scan that is going to be in the map, farther than `min_range` metres.
    pub fn add_scan(&mut self, scan: &Scan, min_range: f32) {
        self.scans.add(scan, min_range);
        self.times = Some([self.times.map_or(scan.time, |times| times[0]), scan.time]);
    }

    /// The map has changed.
    pub fn note(&mut self) {
        self.has_changed = true;
    }

    /// It waits from now on, or goes on.
    pub fn pause(&mut self, pause: bool) {
        self.is_paused = pause;
        self.has_changed |= !pause;
    }

    /// Whether it waits.
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Asks something of it; it goes on if it was paused.
    pub fn command(&mut self, command: Command) {
        self.command = Some(command);
        self.pause(false);
    }

    /// Takes the plan that was made, if there is a new one.
    ///
    /// # Errors
    /// Why there is none, in words.
    pub fn plan(&mut self) -> Option<Result<Plan, String>> {
        if !self.is_busy {
            return None;
        }
        let plan = self.plans.try_recv();
        self.is_busy = matches!(plan, Err(TryRecvError::Empty));
        // What was planned before it was paused, or asked something else, counts no more.
        plan.ok().flatten().filter(|_| !self.is_paused && self.command.is_none())
    }

    /// Has a plan made of the map as it is, if it has changed and the last plan is done. To be called between two scans, while none waits. Copies what changed, and waits for nothing; returns how
    /// long that took if it was time for it.
    pub fn step(&mut self, atlas: &Atlas) -> Option<Duration> {
        let begin = Instant::now();
        let has_waited = self.last.is_none_or(|(at, took)| begin.saturating_duration_since(at) >= PERIOD.max(took.div_f64(SHARE)));
        if self.is_busy || self.is_paused || !self.has_changed || !(has_waited || self.command.is_some()) || atlas.submaps().is_empty() {
            return None;
        }
        let seconds_left = self.settings.time.zip(self.times).map(|(time, [first, last])| time - (last - first));
        let order = Order {
            changes: self.copied.changes(atlas),
            scans: self.scans.take(),
            beams: self.scans.beams(),
            seconds_left,
            command: self.command.take(),
        };
        self.has_changed = false;
        self.is_busy = self.orders.send(order).is_ok();
        let took = begin.elapsed();
        self.last = Some((begin, took));
        Some(took)
    }

    /// Whether a plan is being made.
    pub fn is_busy(&self) -> bool {
        self.is_busy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::Event;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Mapper, Settings};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};
    use voxelastic_testing::PATIENCE;

    fn settings() -> PlannerSettings {
        PlannerSettings { radius: 0.25, margin: 0.1, height: None, speed: 1.0, bounds: None, time: None, max_range: 12.0, least_volume: 4.0 }
    }

    #[test]
    fn scans_go_on_while_the_planner_is_stuck() {
        let (entered, entries) = channel();
        let (release, held) = channel::<()>();
        let mut planner = LivePlanner::with(settings(), 1, move |order: Order| {
            entered.send(order.scans.len()).unwrap();
            held.recv().ok()?;
            Some(Ok(Plan { state: PlanState::Exploring, ..Plan::default() }))
        });
        let mut mapper = Mapper::new(Settings { voxel_size: 0.2, max_range: 12.0, field: FieldKind::Occupancy, ..Settings::default() }).unwrap();
        let sim = Simulation::new(SimOptions { scans: Some(24), columns: Some(128), ..SimOptions::of("room") }).unwrap();
        let mut copies = 0;
        for scan in sim.scans(PoseSource::Truth) {
            planner.add_scan(&scan, 0.5);
            mapper.handle(Event::Scan(scan)).unwrap();
            planner.note();
            copies += usize::from(planner.step(mapper.atlas()).is_some());
            assert!(planner.plan().is_none(), "there is no plan yet");
        }
        // All scans are mapped, although the planner works on the first one, and has not taken a second copy.
        assert_eq!((mapper.atlas().scan_count(), copies, planner.is_busy()), (24, 1, true));
        assert_eq!(entries.recv().unwrap(), 1);
        release.send(()).unwrap();
        let begin = Instant::now();
        let plan = loop {
            if let Some(plan) = planner.plan() {
                break plan.unwrap();
            }
            assert!(begin.elapsed() < PATIENCE);
            std::thread::sleep(Duration::from_millis(1));
        };
        assert_eq!((plan.state, planner.is_busy()), (PlanState::Exploring, false));
        std::thread::sleep(PERIOD);
        assert!(planner.step(mapper.atlas()).is_some(), "the next plan is about what came meanwhile");
        assert_eq!(entries.recv().unwrap(), 16);
        // What is asked meanwhile makes the plan in work worth nothing, and so does a pause.
        planner.command(Command::Return);
        release.send(()).unwrap();
        while planner.is_busy() {
            assert!(planner.plan().is_none());
        }
        assert!(planner.step(mapper.atlas()).is_some(), "at once");
        planner.pause(true);
        release.send(()).unwrap();
        while planner.is_busy() {
            assert!(planner.plan().is_none());
        }
        planner.note();
        std::thread::sleep(PERIOD);
        assert!(planner.step(mapper.atlas()).is_none() && planner.is_paused());
    }

    #[test]
    fn impossible_settings_are_refused() {
        for bad in [
            PlannerSettings { radius: -1.0, ..settings() },
            PlannerSettings { speed: 0.0, ..settings() },
            PlannerSettings { bounds: Some([[1.0; 3], [0.0; 3]]), ..settings() },
        ] {
            assert!(LivePlanner::start(bad, 1).is_err(), "{bad:?}");
        }
        assert!(LivePlanner::start(settings(), 1).is_ok());
    }
}
