//! A local plane for every scattered return, and the distance between returns around it.

use super::between::add_between;
use super::cells::CellOrder;
use super::neighbours::Neighbours;
use super::plane::{Plane, fit, fit_wider};
use crate::sensor::normals::NormalSettings;
use crate::sensor::returns::Returns;
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 1024;
/// A return within this many standard deviations is on its plane; on a neighbour's, which was not fitted to it, it must be nearer.
const ON_PLANE: f32 = 3.0;
const ON_NEIGHBOUR: f32 = 2.0;
/// Noise that a scan shows is taken to be within these bounds, metres.
const NOISE: [f32; 2] = [0.002, 0.03];

/// Fits planes to scattered returns. Holds scratch memory.
#[derive(Clone, Debug)]
pub(crate) struct ScatteredFitter {
    settings: NormalSettings,
    /// Distance between points that are added between returns, metres.
    step: Option<f32>,
    order: CellOrder,
    neighbours: Neighbours,
    planes: Vec<Plane>,
}

impl ScatteredFitter {
    pub(crate) fn new(settings: NormalSettings) -> Self {
        Self { settings, step: None, order: CellOrder::default(), neighbours: Neighbours::default(), planes: Vec::new() }
    }

    /// Sets the distance between points that are added between returns, metres.
    pub(crate) fn set_step(&mut self, step: f32) {
        self.step = Some(step);
    }

    /// Sorts the indices of returns among `points` into the order in which [`fit`](Self::fit) needs them: those near to each other follow each other.
    pub(crate) fn sort(&mut self, points: &[[f32; 3]], which: &mut Vec<u32>) {
        self.order.sort(points, which);
    }

    /// Fills the normals, roughness and spacing of `returns`, in the order of [`sort`](Self::sort), and adds points between them.
    pub(crate) fn fit(&mut self, returns: &mut Returns) {
        let Self { settings, order, neighbours, planes, .. } = self;
        let (points, origins) = (&returns.points[..], &returns.origins[..]);
        neighbours.find(points, &order.keys);
        planes.clear();
        planes.resize(points.len(), Plane::default());
        let neighbours = &*neighbours;
        planes.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, planes)| fit(points, neighbours, chunk * CHUNK, planes));
        let noise = settings.range_noise.unwrap_or_else(|| noise_of(planes));
        let chunks = planes.par_chunks_mut(CHUNK).enumerate();
        chunks.for_each(|(chunk, planes)| accept(points, neighbours, chunk * CHUNK, planes, noise, settings));
        planes
            .par_iter_mut()
            .zip(points)
            .enumerate()
            .with_min_len(CHUNK)
            .for_each(|(i, (plane, &p))| plane.face(origins.get(i).copied().unwrap_or_default(), p));
        let spread = noise.max(settings.roughness);
        let planes = &planes[..];
        let chosen = (0..points.len()).into_par_iter().with_min_len(CHUNK).map(|i| {
            let plane = choose(i, points[i], neighbours, planes, spread);
            plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness))
        });
        (returns.normals, returns.roughness) = chosen.unzip();
        returns.spacing.clear();
        returns.spacing.extend((0..returns.points.len()).map(|i| neighbours.spacing(i)));
        if let Some(step) = self.step {
            add_between(returns, |i| self.neighbours.of(i), spread, step);
        }
    }
}

/// Accepts or rejects planes, those of the returns from `first` on. Where the neighbours are too near to each other for their noise, those of the neighbours tell
/// more.
fn accept(points: &[[f32; 3]], neighbours: &Neighbours, first: usize, planes: &mut [Plane], noise: f32, settings: &NormalSettings) {
    let mut uncertain = Vec::new();
    for (i, plane) in (first..).zip(&mut *planes) {
        plane.accept(noise, settings);
        if !plane.is_accepted && plane.breadth > 0.0 && plane.is_flat(noise, settings) {
            uncertain.push(i as u32);
        }
    }
    let mut wider = vec![Plane::default(); uncertain.len()];
    fit_wider(points, neighbours, &uncertain, &mut wider);
    for (i, mut plane) in uncertain.into_iter().zip(wider) {
        plane.accept(noise, settings);
        planes[i as usize - first] = plane;
    }
}

/// The plane of return `i` at `p`: its own, or where that is rejected or does not contain it, the best of its neighbours': at an edge or a crease, the
/// neighbourhoods of the returns on one side contain one surface only.
fn choose<'a>(i: usize, p: [f32; 3], neighbours: &Neighbours, planes: &'a [Plane], spread: f32) -> Option<&'a Plane> {
    let own = &planes[i];
    if own.is_accepted && own.misfit(p, spread) <= ON_PLANE {
        return Some(own);
    }
    let others = neighbours.of(i).iter().map(|&j| &planes[j as usize]).filter(|plane| plane.is_accepted);
    let best = others.map(|plane| (plane.misfit(p, spread), plane)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(misfit, _)| *misfit <= ON_NEIGHBOUR).map(|(_, plane)| plane)
}

/// The noise of a scan: the median deviation from planes, metres.
fn noise_of(planes: &[Plane]) -> f32 {
    let mut deviations: Vec<f32> = planes.iter().filter(|plane| plane.breadth > 0.0).map(|plane| plane.roughness).collect();
    if deviations.is_empty() {
        return NOISE[1];
    }
    let middle = deviations.len() / 2;
    deviations.select_nth_unstable_by(middle, f32::total_cmp).1.clamp(NOISE[0], NOISE[1])
}
