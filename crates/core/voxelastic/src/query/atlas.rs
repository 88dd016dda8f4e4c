//! Queries on the whole atlas in the map frame.

use super::frontier::{FrontierFace, gather};
use super::point_order::{Cells, FEW};
use super::ray_cast::{Ray, RayHit};
use super::shape::{Shape, moved};
use super::{CellSummary, FieldQuery, FrontierPoint, UnknownAs};
use crate::atlas::{Atlas, Submap, SubmapId};
use crate::field::occupancy::{State, UNKNOWN, log_odds, state_of};
use crate::geometry::{Aabb, Pose, box_around};
use crate::octree::BLOCK_EDGE;
use rayon::prelude::*;

/// Queries all submaps of an atlas at their current root poses, including one that is [being fused](Atlas::merging). Coordinates are
/// metres in the map frame.
///
/// Creating one visits the coarse octants of every submap to find their bounds. It borrows the atlas: create a new one after the map changed.
#[derive(Clone, Debug)]
pub struct AtlasQuery<'a> {
    voxel_size: f64,
    pub(super) parts: Vec<PlacedField<'a>>,
}

/// The occupancy field of a submap, its pose and bounds.
#[derive(Clone, Debug)]
pub(super) struct PlacedField<'a> {
    pub query: FieldQuery<'a>,
    pub t_map_submap: Pose,
    pub t_submap_map: Pose,
    /// Bounds of everything observed, submap frame.
    pub low: [f64; 3],
    pub high: [f64; 3],
    /// Corners of the box around these bounds, map frame: most of a large map is ruled out by it without a transformation.
    around: [[f64; 3]; 2],
}

impl PlacedField<'_> {
    /// Whether the box (map frame) overlaps the box around the bounds.
    #[inline(always)]
    fn is_near(&self, low: [f64; 3], high: [f64; 3]) -> bool {
        (0..3).all(|k| low[k] <= self.around[1][k] && high[k] >= self.around[0][k])
    }

    /// Whether the box (submap frame) overlaps the bounds.
    #[inline(always)]
    pub fn reaches(&self, low: [f64; 3], high: [f64; 3]) -> bool {
        (0..3).all(|k| low[k] <= self.high[k] && high[k] >= self.low[k])
    }

    /// Value at a point in the map frame.
    #[inline(always)]
    pub fn value(&self, p: [f64; 3]) -> i8 {
        if !self.is_near(p, p) {
            return UNKNOWN;
        }
        let local = moved(&self.t_submap_map, p);
        if self.reaches(local, local) { self.query.value(local) } else { UNKNOWN }
    }

    /// Whether a ray (map frame) may cross the bounds.
    fn may_cross(&self, ray: &Ray) -> bool {
        let end: [f64; 3] = std::array::from_fn(|k| ray.origin[k] + ray.direction[k] * ray.length);
        !ray.length.is_finite()
            || self.is_near(std::array::from_fn(|k| ray.origin[k].min(end[k])), std::array::from_fn(|k| ray.origin[k].max(end[k])))
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

/// The union of two values: a known one over an unknown one, otherwise the larger. Occupied wins over free.
#[inline(always)]
pub(super) fn union(a: i8, b: i8) -> i8 {
    // A value of zero is neither free nor occupied.
    match (state_of(a), state_of(b)) {
        (State::Unknown, State::Unknown) => a.max(b),
        (State::Unknown, _) => b,
        (_, State::Unknown) => a,
        _ => a.max(b),
    }
}

impl Submap {
    /// Queries on the submap's occupancy in the submap frame.
    pub fn query(&self) -> FieldQuery<'_> {
        FieldQuery::new(&self.occupancy, self.voxel_size)
    }
}

impl<'a> AtlasQuery<'a> {
    /// Queries on `atlas`, as [`Atlas::query`], but unknown everywhere if the map holds surfaces only.
    pub fn new(atlas: &'a Atlas) -> Self {
        Self::of_submaps(atlas, |_| true)
    }

    /// Queries on the submaps of `atlas` that `is_included` names, as if there were no others: for instance the newest one alone, which drift since an older one does not
    /// contradict.
    pub fn of_submaps(atlas: &'a Atlas, is_included: impl Fn(SubmapId) -> bool) -> Self {
        let part = |(submap, t_map_submap): (&'a Submap, Pose)| {
            let query = submap.query();
            let bounds = query.bounds();
            let t_submap_map = t_map_submap.inverse();
            let (low, high) = (bounds.min.map(f64::from), bounds.max.map(f64::from));
            (!bounds.is_empty()).then(|| PlacedField { query, t_map_submap, t_submap_map, low, high, around: box_around(&t_map_submap, [low, high]) })
        };
        let included = atlas.placed().filter(|(submap, _)| is_included(submap.id()));
        Self { voxel_size: f64::from(atlas.voxel_size()), parts: included.filter_map(part).collect() }
    }

    /// Edge of the finest voxel, metres.
    pub fn voxel_size(&self) -> f64 {
        self.voxel_size
    }

    /// Whether no submap has observations.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Box around everything observed, map frame; empty if nothing was.
    pub fn bounds(&self) -> Aabb {
        let mut bounds = Aabb::default();
        for part in &self.parts {
            let known = part.query.bounds_in(&part.t_map_submap);
            bounds.add(known.min);
            bounds.add(known.max);
        }
        bounds
    }

    /// [Union](union) of the values at `p`, steps.
    #[inline(always)]
    pub(super) fn value(&self, p: [f64; 3]) -> i8 {
        self.parts.iter().fold(UNKNOWN, |best, part| union(best, part.value(p)))
    }

    /// State at `p`: occupied if it is occupied in any submap, free if it is free in some submap and occupied in none.
    pub fn state(&self, p: [f64; 3]) -> State {
        state_of(self.value(p))
    }

    /// The state at each of `points` (metres, map frame), as [`state`](Self::state) gives it.
    pub fn states<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<State> {
        if points.len() < FEW {
            return points.par_iter().with_min_len(64).map(|p| self.state(p.map(Into::into))).collect();
        }
        let mut cells = Cells::new(BLOCK_EDGE as f64 * self.voxel_size);
        for part in &self.parts {
            cells.cover(part.low, part.high, &part.t_map_submap);
        }
        cells.answer(
            points,
            State::Unknown,
            || (),
            |(), points, states| {
                for (state, p) in states.iter_mut().zip(points) {
                    *state = self.state(*p);
                }
            },
        )
    }

    /// Log-odds of occupancy at `p`: the largest of all submaps in which `p` is free or occupied.
    pub fn log_odds(&self, p: [f64; 3]) -> Option<f32> {
        log_odds(self.value(p))
    }

    /// Summary of the cubes of 2^level finest voxels around `p`, one in the grid of each submap: occupied over free over unknown, as
    /// [`FieldQuery::at_level`] returns it.
    pub fn at_level(&self, p: [f64; 3], level: u32) -> CellSummary {
        let summary = |part: &PlacedField<'_>| part.query.at_level(moved(&part.t_submap_map, p), level);
        let larger = |a: CellSummary, b: CellSummary| match (a.state(), b.state()) {
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
        self.parts.iter().map(summary).fold(CellSummary::UNKNOWN, larger)
    }

    /// Whether all of `shape` (map frame) is free.
    ///
    /// The shape may not touch an occupied voxel of any submap. Unless unknown space counts as free, the free spaces of submaps complete
    /// each other: space is divided into cubes of the finest voxel's size (a grid of the map frame), and each cube's intersection with the
    /// shape must be free in some submap. Where the free spaces of two submaps overlap by less than a voxel, a shape across both may be
    /// reported as not free, never the other way round.
    pub fn is_free(&self, shape: &Shape, unknown: UnknownAs) -> bool {
        if !shape.is_valid() {
            return false;
        }
        let local: Vec<(&PlacedField<'_>, Shape)> = self.near(shape);
        if unknown == UnknownAs::Blocked && local.is_empty() {
            return false;
        }
        if unknown == UnknownAs::Blocked && local.len() == 1 {
            return local[0].0.query.is_free(&local[0].1, UnknownAs::Blocked);
        }
        // Most often the whole shape is free in one submap.
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

    /// Whether all of `shape` (map frame) is free in some submap and nothing in it is occupied in any other: sufficient for
    /// [`is_free`](Self::is_free), which also combines the free spaces of several submaps and takes longer.
    pub fn is_free_by_one(&self, shape: &Shape) -> bool {
        if !shape.is_valid() {
            return false;
        }
        let mut is_known = false;
        for (part, shape) in self.near(shape) {
            let is_free = !is_known && part.query.is_free(&shape, UnknownAs::Blocked);
            is_known |= is_free;
            if !is_free && !part.query.is_free(&shape, UnknownAs::Free) {
                return false;
            }
        }
        is_known
    }

    /// The submaps whose bounds the shape overlaps, with the shape in their frames.
    fn near(&self, shape: &Shape) -> Vec<(&PlacedField<'a>, Shape)> {
        let (low, high) = shape.bounds();
        let local = |part: &'_ PlacedField<'a>| shape.moved(&part.t_submap_map);
        let reaches = |part: &PlacedField<'_>, local: &Shape| {
            let (low, high) = local.bounds();
            part.reaches(low, high)
        };
        let near = self.parts.iter().filter(|part| part.is_near(low, high));
        near.map(|part| (part, local(part))).filter(|(part, local)| reaches(part, local)).collect()
    }

    /// First point along `ray` (map frame) that is occupied in any submap or, unless unknown space counts as free, free in none. None if
    /// the ray ends before, or if the ray is invalid.
    pub fn ray_cast(&self, ray: &Ray, unknown: UnknownAs) -> Option<RayHit> {
        let ray = ray.normalised()?;
        let mut nearest: Option<RayHit> = None;
        let mut left = ray;
        for part in &self.parts {
            if !part.may_cross(&left) {
                continue;
            }
            if let Some(hit) = part.query.ray_cast_from(&part.ray(&left), 0.0, UnknownAs::Free) {
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

    /// Where the union of the submaps' free spaces ends along `ray`, if before the ray does.
    fn end_of_free(&self, ray: &Ray) -> Option<RayHit> {
        let nudge = 1e-6 * self.voxel_size;
        let (mut at, mut normal) = (0.0, [0.0; 3]);
        loop {
            let mut farthest: Option<(f64, [f64; 3])> = None;
            for part in &self.parts {
                let start = if at > 0.0 { at + nudge } else { 0.0 };
                let hit = part.query.ray_cast_from(&part.ray(ray), start, UnknownAs::Blocked)?;
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

    /// The frontier of the whole map: free space next to space that is unknown in all submaps. One point per cube of 2^level finest voxels
    /// of the map frame, ordered by the cubes' coordinates.
    pub fn frontier(&self, level: u32) -> Vec<FrontierPoint> {
        let mut points = Vec::new();
        for (i, part) in self.parts.iter().enumerate() {
            let others = |p: [f64; 3]| self.parts.iter().enumerate().filter(|(j, _)| *j != i).fold(UNKNOWN, |best, (_, o)| union(best, o.value(p)));
            let other_state = |p: [f64; 3]| state_of(others(moved(&part.t_map_submap, p)));
            let is_frontier = |face: &FrontierFace| other_state(face.unknown) == State::Unknown && other_state(face.free) != State::Occupied;
            let faces = part.query.frontier_faces();
            points.extend(
                faces.par_iter().filter(|face| is_frontier(face)).map(|face| transformed(&part.t_map_submap, &face.point)).collect::<Vec<_>>(),
            );
        }
        gather(points.into_iter(), self.voxel_size * f64::from(1u32 << level.min(30)))
    }
}

fn transformed(t: &Pose, point: &FrontierPoint) -> FrontierPoint {
    FrontierPoint { position: moved(t, point.position), normal: (t.rotation * nalgebra::Vector3::from(point.normal)).into(), area: point.area }
}
