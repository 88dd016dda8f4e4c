//! The sensor model: casts the beams and makes clouds.

use super::noise::{Neighbours, Noise};
use super::pattern::Pattern;
use super::sample::{NO_RETURN, Sample};
use super::thin::returns_only;
use crate::random::Stream;
use crate::solid::Vec3;
use crate::traffic::{BodyPose, Label, Surroundings};
use crate::{Hit, Ray, SimError, SurfacePoint};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use voxelastic::sensor::BeamModel;
use voxelastic::{Cloud, Pose};

/// Settings of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarSettings {
    /// Farthest return, metres.
    pub max_range: f64,
    /// Nearest return, metres.
    pub min_range: f64,
    /// Whether the sensor moves during the sweep; otherwise the whole sweep is measured at one instant.
    pub moving: bool,
    /// Duration of a turn, seconds.
    pub period: f64,
    /// Noise of the measurements.
    pub noise: Noise,
}

impl Default for LidarSettings {
    fn default() -> Self {
        Self { max_range: 120.0, min_range: 0.3, moving: false, period: 0.1, noise: Noise::default() }
    }
}

/// Most firings of a sweep: columns of the model.
const MAX_FIRINGS: usize = 65_536;

impl LidarSettings {
    fn check(&self) -> Result<(), SimError> {
        let range = 0.0..=1e5;
        if !(range.contains(&self.min_range) && range.contains(&self.max_range) && self.max_range > self.min_range) {
            return Err(SimError::Setting { setting: "max_range", value: self.max_range, allowed: "above min_range, which is not below 0" });
        }
        if !(1e-4..=100.0).contains(&self.period) {
            return Err(SimError::Setting { setting: "period", value: self.period, allowed: "from 0.0001 to 100 seconds" });
        }
        self.noise.check()
    }
}

/// Where a beam met a surface, world frame.
struct Met {
    range: f64,
    point: Vec3,
    normal: Vec3,
    albedo: f32,
    /// The solid of the world; of a body that moves, that of the body.
    solid: u32,
    label: Label,
}

/// A simulated sensor.
#[derive(Clone, Debug)]
pub struct Lidar {
    model: BeamModel,
    settings: LidarSettings,
    /// Of a sensor whose beams never repeat: rows of the model are its lines, columns its firings.
    pattern: Option<Pattern>,
    /// Origin and direction of each beam, lidar frame, column by column; empty if they never repeat.
    beams: Vec<Ray>,
    ring_of_row: Vec<u16>,
}

impl Lidar {
    /// A sensor with the beams of `model`.
    ///
    /// # Errors
    /// [`SimError::Setting`] for settings out of range.
    pub fn new(model: BeamModel, settings: LidarSettings) -> Result<Self, SimError> {
        settings.check()?;
        let (rows, columns) = (model.rows(), model.columns());
        let beams = (0..columns).flat_map(|column| (0..rows).map(move |row| (row, column)));
        let beams = beams
            .map(|(row, column)| {
                let vector = |v: [f32; 3]| Vec3::from(v.map(f64::from));
                (vector(model.origin(row as f32, column as f32)), vector(model.direction(row as f32, column as f32)).normalize())
            })
            .collect();
        let mut ring_of_row = vec![0u16; rows];
        for (ring, &row) in (0u16..).zip(model.row_of_ring()) {
            ring_of_row[usize::from(row)] = ring;
        }
        Ok(Self { model, settings, pattern: None, beams, ring_of_row })
    }

    /// A sensor whose beams never repeat. Its model has a row for each line and a column for each firing of a sweep; its clouds are the returns in the order of
    /// firing, without rings.
    ///
    /// # Errors
    /// [`SimError::Setting`] for settings out of range.
    pub fn of_pattern(pattern: Pattern, settings: LidarSettings) -> Result<Self, SimError> {
        settings.check()?;
        let firings = ((pattern.rate * settings.period).round() as usize).clamp(2, MAX_FIRINGS);
        let [bottom, top] = pattern.elevations.map(|e| e as f32);
        let model = BeamModel::even(pattern.lines, firings, top, bottom)?.with_name(pattern.name);
        Ok(Self { pattern: Some(pattern), beams: Vec::new(), ..Self::new(model, settings)? })
    }

    /// The beams of a sweep that begins at a time in seconds, lidar frame, column by column.
    fn beams_at(&self, time: f64) -> Cow<'_, [Ray]> {
        match &self.pattern {
            Some(pattern) => Cow::Owned(pattern.beams(time, self.model.columns())),
            None => Cow::Borrowed(&self.beams),
        }
    }

    /// The beam model.
    pub fn model(&self) -> &BeamModel {
        &self.model
    }

    /// Its settings.
    pub fn settings(&self) -> &LidarSettings {
        &self.settings
    }

    /// True measurements of all beams, column by column (`column * rows + row`). `pose_at` returns the pose of the lidar frame at a time in seconds since
    /// the start of the sweep.
    pub fn sample<'a>(&self, world: impl Into<Surroundings<'a>>, pose_at: impl Fn(f64) -> Pose + Sync) -> Vec<Sample> {
        self.cast(&world.into(), pose_at, self.settings.max_range, NO_RETURN, |(_, direction), met| {
            // At silhouettes rounding may give a slightly negative cosine.
            let cosine = (-met.normal.dot(direction)).clamp(0.0, 1.0) as f32;
            Sample { range: met.range, cosine, albedo: met.albedo, label: met.label }
        })
    }

    /// True surface points of all beams of a sweep within `max_range` metres, map frame, column by column.
    pub(crate) fn true_points(&self, around: &Surroundings<'_>, pose_at: impl Fn(f64) -> Pose + Sync, max_range: f64) -> Vec<Option<SurfacePoint>> {
        let max_range = max_range.min(self.settings.max_range);
        self.cast(around, pose_at, max_range, None, |_, met| {
            Some(SurfacePoint { point: met.point.into(), normal: met.normal.into(), solid: met.solid })
        })
    }

    /// Casts all beams and maps each meeting with a surface to a `T`; beams without one get `nothing`.
    fn cast<T: Clone + Send + Sync>(
        &self,
        around: &Surroundings<'_>,
        pose_at: impl Fn(f64) -> Pose + Sync,
        max_range: f64,
        nothing: T,
        map: impl Fn(&Ray, &Met) -> T + Sync,
    ) -> Vec<T> {
        let (rows, columns) = (self.model.rows(), self.model.columns());
        let world = around.world;
        let beams = self.beams_at(around.time);
        let mut results = vec![nothing; rows * columns];
        let poses = self.poses(pose_at);
        let bodies: Vec<Vec<BodyPose<'_>>> = (0..poses.len()).map(|firing| around.bodies_at(self.offset(firing))).collect();
        results.par_chunks_mut(rows).enumerate().with_min_len(8).for_each_init(
            || (Vec::with_capacity(rows), vec![None; rows]),
            |(rays, hits): &mut (Vec<Ray>, Vec<Option<Hit>>), (column, results)| {
                let firing = |row: usize| if poses.len() > 1 { self.model.firing_column(row, column) } else { 0 };
                rays.clear();
                rays.extend((0..rows).map(|row| {
                    let (origin, direction) = &beams[column * rows + row];
                    let pose = &poses[firing(row)];
                    (pose.1 * origin + pose.0, pose.1 * direction)
                }));
                world.cast_all(rays, max_range, hits);
                for (row, ((result, ray), hit)) in results.iter_mut().zip(rays.iter()).zip(hits.iter()).enumerate() {
                    let met = hit.map(|hit| {
                        let point = ray.0 + ray.1 * hit.range;
                        let normal = world.normal(hit.solid, point.into()).into();
                        Met { range: hit.range, point, normal, albedo: world.albedo(hit.solid), solid: hit.solid, label: Label::Static }
                    });
                    let met = bodies[firing(row)].iter().fold(met, |nearest, body| {
                        let limit = nearest.as_ref().map_or(max_range, |met| met.range);
                        body.cast(ray, limit)
                            .map(|(range, normal, albedo, solid)| Met {
                                range,
                                point: ray.0 + ray.1 * range,
                                normal,
                                albedo,
                                solid,
                                label: body.label,
                            })
                            .or(nearest)
                    });
                    if let Some(met) = met.filter(|met| met.range >= self.settings.min_range) {
                        *result = map(ray, &met);
                    }
                }
            },
        );
        results
    }

    /// Translation and rotation of the sensor at each firing; a single pose if it does not move.
    fn poses(&self, pose_at: impl Fn(f64) -> Pose + Sync) -> Vec<(Vec3, nalgebra::Matrix3<f64>)> {
        let count = if self.settings.moving { self.model.columns() } else { 1 };
        let split = |pose: Pose| (pose.translation.vector, *pose.rotation.to_rotation_matrix().matrix());
        (0..count).map(|firing| split(pose_at(self.offset(firing)))).collect()
    }

    /// Seconds from the start of the sweep to a firing; 0 if the sensor does not move.
    fn offset(&self, firing: usize) -> f64 {
        if self.settings.moving { self.settings.period * firing as f64 / self.model.columns() as f64 } else { 0.0 }
    }

    /// Simulates a scan: an organised cloud of rows x columns in the pixels of the beam model, with intensity, ring and time. Each point is in the lidar
    /// frame at the time of its firing, as sensors report it; beams without return are NaN. The noise depends on `random` only, not on the
    /// number of threads. `world` is a [`World`](crate::World), or one with [`Traffic`](crate::traffic::Traffic) in it. Where beams never repeat, the cloud is unorganised:
    /// the returns in the order of firing.
    pub fn scan<'a>(&self, world: impl Into<Surroundings<'a>>, pose_at: impl Fn(f64) -> Pose + Sync, random: &Stream) -> Cloud {
        self.labelled_scan(world, pose_at, random).0
    }

    /// As [`scan`](Self::scan), with a [`Label`] of each point, as a number.
    pub fn labelled_scan<'a>(&self, world: impl Into<Surroundings<'a>>, pose_at: impl Fn(f64) -> Pose + Sync, random: &Stream) -> (Cloud, Vec<u8>) {
        let (rows, columns) = (self.model.rows(), self.model.columns());
        let around = world.into();
        let beams = self.beams_at(around.time);
        let samples = self.sample(around, pose_at);
        let mut points = vec![[f32::NAN; 3]; rows * columns];
        let mut intensity = vec![0.0f32; rows * columns];
        let mut labels = vec![0u8; rows * columns];
        let lines = (points.par_chunks_mut(columns), intensity.par_chunks_mut(columns), labels.par_chunks_mut(columns));
        lines.into_par_iter().enumerate().for_each(|(row, (points, intensity, labels))| {
            for column in 0..columns {
                let index = column * rows + row;
                let sample = &samples[index];
                if sample.range.is_infinite() {
                    continue;
                }
                let mut random = random.fork(index as u64);
                let neighbours = self.neighbours(&samples, row, column);
                let Some(range) = self.settings.noise.measure(sample, neighbours, &mut random) else { continue };
                let (origin, direction) = &beams[index];
                let p = origin + direction * range.max(1e-3);
                points[column] = [p.x as f32, p.y as f32, p.z as f32];
                let strength = 255.0 * f64::from(sample.albedo) * (0.3 + 0.7 * f64::from(sample.cosine));
                intensity[column] = (strength * (1.0 + self.settings.noise.intensity_sigma * random.normal())).clamp(0.0, 255.0) as f32;
                labels[column] = sample.label as u8;
            }
        });
        let pixels = || (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)));
        let cloud = Cloud {
            points,
            width: columns,
            height: rows,
            intensity: Some(intensity),
            ring: Some(pixels().map(|(row, _)| self.ring_of_row[row]).collect()),
            time: Some(pixels().map(|(row, column)| self.offset(self.model.firing_column(row, column)) as f32).collect()),
            ..Cloud::default()
        };
        if self.pattern.is_none() {
            return (cloud, labels);
        }
        (returns_only(&cloud, &mut labels), labels)
    }

    /// True ranges of the neighbours of a pixel: left and right, above and below.
    fn neighbours(&self, samples: &[Sample], row: usize, column: usize) -> [Neighbours; 2] {
        let (rows, columns) = (self.model.rows(), self.model.columns());
        let at = |row: usize, column: usize| Some(samples[column * rows + row].range).filter(|r| r.is_finite());
        let left = at(row, (column + columns - 1) % columns);
        let right = at(row, (column + 1) % columns);
        let above = row.checked_sub(1).and_then(|r| at(r, column));
        let below = Some(row + 1).filter(|&r| r < rows).and_then(|r| at(r, column));
        [[left, right], [above, below]]
    }
}

#[cfg(test)]
mod tests;
