//! `voxelastic refine`: the surfaces of a map correct its poses.

use crate::args::DataArgs;
use crate::failure::{self, Failure};
use crate::progress::Progress;
use crate::{interrupt, output};
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::Mapper;
use voxelastic_io::store::MapWriter;
use voxelastic_run::map_files::{self, Loading};
use voxelastic_run::refining::{MapScans, PlaneFigures, RefineSummary, rebuilt};
use voxelastic_run::{Source, Warning, Warnings, threads, usage};

/// Refine the poses of a map by its surfaces, and make the map again with them
///
/// Bundle adjustment over planes: poses and planes are found together, so that the planes that several scans see become as thin as they can. The scans are read again from DATA,
/// with the same flags as for `voxelastic map`. A tenth of what was measured is held out and judges: where it does not lie nearer to the planes of other scans afterwards, the poses,
/// and the map, stay as they are, which is said. Poses should be right within half a metre before (loop closures, optimisation).
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic refine hall.vox hall                    replaces hall.vox, when all is done
  voxelastic refine hall.vox hall -o refined.vox     writes another map
  voxelastic refine hall.vox hall --dry-run --json   only says how thick planes are, and would be")]
pub struct RefineArgs {
    /// The map
    #[arg(value_name = "MAP.vox")]
    map: PathBuf,
    #[command(flatten)]
    data: DataArgs,
    /// The map to write [default: MAP.vox is replaced]
    #[arg(short, long, value_name = "OUT.vox")]
    output: Option<PathBuf>,
    /// Refine the poses and say what comes of it, and write nothing
    #[arg(long, conflicts_with = "output")]
    dry_run: bool,
    /// Number of threads; 0 for all cores. The result does not depend on it
    #[arg(long, value_name = "N", default_value_t = 0)]
    threads: usize,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary<'a> {
    /// The map that was written; `null` if none was.
    #[serde(serialize_with = "crate::output::optional_path")]
    output: Option<&'a Path>,
    #[serde(flatten)]
    refinement: RefineSummary,
    /// Submaps that were made again.
    submaps_rebuilt: usize,
    /// Time to read the scans, to refine the poses, and in all, seconds.
    read_s: f64,
    refine_s: f64,
    total_s: f64,
    /// Peak resident memory, megabytes (10^6 bytes); `null` where the system does not report it.
    peak_rss_mb: Option<f64>,
    /// What there is to say that is no error.
    warnings: Vec<Warning>,
}

/// Runs the command.
pub fn run(args: &RefineArgs, quiet: bool) -> anyhow::Result<u8> {
    let clock = Instant::now();
    args.data.check(false)?;
    let mut warnings = Warnings::default();
    let store = map_files::open(&args.map)?;
    if store.manifest().all_sessions().len() > 1 {
        let remedy = "refine each of them before they are put together: their scans are in several data sets";
        return Err(Failure::new(format!("{}: a map of several sessions cannot be refined", args.map.display()), remedy).into());
    }
    let details = store.manifest().details.clone();
    drop(store);
    let mut writer = match (&args.output, args.dry_run) {
        (_, true) => None,
        (Some(path), _) => Some(MapWriter::create(path).context("cannot write the map there")?),
        (None, _) => Some(MapWriter::open(&args.map)?),
    };
    interrupt::install("stopping; the map stays as it was");
    let pool = threads::pool(args.threads)?;
    let map = pool.install(|| map_files::load(&args.map, Loading::AS_STORED))?;
    let (source, _) = Source::open_decided(args.data.path(), &args.data.options(false), None, &mut Warnings::default())?;
    play(&source)?;
    let mut clouds = source.clouds();
    let before_reading = clock.elapsed();
    let mut progress = Progress::new("scans read", Some(map.atlas.submaps().iter().map(|s| s.scans().len() as u64).sum()), quiet);
    let scans = pool.install(|| {
        MapScans::read(&map.atlas, clouds.as_mut(), |_, _| {
            progress.step(String::new);
            !interrupt::requested()
        })
    })?;
    drop(progress);
    let Some(scans) = scans else { return Ok(stopped(writer)) };
    let read_s = (clock.elapsed() - before_reading).as_secs_f64();
    let before_refining = clock.elapsed();
    let (poses, refinement) = pool.install(|| scans.refine(&mut warnings))?;
    let refine_s = (clock.elapsed() - before_refining).as_secs_f64();
    log_figures(&refinement);
    let mut submaps_rebuilt = 0;
    let mut is_written = false;
    if let (Some(writer), Some(poses)) = (&mut writer, poses) {
        let mapper = Mapper::in_saved(map.settings.clone(), source.sensor(), map.atlas)?;
        let mut progress = Progress::new("submaps made again", Some(mapper.atlas().submaps().len() as u64), quiet);
        let (mapping, is_whole) = rebuilt(mapper, pool, poses, clouds.as_mut(), &mut warnings, |_, _| {
            progress.step(String::new);
            !interrupt::requested()
        })?;
        drop(progress);
        if is_whole {
            submaps_rebuilt = mapping.mapper().elastic_counts().rebuilds;
            let atlas = mapping.atlas();
            mapping.pool().install(|| writer.save(atlas, &details)).context("cannot save the map; it is as it was before")?;
            is_written = true;
        }
    }
    if interrupt::requested() {
        return Ok(stopped(writer));
    }
    let output = is_written.then(|| args.output.as_deref().unwrap_or(&args.map));
    if let Some(path) = output {
        tracing::info!("saved {}: {submaps_rebuilt} submaps were made again", path.display());
    } else if let Some(writer) = writer {
        writer.abandon();
    }
    let (total_s, peak_rss_mb) = (clock.elapsed().as_secs_f64(), usage::peak_resident_bytes().map(usage::megabytes));
    if args.json {
        let warnings = warnings.all().to_vec();
        output::print_json(&Summary { output, refinement, submaps_rebuilt, read_s, refine_s, total_s, peak_rss_mb, warnings })?;
    }
    Ok(failure::DONE)
}

/// Of recordings, clouds can be read again only once they were played.
fn play(source: &Source) -> anyhow::Result<()> {
    if source.scans().is_none() {
        source.inputs().take_while(|_| !interrupt::requested()).for_each(drop);
    }
    Ok(())
}

fn stopped(writer: Option<MapWriter>) -> u8 {
    writer.into_iter().for_each(MapWriter::abandon);
    failure::INTERRUPTED
}

fn log_figures(summary: &RefineSummary) {
    let cm = |metres: Option<f64>| metres.map_or_else(|| "-".to_owned(), |m| format!("{:.2} cm", 100.0 * m));
    let line = |what: &str, f: &PlaneFigures| {
        let (near, planes) = (100.0 * f.near, f.planes);
        let (half, most) = (cm(f.thickness_m), cm(f.thickness_90_m));
        tracing::info!(
            "{what}: {planes} planes, half of them thinner than {half}, 90 % than {most}; {near:.0} % of held-out points near one, half within {}",
            cm(f.distance_m)
        );
    };
    line("before", &summary.before);
    if summary.refined {
        line("after", &summary.after);
        let (rms, most) = (100.0 * summary.moved_rms_m, 100.0 * summary.moved_most_m);
        tracing::info!("{} scans moved by {rms:.1} cm (root mean square), {most:.1} cm at most", summary.scans);
    }
}
