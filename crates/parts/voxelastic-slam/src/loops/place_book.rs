//! The places of a whole recording, to be compared with those of others: in other processes, later, or on other machines.

use super::finder::{Closure, LoopFinder, close, edge};
use super::fine_surface::FineSurface;
use super::overlap::{Guess, best_guess};
use super::place::{Keyframe, Place};
use super::settings::LoopSettings;
use super::signature::{Signature, SignatureMaker};
use super::visible::{MapSurface, Visible};
use crate::registration::automatic_voxel_size;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::{Pose, PoseExt};

/// Distance between the scans of a map's place, in voxels.
const SCAN_SPACING: f64 = 3.0;
/// What is left of the information of a loop edge between maps that could not be measured finely: in a campus such edges were wrong by 0.17 m in the median.
const WEAKER: f64 = 0.04;
/// Scans on either side of a node from which two maps are compared.
const COMPARED_AROUND: usize = 4;
/// A place of a map is left out if another one is nearer than this share of its length.
const SAME_PLACE: f64 = 0.25;

/// The places of a recording or of a map, in the order in which they were passed.
#[derive(Clone, Debug)]
pub struct PlaceBook {
    voxel: f64,
    places: Vec<Place>,
    /// The surfaces of a map; a recording has scans only.
    fine: Option<FineSurface>,
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
        finder.into_places().map(|(voxel, places)| Self { voxel, places, fine: None })
    }

    /// The places of a map: of what can be seen of its surface along the poses from which it was observed, in the order of its scans, in voxels of edge
    /// `voxel`, metres. Places that were passed several times are there once.
    pub fn of_map(surface: &MapSurface<'_>, path: &[(NodeId, Pose)], voxel: f64, settings: &LoopSettings) -> Self {
        let length = settings.place_length * voxel;
        let stations = stations(path, voxel, length);
        let parts = parts(&stations, length);
        let visible = Visible::new(surface, voxel);
        let maker = SignatureMaker::new();
        let place = |part: &std::ops::Range<usize>| {
            let keyframes: Vec<Keyframe> =
                stations[part.clone()].iter().map(|s| visible.keyframe((s.node, s.t_map_lidar), s.piece, s.path)).collect();
            Place::new(&keyframes.iter().collect::<Vec<_>>(), voxel, &maker)
        };
        Self { voxel, places: parts.par_iter().filter_map(place).collect(), fine: Some(FineSurface::new(surface, voxel)) }
    }

    /// The edge of the voxels in which places of a map are best compared, metres: as for a sensor with such a view.
    pub fn voxel_for_map(surface: &MapSurface<'_>, path: &[(NodeId, Pose)]) -> f64 {
        let coarse = Visible::new(surface, 0.5);
        let step = path.len().div_ceil(8).max(1);
        let mut sizes: Vec<f64> = path.iter().step_by(step).map(|(_, pose)| automatic_voxel_size(&coarse.scan(pose))).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len() / 2).copied().unwrap_or(0.5)
    }

    /// Of each place the node in whose frame it is, and that node's pose.
    pub fn anchors(&self) -> impl Iterator<Item = (NodeId, Pose)> {
        self.places.iter().map(|place| (place.node, place.t_map_anchor))
    }

    /// All nodes whose scans are in places, with their poses.
    pub fn nodes(&self) -> impl Iterator<Item = (NodeId, Pose)> {
        self.places.iter().flat_map(|place| place.scans.iter().map(|scan| (scan.node, place.t_map_anchor * scan.t_anchor_lidar)))
    }

    fn pose(&self, node: NodeId) -> Option<Pose> {
        self.nodes().find(|(other, _)| *other == node).map(|(_, pose)| pose)
    }

    /// Registers places of `second` to places of this book from guesses, and judges the outcomes. A guess has the number of a place of this book, that of one of
    /// `second`, and the pose of the second's [anchor](Self::anchors) in the frame of the first's.
    pub fn verify_guesses(&self, second: &Self, guesses: &[(usize, usize, Pose)], settings: &LoopSettings) -> Vec<Closure> {
        let verify = |(a, b, t_first_second): &(usize, usize, Pose)| {
            let (a, b) = (self.places.get(*a)?, second.places.get(*b)?);
            let b = Place { piece: usize::MAX, ..b.clone() };
            Some(close(a, &b, &Guess { t_first_second: *t_first_second, correlation: 1.0 }, self.voxel, settings))
        };
        guesses.par_iter().filter_map(verify).collect()
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

    /// An edge between nodes of two maps, measured by their surfaces where these hold it, else with less information.
    pub fn fine_edge(&self, second: &Self, edge: &Edge) -> Edge {
        let refined = || {
            let (a, b) = (self.fine.as_ref()?, second.fine.as_ref()?);
            a.refined(b, edge, (&self.pose(edge.from)?, &second.pose(edge.to)?), self.voxel)
        };
        refined().unwrap_or_else(|| weaker(edge))
    }

    /// How much two maps differ where an edge lays them on each other: the share of the surfaces of one that are in space that the other saw to be free, the larger of
    /// the two ways. None if the books are not of maps, or too little of the one is where the other saw anything.
    pub fn difference(&self, second: &Self, edge: &Edge) -> Option<f64> {
        let (a, b) = (self.fine.as_ref()?, second.fine.as_ref()?);
        let around = |book: &Self, node: NodeId| {
            let (place, k) = book.places.iter().find_map(|place| Some((place, place.scans.iter().position(|scan| scan.node == node)?)))?;
            Some(place.scans_around(k, COMPARED_AROUND).iter().map(|scan| place.t_map_anchor * scan.t_anchor_lidar).collect::<Vec<_>>())
        };
        let t_first_second = self.pose(edge.from)? * edge.t_from_to * second.pose(edge.to)?.inverse();
        a.contradiction(b, (&around(self, edge.from)?, &around(second, edge.to)?), &t_first_second)
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
        Self { voxel, places: book.places.into_iter().filter_map(place).collect(), fine: None }
    }
}

/// An edge between maps that their surfaces could not measure: places that are made of surfaces are less exact than those of scans.
fn weaker(edge: &Edge) -> Edge {
    Edge { information: edge.information.map(|all| all.map(|value| value * WEAKER)), ..edge.clone() }
}

/// A pose from which a map was observed, at some distance from the one before.
struct Station {
    node: NodeId,
    t_map_lidar: Pose,
    piece: usize,
    /// Length of the path up to here, metres.
    path: f64,
}

/// Poses of a path, spaced as the scans of places are. A jump begins a new piece.
fn stations(path: &[(NodeId, Pose)], voxel: f64, length: f64) -> Vec<Station> {
    let mut all: Vec<Station> = Vec::new();
    let (mut piece, mut travelled, mut before) = (0, 0.0, None::<Pose>);
    for (node, t_map_lidar) in path {
        let step = before.map_or(0.0, |before| before.translation_distance(t_map_lidar));
        let jumps = step > 0.5 * length;
        piece += usize::from(jumps);
        travelled += if jumps { 0.0 } else { step };
        before = Some(*t_map_lidar);
        let is_far = all.last().is_none_or(|last| last.piece != piece || last.t_map_lidar.translation_distance(t_map_lidar) >= SCAN_SPACING * voxel);
        if is_far {
            all.push(Station { node: *node, t_map_lidar: *t_map_lidar, piece, path: travelled });
        }
    }
    all
}

/// The stations of each place: those along `length` metres of path, one every half of it and one at the end of each piece.
fn parts(stations: &[Station], length: f64) -> Vec<std::ops::Range<usize>> {
    let mut parts: Vec<std::ops::Range<usize>> = Vec::new();
    let middle = |part: &std::ops::Range<usize>| stations[part.start + part.len() / 2].t_map_lidar;
    let mut due = 0.0;
    for (end, station) in stations.iter().enumerate() {
        let is_last = stations.get(end + 1).is_none_or(|next| next.piece != station.piece);
        if station.path < due && !is_last {
            continue;
        }
        due = station.path + 0.5 * length;
        let is_of_it = |s: &Station| s.piece == station.piece && s.path >= station.path - length;
        let begin = end - stations[..end].iter().rev().take_while(|s| is_of_it(s)).count();
        let part = begin..end + 1;
        if parts.iter().all(|other| middle(other).translation_distance(&middle(&part)) >= SAME_PLACE * length) {
            parts.push(part);
        } else if let Some(only) = parts.last_mut().filter(|only| is_last && part.start == only.start && stations[only.start].piece == station.piece)
        {
            // A path that is too short for two places is one as a whole, and not its first station.
            *only = part;
        }
    }
    parts
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
