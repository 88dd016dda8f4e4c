//! `voxelastic check`: looks at some of the data before they are mapped, and says what is doubtful.

use crate::args::data::DataArgs;
use crate::failure;
use crate::output;
use anyhow::Context;
use clap::Args;
use serde::Serialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::geometry::{PoseExt, Rigid};
use voxelastic_eval::colour::Rgb;
use voxelastic_eval::grid_view::GridView;
use voxelastic_io::PoseKind;
use voxelastic_run::source::{CheckScan, Examination, Verdict, check_undistorted, pose_flags};
use voxelastic_run::{PosesCheck, Source, Warning, Warnings};

/// Look at some of the data: what they are, whether poses fit the scans, what is doubtful
///
/// Reads some of the scans and compares how the lidar moved by their surfaces with how it moved by the poses. Where the two disagree, it looks for the reading of
/// the poses under which they agree, and names the flags that set it. The picture shows two scans on each other from above: as the poses place them, and, if these
/// are doubtful, as the best reading does. Of clouds whose points have times it says whether their surfaces are sharper with another reading of these.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  voxelastic check hall                       what would be mapped, and whether it can be right
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
pub fn run(args: &CheckArgs) -> anyhow::Result<u8> {
    let mut warnings = Warnings::default();
    let options = args.data.options(false);
    let (source, found) = args.data.source(false, false, PoseKind::default(), PosesCheck::Warn, &mut warnings)?;
    let found = found.context("nothing was examined")?;
    check_undistorted(&found.sample, args.data.path(), &options, &mut warnings);
    let picture = args.output.as_deref().filter(|_| !found.sample.pairs.is_empty());
    picture.map(|file| draw(file, &found, options.t_base_lidar.as_ref())).transpose()?;
    let summary = Summary::of(&source, &found, found.poses.as_ref().and_then(|check| pose_flags(check, &options)), &warnings, picture);
    if args.json {
        output::print_json(&summary)?;
    } else {
        output::print(&summary.page())?;
    }
    Ok(if summary.warnings.is_empty() { failure::DONE } else { failure::DOUBTFUL })
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

const FIRST: Rgb = [214, 96, 34];
const SECOND: Rgb = [38, 96, 190];
const BOTH: Rgb = [40, 44, 52];
const PAPER: Rgb = [255, 255, 255];
/// Edge of a cell, metres, and how far around the lidar is drawn.
const PIXEL: f64 = 0.1;
const HALF: usize = 250;
/// Columns between two drawings.
const GAP: usize = 12;

/// Draws the pair of scans that lies farthest apart, from above.
fn draw(file: &Path, found: &Examination, t_base_lidar: Option<&Pose>) -> anyhow::Result<()> {
    let track = &found.sample.track;
    let distance = |(a, b): &&(CheckScan, CheckScan)| track[a.index()].1.translation_distance(&track[b.index()].1);
    let Some((first, second)) = found.sample.pairs.iter().max_by(|a, b| distance(a).total_cmp(&distance(b))) else { return Ok(()) };
    let given = track[first.index()].1.inv_mul(&track[second.index()].1);
    let best = found.poses.as_ref().and_then(|check| check.motion_under_best_reading(track, t_base_lidar, (first.index(), second.index())));
    let drawings: Vec<Vec<Rgb>> = [Some(given), best].into_iter().flatten().map(|motion| cells(first, second, &motion)).collect();
    let side = 2 * HALF;
    let width = drawings.len() * side + (drawings.len() - 1) * GAP;
    let mut all = vec![PAPER; width * side];
    for (k, drawing) in drawings.iter().enumerate() {
        for (row, cells) in drawing.chunks(side).enumerate() {
            let start = row * width + k * (side + GAP);
            all[start..start + side].copy_from_slice(cells);
        }
    }
    let title = if drawings.len() == 2 {
        "two scans from above: by the poses as they are (left), and as the scans agree (right)"
    } else {
        "two scans from above, by their poses"
    };
    let view = GridView {
        title: title.to_owned(),
        labels: ["x [m]", "y [m]"],
        origin: [-(HALF as f64) * PIXEL; 2],
        pixel: PIXEL,
        size: [width, side],
        cells: &all,
        legend: vec![(FIRST, "one scan".to_owned()), (SECOND, "the other".to_owned()), (BOTH, "both".to_owned())],
        ..GridView::default()
    };
    view.write_png(file).with_context(|| format!("cannot draw {}", file.display()))?;
    Ok(())
}

/// The cells that the points of two scans are in, around the first lidar.
fn cells(first: &CheckScan, second: &CheckScan, motion: &Pose) -> Vec<Rgb> {
    let side = 2 * HALF;
    let moved = Rigid::from(motion);
    let mut seen: HashMap<usize, u8> = HashMap::new();
    let points = first.points().iter().map(|p| (*p, 1)).chain(second.points().iter().map(|p| (moved.apply(*p), 2)));
    for (p, scan) in points {
        let cell = |v: f32| (f64::from(v) / PIXEL).floor() as i64 + HALF as i64;
        if let (Ok(x), Ok(y)) = (usize::try_from(cell(p[0])), usize::try_from(cell(p[1])))
            && x < side
            && y < side
        {
            *seen.entry(y * side + x).or_default() |= scan;
        }
    }
    let colour = |k: usize| match seen.get(&k) {
        None => PAPER,
        Some(1) => FIRST,
        Some(2) => SECOND,
        Some(_) => BOTH,
    };
    (0..side * side).map(colour).collect()
}
