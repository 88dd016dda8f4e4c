//! Other mapping systems on the same scans: a command in, JSON out.
//!
//! A peer takes part through an *adapter*, a program in any language. It is called with one argument, the path of a request, and prints
//! one JSON object a line on stdout.
//!
//! The request is a JSON object:
//!
//! | key | meaning |
//! | --- | --- |
//! | `format` | 1 |
//! | `field` | `"tsdf"` (surfaces) or `"occupancy"`: what is to be mapped |
//! | `voxel_m`, `max_range_m`, `min_range_m`, `threads` | how; ranges from the sensor, metres |
//! | `time_limit_s` | no scan should be begun after so many seconds; the adapter is stopped half a minute later |
//! | `scans` | in order: `points`, the path of a file of little-endian `f32` quadruples x, y, z, 0 in the lidar's frame (KITTI's `.bin`), returns only; `t_map_lidar`, the lidar's pose `[x, y, z, qx, qy, qz, qw]` in the map |
//! | `surface` | where the adapter may write the vertices of its mesh, or the centres of its occupied voxels, in the map's frame, again as x, y, z, 0 |
//!
//! The answer is a line `{"system": "OctoMap 1.10, discretised"}` first, then one for each scan, when it is in the map:
//! `{"scan": 0, "cpu_ms": 1.5, "wall_ms": 1.6}`, with `map_mb` and `peak_rss_mb` (10^6 bytes) where the adapter knows them. Reading the points
//! is not part of the times; what it takes until the map can be asked is. A last line `{"surface": true}` says that they were written.
//! Lines that are no JSON object are ignored, so that a library may talk. Exit with code 77 when the peer is not installed, and with 78 when it does
//! not map that field.
//!
//! `peers/octomap_adapter.py` and `peers/vdbfusion_adapter.py` beside this crate's sources are adapters, of which `peers/adapter.py` is the common part;
//! [`through_python`] runs them.

mod request;

use crate::error::Result;
use crate::process::{End, lines};
use crate::run::{Case, Run, Series};
use crate::workshop::{Workshop, load};
use crate::{BenchError, Dataset, quality};
pub(crate) use request::Handout;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::time::Duration;
use voxelastic_eval::Spread;

/// A mapping system that takes part through an adapter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Peer {
    /// Its name, until it tells a better one.
    pub name: String,
    /// The adapter's command line; the path of the request is added.
    pub command: Vec<String>,
}

/// The peers that have Python packages, with their adapters.
const ADAPTERS: [(&str, &str, &str); 2] = [
    ("OctoMap", "octomap_adapter.py", include_str!("../../peers/octomap_adapter.py")),
    ("VDBFusion", "vdbfusion_adapter.py", include_str!("../../peers/vdbfusion_adapter.py")),
];
/// What they share, a module beside them.
const SHARED: (&str, &str) = ("adapter.py", include_str!("../../peers/adapter.py"));
/// Time that an adapter has beyond the limit: to start, and to finish a scan.
const GRACE: Duration = Duration::from_secs(30);

/// OctoMap and VDBFusion through their Python packages, run with `python`.
///
/// # Errors
/// When an adapter cannot be put into the workshop.
pub fn through_python(shop: &Workshop, python: &str) -> Result<Vec<Peer>> {
    let put = |(file, text): (&str, &str)| {
        let script = shop.folder().join(file);
        fs::write(&script, text).map_err(BenchError::file(&script)).map(|()| script)
    };
    put(SHARED)?;
    let peer = |(name, file, text): (&str, &str, &str)| {
        let command = vec![python.to_owned(), put((file, text))?.display().to_string()];
        Ok(Peer { name: name.to_owned(), command })
    };
    ADAPTERS.into_iter().map(peer).collect()
}

impl Peer {
    /// Reads `NAME=COMMAND ARGUMENTS`; none when either is missing.
    pub fn parse(text: &str) -> Option<Self> {
        let (name, command) = text.split_once('=')?;
        let command: Vec<String> = command.split_whitespace().map(str::to_owned).collect();
        (!name.trim().is_empty() && !command.is_empty()).then(|| Self { name: name.trim().to_owned(), command })
    }

    /// Lets the peer map `case` from `handout`, for `limit` at most, and measures what it wrote.
    pub(crate) fn run(&self, shop: &Workshop, case: &Case<'_>, handout: &Handout, limit: Duration) -> Result<Run> {
        let (surface, load) = (shop.scratch("peer.bin"), load());
        shop.discard("peer.bin");
        let request = handout.request(case, limit, &surface)?;
        let (program, arguments) = self.command.split_first().map_or(("", &[][..]), |(p, a)| (p.as_str(), a));
        let mut all = arguments.to_vec();
        all.push(request.display().to_string());
        let mut answer = Answer { system: self.name.clone(), ..Answer::default() };
        let end = lines(program, &all, limit + GRACE, |line| answer.take(line))?;
        let offered = handout.len();
        let mut run = Run { load, scans_offered: offered, note: note(&end, answer.scans(), offered), ..answer.run(case) };
        run.command = crate::process::line(program, &all);
        if answer.wrote_surface && run.scans == offered {
            run.quality = quality::measure(shop, &surface, case.data, None)?;
        }
        Ok(run)
    }
}

/// Exit code of an adapter whose peer is not installed.
const ABSENT: &str = "77";
/// Exit code of an adapter whose peer does not map the field.
const OTHER_FIELD: &str = "78";
/// The note of a run that such an adapter leaves.
pub(crate) const NOT_THIS_FIELD: &str = "does not map this field";

/// What to say of a run that is not complete.
fn note(end: &End, done: usize, offered: usize) -> String {
    match end {
        End::Failed(status) if status.ends_with(ABSENT) => "skipped: not installed".to_owned(),
        End::Failed(status) if status.ends_with(OTHER_FIELD) => NOT_THIS_FIELD.to_owned(),
        End::Failed(status) => format!("failed: {status}"),
        End::Stopped => format!("stopped after {done} of {offered} scans"),
        End::Done if done < offered => format!("time was up after {done} of {offered} scans"),
        End::Done => String::new(),
    }
}

/// What an adapter has said so far.
#[derive(Debug, Default)]
struct Answer {
    system: String,
    series: Series,
    wrote_surface: bool,
}

impl Answer {
    fn take(&mut self, line: &str) {
        let Ok(Value::Object(said)) = serde_json::from_str(line) else { return };
        if let Some(system) = said.get("system").and_then(Value::as_str) {
            self.system = system.to_owned();
        }
        let number = |key: &str| said.get(key).and_then(Value::as_f64).filter(|v| *v >= 0.0);
        if let (true, Some(cpu), Some(wall)) = (said.contains_key("scan"), number("cpu_ms"), number("wall_ms")) {
            self.series.cpu_ms.push(cpu);
            self.series.wall_ms.push(wall);
            self.series.map_mb.extend(number("map_mb"));
            self.series.peak_mb.extend(number("peak_rss_mb"));
        }
        self.wrote_surface |= said.get("surface").and_then(Value::as_bool).unwrap_or(false);
    }

    fn scans(&self) -> usize {
        self.series.cpu_ms.len()
    }

    fn run(&self, case: &Case<'_>) -> Run {
        Run {
            system: self.system.clone(),
            scans: self.scans(),
            cpu_ms: Spread::of(&self.series.cpu_ms),
            wall_ms: Spread::of(&self.series.wall_ms),
            peak_rss_mb: self.series.peak_mb.last().copied(),
            map_mb: self.series.map_mb.last().copied(),
            repetitions_ms: Spread::of(&self.series.cpu_ms).median.into_iter().collect(),
            series: self.series.clone(),
            one_submap: true,
            ..case.named()
        }
    }
}

/// The scans of `data` as peers get them.
pub(crate) fn handout(data: &Dataset, folder: &Path) -> Result<Handout> {
    Handout::write(data, folder)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::{HARD, Truth};
    use voxelastic::settings::FieldKind;

    fn talk(script: &str, limit: Duration) -> Run {
        let dir = tempfile::tempdir().unwrap();
        let shop = Workshop::open("voxelastic".into(), dir.path().into()).unwrap();
        let adapter = dir.path().join("adapter.sh");
        fs::write(&adapter, script).unwrap();
        let data = Dataset { name: "two".into(), folder: "two".into(), poses: None, truth: Truth::None, max_scans: None };
        let case = Case { data: &data, setting: HARD, field: FieldKind::Occupancy, threads: 1, one_submap: true };
        let peer = Peer { name: "toy".into(), command: vec!["/bin/sh".into(), adapter.display().to_string()] };
        peer.run(&shop, &case, &Handout::of(dir.path(), 2), limit).unwrap()
    }

    #[test]
    fn an_adapter_is_told_what_to_map_and_its_lines_are_read() {
        let script = r#"
            grep -q '"voxel_m":0.065' "$1" && grep -q '"time_limit_s":5.0' "$1" || exit 1
            echo '{"system": "Toy 2"}'; echo a library talks
            echo '{"scan": 0, "cpu_ms": 3, "wall_ms": 4, "map_mb": 1, "peak_rss_mb": 9}'
            echo '{"scan": 1, "cpu_ms": 5, "wall_ms": 6, "map_mb": 2, "peak_rss_mb": 10}'"#;
        let run = talk(script, Duration::from_secs(5));
        assert_eq!((run.system.as_str(), run.scans, run.note.as_str()), ("Toy 2", 2, ""));
        assert_eq!((run.cpu_ms.mean, run.map_mb, run.peak_rss_mb), (Some(4.0), Some(2.0), Some(10.0)));
    }

    #[test]
    fn an_adapter_that_gives_up_early_says_so() {
        let run = talk("echo '{\"scan\": 0, \"cpu_ms\": 3, \"wall_ms\": 4}'", Duration::from_secs(5));
        assert_eq!((run.scans, run.note.as_str()), (1, "time was up after 1 of 2 scans"));
        assert_eq!(talk("exit 77", Duration::from_secs(5)).note, "skipped: not installed");
        assert_eq!(talk("exit 78", Duration::from_secs(5)).note, NOT_THIS_FIELD);
        assert!(talk("exit 3", Duration::from_secs(5)).note.starts_with("failed: "));
    }

    #[test]
    fn peers_are_named_on_the_command_line() {
        let peer = Peer::parse("Bonxai = python3 bonxai.py").unwrap();
        assert_eq!((peer.name.as_str(), peer.command.len()), ("Bonxai", 2));
        assert!(Peer::parse("nothing").is_none() && Peer::parse("x=").is_none());
    }
}
