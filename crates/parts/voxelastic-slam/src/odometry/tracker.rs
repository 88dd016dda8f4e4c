//! The odometry: scans in, poses out.

use super::alternation::Alternation;
use super::drift::{self, Drift};
use super::find::{self, Found, Surroundings};
use super::level::{self, Level};
use super::prediction::Predictor;
use super::recent::RecentScans;
use super::report::{Failure, OdometryReport, PhaseTimes, Status};
use super::settings::OdometrySettings;
use super::vertical::{Interval, MeasuredVertical, VerticalEstimator};
use crate::deskew::{returns, sweep_span};
use crate::registration::{Downsampler, LocalMap, RegistrationSettings, Surfel, automatic_voxel_size, mean_radius};
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::time::Instant;
use voxelastic::Cloud;
use voxelastic::geometry::{Pose, PoseExt};
use voxelastic::motion::{ImuSample, Motion};

/// Surfaces that a scan must have to be registered.
const LEAST_SURFACES: usize = 100;
/// A scan with fewer returns than this share of the usual number is one of a covered sensor.
const COVERED: f64 = 0.1;
/// Scans between two removals of far voxels.
const PRUNE_EVERY: usize = 10;
/// Change of the motion during a sweep, for a point at the scan's radius, that is worth a second deskew, metres.
const DESKEW_AGAIN: f64 = 0.02;

/// Odometry: poses from scans alone, by registration to a local map.
///
/// Results do not depend on the number of threads.
#[derive(Clone, Debug)]
pub struct Odometry {
    pub(super) settings: OdometrySettings,
    /// From fine to coarse; empty before the first scan.
    pub(super) levels: Vec<LocalMap>,
    /// Rotation of the voxels in the map: they have the axes of the first scan, not those of the level map, where floors and walls would lie on borders of voxels.
    pub(super) map_from_voxels: UnitQuaternion<f64>,
    pub(super) predictor: Predictor,
    pub(super) last: Option<Last>,
    pub(super) drift: Drift,
    pub(super) piece: usize,
    pub(super) scans: usize,
    pub(super) failures: usize,
    /// Running mean of the registrations' scores.
    pub(super) score: f64,
    pub(super) level: Level,
    /// Whether the first scan tells of a sensor that is not upright, and nothing tells how it is.
    pub(super) is_leaning: bool,
    /// Running mean of the scans' returns.
    pub(super) usual_returns: f64,
    pub(super) alternation: Alternation,
    pub(super) recent: RecentScans,
    pub(super) vertical: VerticalEstimator,
    pub(super) scratch: Scratch,
}

/// The last registered scan, and the last keyframe.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Last {
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_lidar: Pose,
    time: Option<f64>,
    #[serde(with = "voxelastic::geometry::stored")]
    keyframe: Pose,
    /// Path so far, metres.
    path: f64,
}

/// Memory that is used again for each scan.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    downsampler: Downsampler,
    points: Vec<[f32; 3]>,
    dense: Vec<[f32; 3]>,
    pub(super) scan_map: LocalMap,
    surfels: Vec<Surfel>,
}

impl Odometry {
    /// An odometry that has seen no scan.
    pub fn new(settings: OdometrySettings) -> Self {
        let scratch =
            Scratch { downsampler: Downsampler::default(), points: Vec::new(), dense: Vec::new(), scan_map: LocalMap::new(1.0), surfels: Vec::new() };
        Self {
            settings,
            levels: Vec::new(),
            map_from_voxels: UnitQuaternion::identity(),
            predictor: Predictor::new(),
            last: None,
            drift: Drift::new(Pose::identity()),
            piece: 0,
            scans: 0,
            failures: 0,
            score: 0.0,
            level: Level::default(),
            is_leaning: false,
            usual_returns: 0.0,
            alternation: Alternation::default(),
            recent: RecentScans::default(),
            vertical: VerticalEstimator::default(),
            scratch,
        }
    }

    /// Adds a sample of an inertial measurement unit at the lidar, with the lidar's axes. Samples must come before the scan whose sweep they cover.
    pub fn add_imu(&mut self, sample: ImuSample) {
        self.predictor.add_imu(sample);
    }

    /// How the map frame was levelled.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Finds the pose of a scan and adds the scan to the local map. `time` is the cloud's time stamp in seconds, where it is known.
    pub fn register(&mut self, cloud: &Cloud, time: Option<f64>) -> OdometryReport {
        let clock = Instant::now();
        let mut times = PhaseTimes::default();
        let Some(last) = self.last else { return self.first(cloud, time, Pose::identity(), clock) };
        let seconds = time.zip(last.time).map(|(now, before)| now - before);
        if time.is_some_and(|t| !t.is_finite()) || seconds.is_some_and(|s| s <= 0.0) {
            return self.out_of_time(cloud, time, &last);
        }
        let gap = seconds.filter(|s| self.predictor.is_gap(*s));
        let prediction = renormalised(self.predictor.pose(&last.t_map_lidar, last.time, seconds));
        let predicted = last.t_map_lidar.inv_mul(&prediction);
        let mut motion = self.sweep(cloud, &last, &prediction, seconds);
        self.prepare(cloud, motion.as_ref());
        times.prepare = clock.elapsed();
        if self.scratch.surfels.len() < LEAST_SURFACES || self.is_covered() {
            return self.failed_or_restarted(Failure::TooFewReturns, cloud, time, prediction, times);
        }
        let clock = Instant::now();
        let mut found = match self.surroundings().find(&prediction, &last.t_map_lidar, self.predictor.sigma()) {
            Ok(found) => found,
            Err(failure) => return self.failed_or_restarted(failure, cloud, time, prediction, times),
        };
        // The motion during the sweep is known better now.
        let moved = last.t_map_lidar.inv_mul(&found.t_map_lidar);
        let radius = mean_radius(&self.scratch.surfels);
        if motion.is_some() && moved.translation_distance(&predicted) + radius * moved.rotation_distance(&predicted) > DESKEW_AGAIN {
            self.predictor.set_motion(moved, seconds);
            motion = self.sweep(cloud, &last, &found.t_map_lidar, seconds);
            self.prepare(cloud, motion.as_ref());
            let Some(again) = self.surroundings().register_from(&found.t_map_lidar, DESKEW_AGAIN) else {
                return self.failed_or_restarted(Failure::TooLittleOverlap, cloud, time, prediction, times);
            };
            found = Found { contradiction: found.contradiction, ..again };
        }
        let registration = &found.registration;
        let information = registration.information(&self.scratch.surfels, &self.levels);
        times.register = clock.elapsed();
        let clock = Instant::now();
        let vertical = self.accept(&last, &prediction, &found, time, seconds);
        let is_keyframe = self.is_keyframe(&last, &found.t_map_lidar);
        let at = [
            self.last.map_or(0.0, |last| last.path),
            drift::age(&self.scratch.surfels, &(self.map_from_voxels.inverse() * found.t_map_lidar), &self.levels[0]),
        ];
        let moved = last.t_map_lidar.inv_mul(&found.t_map_lidar);
        let [growth, covariance] = self.drift.add(&moved, &found.t_map_lidar, at, &information);
        self.insert(&found.t_map_lidar);
        times.update = clock.elapsed();
        OdometryReport {
            t_map_lidar: found.t_map_lidar,
            motion,
            information,
            growth,
            covariance,
            status: match registration.degenerate.len() {
                0 => Status::Tracked,
                directions => Status::Degenerate { directions },
            },
            piece: self.piece,
            is_keyframe,
            overlap: registration.overlap,
            score: registration.score,
            contradiction: found.contradiction,
            level: self.level,
            vertical,
            alternates: self.alternation.is_sure(),
            gap,
            spread: registration.spread,
            iterations: registration.iterations,
            times,
        }
    }

    fn registration_settings(&self) -> RegistrationSettings {
        let s = &self.settings;
        RegistrationSettings { max_iterations: s.max_iterations, convergence: 1e-3, least_scale: s.kernel_scale, point_weight: s.point_weight }
    }

    /// How the lidar moved during the sweep of a scan with this pose: by the inertial unit, else at the constant velocity since the last scan.
    fn sweep(&self, cloud: &Cloud, last: &Last, pose: &Pose, seconds: Option<f64>) -> Option<Motion> {
        if cloud.motion.is_some() {
            return cloud.motion.clone();
        }
        let since_last = last.t_map_lidar.inv_mul(pose);
        let inertial = &self.predictor.inertial;
        if let Some((from, seconds)) = last.time.zip(seconds).filter(|_| self.settings.deskew) {
            let mean = || (pose.translation.vector - last.t_map_lidar.translation.vector) / seconds;
            let velocity = inertial.corrected_velocity(&last.t_map_lidar, pose, from, from + seconds).unwrap_or_else(mean);
            let motion = sweep_span(cloud).and_then(|span| inertial.sweep(pose, velocity, from + seconds, span));
            if motion.is_some() {
                return motion;
            }
        }
        let seconds = seconds.filter(|s| *s > 0.0 && self.settings.deskew && self.predictor.has_velocity())?;
        let [begin, end] = sweep_span(cloud)?.map(|t| t as f32);
        let at = |t: f32| {
            let share = f64::from(t) / seconds;
            let rotation = UnitQuaternion::from_scaled_axis(since_last.rotation.scaled_axis() * share);
            // The velocity is that in the frame of the last scan; a turn since then does not matter within a sweep.
            Pose::from_parts(Translation3::from(since_last.rotation.inverse() * since_last.translation.vector * share), rotation)
        };
        Motion::through([(begin, at(begin)), (end, at(end))])
    }

    /// Gate, deskew, downsampling and surfaces of a scan, into the scratch memory.
    fn prepare(&mut self, cloud: &Cloud, motion: Option<&Motion>) {
        let Scratch { downsampler, points, dense, scan_map, surfels } = &mut self.scratch;
        returns(cloud, motion, [self.settings.min_range, self.settings.max_range], points);
        if self.levels.is_empty() {
            let size = self.settings.voxel_size.unwrap_or_else(|| automatic_voxel_size(points));
            self.levels = (0..self.settings.levels.clamp(1, 8)).map(|k| LocalMap::new(size * f64::from(1u32 << k))).collect();
            *scan_map = LocalMap::new(size * self.settings.source_spacing);
        }
        let size = self.levels[0].size();
        downsampler.means(points, (size / self.settings.map_density) as f32, dense);
        scan_map.clear();
        scan_map.insert(dense.iter().map(|p| p.map(f64::from)));
        scan_map.surfels(surfels);
    }

    /// The prepared scan, and what it is registered to.
    fn surroundings(&self) -> Surroundings<'_> {
        Surroundings {
            surfels: &self.scratch.surfels,
            points: &self.scratch.dense,
            levels: &self.levels,
            map_from_voxels: self.map_from_voxels,
            recent: &self.recent,
            usual_score: self.score,
            settings: self.registration_settings(),
            is_leaning: self.is_leaning,
        }
    }

    /// Takes over the outcome of a registration. Returns where up is, if that is known anew.
    fn accept(&mut self, last: &Last, prediction: &Pose, found: &Found, time: Option<f64>, seconds: Option<f64>) -> Option<MeasuredVertical> {
        self.failures = 0;
        let score = found.registration.score;
        self.score = if self.score == 0.0 { score } else { 0.8 * self.score + 0.2 * score };
        self.predictor.add_error(&prediction.inv_mul(&found.t_map_lidar), mean_radius(&self.scratch.surfels));
        let moved = renormalised(last.t_map_lidar.inv_mul(&found.t_map_lidar));
        self.alternation.add(&moved);
        self.predictor.set_motion(moved, seconds);
        let path = last.path + moved.translation.vector.norm();
        self.last = Some(Last { t_map_lidar: found.t_map_lidar, time, keyframe: last.keyframe, path });
        self.levels.iter_mut().for_each(|level| level.set_path(path));
        let (from, to) = last.time.zip(time)?;
        let inertial = &mut self.predictor.inertial;
        let impulse = inertial.impulse(&last.t_map_lidar, from, to);
        inertial.correct(&last.t_map_lidar, &found.t_map_lidar, from, to);
        let moved = found.t_map_lidar.translation.vector - last.t_map_lidar.translation.vector;
        self.vertical.add(&Interval { times: [from, to], impulse: impulse?, moved }, self.level)
    }

    /// Whether a pose is far enough from the last keyframe; it is then the last keyframe.
    fn is_keyframe(&mut self, last: &Last, pose: &Pose) -> bool {
        let s = &self.settings;
        let is_far = pose.translation_distance(&last.keyframe) >= s.keyframe_distance
            || pose.rotation_distance(&last.keyframe) >= s.keyframe_angle.to_radians();
        if let Some(last) = self.last.as_mut().filter(|_| is_far) {
            last.keyframe = *pose;
        }
        is_far
    }

    /// Adds the prepared scan to the map.
    fn insert(&mut self, t_map_lidar: &Pose) {
        let t_voxels_lidar = self.map_from_voxels.inverse() * t_map_lidar;
        let rotation = t_voxels_lidar.rotation.to_rotation_matrix();
        let centre = t_voxels_lidar.translation.vector;
        let moved = |p: &[f32; 3]| (rotation * Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])) + centre).into();
        self.scans += 1;
        self.recent.add(t_map_lidar, &self.scratch.dense, self.levels[0].size());
        for level in &mut self.levels {
            level.insert(self.scratch.dense.iter().map(moved));
            if self.scans.is_multiple_of(PRUNE_EVERY) {
                level.prune(centre.into(), self.settings.max_range);
            }
        }
    }

    /// The first scan of a piece.
    fn first(&mut self, cloud: &Cloud, time: Option<f64>, t_map_lidar: Pose, clock: Instant) -> OdometryReport {
        self.levels.clear();
        self.recent.clear();
        let span = sweep_span(cloud).filter(|_| self.settings.deskew);
        // Nothing is known of the velocity yet; the rotation matters more.
        let turned = |(time, span): (f64, [f64; 2])| self.predictor.inertial.sweep(&t_map_lidar, Vector3::zeros(), time, span);
        let motion = cloud.motion.clone().or_else(|| time.zip(span).and_then(turned));
        self.prepare(cloud, motion.as_ref());
        let mut times = PhaseTimes { prepare: clock.elapsed(), ..PhaseTimes::default() };
        if self.scratch.surfels.len() < LEAST_SURFACES {
            self.levels.clear();
            return self.failed(Failure::TooFewReturns, t_map_lidar, times);
        }
        let clock = Instant::now();
        self.predictor.restart();
        let t_map_lidar = self.levelled(t_map_lidar, time, span);
        self.insert(&t_map_lidar);
        self.drift = Drift::new(t_map_lidar);
        self.last = Some(Last { t_map_lidar, time: time.filter(|t| t.is_finite()), keyframe: t_map_lidar, path: 0.0 });
        (self.failures, self.score) = (0, 0.0);
        (self.usual_returns, self.alternation) = (self.scratch.points.len() as f64, Alternation::default());
        times.update = clock.elapsed();
        OdometryReport { status: Status::First, motion, is_keyframe: true, overlap: 1.0, ..self.failed(Failure::TooFewReturns, t_map_lidar, times) }
    }

    /// The pose of the first scan of a piece; that of the first piece levels the map.
    fn levelled(&mut self, mut t_map_lidar: Pose, time: Option<f64>, span: Option<[f64; 2]>) -> Pose {
        let end = time.map(|time| time + span.map_or(0.0, |span| span[1].max(0.0)));
        if self.piece == 0 {
            let by_gravity = end.and_then(|end| self.predictor.inertial.up(end)).map(|up| (Level::Gravity, up));
            if let Some((level, up)) = by_gravity.or_else(|| level::up(&self.scratch.surfels).map(|up| (Level::Surfaces, up))) {
                (self.level, t_map_lidar) = (level, level::levelled(&up));
                self.map_from_voxels = t_map_lidar.rotation;
            }
            self.is_leaning = self.level == Level::Unknown && find::is_leaning(&self.scratch.surfels);
        }
        if let Some(end) = end {
            self.predictor.inertial.begin(&t_map_lidar, end);
        }
        t_map_lidar
    }

    /// Whether the prepared scan has far fewer returns than those before; if that stays so, it becomes usual.
    fn is_covered(&mut self) -> bool {
        let now = self.scratch.points.len() as f64;
        let is_covered = now < COVERED * self.usual_returns;
        let share = if is_covered { 0.05 } else { 0.2 };
        self.usual_returns += share * (now - self.usual_returns);
        is_covered
    }

    /// A scan whose time is not after that of the last: after several of these in turn, the clock was set back and a new piece begins.
    fn out_of_time(&mut self, cloud: &Cloud, time: Option<f64>, last: &Last) -> OdometryReport {
        self.failures += 1;
        if self.failures < self.settings.max_failures || time.is_some_and(|t| !t.is_finite()) {
            return self.failed(Failure::TimeNotAscending, last.t_map_lidar, PhaseTimes::default());
        }
        self.piece += 1;
        self.first(cloud, time, last.t_map_lidar, Instant::now())
    }

    /// A scan that cannot be registered: after several of these in turn, it is the first of a new piece.
    fn failed_or_restarted(&mut self, failure: Failure, cloud: &Cloud, time: Option<f64>, prediction: Pose, times: PhaseTimes) -> OdometryReport {
        self.failures += 1;
        if self.failures < self.settings.max_failures || failure == Failure::TooFewReturns {
            return self.failed(failure, prediction, times);
        }
        self.piece += 1;
        self.first(cloud, time, prediction, Instant::now())
    }

    fn failed(&self, failure: Failure, t_map_lidar: Pose, times: PhaseTimes) -> OdometryReport {
        OdometryReport::failed(failure, t_map_lidar, self.piece, self.level, times)
    }
}

/// Products of many rotations drift off unit length.
fn renormalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}
