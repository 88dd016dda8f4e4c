//! The search for loop closures in a stream of events.

use super::drift::{Drift, Errors};
use super::overlap::{Guess, best_guess};
use super::place::{Keyframe, Place, thinned};
use super::settings::LoopSettings;
use super::signature::SignatureMaker;
use super::ties::Ties;
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
/// Length of path that a closure counts for, in voxels: places are not rigid.
const CLOSURE_LENGTH: f64 = 5.0;
/// The first places in which errors of poses are measured, and of those that follow one in so many.
const MEASURED: (usize, usize) = (10, 4);
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
    /// Distance between the closure and what odometry and closures before it say, metres; by the poses as they came where nothing ties the places together.
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
    /// The odometry cannot be as wrong as that: by what it got wrong along the way, in that direction.
    BeyondDrift,
}

/// The outcomes of all searches so far. A finder that [knows](LoopFinder::with_searches) them need not search again.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Searches {
    by_place: VecDeque<Search>,
}

/// What a place was found to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Search {
    /// What its poses got wrong.
    drift: Option<Errors>,
    /// Closures that were tried.
    tried: Vec<Closure>,
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
    ties: Ties,
    drift: Drift,
    closures: Vec<Closure>,
    /// What each place's poses got wrong, and how many closures were tried.
    searches: Vec<(Option<Errors>, usize)>,
    /// Outcomes of the next searches, if this finder takes events that another one has taken.
    known: VecDeque<Search>,
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
            ties: Ties::default(),
            drift: Drift::default(),
            closures: Vec::new(),
            searches: Vec::new(),
            known: VecDeque::new(),
            downsampler: Downsampler::default(),
        }
    }

    /// Takes the outcomes of its first searches from another finder, with the same settings, that has taken the same events.
    #[must_use]
    pub fn with_searches(self, searches: Searches) -> Self {
        Self { known: searches.by_place, ..self }
    }

    /// The outcomes of the searches so far.
    pub fn searches(&self) -> Searches {
        let mut rest = &self.closures[..];
        let take = |(drift, count): &(Option<Errors>, usize)| {
            let (tried, others) = rest.split_at(*count);
            rest = others;
            Search { drift: *drift, tried: tried.to_vec() }
        };
        Searches { by_place: self.searches.iter().map(take).collect() }
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
        let known = self.known.pop_front();
        let number = self.places.len();
        let is_measured = number < MEASURED.0 || number.is_multiple_of(MEASURED.1);
        let drift = known.as_ref().map_or_else(|| if is_measured { Errors::within(&place, voxel) } else { None }, |search| search.drift);
        drift.iter().for_each(|measured| self.drift.add(measured));
        if let Some(before) = self.places.last().filter(|before| before.piece == place.piece) {
            self.ties.add(number - 1, number, &before.t_map_anchor.inv_mul(&place.t_map_anchor), place.path - before.path);
        }
        let tried = known.map_or_else(|| self.search(&place, number, voxel, length), |search| search.tried);
        self.searches.push((drift, tried.len()));
        self.places.push(place);
        let accepted = || tried.iter().filter(|closure| closure.verdict == Verdict::Accepted);
        accepted().for_each(|closure| self.tie(closure, number, voxel));
        let mut edges: Vec<Edge> = accepted().filter_map(|c| edge(c, voxel)).collect();
        edges.sort_by_key(|e| (e.from, e.to));
        edges.dedup_by_key(|e| (e.from, e.to));
        self.closures.extend(tried);
        edges
    }

    /// Ties the place with this number to the one that a closure says it is.
    fn tie(&mut self, closure: &Closure, number: usize, voxel: f64) {
        let (Some(fit), Some(second)) = (closure.fit, self.places.get(number)) else { return };
        let first = self.places.iter().enumerate().find_map(|(k, first)| Some((k, first.t_anchor(closure.from)?)));
        if let Some(((k, of_first), of_second)) = first.zip(second.t_anchor(closure.to)) {
            self.ties.add(k, number, &(of_first * fit.t_first_second * of_second.inverse()), CLOSURE_LENGTH * voxel);
        }
    }

    /// Looks for a place among those before.
    fn search(&self, place: &Place, number: usize, voxel: f64, length: f64) -> Vec<Closure> {
        let candidates = self.candidates(place, voxel, length);
        let known = self.ties.from(number);
        let most_contradiction = self.drift.most_contradiction(self.settings.most_contradiction);
        let settings = LoopSettings { most_contradiction, ..self.settings.clone() };
        let close = |(k, guess): &(usize, Guess)| {
            let closure = close(&self.places[*k], place, guess, voxel, &settings);
            // The way there, backwards.
            let way = known.get(*k).copied().flatten().map(|(t_second_first, metres)| (t_second_first.inverse(), metres));
            way.map_or(closure, |(expected, metres)| within_drift(closure, &self.drift, (&self.places[*k], place), &expected, metres, voxel))
        };
        candidates.par_iter().map(close).collect()
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

/// Registers a place to an earlier one and judges the outcome, whatever lies between them.
pub(super) fn close(first: &Place, second: &Place, guess: &Guess, voxel: f64, settings: &LoopSettings) -> Closure {
    let found = fit(first, second, guess, voxel, (settings.least_overlap, settings.least_score));
    let (from, to) = found.map_or((first.node, second.node), |f| f.nodes);
    let claimed = found.map_or(guess.t_first_second, |f| f.t_first_second);
    let came = |place: &Place, node: NodeId| place.t_map_anchor * place.t_anchor(node).unwrap_or_default();
    let correction_m = came(first, from).inv_mul(&came(second, to)).translation_distance(&claimed);
    let verdict = match &found {
        None => Verdict::NotRegistered,
        Some(f) if f.overlap < settings.least_overlap || f.score < settings.least_score => Verdict::PoorFit,
        Some(f) if f.degenerate > 0 => Verdict::NotRegistered,
        Some(f) if f.contradiction.is_none_or(|c| c > settings.most_contradiction) => Verdict::FreeSpace,
        _ => Verdict::Accepted,
    };
    Closure { from, to, correlation: guess.correlation, fit: found, correction_m, verdict }
}

/// A closure of two places, held against where the second is `expected` in the frame of the first, by so many metres of path.
fn within_drift(closure: Closure, drift: &Drift, places: (&Place, &Place), expected: &Pose, metres: f64, voxel: f64) -> Closure {
    let (Some(fit), Some(of_first), Some(of_second)) = (closure.fit, places.0.t_anchor(closure.from), places.1.t_anchor(closure.to)) else {
        return closure;
    };
    let claim = of_first * fit.t_first_second * of_second.inverse();
    let correction_m = claim.translation_distance(expected);
    let is_possible = drift.claimed(places, expected, &claim, metres, voxel) <= 1.0;
    let verdict = if closure.verdict == Verdict::Accepted && !is_possible { Verdict::BeyondDrift } else { closure.verdict };
    Closure { correction_m, verdict, ..closure }
}

pub(super) fn edge(closure: &Closure, voxel: f64) -> Option<Edge> {
    let fit = closure.fit?;
    let (position, angle) = ((SIGMA.0 * voxel).powi(2), SIGMA.1.to_radians().powi(2));
    let places = Matrix6::from_diagonal(&Vector6::new(position, position, position, angle, angle, angle));
    let registration = fit.information.and_then(|upper| symmetric(&upper).cholesky()).map_or_else(Matrix6::zeros, |whole| whole.inverse());
    let information = Some(upper_triangle(&(places + registration).cholesky()?.inverse()));
    Some(Edge { from: closure.from, to: closure.to, t_from_to: fit.t_first_second, information })
}
