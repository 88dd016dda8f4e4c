//! Writes a simulation to a folder that `voxelastic map` reads, and loads it again.
//!
//! | file | what |
//! | --- | --- |
//! | `scans/NNNNNN.pcd` | the cloud of node N: organised, `x y z intensity time ring`, no return is NaN; of a sensor whose beams never repeat, and thinned ones: unorganised, without rings |
//! | `labels/NNNNNN.label` | a [`Label`](crate::traffic::Label) of each of its points as a `u32`, little-endian, as in SemanticKITTI; if anything moves |
//! | `poses.tum` | the drifting odometry, the default poses of the folder |
//! | `poses@NNNNNN.txt` | TUM, the poses of the nodes 0 to N as corrected when a loop closed at node N |
//! | `groundtruth.tum` | the true poses |
//! | `graph.g2o` | nodes with odometry poses, odometry edges, loop edges |
//! | `world.toml` | the options of the simulation |
//! | `imu/samples.csv` | samples of the inertial measurement unit, if there is one, in its frame; the first line has its pose in the lidar frame |
//! | `imu/truth.tum` | true poses of the lidar at the times of the samples |
//! | `images/cameras.toml` | intrinsics of the camera and its pose in the lidar frame, if there is one |
//! | `images/front/TIME.png` | its images |
//! | `recording.mcap` | as a recording instead: scans and samples as messages, without `scans/` and `imu/samples.csv` |

mod folder;

use crate::options::SimOptions;
use crate::{SimError, Simulation, World};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic_io::{PoseGraph, g2o, imu_csv, pcd, poses};

pub use folder::{Folder, Outcome};

/// Name of the file with the options of the simulation.
pub const WORLD_FILE: &str = "world.toml";

/// Name of the recording in a folder with one.
pub const RECORDING_FILE: &str = "recording.mcap";

/// Name of the folder with the labels of the points.
pub const LABEL_FOLDER: &str = "labels";

/// Version of the world file.
const FORMAT: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct WorldFile {
    format: u32,
    /// Fingerprint of the world, in hexadecimal.
    fingerprint: String,
    simulation: SimOptions,
}

/// Called after each batch with the numbers of scans written and in all; `Break` stops.
pub type Progress<'a> = dyn FnMut(usize, usize) -> ControlFlow<()> + 'a;

impl Simulation {
    /// Writes the simulation into the folder `dir`, which must be empty or not exist yet; returns the number of scans
    /// written. When `progress` stops it, the folder holds the scans so far with their poses and graph.
    ///
    /// # Errors
    /// [`SimError::NotEmpty`], [`SimError::File`] or [`SimError::Write`].
    pub fn write(&self, dir: impl AsRef<Path>, progress: &mut Progress<'_>) -> Result<usize, SimError> {
        let dir = dir.as_ref();
        let scans = dir.join("scans");
        refuse_occupied(dir)?;
        fs::create_dir_all(&scans).map_err(SimError::file(&scans))?;
        let labels = (self.options().traffic > 0).then(|| dir.join(LABEL_FOLDER));
        if let Some(labels) = &labels {
            fs::create_dir_all(labels).map_err(SimError::file(labels))?;
        }
        self.write_camera(dir)?;
        let mut written = 0;
        // A batch for all threads: some encode and write while others cast.
        let batch = 2 * rayon::current_num_threads();
        while written < self.len() {
            let end = (written + batch).min(self.len());
            (written..end).into_par_iter().try_for_each(|k| {
                let (cloud, of_points) = self.labelled_cloud(k).unwrap_or_default();
                if let Some(labels) = &labels {
                    let path = labels.join(format!("{k:06}.label"));
                    let bytes: Vec<u8> = of_points.iter().flat_map(|&label| u32::from(label).to_le_bytes()).collect();
                    fs::write(&path, bytes).map_err(SimError::file(&path))?;
                }
                self.write_image(dir, k)?;
                pcd::write(scans.join(format!("{k:06}.pcd")), &cloud).map_err(SimError::from)
            })?;
            written = end;
            if progress(written, self.len()).is_break() {
                break;
            }
        }
        self.write_poses(dir, written)?;
        self.write_imu(dir, written, true)?;
        self.write_world(dir, written)?;
        Ok(written)
    }

    /// Writes the folder with a recording in it instead of clouds; as [`write`](Self::write) otherwise.
    ///
    /// # Errors
    /// As [`write`](Self::write).
    pub fn write_as_recording(&self, dir: impl AsRef<Path>, progress: &mut Progress<'_>) -> Result<usize, SimError> {
        let dir = dir.as_ref();
        refuse_occupied(dir)?;
        fs::create_dir_all(dir).map_err(SimError::file(dir))?;
        let written = self.write_recording(&dir.join(RECORDING_FILE), progress)?;
        self.write_poses(dir, written)?;
        self.write_imu(dir, written, false)?;
        self.write_world(dir, written)?;
        Ok(written)
    }

    /// Writes what belongs to the inertial measurement unit, up to the end of the last of `count` scans.
    fn write_imu(&self, dir: &Path, count: usize, with_samples: bool) -> Result<(), SimError> {
        let (Some(unit), Some(last)) = (self.imu_unit(), self.times().get(count.saturating_sub(1))) else { return Ok(()) };
        let end = last + self.lidar().settings().period;
        let samples: Vec<_> = self.imu().into_iter().take_while(|s| s.time <= end).collect();
        let folder = dir.join(imu_csv::FOLDER);
        fs::create_dir_all(&folder).map_err(SimError::file(&folder))?;
        let truth: Vec<(f64, Pose)> = samples.iter().map(|s| (s.time, self.scene().trajectory.pose(s.time))).collect();
        poses::write_tum(folder.join("truth.tum"), &truth)?;
        if with_samples {
            imu_csv::write(folder.join(imu_csv::FILE), unit.t_lidar_imu(), &samples)?;
        }
        Ok(())
    }

    fn write_poses(&self, dir: &Path, count: usize) -> Result<(), SimError> {
        let timed = |poses: &[Pose]| self.times().iter().copied().zip(poses.iter().copied()).take(count).collect::<Vec<_>>();
        poses::write_tum(dir.join("poses.tum"), &timed(self.odometry()))?;
        poses::write_tum(dir.join("groundtruth.tum"), &timed(self.ground_truth()))?;
        for correction in self.corrections().iter().filter(|c| (c.node as usize) < count) {
            poses::write_tum(dir.join(format!("poses@{:06}.txt", correction.node)), &timed(&correction.poses))?;
        }
        let known = |node: NodeId| (node as usize) < count;
        let edges = self.odometry_edges().iter().chain(self.loop_edges()).filter(|e| known(e.from) && known(e.to));
        let nodes = (0..).zip(self.odometry().iter().copied()).take(count).collect();
        g2o::write(dir.join("graph.g2o"), &PoseGraph { nodes, edges: edges.cloned().collect(), fixed: vec![0] })?;
        Ok(())
    }

    /// Writes the options of a simulation of `count` scans. If that is not all, its world, true poses and clouds are the same, but its odometry
    /// differs, because drift depends on the whole path.
    fn write_world(&self, dir: &Path, count: usize) -> Result<(), SimError> {
        let path = dir.join(WORLD_FILE);
        let mut simulation = self.options().clone();
        if count < self.len() {
            simulation.scans = Some(count);
        }
        let file = WorldFile { format: FORMAT, fingerprint: hexadecimal(self.world()), simulation };
        let text = toml::to_string(&file).map_err(|e| SimError::WorldFile { path: path.clone(), message: e.to_string() })?;
        let text = format!("# A simulated world: the truth that maps of the scans beside this file are measured against.\n{text}");
        voxelastic_files::write(&path, |out| out.write_all(text.as_bytes())).map_err(SimError::file(&path))
    }

    /// Loads the simulation of a `world.toml` or of the folder that contains it: the same scans again.
    ///
    /// # Errors
    /// [`SimError::File`], [`SimError::WorldFile`], [`SimError::WorldChanged`], and those of [`Simulation::new`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SimError> {
        let (path, file) = read(path.as_ref())?;
        let simulation = Self::new(file.simulation)?;
        check(&path, &file.fingerprint, simulation.world())?;
        Ok(simulation)
    }
}

impl World {
    /// Loads the world of a `world.toml` or of the folder that contains it, to evaluate maps of its scans.
    ///
    /// # Errors
    /// As [`Simulation::load`].
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SimError> {
        let (path, file) = read(path.as_ref())?;
        let world = Self::named(&file.simulation.world, file.simulation.seed)?;
        check(&path, &file.fingerprint, &world)?;
        Ok(world)
    }
}

fn refuse_occupied(dir: &Path) -> Result<(), SimError> {
    let occupied = dir.is_dir() && fs::read_dir(dir).map_err(SimError::file(dir))?.next().is_some();
    if occupied { Err(SimError::NotEmpty { path: dir.into() }) } else { Ok(()) }
}

fn hexadecimal(world: &World) -> String {
    format!("{:016x}", world.fingerprint())
}

fn read(path: &Path) -> Result<(PathBuf, WorldFile), SimError> {
    let path = if path.is_dir() { path.join(WORLD_FILE) } else { path.to_path_buf() };
    let text = fs::read_to_string(&path).map_err(SimError::file(&path))?;
    let bad = |message: String| SimError::WorldFile { path: path.clone(), message };
    let file: WorldFile = toml::from_str(&text).map_err(|e| bad(e.to_string().trim_end().to_owned()))?;
    if file.format != FORMAT {
        return Err(bad(format!("format {} is not known to this version, which reads format {FORMAT}", file.format)));
    }
    Ok((path, file))
}

fn check(path: &Path, found: &str, world: &World) -> Result<(), SimError> {
    let built = hexadecimal(world);
    if found == built {
        return Ok(());
    }
    Err(SimError::WorldChanged { path: path.into(), name: world.name().into(), found: found.into(), built })
}

#[cfg(test)]
mod tests;
