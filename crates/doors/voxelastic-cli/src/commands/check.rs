//! `voxelastic check`: looks at some of the data before they are mapped, and says what is doubtful.

use crate::args::data::DataArgs;
use crate::failure::{self, Failure};
use crate::output;
use crate::progress::Progress;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use voxelastic_io::PoseKind;
use voxelastic_run::editing::MapCheck;
use voxelastic_run::source::{Examination, Verdict, check_undistorted, draw_pair, pose_flags};
use voxelastic_run::{PosesCheck, Source, Warning, Warnings, map_files, threads};

/// Look at some of the data, or at a map: what they are, whether poses fit the scans, what is doubtful
///
/// Reads some of the scans and compares how the lidar moved by their surfaces with how it moved by the poses. Where the two disagree, it looks for the reading of
/// the poses under which they agree, and names the flags that set it. The picture shows two scans on each other from above: as the poses place them, and, if these
/// are doubtful, as the best reading does. Of clouds whose points have times it says whether their surfaces are sharper with another reading of these.
///
/// Of a map it lists what is least consistent, each with an edit that would mend it, as `voxelastic edit MAP --apply` takes it: closures that bend it, submaps that do
/// not fit, what leans.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic check hall                       what would be mapped, and whether it can be right
  voxelastic check hall.vox > edits.toml      what is least consistent in a map, with edits that would mend it
  voxelastic check drive.bag -o drive.png     draws two scans on each other
  voxelastic check DATA --json                for programs; exit code 3 if something is doubtful")]
pub struct CheckArgs {
    #[command(flatten)]
    data: DataArgs,
    /// Draw two scans on each other as the poses place them
    #[arg(short, long, value_name = "FILE.png")]
    output: Option<PathBuf>,
    /// Print one JSON object on stdout
    #[arg(long)]
    json: bool,
}

/// The keys of `--json`.
#[derive(Debug, Serialize)]
struct Summary {
    /// What was found, in lines.
    description: Vec<String>,
    /// Clouds that were read.
    clouds: usize,
    /// Returns of the middle one.
    returns: usize,
    /// 95 % of the returns are within this range, metres.
    range_m: f32,
    /// Time from the first to the last point of a cloud, seconds; `null` where points have no times.
    sweep_s: Option<f64>,
    /// Time between clouds, seconds; `null` where not all were read.
    interval_s: Option<f64>,
    /// The comparison of poses with scans; `null` where there are no poses.
    poses: Option<Poses>,
    /// What is doubtful, each with a stable `code`, `text`, `remedy` and `count`.
    warnings: Vec<Warning>,
    /// The picture that was drawn.
    picture: Option<PathBuf>,
}

/// A comparison of poses with scans.
#[derive(Debug, Serialize)]
struct Poses {
    /// `agree`, `agree-better` (with the lidar mounted a little otherwise), `disagree`, `undecided`.
    verdict: &'static str,
    /// Pairs of scans whose surfaces tell how the lidar moved, and those for which the poses say the same.
    pairs: usize,
    agreeing: usize,
    /// How far apart the two are in the middle of all pairs.
    median_m: f64,
    median_degrees: f64,
    /// Flags under which they agree, if some are known.
    flags: Option<String>,
}

/// Runs the command.
pub fn run(args: &CheckArgs, quiet: bool) -> anyhow::Result<u8> {
    if map_files::is_map(args.data.path()) {
        return of_map(args, quiet);
    }
    let mut warnings = Warnings::default();
    let options = args.data.options(false);
    let (source, found) = args.data.source(false, false, PoseKind::default(), PosesCheck::Warn, &mut warnings)?;
    let found = found.context("nothing was examined")?;
    check_undistorted(&found.sample, args.data.path(), &options, &mut warnings);
    let picture = args.output.as_deref().filter(|_| !found.sample.pairs.is_empty());
    picture.map(|file| draw_pair(file, &found, options.t_base_lidar.as_ref())).transpose()?;
    let summary = Summary::of(&source, &found, found.poses.as_ref().and_then(|check| pose_flags(check, &options)), &warnings, picture);
    if args.json {
        output::print_json(&summary)?;
    } else {
        output::print(&summary.page())?;
    }
    Ok(if summary.warnings.is_empty() { failure::DONE } else { failure::DOUBTFUL })
}

fn of_map(args: &CheckArgs, quiet: bool) -> anyhow::Result<u8> {
    if args.output.is_some() || args.data.says_how_to_read() {
        return Err(Failure::usage("a map has no scans to draw, and is not read as data are", "do without -o and flags about the input").into());
    }
    let mut progress = Progress::new("edits tried", None, quiet);
    let found = threads::pool(0)?.install(|| MapCheck::of(args.data.path(), &mut || progress.step(String::new)))?;
    drop(progress);
    if args.json {
        output::print_json(&found)?;
    } else {
        output::print(&found.page())?;
    }
    Ok(if found.suggestions.is_empty() { failure::DONE } else { failure::DOUBTFUL })
}

impl Summary {
    fn of(source: &Source, found: &Examination, flags: Option<String>, warnings: &Warnings, picture: Option<&Path>) -> Self {
        let sample = &found.sample;
        let mut clouds = sample.clouds.clone();
        clouds.sort_by_key(|cloud| cloud.returns);
        let (returns, range_m) = clouds.get(clouds.len() / 2).map(|cloud| (cloud.returns, cloud.range_m)).unwrap_or_default();
        let poses = found.poses.as_ref().map(|check| Poses {
            verdict: match check.verdict {
                Verdict::Agree => "agree",
                Verdict::AgreeBetter(_) => "agree-better",
                Verdict::Disagree(_) => "disagree",
                Verdict::Undecided => "undecided",
            },
            pairs: check.pairs,
            agreeing: check.agreeing,
            median_m: check.median.0,
            median_degrees: check.median.1.to_degrees(),
            flags,
        });
        Self {
            description: source.description().lines().map(str::to_owned).collect(),
            clouds: clouds.len(),
            returns,
            range_m,
            sweep_s: sample.sweep_s(),
            interval_s: sample.interval_s,
            poses,
            warnings: warnings.all().to_vec(),
            picture: picture.map(Path::to_owned),
        }
    }

    /// For people, on a page.
    fn page(&self) -> String {
        let mut rows: Vec<(String, String)> = Vec::new();
        let mut row = |name: &str, value: String| rows.push((name.to_owned(), value));
        for line in &self.description {
            let (name, value) = line.split_once(": ").unwrap_or(("", line));
            row(name, value.to_owned());
        }
        row("read for this", format!("{} clouds, {} returns in the middle one, 95 % within {:.1} m", self.clouds, self.returns, self.range_m));
        row(
            "times of points",
            match (self.sweep_s, self.interval_s) {
                (None, _) => "none: clouds are taken as they are, undistorted or not".to_owned(),
                (Some(sweep), None) => format!("a sweep takes {:.1} ms", sweep * 1e3),
                (Some(sweep), Some(interval)) => format!("a sweep takes {:.1} ms, clouds come every {:.1} ms", sweep * 1e3, interval * 1e3),
            },
        );
        row(
            "poses on scans",
            match &self.poses {
                None => "no poses: the odometry estimates them".to_owned(),
                Some(p) if p.verdict == "undecided" => format!("not known: {} of {} pairs agree that tell how the lidar moved", p.agreeing, p.pairs),
                Some(p) => format!(
                    "{} of {} pairs agree; {:.1} cm and {:.2} degrees apart in the middle",
                    p.agreeing,
                    p.pairs,
                    p.median_m * 100.0,
                    p.median_degrees
                ),
            },
        );
        if let Some(file) = &self.picture {
            row("picture", file.display().to_string());
        }
        for (k, warning) in self.warnings.iter().enumerate() {
            row(if k == 0 { "doubtful" } else { "" }, format!("{} [{}]", warning.text, warning.code));
            row("", format!("-> {}", warning.remedy));
        }
        if self.warnings.is_empty() {
            row("doubtful", "nothing".to_owned());
        }
        rows.iter().map(|(name, value)| format!("{name:<22}{value}\n")).collect()
    }
}
