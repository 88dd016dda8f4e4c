//! Where in a map a scan was taken, from an unknown start.

use super::align::align;
use super::beside::beside;
use super::located::{Located, is_near, judged};
use super::overlap::{Guess, HEADING_ERROR, guesses, turn_between};
use super::place::{Keyframe, Place, free_voxel, surfels, thinned};
use super::signature::SignatureMaker;
use crate::deskew::returns;
use crate::free_space::FreeSpace;
use crate::registration::{Downsampler, LocalMap, RegistrationSettings, automatic_voxel_size, register};
use nalgebra::{UnitQuaternion, Vector3};
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
    /// Guesses to which the scan is registered, at most two of one place.
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
            most_registered: 12,
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

/// Directions in which a scan is asked for returns, to know how much of the circle it sees.
const DIRECTIONS: usize = 72;
/// Poses so near each other are the same, and guesses are of the same place: voxels, and radians.
const SAME: (f64, f64) = (2.0, 0.2);
const SAME_GUESS: (f64, f64) = (4.0, 0.35);
/// Guesses of one place that are registered, at most.
const GUESSES_OF_A_PLACE: usize = 2;
/// Rays of a scan or a place that are followed in fine voxels, at most.
const MOST_RAYS: usize = 16_000;

/// What a scan is registered to.
struct Candidate {
    /// Number of the place.
    place: usize,
    guess: Guess,
    /// The guess in the map frame.
    t_map_lidar: Pose,
}

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

    /// As [`locate`](Self::locate), with the other places that the scan was registered to: the most probable first, which alone is refined. Empty where that is `None`.
    pub fn locate_all(&mut self, cloud: &Cloud, about: Option<Whereabouts>) -> Vec<Located> {
        self.locate_among(cloud, &[about])
    }

    /// As [`locate_all`](Self::locate_all), about each of these, and anywhere where one is `None`: what is looked for in a part of a large map is not crowded out by what looks
    /// like the scan elsewhere.
    pub fn locate_among(&mut self, cloud: &Cloud, about: &[Option<Whereabouts>]) -> Vec<Located> {
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
        let free_fine = FreeSpace::with_rays(&view.views(), free_voxel(voxel), MOST_RAYS);
        let limits = self.limits(share_of_circle(&used, &view.level));
        let mut candidates: Vec<Candidate> = Vec::new();
        about.iter().for_each(|about| self.add_candidates(&view, voxel, about.as_ref(), &mut candidates));
        let found = candidates.par_iter().filter_map(|candidate| {
            let place = &self.places[candidate.place];
            let found = align(place, &points, &candidate.guess, voxel)?;
            let t = &found.t_map_lidar;
            let t_map_lidar = place.t_map_anchor * t;
            if !about.iter().any(|about| about.is_none_or(|about| about.admits(&t_map_lidar))) {
                return None;
            }
            // Rays to what the map has behind a wall mark the wall's inside as free, where no scan has surfaces.
            let back = FreeSpace::new(&place.views(), voxel as f32).contradiction(&view.views(), t)?;
            let contradiction = free.contradiction(&place.views(), &t.inverse())?.max(back);
            let back = FreeSpace::with_rays(&place.views(), free_voxel(voxel), MOST_RAYS).contradiction(&view.views(), t)?;
            let fine_contradiction = free_fine.contradiction(&place.views(), &t.inverse())?.max(back);
            Some(Located {
                t_map_lidar,
                probability: 0.0,
                is_possible: found.overlap >= limits.0 && contradiction <= limits.1,
                is_certain: false,
                overlap: found.overlap,
                score: found.score,
                contradiction,
                fine_contradiction,
                beside: beside(&place.scans, &points, t, voxel).unwrap_or(1.0),
                spread: found.spread,
                information: None,
            })
        });
        let mut found = judged(found.collect(), (SAME.0 * voxel, SAME.1));
        if let Some(best) = found.first_mut() {
            *best = self.refined(best, &used, voxel).unwrap_or(*best);
        }
        found
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

    /// Adds places that look like the scan, best first, each with a guess that is not among the candidates yet.
    fn add_candidates(&self, view: &Place, voxel: f64, about: Option<&Whereabouts>, candidates: &mut Vec<Candidate>) {
        // A scan is near the place that it fits.
        let is_about = |place: &Place| about.is_none_or(|about| about.distance(&place.t_map_anchor) <= about.within + SPACING * voxel);
        let likeness = |place: &Place| self.maker.compare(&place.signature, &view.signature, 1).first().map_or(-1.0, |l| l.score);
        let mut alike: Vec<(usize, f32)> =
            self.places.par_iter().enumerate().filter(|(_, place)| is_about(place)).map(|(k, place)| (k, likeness(place))).collect();
        alike.sort_by(|a, b| b.1.total_cmp(&a.1));
        alike.truncate(self.settings.most_compared);
        let turned = |place: &Place| {
            let levelled = place.t_map_anchor.rotation * place.level.inverse();
            Some(about?.yaw? - heading(&levelled) - heading(&view.level))
        };
        let guesses_at = |(k, _): &(usize, f32)| {
            let place = &self.places[*k];
            let candidate = |guess: Guess| Candidate { place: *k, t_map_lidar: place.t_map_anchor * guess.t_first_second, guess };
            guesses(place, view, turned(place), voxel as f32, &self.maker).into_iter().map(candidate).collect::<Vec<_>>()
        };
        let mut found: Vec<Candidate> = alike.par_iter().flat_map_iter(guesses_at).collect();
        found.sort_by(|a, b| b.guess.correlation.total_cmp(&a.guess.correlation));
        // Neighbours guess the same; what else it could be must not be crowded out. One of them may lead astray, so two are tried.
        let most = candidates.len() + self.settings.most_registered;
        for candidate in found {
            let is_same = |other: &&Candidate| is_near(&other.t_map_lidar, &candidate.t_map_lidar, (SAME_GUESS.0 * voxel, SAME_GUESS.1));
            if candidates.len() < most && candidates.iter().filter(is_same).count() < GUESSES_OF_A_PLACE {
                candidates.push(candidate);
            }
        }
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

/// The direction of the x axis, radians.
fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let x = rotation * Vector3::x();
    x.y.atan2(x.x)
}
