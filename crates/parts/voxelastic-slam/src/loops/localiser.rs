//! Where in a map a scan was taken, from an unknown start.

use super::align::align;
use super::overlap::{Guess, HEADING_ERROR, best_guess, turn_between};
use super::place::{Keyframe, Place, surfels, thinned};
use super::signature::SignatureMaker;
use crate::deskew::returns;
use crate::free_space::FreeSpace;
use crate::registration::{Downsampler, LocalMap, RegistrationSettings, automatic_voxel_size, register};
use nalgebra::{Matrix6, UnitQuaternion, Vector3};
use rayon::prelude::*;
use voxelastic::Cloud;
use voxelastic::geometry::{Pose, PoseExt, Rigid};

/// Radius of the map around a place, in voxels.
const RADIUS: f64 = 90.0;
/// Distance between places, in voxels.
const SPACING: f64 = 8.0;
/// Points of a scan that are registered.
const MOST_POINTS: usize = 30_000;
/// Error to expect of a pose before it is refined, in voxels.
const REFINED_BY: f64 = 0.2;

/// How a scan is localised.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct LocaliserSettings {
    /// Edge of a voxel, metres; `None`: from the ranges of the first scan.
    pub voxel_size: Option<f64>,
    /// Nearest return that is used, metres.
    pub min_range: f64,
    /// Farthest return that is used, metres.
    pub max_range: f64,
    /// Places whose images are compared with that of the scan.
    pub most_compared: usize,
    /// Places to which the scan is registered.
    pub most_registered: usize,
    /// Least share of the scan's surfaces with a counterpart in the map, of a scan all around; the less it sees of the circle, the more of it must be there.
    pub least_overlap: f64,
    /// Largest share of the surfaces of map or scan in space that the other saw to be free, of a scan all around; the less it sees of the circle, the less may be.
    pub most_contradiction: f64,
}

impl Default for LocaliserSettings {
    fn default() -> Self {
        Self {
            voxel_size: None,
            min_range: 0.5,
            max_range: 100.0,
            most_compared: 30,
            most_registered: 5,
            least_overlap: 0.5,
            most_contradiction: 0.05,
        }
    }
}

/// About where a scan was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Whereabouts {
    /// In the map frame, metres.
    pub position: Vector3<f64>,
    /// How far from there it may be, metres.
    pub within: f64,
    /// The direction of the lidar's x axis, radians from the map's x axis towards its y axis, right to within 45 degrees; `None` if it is not known.
    pub yaw: Option<f64>,
}

/// Where a scan was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Located {
    /// Pose of the lidar in the map frame.
    pub t_map_lidar: Pose,
    /// Share of the scan's surfaces with a counterpart in the map.
    pub overlap: f64,
    /// Mean weight of the scan's surfaces, 1 where all lie on the map's.
    pub score: f64,
    /// Share of the surfaces of the map in space that the scan saw to be free, or of the scan in such space of the map: the larger one.
    pub contradiction: f64,
    /// Whether overlap and contradiction are within their limits, and no other place fits as well.
    pub is_certain: bool,
    /// Robust mean distance of the scan's surfaces to those of the map, metres.
    pub spread: f64,
    /// Information of the pose in the lidar frame (x y z roll pitch yaw), inverse square metres and radians, of a pose that was refined.
    pub information: Option<Matrix6<f64>>,
}

/// Directions in which a scan is asked for returns, to know how much of the circle it sees.
const DIRECTIONS: usize = 72;
/// Another place whose quality is at least this share of the best's fits as well.
const AS_GOOD: f64 = 0.97;
/// Poses so near each other are the same, voxels; and radians.
const SAME: (f64, f64) = (2.0, 0.2);

/// Localises scans in a map.
#[derive(Debug)]
pub struct Localiser {
    settings: LocaliserSettings,
    maker: SignatureMaker,
    points: Vec<[f32; 3]>,
    viewpoints: Vec<Pose>,
    voxel: Option<f64>,
    places: Vec<Place>,
    downsampler: Downsampler,
}

impl Localiser {
    /// A localiser in the map with these surface points and the poses of the lidar from which it was observed, in the map frame.
    pub fn new(points: Vec<[f32; 3]>, viewpoints: Vec<Pose>, settings: LocaliserSettings) -> Self {
        let voxel = settings.voxel_size;
        Self { settings, maker: SignatureMaker::new(), points, viewpoints, voxel, places: Vec::new(), downsampler: Downsampler::default() }
    }

    /// Finds the pose of a scan. If it is known about where it was taken, only poses there count. `None` if the scan has no returns, the map has no place
    /// there, or the scan cannot be registered to any.
    pub fn locate(&mut self, cloud: &Cloud, about: Option<Whereabouts>) -> Option<Located> {
        self.locate_all(cloud, about).into_iter().next()
    }

    /// As [`locate`](Self::locate), with the other places that the scan was registered to: the best first, which is refined, and then by how well it fits. Empty where
    /// that is `None`.
    pub fn locate_all(&mut self, cloud: &Cloud, about: Option<Whereabouts>) -> Vec<Located> {
        let mut used = Vec::new();
        returns(cloud, cloud.motion.as_ref(), [self.settings.min_range, self.settings.max_range], &mut used);
        if used.is_empty() {
            return Vec::new();
        }
        let voxel = self.prepare(&used);
        let points = thinned(&mut self.downsampler, &used, voxel, MOST_POINTS);
        let scan = Keyframe { node: 0, t_map_lidar: Pose::identity(), piece: 0, path: 0.0, points };
        let Some(view) = Place::new(&[&scan], voxel, &self.maker) else { return Vec::new() };
        let points = surfels(&view.scans, voxel);
        let free = FreeSpace::new(&view.views(), voxel as f32);
        let candidates = self.candidates(&view, voxel, about.as_ref());
        let limits = self.limits(share_of_circle(&used, &view.level));
        let found = candidates.par_iter().filter_map(|(k, guess)| {
            let place = &self.places[*k];
            let found = align(place, &points, guess, voxel)?;
            let t = &found.t_map_lidar;
            if about.is_some_and(|about| !about.admits(&(place.t_map_anchor * t))) {
                return None;
            }
            // Rays to what the map has behind a wall mark the wall's inside as free, where no scan has surfaces.
            let back = FreeSpace::new(&place.views(), voxel as f32).contradiction(&view.views(), t)?;
            let contradiction = free.contradiction(&place.views(), &t.inverse())?.max(back);
            Some(Located {
                t_map_lidar: place.t_map_anchor * found.t_map_lidar,
                overlap: found.overlap,
                score: found.score,
                contradiction,
                is_certain: found.overlap >= limits.0 && contradiction <= limits.1,
                spread: found.spread,
                information: None,
            })
        });
        let mut found: Vec<Located> = found.collect();
        let quality = |l: &Located| l.score * (1.0 - 4.0 * l.contradiction);
        // Of equals, the last was the best so far.
        found.reverse();
        found.sort_by(|a, b| quality(b).total_cmp(&quality(a)));
        let mut distinct: Vec<Located> = Vec::new();
        for located in found {
            if distinct.iter().all(|better| !is_same(&better.t_map_lidar, &located.t_map_lidar, voxel)) {
                distinct.push(located);
            }
        }
        let has_rival = |best: &Located| distinct[1..].iter().any(|other| other.is_certain && quality(other) >= AS_GOOD * quality(best));
        let is_alone = distinct.first().is_some_and(|best| !has_rival(best));
        if let Some(best) = distinct.first_mut() {
            best.is_certain &= is_alone;
            *best = self.refined(best, &used, voxel).unwrap_or(*best);
        }
        distinct
    }

    /// The least overlap and the largest contradiction of a scan that sees this share of the circle.
    fn limits(&self, share: f64) -> (f64, f64) {
        let LocaliserSettings { least_overlap, most_contradiction, .. } = self.settings;
        (1.0 - share * (1.0 - least_overlap), 0.5 * (1.0 + share) * most_contradiction)
    }

    /// A pose once more, with voxels of half the size and all points of the map.
    fn refined(&self, located: &Located, returns: &[[f32; 3]], voxel: f64) -> Option<Located> {
        let t_map_lidar = &located.t_map_lidar;
        let fine = 0.5 * voxel;
        let t_lidar_map = Rigid::from(&t_map_lidar.inverse());
        let radius = (RADIUS * voxel) as f32;
        let is_near = |p: &[f32; 3]| p[0] * p[0] + p[1] * p[1] + p[2] * p[2] < radius * radius;
        let mut map = LocalMap::new(fine);
        map.insert(self.points.iter().map(|p| t_lidar_map.apply(*p)).filter(is_near).map(|p| p.map(f64::from)));
        let mut scan = LocalMap::new(fine);
        scan.insert(returns.iter().map(|p| p.map(f64::from)));
        let mut points = Vec::new();
        scan.surfels(&mut points);
        let settings = RegistrationSettings { max_iterations: 30, convergence: 1e-4, least_scale: 0.1 * voxel, point_weight: 1.0 };
        let levels = [map];
        let found = register(&points, &Pose::identity(), &levels, REFINED_BY * voxel, &settings)?;
        if found.t_map_lidar.translation.vector.norm() >= voxel {
            return None;
        }
        let information = Some(found.information(&points, &levels));
        Some(Located { t_map_lidar: t_map_lidar * found.t_map_lidar, spread: found.spread, information, ..*located })
    }

    /// Makes the places, for the voxel size that suits the first scan.
    fn prepare(&mut self, returns: &[[f32; 3]]) -> f64 {
        let voxel = *self.voxel.get_or_insert_with(|| automatic_voxel_size(returns));
        if self.places.is_empty() {
            let surface = thinned(&mut self.downsampler, &self.points, voxel, usize::MAX);
            let mut centres: Vec<Pose> = Vec::new();
            for pose in &self.viewpoints {
                if centres.iter().all(|c| c.translation_distance(pose) >= SPACING * voxel) {
                    centres.push(*pose);
                }
            }
            let place = |(k, pose): (usize, &Pose)| {
                let t_lidar_map = Rigid::from(&pose.inverse());
                let radius = (RADIUS * voxel) as f32;
                let is_near = |p: &[f32; 3]| p[0] * p[0] + p[1] * p[1] + p[2] * p[2] < radius * radius;
                let points = surface.iter().map(|p| t_lidar_map.apply(*p)).filter(is_near).collect();
                let view = Keyframe { node: k as u64, t_map_lidar: *pose, piece: 0, path: 0.0, points };
                Place::new(&[&view], voxel, &self.maker)
            };
            self.places = centres.par_iter().enumerate().filter_map(place).collect();
        }
        voxel
    }

    /// Places that look like the scan, best first.
    fn candidates(&self, view: &Place, voxel: f64, about: Option<&Whereabouts>) -> Vec<(usize, Guess)> {
        // A scan is near the place that it fits.
        let is_near = |place: &Place| about.is_none_or(|about| about.distance(&place.t_map_anchor) <= about.within + SPACING * voxel);
        let likeness = |place: &Place| self.maker.compare(&place.signature, &view.signature, 1).first().map_or(-1.0, |l| l.score);
        let mut alike: Vec<(usize, f32)> =
            self.places.par_iter().enumerate().filter(|(_, place)| is_near(place)).map(|(k, place)| (k, likeness(place))).collect();
        alike.sort_by(|a, b| b.1.total_cmp(&a.1));
        alike.truncate(self.settings.most_compared);
        let turned = |place: &Place| {
            let levelled = place.t_map_anchor.rotation * place.level.inverse();
            Some(about?.yaw? - heading(&levelled) - heading(&view.level))
        };
        let guess_at = |(k, _): &(usize, f32)| {
            let place = &self.places[*k];
            best_guess(place, view, turned(place), voxel as f32, &self.maker).map(|guess| (*k, guess))
        };
        let mut guesses: Vec<(usize, Guess)> = alike.par_iter().filter_map(guess_at).collect();
        guesses.sort_by(|a, b| b.1.correlation.total_cmp(&a.1.correlation));
        guesses.truncate(self.settings.most_registered);
        guesses
    }
}

impl Whereabouts {
    fn distance(&self, t_map_lidar: &Pose) -> f64 {
        (t_map_lidar.translation.vector - self.position).norm()
    }

    fn admits(&self, t_map_lidar: &Pose) -> bool {
        self.distance(t_map_lidar) <= self.within && self.yaw.is_none_or(|yaw| turn_between(heading(&t_map_lidar.rotation), yaw) <= HEADING_ERROR)
    }
}

/// The share of all headings in which a scan has returns; `level` makes level what is.
fn share_of_circle(returns: &[[f32; 3]], level: &UnitQuaternion<f64>) -> f64 {
    let turned = Rigid::from(&Pose::from_parts(Vector3::zeros().into(), *level));
    let mut returns_towards = [0; DIRECTIONS];
    for p in returns {
        let [x, y, _] = turned.apply(*p);
        let turn = (y.atan2(x) / std::f32::consts::TAU).rem_euclid(1.0);
        returns_towards[((turn * DIRECTIONS as f32) as usize).min(DIRECTIONS - 1)] += 1;
    }
    // A few returns are of what is right above or below.
    returns_towards.iter().filter(|count| **count * 10 * DIRECTIONS > returns.len()).count() as f64 / DIRECTIONS as f64
}

fn is_same(a: &Pose, b: &Pose, voxel: f64) -> bool {
    a.translation_distance(b) < SAME.0 * voxel && a.rotation_distance(b) < SAME.1
}

/// The direction of the x axis, radians.
fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let x = rotation * Vector3::x();
    x.y.atan2(x.x)
}
