//! Where two submaps that saw the same place lie to each other: by their surfaces.

use crate::error::{Error, Result};
use crate::surfaces::{self, SurfaceOptions};
use serde::Serialize;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::event::{Edge, NodeId};
use voxelastic::surface::Mesh;
use voxelastic_slam::join::{Start, join};
use voxelastic_slam::loops::{Closure, LoopSettings, MapSurface, PlaceBook, Verdict};

/// How well two submaps fit.
#[derive(Clone, Debug, Serialize)]
pub struct Fit {
    /// Edges between places of both that were found.
    pub edges: usize,
    /// Share of the surfaces of one that have a counterpart in the other, 0 to 1, where they fit best.
    pub overlap: f64,
    /// How well these lie on each other, 0 to 1.
    pub score: f64,
    /// Robust mean distance of the surfaces, metres.
    pub spread_m: f64,
    /// Share of the surfaces in space that the other saw to be free; `null` where that is not known.
    pub contradiction: Option<f64>,
}

/// A submap with its surface in the map and the path of its scans.
struct View {
    surface: Mesh,
    voxel: f32,
    path: Vec<(NodeId, Pose)>,
}

impl View {
    fn of(submap: &Submap) -> Result<Self> {
        let mut path: Vec<(NodeId, Pose)> = submap.corrected_scans().map(|(node, t)| (node, submap.t_map_submap() * t)).collect();
        path.sort_by_key(|(node, _)| *node);
        let atlas = Atlas::from_submaps(submap.voxel_size(), vec![submap.clone()]);
        let none = |_| Error::new(format!("submap {} has no surface", submap.id()), "name others: `voxelastic info` lists them");
        Ok(Self { surface: surfaces::of_submaps(&atlas, &SurfaceOptions::default()).map_err(none)?, voxel: submap.voxel_size(), path })
    }

    fn surface(&self) -> MapSurface<'_> {
        MapSurface { positions: &self.surface.positions, normals: &self.surface.normals, voxel: self.voxel }
    }
}

/// Registers two submaps. `start` moves the second from where it lies in the map to about where it belongs; without one, where it lies is tried, and then places are
/// recognised.
///
/// # Errors
/// When they do not fit, with how well they do.
pub fn register(first: &Submap, second: &Submap, start: Option<Pose>) -> Result<(Vec<Edge>, Fit)> {
    let (a, b) = (View::of(first)?, View::of(second)?);
    let settings = LoopSettings::default();
    let voxel = PlaceBook::voxel_for_map(&a.surface(), &a.path);
    let book = |view: &View| PlaceBook::of_map(&view.surface(), &view.path, voxel, &settings);
    let (first_book, second_book) = (book(&a), book(&b));
    let attempt = join(&first_book, &second_book, &b.path, start.map_or(Start::Likely(Pose::identity()), Start::Given), &settings)?;
    let score = |closure: &&Closure| closure.fit.map_or(0.0, |fit| fit.score);
    let best = attempt
        .tried
        .iter()
        .max_by(|x, y| (x.verdict == Verdict::Accepted).cmp(&(y.verdict == Verdict::Accepted)).then(score(x).total_cmp(&score(y))));
    let mut edges = attempt.joined.as_ref().map_or_else(Vec::new, |joined| joined.edges.clone());
    if edges.is_empty() {
        // Somebody named the two, so that one place is enough, if it is where they lie, or where the start has them.
        let is_near = |closure: &&Closure| closure.verdict == Verdict::Accepted && closure.correlation >= 1.0;
        let near = attempt.tried.iter().filter(is_near).max_by(|x, y| score(x).total_cmp(&score(y)));
        edges.extend(near.and_then(|closure| Some(first_book.fine_edge(&second_book, &first_book.edge(closure)?))));
    }
    if edges.is_empty() {
        let figures = best.and_then(|closure| Some((closure.fit?, closure.verdict))).map_or_else(String::new, |(fit, verdict)| {
            let why = match verdict {
                Verdict::FreeSpace => "surfaces of one would be in space that the other saw to be free",
                Verdict::BeyondDrift => "the fit is too far from the start",
                Verdict::NotRegistered => "the surfaces hold nothing in some direction",
                Verdict::Accepted => "one place alone fits, which could be another one that looks alike",
                _ => "too few surfaces lie on each other",
            };
            format!("; at best {:.0} % of the surfaces have a counterpart, score {:.2}: {why}", 100.0 * fit.overlap, fit.score)
        });
        let message =
            format!("submaps {} and {} do not fit: {} pairs of places were compared{figures}", first.id(), second.id(), attempt.tried.len());
        return Err(Error::new(message, "give a `start` near the truth; or `scans` with what is `measured`, if you know it"));
    }
    let fit = best.and_then(|closure| closure.fit);
    let fit = Fit {
        edges: edges.len(),
        overlap: fit.map_or(0.0, |fit| fit.overlap),
        score: fit.map_or(0.0, |fit| fit.score),
        spread_m: fit.map_or(0.0, |fit| fit.spread),
        contradiction: fit.and_then(|fit| fit.contradiction),
    };
    Ok((edges, fit))
}
