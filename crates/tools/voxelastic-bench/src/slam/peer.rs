//! Peers of odometry and loop closure, by adapters.
//!
//! An adapter is called with the path of a request, a JSON object: `format` (1), `threads`, `min_range_m`, `max_range_m`, `time_limit_s` (no scan should
//! be started later), `imu` (where there is an inertial measurement unit: the path of a file of little-endian `f64` rows of time in seconds, angular velocity and
//! specific force, as at the lidar's origin and along its axes) and `scans`, each with `points`, the path of a file of little-endian `f32`
//! quadruples x, y, z, t in the lidar's frame, returns only; where the scans have times, `time_s`, to which t is relative; and, where odometry is given,
//! `t_map_lidar`, three rows of four numbers in a list.
//!
//! It prints JSON objects, one a line: `{"system": "KISS-ICP 1.3.0"}`; for each scan `{"scan": 0, "cpu_ms": 1.5, "pose": rows}` (or null; with `peak_rss_mb` where it is known); at the end,
//! if they have changed, `{"poses": [rows, ..]}`; and for each closure `{"closure": [from, to], "t_from_to": rows}`, scans by number. Exit code 77: not
//! installed; 78: it cannot do this with these scans.

use super::results::{Recording, SlamRun};
use super::score::{self, Claimed, Truth};
use crate::error::{BenchError, Result};
use crate::peers::environments::{EVALIO, GENZ_ICP, GENZ_LIO, KISS, PELORUS, Package, RETRO_SLAM, RKO_LIO};
use crate::peers::{Interpreters, user_lines, write_adapter};
use crate::process::{Outcome, command_line, run_lines};
use crate::workspace::Workspace;
use serde::Serialize;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic::event::Event;
use voxelastic::{Cloud, Pose};
use voxelastic_io::dataset::{self, OpenOptions};
use voxelastic_io::raw;

/// An adapter of this crate.
struct Adapter {
    name: &'static str,
    file: &'static str,
    text: &'static str,
    /// Which of the systems in the package, where there are several.
    argument: Option<&'static str>,
    task: &'static str,
    package: Package,
}

const EVALIO_FILE: (&str, &str) = ("evalio_adapter.py", include_str!("../../peers/evalio_adapter.py"));

const fn evalio(name: &'static str, argument: &'static str) -> Adapter {
    Adapter { name, file: EVALIO_FILE.0, text: EVALIO_FILE.1, argument: Some(argument), task: ODOMETRY, package: EVALIO }
}

macro_rules! adapter {
    ($name:literal, $file:literal, $task:expr, $package:expr) => {
        Adapter { name: $name, file: $file, text: include_str!(concat!("../../peers/", $file)), argument: None, task: $task, package: $package }
    };
}

const ODOMETRY: &str = "odometry";
const BOTH: &str = "odometry and closures";
const ADAPTERS: [Adapter; 16] = [
    adapter!("KISS-ICP", "kiss_icp_adapter.py", ODOMETRY, KISS),
    adapter!("GenZ-ICP", "genz_icp_adapter.py", ODOMETRY, GENZ_ICP),
    adapter!("KISS-SLAM", "kiss_slam_adapter.py", BOTH, KISS),
    adapter!("RETRO-SLAM", "retro_slam_adapter.py", BOTH, RETRO_SLAM),
    adapter!("MapClosures", "map_closures_adapter.py", "closures, odometry given", KISS),
    adapter!("RKO-LIO", "rko_lio_adapter.py", ODOMETRY, RKO_LIO),
    adapter!("GenZ-LIO", "genz_lio_adapter.py", ODOMETRY, GENZ_LIO),
    adapter!("Pelorus", "pelorus_adapter.py", ODOMETRY, PELORUS),
    evalio("KISS-ICP of evalio", "kiss"),
    evalio("GenZ-ICP of evalio", "genz"),
    evalio("MAD-ICP of evalio", "mad"),
    evalio("CT-ICP of evalio", "ct"),
    evalio("LOAM of evalio", "loam"),
    evalio("FORM of evalio", "form"),
    evalio("LIO-SAM of evalio", "liosam"),
    evalio("DLIO of evalio", "dlio"),
];
/// The module that they share.
const SHARED: (&str, &str) = ("slam.py", include_str!("../../peers/slam.py"));
/// Why a peer was not run that cannot do this with these scans.
pub(crate) const NOT_FOR_THESE: &str = "not for these scans";
/// Ranges of returns that count, metres.
const RANGES: (f64, f64) = (0.5, 100.0);
/// Time beyond the limit for an adapter to start and to finish a scan.
const GRACE: Duration = Duration::from_secs(60);

/// A system with its adapter.
#[derive(Debug)]
pub(crate) struct SlamPeer {
    name: &'static str,
    task: &'static str,
    python: String,
    script: PathBuf,
    argument: Option<&'static str>,
    user_lines: Option<usize>,
}

#[derive(Debug, Serialize)]
struct Scan {
    points: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    t_map_lidar: Option<Vec<f64>>,
}

#[derive(Debug, Serialize)]
struct Request<'a> {
    format: u32,
    threads: usize,
    min_range_m: f64,
    max_range_m: f64,
    time_limit_s: f64,
    imu: Option<&'a Path>,
    scans: &'a [Scan],
}

/// The scans of a recording as plain files.
#[derive(Debug)]
pub(crate) struct Exported {
    folder: PathBuf,
    scans: Vec<Scan>,
    imu: Option<PathBuf>,
}

impl Exported {
    pub fn write(data: &Path, recording: &Recording, folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder).map_err(BenchError::file(folder))?;
        let mut exported = Self { folder: folder.to_path_buf(), scans: Vec::new(), imu: None };
        if recording.sweeps {
            exported.write_sweeps(data)?
        } else {
            exported.write_scans(data, recording)?
        }
        Ok(exported)
    }

    /// Scans without times, with the odometry that is given.
    fn write_scans(&mut self, data: &Path, recording: &Recording) -> Result<()> {
        let poses = recording.odometry.unwrap_or(recording.truth);
        let source = dataset::open(data, &OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() })?;
        for event in source.events() {
            if let Event::Scan(scan) = event? {
                let points = self.write_points(&scan.cloud, false)?;
                let t_map_lidar = recording.odometry.map(|_| score::row_of(&scan.t_map_lidar).to_vec());
                self.scans.push(Scan { points, time_s: None, t_map_lidar });
            }
        }
        Ok(())
    }

    /// Sweeps whose points have times, and the samples of the inertial measurement unit.
    fn write_sweeps(&mut self, data: &Path) -> Result<()> {
        let mut samples = Vec::new();
        for scan in raw::open(data, &OpenOptions::default())?.iter() {
            let scan = scan?;
            let points = self.write_points(&scan.cloud, true)?;
            self.scans.push(Scan { points, time_s: Some(scan.time), t_map_lidar: None });
            for sample in scan.imu {
                let [wx, wy, wz] = sample.angular_velocity;
                let [ax, ay, az] = sample.acceleration;
                samples.extend([sample.time, wx, wy, wz, ax, ay, az].map(f64::to_le_bytes).concat());
            }
        }
        let path = self.folder.join("imu.bin");
        fs::write(&path, samples).map_err(BenchError::file(&path))?;
        self.imu = Some(path);
        Ok(())
    }

    fn write_points(&self, cloud: &Cloud, with_times: bool) -> Result<PathBuf> {
        let path = self.folder.join(format!("{:06}.bin", self.scans.len()));
        let times = cloud.time.as_ref().filter(|times| with_times && times.len() == cloud.len());
        let rows = cloud.points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p));
        let row = |(k, [x, y, z]): (usize, &[f32; 3])| [*x, *y, *z, times.map_or(0.0, |times| times[k])].map(f32::to_le_bytes).concat();
        fs::write(&path, rows.flat_map(row).collect::<Vec<u8>>()).map_err(BenchError::file(&path))?;
        Ok(path)
    }

    fn request(&self, limit: Duration) -> Result<PathBuf> {
        let (min_range_m, max_range_m) = RANGES;
        let request = Request {
            format: 1,
            threads: 1,
            min_range_m,
            max_range_m,
            time_limit_s: limit.as_secs_f64(),
            imu: self.imu.as_deref(),
            scans: &self.scans,
        };
        let path = self.folder.join("request.json");
        let text = serde_json::to_string(&request).map_err(|e| BenchError::Answer { command: "request".to_owned(), problem: e.to_string() })?;
        fs::write(&path, text).map_err(BenchError::file(&path))?;
        Ok(path)
    }
}

/// All peers, and why those are missing that cannot be installed.
pub(crate) fn all(workspace: &Workspace, interpreters: &Interpreters) -> Result<(Vec<SlamPeer>, Vec<String>)> {
    write_adapter(workspace, SHARED.0, SHARED.1)?;
    let (mut found, mut missing) = (Vec::new(), Vec::new());
    for Adapter { name, file, text, argument, task, package } in ADAPTERS {
        let script = write_adapter(workspace, file, text)?;
        match interpreters.of(&package) {
            Ok(python) => found.push(SlamPeer { name, task, python, script, argument, user_lines: user_lines(text) }),
            Err(why) => missing.push(format!("{name}: {why}")),
        }
    }
    Ok((found, missing))
}

impl SlamPeer {
    pub fn name(&self) -> &str {
        self.name
    }

    /// Whether it looks for closures.
    pub fn closes(&self) -> bool {
        self.task != ODOMETRY
    }

    /// Runs it on the scans. The inner error says why there is no run.
    pub fn run(&self, workspace: &Workspace, exported: &Exported, truth: &Truth, limit: Duration) -> Result<std::result::Result<SlamRun, String>> {
        let mut arguments = vec![self.script.display().to_string(), exported.request(limit)?.display().to_string()];
        arguments.extend(self.argument.map(str::to_owned));
        let mut answer = Answer::default();
        let outcome = run_lines(&self.python, &arguments, limit + GRACE, |line| answer.read_line(line))?;
        workspace.remove_scratch("request.json");
        let note = match outcome {
            Outcome::Failed(status) if status.ends_with("77") => return Ok(Err("not installed".to_owned())),
            Outcome::Failed(status) if status.ends_with("78") => return Ok(Err(format!("{NOT_FOR_THESE}: its adapter says above why"))),
            Outcome::Failed(status) => format!("failed: {status}"),
            Outcome::TimedOut => "stopped at the time limit".to_owned(),
            Outcome::Success => String::new(),
        };
        if answer.cpu_ms.is_empty() {
            return Ok(Err(if note.is_empty() { "no answer".to_owned() } else { note }));
        }
        Ok(Ok(SlamRun {
            system: if answer.system.is_empty() { self.name.to_owned() } else { answer.system },
            task: self.task,
            scans: answer.cpu_ms.len(),
            scans_offered: exported.scans.len(),
            cpu_ms: Some(answer.cpu_ms.iter().sum::<f64>() / answer.cpu_ms.len() as f64),
            path: truth.path(&answer.poses),
            closures: self.closes().then(|| truth.closures(&answer.closures)),
            peak_rss_mb: answer.peak_mb,
            user_lines: self.user_lines,
            command: command_line(&self.python, &arguments),
            note,
            ..SlamRun::default()
        }))
    }
}

/// The output of an adapter so far.
#[derive(Debug, Default)]
struct Answer {
    system: String,
    cpu_ms: Vec<f64>,
    peak_mb: Option<f64>,
    poses: Vec<Pose>,
    closures: Vec<Claimed>,
}

impl Answer {
    fn read_line(&mut self, line: &str) {
        let Ok(answer) = serde_json::from_str::<Value>(line) else { return };
        if let Some(system) = answer.get("system").and_then(Value::as_str) {
            self.system = system.to_owned();
        }
        if let (true, Some(cpu)) = (answer.get("scan").is_some(), answer.get("cpu_ms").and_then(Value::as_f64)) {
            self.cpu_ms.push(cpu);
            self.poses.extend(answer.get("pose").and_then(score::pose));
            self.peak_mb = answer.get("peak_rss_mb").and_then(Value::as_f64).or(self.peak_mb);
        }
        if let Some(poses) = answer.get("poses").and_then(Value::as_array) {
            self.poses = poses.iter().filter_map(score::pose).collect();
        }
        self.closures.extend(Claimed::of_peer(&answer));
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn answers_of_an_adapter_become_a_run() {
        let row = score::row_of(&Pose::translation(1.0, 2.0, 3.0));
        let mut answer = Answer::default();
        answer.read_line("KISS says something");
        answer.read_line(&json!({"system": "X 1.0"}).to_string());
        answer.read_line(&json!({"scan": 0, "cpu_ms": 2.0, "pose": row}).to_string());
        answer.read_line(&json!({"scan": 1, "cpu_ms": 4.0, "pose": null}).to_string());
        answer.read_line(&json!({"closure": [0, 1], "t_from_to": row}).to_string());
        assert_eq!((answer.system.as_str(), answer.cpu_ms.len(), answer.poses.len(), answer.closures.len()), ("X 1.0", 2, 1, 1));
        answer.read_line(&json!({"poses": [row, row]}).to_string());
        assert_eq!(answer.poses.len(), 2);
    }

    #[test]
    fn adapters_mark_what_a_user_writes() {
        assert!(ADAPTERS.iter().all(|adapter| user_lines(adapter.text).is_some_and(|lines| lines > 0)));
    }

    #[test]
    fn peers_that_are_not_there_are_said() {
        let folder = tempfile::tempdir().unwrap();
        let workspace = Workspace::create("none".into(), folder.path().to_owned()).unwrap();
        let script = folder.path().join("absent.sh");
        let exported = Exported { folder: folder.path().to_owned(), scans: Vec::new(), imu: None };
        for (code, said) in [(77, "not installed"), (78, "not for these scans"), (0, "no answer"), (5, "failed")] {
            fs::write(&script, format!("exit {code}")).unwrap();
            let peer = SlamPeer { name: "X", task: "odometry", python: "/bin/sh".into(), script: script.clone(), argument: None, user_lines: None };
            let why = peer.run(&workspace, &exported, &Truth::none(), Duration::from_secs(5)).unwrap().unwrap_err();
            assert!(why.contains(said), "{why}");
        }
    }
}
