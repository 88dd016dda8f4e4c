//! The suite: three settings, both fields, one and two threads, on all available scans, interleaved with peers.

use crate::data::{self, Dataset, Truth};
use crate::error::Result;
use crate::peers::{self, Peer};
pub use crate::results::{Machine, Suite};
use crate::results::{generator, machine};
use crate::run::{Case, Run, median_run};
use crate::setting::{FIELDS, HARDEST, SETTINGS, Setting};
use crate::workspace::{Workspace, load};
use crate::{goals, special};
use std::path::PathBuf;
use std::time::{Duration, Instant};
use voxelastic::settings::FieldKind;

/// Options of a suite.
#[derive(Clone, Debug)]
pub struct Options {
    /// Quick suite: the hardest setting only, on the first scans of the campus, without accuracy.
    pub quick: bool,
    /// Other systems to measure.
    pub peers: Vec<Peer>,
    /// Time limit of a peer for one configuration.
    pub peer_limit: Duration,
    /// Repetitions of each configuration; the median run is reported.
    pub repeat: usize,
    /// Folder with real scans.
    pub real_data: PathBuf,
    /// An existing simulated campus.
    pub campus: Option<PathBuf>,
}

/// Scans of a quick suite.
const QUICK_SCANS: usize = 60;
/// Factor on the time limit of peers for two laps, which are of no use unless they are complete.
const LAPS_LIMIT_FACTOR: u32 = 6;
/// Scratch name of the map.
const MAP: &str = "run.vox";

/// Runs the suite.
///
/// # Errors
/// When a program of ours fails or data cannot be read. A peer that fails is skipped and listed in the results.
pub fn run(workspace: &Workspace, options: &Options) -> Result<Suite> {
    let clock = Instant::now();
    let mut suite = Suite { format: 1, generator: generator(), machine: machine(), quick: options.quick, ..Suite::default() };
    let datasets = datasets(workspace, options, &mut suite.skipped)?;
    let settings: &[Setting] = if options.quick { &[HARDEST] } else { &SETTINGS };
    for data in &datasets {
        let exported = if options.peers.is_empty() { None } else { Some(peers::export_scans(data, &workspace.scratch("exported"))?) };
        for &setting in settings {
            for field in FIELDS {
                let mut round = Round { workspace, options, data, setting, field, exported: exported.as_ref(), suite: &mut suite };
                round.run()?;
            }
        }
        workspace.remove_scratch("exported");
    }
    suite.special.pose_update = special::pose_updates(&[1000])?.pop();
    if !options.quick {
        let (default, others) = special::second_laps(workspace, &options.peers, LAPS_LIMIT_FACTOR * options.peer_limit, &mut suite.skipped)?;
        (suite.special.second_lap, suite.special.second_lap_others) = (Some(default), others);
    }
    suite.goals = goals::all(&suite);
    suite.machine.load_after = load();
    suite.total_s = clock.elapsed().as_secs_f64();
    Ok(suite)
}

fn datasets(workspace: &Workspace, options: &Options, skipped: &mut Vec<String>) -> Result<Vec<Dataset>> {
    let mut campus = data::campus(workspace, options.campus.as_deref())?;
    if options.quick {
        campus = Dataset { truth: Truth::None, max_scans: Some(QUICK_SCANS), ..campus };
        return Ok(vec![campus]);
    }
    let (real, missing) = data::real(&options.real_data);
    missing.iter().for_each(|m| tracing::warn!("{m}"));
    skipped.extend(missing);
    Ok(std::iter::once(campus).chain(real).collect())
}

/// All runs of one field at one setting on the same scans. They follow each other directly, so that the state of the machine is the same.
struct Round<'a> {
    workspace: &'a Workspace,
    options: &'a Options,
    data: &'a Dataset,
    setting: Setting,
    field: FieldKind,
    exported: Option<&'a peers::ExportedScans>,
    suite: &'a mut Suite,
}

impl<'a> Round<'a> {
    fn run(&mut self) -> Result<()> {
        let cases = self.cases();
        let mut ours: Vec<Vec<Run>> = vec![Vec::new(); cases.len()];
        let mut theirs: Vec<Vec<Run>> = vec![Vec::new(); self.options.peers.len()];
        for repetition in 0..self.options.repeat.max(1) {
            for (case, runs) in cases.iter().zip(&mut ours) {
                tracing::info!("{}", title(case));
                let mut run = case.run(self.workspace, MAP)?;
                // The map is the same for any number of threads and in every repetition.
                if case.threads == 1 && repetition == 0 && !self.options.quick {
                    run.quality = case.evaluate(self.workspace, MAP)?;
                    self.mesh(case)?;
                }
                self.workspace.remove_scratch(MAP);
                runs.push(run);
            }
            if let Some(exported) = self.exported {
                for (peer, runs) in self.options.peers.iter().zip(&mut theirs) {
                    match self.peer(peer, &cases[0], exported) {
                        Ok(run) => runs.extend(run),
                        Err(why) if !self.suite.skipped.contains(&why) => self.suite.skipped.push(why),
                        Err(_) => {}
                    }
                }
            }
        }
        for runs in ours.into_iter().chain(theirs) {
            let quality = runs.iter().find_map(|r| r.quality.clone());
            self.suite.runs.extend(median_run(runs).map(|run| Run { quality, ..run }));
        }
        Ok(())
    }

    /// One thread and two; at the hardest setting of the campus also with a single submap, as peers have it.
    fn cases(&self) -> Vec<Case<'a>> {
        let case = Case { data: self.data, setting: self.setting, field: self.field, threads: 1, one_submap: false };
        let mut cases = vec![case];
        if self.suite.machine.cores > 1 {
            cases.push(Case { threads: 2, ..case });
        }
        if self.setting == HARDEST && self.data.truth == Truth::World {
            cases.push(Case { one_submap: true, ..case });
        }
        cases
    }

    /// Measures mesh extraction, for the map that the goals refer to.
    fn mesh(&mut self, case: &Case<'_>) -> Result<()> {
        if self.setting == HARDEST && self.field == FieldKind::Tsdf && self.data.truth == Truth::World && !case.one_submap {
            self.suite.special.mesh = Some(special::mesh(self.workspace, MAP)?);
        }
        Ok(())
    }

    /// Runs a peer; none if it does not map the field. The error says why there is no run; it does not end the suite.
    fn peer(&self, peer: &Peer, case: &Case<'_>, exported: &peers::ExportedScans) -> std::result::Result<Option<Run>, String> {
        tracing::info!("{}, {}, {}", case.data.name, case.setting, peer.name);
        let run = peer.run(self.workspace, case, exported, self.options.peer_limit).map_err(|problem| format!("{}: {problem}", peer.name))?;
        if run.note == peers::NOT_THIS_FIELD {
            return Ok(None);
        }
        if !run.note.is_empty() {
            tracing::warn!("{}: {}", run.system, run.note);
        }
        if run.scans == 0 { Err(format!("{}: {}", peer.name, run.note)) } else { Ok(Some(run)) }
    }
}

fn title(case: &Case<'_>) -> String {
    let one = if case.one_submap { ", one submap" } else { "" };
    format!("{}, {}, {}, {} threads{one}", case.data.name, case.setting, case.field.name(), case.threads)
}
