//! The search for loop closures in a stream of events.

use super::overlap::{Guess, best_guess};
use super::place::{Keyframe, Place, thinned};
use super::settings::LoopSettings;
use super::signature::SignatureMaker;
use super::verify::{Fit, fit};
use crate::deskew::returns;
use crate::graph::{symmetric, upper_triangle};
use crate::registration::{Downsampler, automatic_voxel_size};
use nalgebra::{Matrix6, Vector6};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::{Pose, PoseExt};

/// Distance between the scans of a place, in voxels.
const SCAN_SPACING: f64 = 3.0;
/// Points of a scan that are kept.
const MOST_POINTS: usize = 8000;
/// Error of the odometry that is always possible, in voxels.
const ALWAYS_POSSIBLE: f64 = 10.0;
/// Standard deviations of a closure beside those of its registration, as the places are not rigid: of the position in voxels, and of the rotation in degrees.
const SIGMA: (f64, f64) = (0.1, 0.2);

/// A closure that was tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Closure {
    /// A node of the place that was there first.
    pub from: NodeId,
    /// A node of the place that looks like it.
    pub to: NodeId,
    /// Correlation of their images, 0 to 1.
    pub correlation: f32,
    /// How well they fit on each other; `None` if they could not be registered.
    pub fit: Option<Fit>,
    /// Distance between the closure and what the odometry says, metres.
    pub correction_m: f64,
    /// Whether it was accepted, or why not.
    pub verdict: Verdict,
}

/// Whether a closure is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Verdict {
    /// Believed.
    Accepted,
    /// The places could not be registered, or hold nothing in some direction.
    NotRegistered,
    /// Too few surfaces of the one are in the other, or they do not lie on each other.
    PoorFit,
    /// Surfaces of the one would be in space that the other saw to be free.
    FreeSpace,
    /// The odometry cannot be as wrong as that.
    BeyondDrift,
}

/// The outcomes of all searches so far. A finder that [knows](LoopFinder::with_searches) them need not search again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Searches {
    /// Closures tried in each search.
    tried: VecDeque<Vec<Closure>>,
}

/// Finds places that were visited before.
#[derive(Debug)]
pub struct LoopFinder {
    settings: LoopSettings,
    maker: SignatureMaker,
    voxel: Option<f64>,
    /// A scan that waits for its odometry edge.
    pending: Option<Keyframe>,
    last: Option<(NodeId, Pose)>,
    piece: usize,
    path: f64,
    /// Keyframes of the last metres.
    recent: VecDeque<Keyframe>,
    /// Path at which the next place ends.
    due: f64,
    places: Vec<Place>,
    closures: Vec<Closure>,
    /// How many of them each search tried.
    searches: Vec<usize>,
    /// Outcomes of the next searches, if this finder takes events that another one has taken.
    known: VecDeque<Vec<Closure>>,
    downsampler: Downsampler,
}

impl LoopFinder {
    /// A finder that has taken no scan.
    pub fn new(settings: LoopSettings) -> Self {
        Self {
            voxel: settings.voxel_size,
            settings,
            maker: SignatureMaker::new(),
            pending: None,
            last: None,
            piece: 0,
            path: 0.0,
            recent: VecDeque::new(),
            due: 0.0,
            places: Vec::new(),
            closures: Vec::new(),
            searches: Vec::new(),
            known: VecDeque::new(),
            downsampler: Downsampler::default(),
        }
    }

    /// Takes the outcomes of its first searches from another finder, with the same settings, that has taken the same events.
    #[must_use]
    pub fn with_searches(self, searches: Searches) -> Self {
        Self { known: searches.tried, ..self }
    }

    /// The outcomes of the searches so far.
    pub fn searches(&self) -> Searches {
        let mut rest = &self.closures[..];
        let take = |count: &usize| {
            let (tried, others) = rest.split_at(*count);
            rest = others;
            tried.to_vec()
        };
        Searches { tried: self.searches.iter().map(take).collect() }
    }

    /// Looks at an event. Returns loop edges to nodes that came before; they belong before the event.
    pub fn take(&mut self, event: &Event) -> Vec<Edge> {
        match event {
            Event::Scan(scan) => {
                let found = self.settle(false);
                self.pending = self.keyframe(scan);
                found
            }
            Event::OdometryEdge(edge) => {
                if self.last.is_some_and(|(node, _)| node == edge.from || node == edge.to)
                    && let Some(pending) = &mut self.pending
                {
                    pending.piece = self.piece;
                }
                Vec::new()
            }
            _ => Vec::new(),
        }
    }

    /// The last closures, after the last event.
    pub fn finish(&mut self) -> Vec<Edge> {
        let mut found = self.settle(true);
        found.extend(self.complete_place());
        found
    }

    /// The points of the last scan, thinned and as from one pose, lidar frame, metres; none if it had no returns. A finder with the same
    /// [voxel size](LoopSettings::voxel_size) that takes a scan of these points does what this one does.
    pub fn last_points(&self) -> Option<&[[f32; 3]]> {
        self.pending.as_ref().map(|pending| &pending.points[..])
    }

    /// The edge of the voxels that it uses, metres; none before the first scan.
    pub fn voxel_size(&self) -> Option<f64> {
        self.voxel
    }

    /// All closures that were tried, in order.
    pub fn closures(&self) -> &[Closure] {
        &self.closures
    }

    /// The edge of the voxels that it uses, and the places so far; none before the first scan.
    pub(super) fn into_places(self) -> Option<(f64, Vec<Place>)> {
        Some((self.voxel?, self.places))
    }

    /// The scan, thinned; its piece is a new one until its odometry edge comes. None if it has no returns.
    fn keyframe(&mut self, scan: &Scan) -> Option<Keyframe> {
        let mut points = Vec::new();
        returns(&scan.cloud, scan.cloud.motion.as_ref(), [self.settings.min_range, self.settings.max_range], &mut points);
        if points.is_empty() {
            return None;
        }
        let voxel = *self.voxel.get_or_insert_with(|| automatic_voxel_size(&points));
        let points = thinned(&mut self.downsampler, &points, voxel, MOST_POINTS);
        Some(Keyframe { node: scan.node, t_map_lidar: scan.t_map_lidar, piece: self.piece + 1, path: 0.0, points })
    }

    /// Adds the scan that waited, and searches for closures if a place is complete with it.
    fn settle(&mut self, is_last: bool) -> Vec<Edge> {
        let Some(mut keyframe) = self.pending.take() else { return Vec::new() };
        let voxel = self.voxel.unwrap_or(1.0);
        let mut found = Vec::new();
        if keyframe.piece > self.piece && self.last.is_some() {
            found = self.complete_place();
            self.recent.clear();
            self.piece = keyframe.piece;
        } else if let Some((_, before)) = self.last {
            self.path += before.translation_distance(&keyframe.t_map_lidar);
        }
        keyframe.piece = self.piece;
        keyframe.path = self.path;
        self.last = Some((keyframe.node, keyframe.t_map_lidar));
        let is_far = self.recent.back().is_none_or(|last| last.t_map_lidar.translation_distance(&keyframe.t_map_lidar) >= SCAN_SPACING * voxel);
        if is_far {
            self.recent.push_back(keyframe);
        }
        if self.path >= self.due && !is_last {
            found.extend(self.complete_place());
            self.due = self.path + 0.5 * self.settings.place_length * voxel;
        }
        found
    }

    /// Makes a place of the last keyframes and searches for it among those before.
    fn complete_place(&mut self) -> Vec<Edge> {
        let Some(voxel) = self.voxel else { return Vec::new() };
        let length = self.settings.place_length * voxel;
        while self.recent.front().is_some_and(|k| k.path < self.path - length) {
            self.recent.pop_front();
        }
        let keyframes: Vec<&Keyframe> = self.recent.iter().collect();
        let Some(place) = Place::new(&keyframes, voxel, &self.maker) else { return Vec::new() };
        let tried = self.known.pop_front().unwrap_or_else(|| {
            let candidates = self.candidates(&place, voxel, length);
            candidates.par_iter().map(|(k, guess)| close(&self.places[*k], &place, guess, voxel, &self.settings)).collect()
        });
        let mut edges: Vec<Edge> = tried.iter().filter(|c| c.verdict == Verdict::Accepted).filter_map(|c| edge(c, voxel)).collect();
        edges.sort_by_key(|e| (e.from, e.to));
        edges.dedup_by_key(|e| (e.from, e.to));
        self.searches.push(tried.len());
        self.closures.extend(tried);
        self.places.push(place);
        edges
    }

    /// Earlier places that look like this one, best first, with how it would lie in their frames.
    fn candidates(&self, place: &Place, voxel: f64, length: f64) -> Vec<(usize, Guess)> {
        let is_elsewhere = |other: &Place| other.piece != place.piece || place.path - other.path > 1.5 * length;
        let likeness = |other: &Place| self.maker.compare(&other.signature, &place.signature, 1).first().map_or(-1.0, |l| l.score);
        let mut alike: Vec<(usize, f32)> =
            self.places.iter().enumerate().filter(|(_, other)| is_elsewhere(other)).map(|(k, other)| (k, likeness(other))).collect();
        alike.sort_by(|a, b| b.1.total_cmp(&a.1));
        alike.truncate(self.settings.most_compared);
        let mut guesses: Vec<(usize, Guess)> = alike
            .par_iter()
            .filter_map(|(k, _)| best_guess(&self.places[*k], place, None, voxel as f32, &self.maker).map(|guess| (*k, guess)))
            .collect();
        guesses.retain(|(_, guess)| guess.correlation >= self.settings.least_correlation);
        guesses.sort_by(|a, b| b.1.correlation.total_cmp(&a.1.correlation));
        guesses.truncate(self.settings.most_registered);
        guesses
    }
}

/// Registers a place to an earlier one and judges the outcome.
pub(super) fn close(first: &Place, second: &Place, guess: &Guess, voxel: f64, settings: &LoopSettings) -> Closure {
    let found = fit(first, second, guess, voxel, (settings.least_overlap, settings.least_score));
    let (from, to) = found.map_or((first.node, second.node), |f| f.nodes);
    let claimed = found.map_or(guess.t_first_second, |f| f.t_first_second);
    let correction_m = by_odometry(first, second, from, to).translation_distance(&claimed);
    let possible = ALWAYS_POSSIBLE * voxel + settings.most_drift * (second.path - first.path);
    let verdict = match &found {
        None => Verdict::NotRegistered,
        Some(f) if f.overlap < settings.least_overlap || f.score < settings.least_score => Verdict::PoorFit,
        Some(f) if f.degenerate > 0 => Verdict::NotRegistered,
        Some(f) if f.contradiction.is_none_or(|c| c > settings.most_contradiction) => Verdict::FreeSpace,
        _ if first.piece == second.piece && correction_m > possible => Verdict::BeyondDrift,
        _ => Verdict::Accepted,
    };
    Closure { from, to, correlation: guess.correlation, fit: found, correction_m, verdict }
}

/// Pose of a node of `second` in the frame of one of `first`, as the odometry has it.
fn by_odometry(first: &Place, second: &Place, from: NodeId, to: NodeId) -> Pose {
    let pose = |place: &Place, node: NodeId| {
        let scan = place.scans.iter().find(|scan| scan.node == node);
        scan.map_or(place.t_map_anchor, |scan| place.t_map_anchor * scan.t_anchor_lidar)
    };
    pose(first, from).inv_mul(&pose(second, to))
}

pub(super) fn edge(closure: &Closure, voxel: f64) -> Option<Edge> {
    let fit = closure.fit?;
    let (position, angle) = ((SIGMA.0 * voxel).powi(2), SIGMA.1.to_radians().powi(2));
    let places = Matrix6::from_diagonal(&Vector6::new(position, position, position, angle, angle, angle));
    let registration = fit.information.and_then(|upper| symmetric(&upper).cholesky()).map_or_else(Matrix6::zeros, |whole| whole.inverse());
    let information = Some(upper_triangle(&(places + registration).cholesky()?.inverse()));
    Some(Edge { from: closure.from, to: closure.to, t_from_to: fit.t_first_second, information })
}
