//! The suite: three settings, two fields, threads, on all scans there are, with peers in between.

use crate::data::{self, Dataset, Truth};
use crate::elastic::{self, Elastic};
use crate::error::Result;
use crate::goals::{self, Goal};
use crate::peers::{self, Peer};
use crate::run::{Case, Run, middle};
use crate::setting::{FIELDS, HARD, SETTINGS, Setting};
use crate::workshop::{Workshop, load};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use voxelastic::settings::FieldKind;

/// What is measured.
#[derive(Clone, Debug)]
pub struct Options {
    /// A first look: the hardest setting only, on the beginning of the campus, no errors, no peers' clouds.
    pub quick: bool,
    /// Systems that take part.
    pub peers: Vec<Peer>,
    /// Time that a peer has for one configuration.
    pub peer_limit: Duration,
    /// How often each configuration is run; the middle one counts.
    pub repeat: usize,
    /// The folder with real scans.
    pub real_data: PathBuf,
    /// A campus that was simulated before.
    pub campus: Option<PathBuf>,
}

/// The machine.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Machine {
    /// The processor's name; empty where the system does not tell.
    pub cpu: String,
    /// Processors that may be used.
    pub cores: usize,
    /// Load when the measuring began.
    pub load_before: Option<f64>,
    /// Load when it ended.
    pub load_after: Option<f64>,
}

/// All that was measured. The keys of `bench.json`; they stay, further ones may come.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Suite {
    /// 1.
    pub format: u32,
    /// Who measured.
    pub generator: String,
    /// Where.
    pub machine: Machine,
    /// Whether it was a first look only.
    pub quick: bool,
    /// A row of the table each.
    pub runs: Vec<Run>,
    /// Corrections, second visits, the mesh.
    pub elastic: Elastic,
    /// What was aimed at.
    pub goals: Vec<Goal>,
    /// What was left out, and why.
    pub skipped: Vec<String>,
    /// How long it took, seconds.
    pub total_s: f64,
}

/// Scans of the quick look.
const QUICK_SCANS: usize = 60;
/// Times that peers have, for two laps, what they have for other runs: one that does not come to the end says nothing.
const LAPS_LIMIT: u32 = 6;
/// Name of the map under measurement.
const MAP: &str = "run.vox";

/// Measures everything that `options` ask for.
///
/// # Errors
/// When a program of ours fails or data cannot be read. A peer that fails is noted and left out.
pub fn run(shop: &Workshop, options: &Options) -> Result<Suite> {
    let clock = Instant::now();
    let mut suite = Suite { format: 1, generator: generator(), machine: machine(), quick: options.quick, ..Suite::default() };
    let datasets = datasets(shop, options, &mut suite.skipped)?;
    let settings: &[Setting] = if options.quick { &[HARD] } else { &SETTINGS };
    for data in &datasets {
        let handout = if options.peers.is_empty() { None } else { Some(peers::handout(data, &shop.scratch("handout"))?) };
        for &setting in settings {
            for field in FIELDS {
                let mut round = Round { shop, options, data, setting, field, handout: handout.as_ref(), suite: &mut suite };
                round.run()?;
            }
        }
        shop.discard("handout");
    }
    suite.elastic.pose_update = elastic::pose_updates(&[1000])?.pop();
    if !options.quick {
        let (usual, others) = elastic::second_laps(shop, &options.peers, LAPS_LIMIT * options.peer_limit, &mut suite.skipped)?;
        (suite.elastic.second_lap, suite.elastic.second_lap_others) = (Some(usual), others);
    }
    suite.goals = goals::all(&suite);
    suite.machine.load_after = load();
    suite.total_s = clock.elapsed().as_secs_f64();
    Ok(suite)
}

/// The program and its version.
pub(crate) fn generator() -> String {
    concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// What the system tells of itself.
pub(crate) fn machine() -> Machine {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|l| l.strip_prefix("model name")?.split_once(':')).map(|(_, name)| name.trim().to_owned());
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    Machine { cpu: name.unwrap_or_default(), cores, load_before: load(), load_after: None }
}

fn datasets(shop: &Workshop, options: &Options, skipped: &mut Vec<String>) -> Result<Vec<Dataset>> {
    let mut campus = data::campus(shop, options.campus.as_deref())?;
    if options.quick {
        campus = Dataset { truth: Truth::None, max_scans: Some(QUICK_SCANS), ..campus };
        return Ok(vec![campus]);
    }
    let (real, missing) = data::real(&options.real_data);
    missing.iter().for_each(|m| tracing::warn!("{m}"));
    skipped.extend(missing);
    Ok(std::iter::once(campus).chain(real).collect())
}

/// All runs of one field at one setting on the same scans: one after the other, so that they see the same machine.
struct Round<'a> {
    shop: &'a Workshop,
    options: &'a Options,
    data: &'a Dataset,
    setting: Setting,
    field: FieldKind,
    handout: Option<&'a peers::Handout>,
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
                let mut run = case.run(self.shop, MAP)?;
                // The map is the same for any number of threads, in every repetition.
                if case.threads == 1 && repetition == 0 && !self.options.quick {
                    run.quality = case.judge(self.shop, MAP)?;
                    self.mesh(case)?;
                }
                self.shop.discard(MAP);
                runs.push(run);
            }
            if let Some(handout) = self.handout {
                for (peer, runs) in self.options.peers.iter().zip(&mut theirs) {
                    match self.peer(peer, &cases[0], handout) {
                        Ok(run) => runs.extend(run),
                        Err(why) if !self.suite.skipped.contains(&why) => self.suite.skipped.push(why),
                        Err(_) => {}
                    }
                }
            }
        }
        for runs in ours.into_iter().chain(theirs) {
            let quality = runs.iter().find_map(|r| r.quality.clone());
            self.suite.runs.extend(middle(runs).map(|run| Run { quality, ..run }));
        }
        Ok(())
    }

    /// One thread and two; at the hardest setting of the campus everything in one submap, too, as peers have it.
    fn cases(&self) -> Vec<Case<'a>> {
        let case = Case { data: self.data, setting: self.setting, field: self.field, threads: 1, one_submap: false };
        let mut cases = vec![case];
        if self.suite.machine.cores > 1 {
            cases.push(Case { threads: 2, ..case });
        }
        if self.setting == HARD && self.data.truth == Truth::World {
            cases.push(Case { one_submap: true, ..case });
        }
        cases
    }

    /// The mesh of everything, of the map that the goals speak of.
    fn mesh(&mut self, case: &Case<'_>) -> Result<()> {
        if self.setting == HARD && self.field == FieldKind::Tsdf && self.data.truth == Truth::World && !case.one_submap {
            self.suite.elastic.mesh = Some(elastic::mesh(self.shop, MAP)?);
        }
        Ok(())
    }

    /// A peer's run if it maps the field, or why there is none: what is wrong with a peer does not end the measuring.
    fn peer(&self, peer: &Peer, case: &Case<'_>, handout: &peers::Handout) -> std::result::Result<Option<Run>, String> {
        tracing::info!("{}, {}, {}", case.data.name, case.setting, peer.name);
        let run = peer.run(self.shop, case, handout, self.options.peer_limit).map_err(|problem| format!("{}: {problem}", peer.name))?;
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
