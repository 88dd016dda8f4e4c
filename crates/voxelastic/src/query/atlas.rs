//! Questions to the whole atlas, in the map frame.

use super::frontier::gather;
use super::ray::{Ray, RayHit};
use super::shape::{Shape, moved};
use super::{FieldQuery, FrontierPoint, Region, UnknownAs};
use crate::atlas::Atlas;
use crate::field::occupancy::{State, UNKNOWN, log_odds, state_of};
use crate::geometry::{Aabb, Pose};
use rayon::prelude::*;

/// Asks all submaps of an atlas at their current root poses, also one that is [being fused](Atlas::retiring). Coordinates are metres
/// in the map frame.
///
/// Making one costs a look at the coarse octants of every submap, for their bounds; make a new one after the map changed.
#[derive(Clone, Debug)]
pub struct AtlasQuery<'a> {
    voxel: f64,
    pub(super) parts: Vec<Part<'a>>,
}

/// A submap that has occupancy.
#[derive(Clone, Debug)]
pub(super) struct Part<'a> {
    pub query: FieldQuery<'a>,
    pub t_map_submap: Pose,
    pub t_submap_map: Pose,
    /// Around everything observed, in the submap frame.
    pub low: [f64; 3],
    pub high: [f64; 3],
}

impl Part<'_> {
    /// Whether anything observed may be in the box (submap frame).
    #[inline(always)]
    pub fn reaches(&self, low: [f64; 3], high: [f64; 3]) -> bool {
        (0..3).all(|k| low[k] <= self.high[k] && high[k] >= self.low[k])
    }

    /// Value at a point of the map frame.
    #[inline(always)]
    pub fn value(&self, p: [f64; 3]) -> i8 {
        let local = moved(&self.t_submap_map, p);
        if self.reaches(local, local) { self.query.value(local) } else { UNKNOWN }
    }

    /// Whether anything observed may be on a ray (submap frame).
    fn may_meet(&self, ray: &Ray) -> bool {
        let end: [f64; 3] = std::array::from_fn(|k| ray.origin[k] + ray.direction[k] * ray.length);
        let is_apart = |k: usize| ray.origin[k].max(end[k]) < self.low[k] || ray.origin[k].min(end[k]) > self.high[k];
        !(ray.length.is_finite() && (0..3).any(is_apart))
    }

    /// The ray in the submap's frame.
    fn ray(&self, ray: &Ray) -> Ray {
        Ray {
            origin: moved(&self.t_submap_map, ray.origin),
            direction: (self.t_submap_map.rotation * nalgebra::Vector3::from(ray.direction)).into(),
            ..*ray
        }
    }
}

/// The stronger of two values: anything known over the unknown, otherwise the larger. Occupied wins over free.
#[inline(always)]
pub(super) fn stronger(a: i8, b: i8) -> i8 {
    // A value of zero is no knowledge of free or occupied either.
    match (state_of(a), state_of(b)) {
        (State::Unknown, State::Unknown) => a.max(b),
        (State::Unknown, _) => b,
        (_, State::Unknown) => a,
        _ => a.max(b),
    }
}

impl<'a> AtlasQuery<'a> {
    /// Asks `atlas`, whose finest voxels have edges of `voxel` metres.
    pub fn new(atlas: &'a Atlas, voxel: f32) -> Self {
        let part = |(submap, t_map_submap): (&'a crate::atlas::Submap, Pose)| {
            let query = FieldQuery::new(&submap.occupancy, voxel);
            let bounds = query.bounds();
            let t_submap_map = t_map_submap.inverse();
            (!bounds.is_empty()).then(|| Part { query, t_map_submap, t_submap_map, low: bounds.min.map(f64::from), high: bounds.max.map(f64::from) })
        };
        let retiring = atlas.retiring().map(|retiring| (retiring.submap, retiring.t_map_submap));
        let submaps = atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap));
        Self { voxel: f64::from(voxel), parts: submaps.chain(retiring).filter_map(part).collect() }
    }

    /// Edge of the finest voxel, metres.
    pub fn voxel(&self) -> f64 {
        self.voxel
    }

    /// Whether no submap knows anything.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Box around everything that any submap observed, map frame; empty when nothing was.
    pub fn bounds(&self) -> Aabb {
        let mut bounds = Aabb::default();
        for part in &self.parts {
            let known = part.query.bounds_in(&part.t_map_submap);
            bounds.add(known.min);
            bounds.add(known.max);
        }
        bounds
    }

    /// Strongest value at `p` in steps.
    #[inline(always)]
    pub(super) fn value(&self, p: [f64; 3]) -> i8 {
        self.parts.iter().fold(UNKNOWN, |best, part| stronger(best, part.value(p)))
    }

    /// State at `p`: occupied if any submap says so, free if some submap says so and none occupied.
    pub fn state(&self, p: [f64; 3]) -> State {
        state_of(self.value(p))
    }

    /// Log-odds of being occupied at `p`, the largest of all submaps that know free or occupied space there.
    pub fn log_odds(&self, p: [f64; 3]) -> Option<f32> {
        log_odds(self.value(p))
    }

    /// What is known of the cubes of 2^level finest voxels around `p`, of which each submap has its own: the strongest state
    /// of all, as [`FieldQuery::at_level`] gives it.
    pub fn at_level(&self, p: [f64; 3], level: u32) -> Region {
        let ask = |part: &Part<'_>| part.query.at_level(moved(&part.t_submap_map, p), level);
        let stronger = |a: Region, b: Region| match (a.state(), b.state()) {
            (State::Unknown, State::Unknown) => {
                if b.max > a.max {
                    b
                } else {
                    a
                }
            }
            (State::Unknown, _) => b,
            (_, State::Unknown) => a,
            _ => {
                if b.max > a.max {
                    b
                } else {
                    a
                }
            }
        };
        self.parts.iter().map(ask).fold(Region::UNSEEN, stronger)
    }

    /// Whether all of `shape` (map frame) is free.
    ///
    /// No submap may have an occupied voxel that the shape touches. Unless unknown space counts as free, submaps may share
    /// the rest: space is taken in cubes of the finest voxel's size (a grid of the map frame), and of each cube's part
    /// in the shape some submap must know all to be free. Where the free spaces of two submaps only just meet, a shape across
    /// both may so be called not free for want of a voxel's overlap, never the other way round.
    pub fn is_free(&self, shape: &Shape, unknown: UnknownAs) -> bool {
        if !shape.is_valid() {
            return false;
        }
        let local: Vec<(&Part<'_>, Shape)> = self.near(shape);
        if unknown == UnknownAs::Blocked && local.is_empty() {
            return false;
        }
        if unknown == UnknownAs::Blocked && local.len() == 1 {
            return local[0].0.query.is_free(&local[0].1, UnknownAs::Blocked);
        }
        // One submap knows all of the shape, most often.
        let mut is_known = unknown == UnknownAs::Free;
        for (part, shape) in &local {
            if !is_known && part.query.is_free(shape, UnknownAs::Blocked) {
                is_known = true;
            } else if !part.query.is_free(shape, UnknownAs::Free) {
                return false;
            }
        }
        is_known || self.is_covered(shape, &local)
    }

    /// Whether some submap knows all of `shape` (map frame) to be free and none of the others has anything occupied in it: what is free by that is
    /// free by [`is_free`](Self::is_free), which also puts together what several submaps know, and takes its time for that.
    pub fn is_free_by_one(&self, shape: &Shape) -> bool {
        if !shape.is_valid() {
            return false;
        }
        let mut is_known = false;
        for (part, shape) in self.near(shape) {
            let knows = !is_known && part.query.is_free(&shape, UnknownAs::Blocked);
            is_known |= knows;
            if !knows && !part.query.is_free(&shape, UnknownAs::Free) {
                return false;
            }
        }
        is_known
    }

    /// The submaps that may know something of the shape, with the shape in their frames.
    fn near(&self, shape: &Shape) -> Vec<(&Part<'a>, Shape)> {
        let local = |part: &'_ Part<'a>| shape.moved(&part.t_submap_map);
        let reaches = |part: &Part<'_>, local: &Shape| {
            let (low, high) = local.bounds();
            part.reaches(low, high)
        };
        self.parts.iter().map(|part| (part, local(part))).filter(|(part, local)| reaches(part, local)).collect()
    }

    /// The first place along `ray` (map frame) that any submap calls occupied or, unless unknown space counts as free, that
    /// none calls free. None when the ray ends before, and for a ray that is none.
    pub fn cast(&self, ray: &Ray, unknown: UnknownAs) -> Option<RayHit> {
        let ray = ray.normalised()?;
        let mut nearest: Option<RayHit> = None;
        let mut left = ray;
        for part in &self.parts {
            let local = part.ray(&left);
            if !part.may_meet(&local) {
                continue;
            }
            if let Some(hit) = part.query.cast_from(&local, 0.0, UnknownAs::Free) {
                let normal = (part.t_map_submap.rotation * nalgebra::Vector3::from(hit.normal)).into();
                // The first of equals stays.
                if nearest.is_none_or(|n| hit.distance < n.distance) {
                    nearest = Some(RayHit { normal, ..hit });
                    left.length = hit.distance;
                }
            }
        }
        if unknown == UnknownAs::Free {
            return nearest;
        }
        self.end_of_free(&left).or(nearest)
    }

    /// Where the free space of all submaps together ends along `ray`, if before the ray does.
    fn end_of_free(&self, ray: &Ray) -> Option<RayHit> {
        let nudge = 1e-6 * self.voxel;
        let (mut at, mut normal) = (0.0, [0.0; 3]);
        loop {
            let mut farthest: Option<(f64, [f64; 3])> = None;
            for part in &self.parts {
                let start = if at > 0.0 { at + nudge } else { 0.0 };
                let hit = part.query.cast_from(&part.ray(ray), start, UnknownAs::Blocked)?;
                if farthest.is_none_or(|(distance, _)| hit.distance > distance) {
                    farthest = Some((hit.distance, (part.t_map_submap.rotation * nalgebra::Vector3::from(hit.normal)).into()));
                }
            }
            match farthest {
                Some((distance, face)) if distance > at + nudge => (at, normal) = (distance, face),
                _ => break,
            }
        }
        (at < ray.length - nudge).then_some(RayHit { distance: at, normal, state: State::Unknown })
    }

    /// The frontier of the whole map, a point for each cube of 2^level finest voxels of the map frame: free space next to
    /// space that no submap knows, in the order of the cubes' coordinates.
    pub fn frontier(&self, level: u32) -> Vec<FrontierPoint> {
        let mut pieces = Vec::new();
        for (i, part) in self.parts.iter().enumerate() {
            let others =
                |p: [f64; 3]| self.parts.iter().enumerate().filter(|(j, _)| *j != i).fold(UNKNOWN, |best, (_, o)| stronger(best, o.value(p)));
            let seen = |p: [f64; 3]| state_of(others(moved(&part.t_map_submap, p)));
            let open = |face: &super::frontier::FrontierFace| seen(face.unknown) == State::Unknown && seen(face.free) != State::Occupied;
            let faces = part.query.frontier_faces();
            pieces.extend(faces.par_iter().filter(|face| open(face)).map(|face| moved_point(&part.t_map_submap, &face.point)).collect::<Vec<_>>());
        }
        gather(pieces.into_iter(), self.voxel * f64::from(1u32 << level.min(30)))
    }
}

fn moved_point(t: &Pose, point: &FrontierPoint) -> FrontierPoint {
    FrontierPoint { position: moved(t, point.position), normal: (t.rotation * nalgebra::Vector3::from(point.normal)).into(), area: point.area }
}
