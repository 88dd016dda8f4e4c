//! How far the surfaces of one map lie beside those of another, where both are.
//!
//! What lies beside its own place, because poses were not exact, is in space that the other map calls free, as a thing is that is not there any more. But then most surfaces
//! around that face the same way are, by about as much; a thing that left is a small part of them.

use crate::atlas::Submap;
use crate::atlas::fusion::places_on_surface;
use crate::field::occupancy::State;
use crate::geometry::Rigid;
use crate::query::{AtlasQuery, UnknownAs};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// The margin is this many times as wide as
const TIMES: f64 = 2.0;
/// this share of the surfaces that face one way lie beside the other map's, at most.
const SHARE: f64 = 0.75;
/// Fewer places on such surfaces tell nothing.
const LEAST_PLACES: usize = 30;
/// A place with no surface of the other map within this, metres, has nothing near.
const FARTHEST: f64 = 0.5;
/// Where more than this share of the places along one axis have nothing near, the maps do not fit: those near the ground always have something.
const MOST: f64 = 0.5;
/// Edge of the squares of ground from which, and from those around, places are taken together, metres.
const SQUARE: f64 = 20.0;

/// By direction (up, down and four more), how far places lie beside the other map's surfaces, metres.
type Distances = [Vec<f64>; 6];

/// How far places on surfaces lie beside another map's.
pub(super) struct Fit {
    by_square: BTreeMap<[i64; 2], Distances>,
    least: f64,
}

impl Fit {
    /// Compares surfaces of submaps with another map. Margins will be `least` metres or wider.
    pub fn of<'a>(submaps: impl IntoIterator<Item = &'a Submap>, other: &AtlasQuery<'_>, least: f64) -> Self {
        let mut by_square: BTreeMap<[i64; 2], Distances> = BTreeMap::new();
        for submap in submaps {
            let t_map_submap = Rigid::from(&submap.t_map_submap);
            let on_map = |(p, n): ([f32; 3], [f32; 3])| (t_map_submap.apply(p), t_map_submap.rotate(n));
            let (places, normals): (Vec<[f32; 3]>, Vec<[f32; 3]>) = places_on_surface(submap).into_iter().map(on_map).unzip();
            let distance_of = |(p, state): (&[f32; 3], State)| match state {
                State::Unknown => None,
                State::Occupied => Some(0.0),
                State::Free => Some(other.clearance(p.map(f64::from), FARTHEST, UnknownAs::Blocked)),
            };
            let distances: Vec<Option<f64>> = places.par_iter().zip(other.states(&places)).map(distance_of).collect();
            for ((place, normal), distance) in places.iter().zip(&normals).zip(distances) {
                if let Some(distance) = distance {
                    by_square.entry(square(&place.map(f64::from))).or_default()[direction(normal)].push(distance);
                }
            }
        }
        Self { by_square, least }
    }

    /// How far around a surface the other map must know free space only, by the place of the surface: map frame, metres. Infinite where the maps do not fit.
    pub fn margins(&self) -> Margins {
        let around = |at: &[i64; 2]| (0..9).map(|step| [at[0] + step % 3 - 1, at[1] + step / 3 - 1]).collect::<Vec<_>>();
        let squares: BTreeSet<[i64; 2]> = self.by_square.keys().flat_map(around).collect();
        let margin = |at: &[i64; 2]| margin(around(at).iter().filter_map(|near| self.by_square.get(near)), self.least);
        Margins { by_square: squares.into_iter().map(|at| (at, margin(&at))).collect(), least: self.least }
    }

    /// The margin by all surfaces together.
    pub fn margin_of_all(&self) -> f64 {
        margin(self.by_square.values(), self.least)
    }
}

/// Margins by place.
pub(super) struct Margins {
    by_square: BTreeMap<[i64; 2], f64>,
    least: f64,
}

impl Margins {
    /// The same margin everywhere.
    pub fn even(margin: f64) -> Self {
        Self { by_square: BTreeMap::new(), least: margin }
    }

    /// The margin at a place in the map frame, metres.
    pub fn at(&self, place: &[f64; 3]) -> f64 {
        self.by_square.get(&square(place)).copied().unwrap_or(self.least)
    }

    /// The widest one that is finite.
    pub fn widest(&self) -> f64 {
        self.by_square.values().copied().filter(|margin| margin.is_finite()).fold(self.least, f64::max)
    }
}

/// The widest margin that surfaces of one direction ask for; infinite if along one axis most have nothing beside them.
fn margin<'a>(all: impl Iterator<Item = &'a Distances>, least: f64) -> f64 {
    let mut together = Distances::default();
    all.for_each(|distances| together.iter_mut().zip(distances).for_each(|(sum, part)| sum.extend(part)));
    let is_nothing_near = |distance: &f64| *distance >= FARTHEST;
    let is_apart = |axis: &[Vec<f64>]| {
        let [known, apart] =
            axis.iter().fold([0, 0], |[known, apart], all| [known + all.len(), apart + all.iter().filter(|d| is_nothing_near(d)).count()]);
        known >= LEAST_PLACES && apart as f64 > MOST * known as f64
    };
    if together.chunks(2).any(is_apart) {
        return f64::INFINITY;
    }
    let most_of = |mut distances: Vec<f64>| {
        // What has nothing near is gone, and so is what lies around it, on the same things: as much again.
        let gone = distances.iter().filter(|d| is_nothing_near(d)).count();
        distances.sort_unstable_by(f64::total_cmp);
        distances.truncate(distances.len().saturating_sub(2 * gone));
        let rank = (SHARE * distances.len() as f64) as usize;
        (distances.len() >= LEAST_PLACES).then(|| distances[rank])
    };
    least.max(TIMES * together.into_iter().filter_map(most_of).fold(0.0, f64::max))
}

fn square(place: &[f64; 3]) -> [i64; 2] {
    [place[0], place[1]].map(|c| (c / SQUARE).floor() as i64)
}

/// The axis that is nearest to a direction, and whether it points up it.
fn direction(normal: &[f32; 3]) -> usize {
    let axis = (0..3).max_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs())).unwrap_or(0);
    2 * axis + usize::from(normal[axis] > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_surfaces_of_a_direction_say_how_well_maps_fit() {
        let margin_of = |up: Vec<f64>, ahead: Vec<f64>| {
            let mut distances = Distances::default();
            (distances[5], distances[1]) = (up, ahead);
            margin([distances].iter(), 0.2)
        };
        let ground = || vec![0.0; 1000];
        assert_eq!(margin_of(ground(), Vec::new()), 0.2);
        // A thing that left is a small part of what faces its way.
        assert_eq!(margin_of(ground(), [vec![0.02; 90], vec![0.5; 20]].concat()), 0.2);
        // All walls that face one way lie beside their places, however much ground there is.
        assert_eq!(margin_of(ground(), vec![0.3; 40]), 0.6);
        assert_eq!(margin_of(ground(), vec![0.3; 10]), 0.2, "too few to tell");
        assert_eq!(margin_of(ground(), vec![0.5; 40]), f64::INFINITY);
        // A wall that left, whose foot and top are near to what is there still, beside one that stands.
        assert_eq!(margin_of(ground(), [vec![0.5; 40], vec![0.3; 30], vec![0.0; 40]].concat()), 0.2);
        assert_eq!(margin([].iter(), 0.2), 0.2);
    }

    #[test]
    fn places_are_taken_together_with_those_around() {
        let beside = |metres: f64| {
            let mut distances = Distances::default();
            distances[0] = vec![metres; 40];
            distances
        };
        let fit = Fit { by_square: BTreeMap::from([([0, 0], beside(0.2)), ([9, 9], beside(0.0))]), least: 0.15 };
        let margins = fit.margins();
        let at = |x: f64, y: f64| margins.at(&[x, y, 1.0]);
        assert_eq!([at(5.0, 5.0), at(-15.0, 30.0), at(50.0, 5.0), at(185.0, 185.0)], [0.4, 0.4, 0.15, 0.15]);
        assert_eq!([margins.widest(), fit.margin_of_all(), Margins::even(0.3).at(&[0.0; 3])], [0.4, 0.4, 0.3]);
    }

    #[test]
    fn directions_are_those_of_the_nearest_axis() {
        assert_eq!([[0.9, 0.1, 0.2], [-0.9, 0.1, 0.2], [0.1, 0.2, 0.7], [0.1, -0.8, 0.6]].map(|n| direction(&n)), [1, 0, 5, 2]);
    }
}
