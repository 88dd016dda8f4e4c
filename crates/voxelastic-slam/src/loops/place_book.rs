//! The places of a whole recording, to be compared with those of others: in other processes, later, or on other machines.

use super::finder::{Closure, LoopFinder, close, edge};
use super::overlap::{Guess, best_guess};
use super::place::{Keyframe, Place};
use super::settings::LoopSettings;
use super::signature::{Signature, SignatureMaker};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::Pose;

/// The places of a recording, in the order in which it passed them.
#[derive(Clone, Debug)]
pub struct PlaceBook {
    voxel: f64,
    places: Vec<Place>,
}

/// What tells places apart, without their points: small enough to gather those of a whole fleet.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlaceDescriptors {
    voxel: f64,
    signatures: Vec<Signature>,
}

/// Two places that look alike: of two books, by their numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacePair {
    /// Number of the place in the first book.
    pub first: usize,
    /// Number of the place in the second book.
    pub second: usize,
    /// How much they look alike, at most 1.
    pub likeness: f32,
}

/// The serialised form of a place: what all else follows from.
#[derive(Serialize, Deserialize)]
struct StoredPlace {
    anchor: usize,
    piece: usize,
    path: f64,
    scans: Vec<StoredScan>,
}

#[derive(Serialize, Deserialize)]
struct StoredScan {
    node: NodeId,
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_lidar: Pose,
    /// In the lidar frame, metres.
    points: Vec<[f32; 3]>,
}

#[derive(Serialize, Deserialize)]
struct StoredBook {
    voxel: f64,
    places: Vec<StoredPlace>,
}

impl PlaceBook {
    /// The places of all events that a finder has taken, after its [`finish`](LoopFinder::finish); none before the first scan.
    pub fn of(finder: LoopFinder) -> Option<Self> {
        finder.into_places().map(|(voxel, places)| Self { voxel, places })
    }

    /// Number of places.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there is no place.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Edge of the voxels in which places are compared, metres; that of books that are compared should be the same.
    pub fn voxel_size(&self) -> f64 {
        self.voxel
    }

    /// What tells the places apart.
    pub fn descriptors(&self) -> PlaceDescriptors {
        PlaceDescriptors { voxel: self.voxel, signatures: self.places.iter().map(|place| place.signature.clone()).collect() }
    }

    /// Registers places of `second` to places of this book, for each of the former those whose images fit best, and judges the outcomes: all closures that
    /// were tried, by the places of `second`. The recordings may have frames of their own.
    pub fn verify(&self, second: &Self, pairs: &[PlacePair], settings: &LoopSettings) -> Vec<Closure> {
        let maker = SignatureMaker::new();
        let guess = |pair: &PlacePair| {
            let (a, b) = (self.places.get(pair.first)?, second.places.get(pair.second)?);
            let guess = best_guess(a, b, None, self.voxel as f32, &maker)?;
            (guess.correlation >= settings.least_correlation).then_some((pair.second, a, b, guess))
        };
        let mut guesses: Vec<_> = pairs.par_iter().filter_map(guess).collect();
        guesses.sort_by(|x, y| x.0.cmp(&y.0).then(y.3.correlation.total_cmp(&x.3.correlation)));
        let best = guesses.chunk_by(|x, y| x.0 == y.0).flat_map(|same| &same[..same.len().min(settings.most_registered)]);
        let verify = |(_, a, b, guess): &&(usize, &Place, &Place, Guess)| {
            // Poses of different recordings say nothing about each other.
            let b = Place { piece: usize::MAX, ..(*b).clone() };
            close(a, &b, guess, self.voxel, settings)
        };
        best.collect::<Vec<_>>().par_iter().map(verify).collect()
    }

    /// The edge of a closure that was accepted.
    pub fn edge(&self, closure: &Closure) -> Option<Edge> {
        edge(closure, self.voxel)
    }

    /// The book as bytes. Their form belongs to the version of the program.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(&self.stored()).unwrap_or_default()
    }

    /// A book from bytes; none if they are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes::<StoredBook>(bytes).ok().filter(|book| book.voxel > 0.0).map(Self::restored)
    }

    fn stored(&self) -> StoredBook {
        let scan = |place: &Place, k: usize| {
            let scan = &place.scans[k];
            let back = voxelastic::geometry::Rigid::from(&scan.t_anchor_lidar.inverse());
            let points = scan.points.iter().map(|p| back.apply(*p)).collect();
            StoredScan { node: scan.node, t_map_lidar: place.t_map_anchor * scan.t_anchor_lidar, points }
        };
        let place = |place: &Place| StoredPlace {
            anchor: place.scans.iter().position(|scan| scan.node == place.node).unwrap_or(0),
            piece: place.piece,
            path: place.path,
            scans: (0..place.scans.len()).map(|k| scan(place, k)).collect(),
        };
        StoredBook { voxel: self.voxel, places: self.places.iter().map(place).collect() }
    }

    fn restored(book: StoredBook) -> Self {
        let maker = SignatureMaker::new();
        let voxel = book.voxel;
        let place = |stored: StoredPlace| {
            let StoredPlace { anchor, piece, path, scans } = stored;
            let keyframe = |scan: StoredScan| Keyframe { node: scan.node, t_map_lidar: scan.t_map_lidar, piece, path, points: scan.points };
            let keyframes: Vec<Keyframe> = scans.into_iter().map(keyframe).collect();
            Place::anchored(&keyframes.iter().collect::<Vec<_>>(), anchor, voxel, &maker)
        };
        Self { voxel, places: book.places.into_iter().filter_map(place).collect() }
    }
}

impl PlaceDescriptors {
    /// Pairs of places, of `self` and of `second`, that look alike: for each place of `second` the `most` best, best first, in its order. None between
    /// books with different voxels.
    pub fn alike(&self, second: &Self, most: usize) -> Vec<PlacePair> {
        if (self.voxel - second.voxel).abs() > 1e-9 {
            return Vec::new();
        }
        let maker = SignatureMaker::new();
        let best = |(k, signature): (usize, &Signature)| {
            let likeness = |(first, other): (usize, &Signature)| {
                let likeness = maker.compare(other, signature, 1).first().map_or(-1.0, |likeness| likeness.score);
                PlacePair { first, second: k, likeness }
            };
            let mut pairs: Vec<PlacePair> = self.signatures.iter().enumerate().map(likeness).collect();
            pairs.sort_by(|a, b| b.likeness.total_cmp(&a.likeness).then(a.first.cmp(&b.first)));
            pairs.truncate(most);
            pairs
        };
        second.signatures.par_iter().enumerate().flat_map_iter(best).collect()
    }

    /// The descriptors as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// Descriptors from bytes; none if they are damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        postcard::from_bytes(bytes).ok()
    }
}
