//! A local plane for every scattered return, and the distance between returns around it.

use super::between::add_between;
use super::neighbours::Neighbours;
use crate::geometry::smallest_eigenvector;
use crate::sensor::normals::NormalSettings;
use crate::sensor::returns::Returns;
use rayon::prelude::*;

/// Returns of one task.
const CHUNK: usize = 256;
/// Fewer neighbours make no plane.
const LEAST: usize = 6;
/// A return within this many standard deviations is on its plane; on a neighbour's, which was not fitted to it, it must be nearer.
const ON_PLANE: f32 = 3.0;
const ON_NEIGHBOUR: f32 = 2.0;
/// Noise that a scan shows is taken to be within these bounds, metres.
const NOISE: [f32; 2] = [0.002, 0.03];

/// A plane through neighbouring returns.
#[derive(Clone, Copy, Debug, Default)]
struct Plane {
    centre: [f32; 3],
    /// Unit normal towards the sensor.
    normal: [f32; 3],
    /// Standard deviation of the neighbours along the normal, metres.
    roughness: f32,
    /// Extent of the neighbours across the plane's narrow direction: root of the sum of squares, metres.
    breadth: f32,
    is_accepted: bool,
}

impl Plane {
    /// The plane through the neighbours of a return.
    fn through(points: &[[f32; 3]], neighbours: &[u32]) -> Option<Self> {
        if neighbours.len() < LEAST {
            return None;
        }
        let origin = points[neighbours[0] as usize].map(f64::from);
        let count = neighbours.len() as f64;
        let offset = |&j: &u32| -> [f64; 3] { std::array::from_fn(|k| f64::from(points[j as usize][k]) - origin[k]) };
        let mean = neighbours.iter().map(offset).fold([0.0; 3], |sum, p| std::array::from_fn(|k| sum[k] + p[k] / count));
        let mut covariance = [0.0; 6];
        for [x, y, z] in neighbours.iter().map(offset).map(|p| -> [f64; 3] { std::array::from_fn(|k| p[k] - mean[k]) }) {
            [x * x, x * y, x * z, y * y, y * z, z * z].into_iter().zip(&mut covariance).for_each(|(v, sum)| *sum += v);
        }
        let (values, normal) = smallest_eigenvector(covariance);
        let normal = normal?;
        Some(Self {
            centre: std::array::from_fn(|k| (origin[k] + mean[k]) as f32),
            normal: normal.map(|c| c as f32),
            roughness: (values[0].max(0.0) / (count - 3.0)).sqrt() as f32,
            breadth: values[1].max(0.0).sqrt() as f32,
            is_accepted: false,
        })
    }

    fn distance(&self, p: [f32; 3]) -> f32 {
        (0..3).map(|k| (p[k] - self.centre[k]) * self.normal[k]).sum()
    }

    /// Distance of a point in standard deviations.
    fn misfit(&self, p: [f32; 3], noise: f32) -> f32 {
        self.distance(p).abs() / self.roughness.max(noise)
    }
}

/// Fits planes to scattered returns. Holds scratch memory.
#[derive(Clone, Debug)]
pub(crate) struct ScatteredFitter {
    settings: NormalSettings,
    /// Distance between points that are added between returns, metres.
    step: Option<f32>,
    neighbours: Neighbours,
    planes: Vec<Plane>,
}

impl ScatteredFitter {
    pub(crate) fn new(settings: NormalSettings) -> Self {
        Self { settings, step: None, neighbours: Neighbours::default(), planes: Vec::new() }
    }

    /// Sets the distance between points that are added between returns, metres.
    pub(crate) fn set_step(&mut self, step: f32) {
        self.step = Some(step);
    }

    /// Fills the normals, roughness and spacing of `returns`, and adds points between them.
    pub(crate) fn fit(&mut self, returns: &mut Returns) {
        let Self { settings, neighbours, planes, .. } = self;
        neighbours.find(&returns.points);
        let points = &returns.points[..];
        let fit = (0..points.len()).into_par_iter().with_min_len(CHUNK);
        fit.map(|i| Plane::through(points, neighbours.of(i)).unwrap_or_default()).collect_into_vec(planes);
        let noise = settings.range_noise.unwrap_or_else(|| noise_of(planes));
        let origins = &returns.origins[..];
        planes.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(i, plane)| {
            let p = points[i];
            plane.accept(neighbours.of(i).len(), noise, settings);
            if !plane.is_accepted && plane.is_flat(noise, settings) {
                // Too near to each other for their noise: the neighbours of the neighbours tell more.
                let wider = neighbours.of_neighbours(i);
                *plane = Plane::through(points, &wider).unwrap_or_default();
                plane.accept(wider.len(), noise, settings);
            }
            plane.face(origins.get(i).copied().unwrap_or_default(), p);
        });
        let spread = noise.max(settings.roughness);
        let chosen = (0..points.len()).into_par_iter().with_min_len(CHUNK);
        let planes = &planes[..];
        let chosen = chosen.map(|i| {
            let plane = choose(i, points[i], neighbours, planes, spread);
            plane.map_or(([0.0; 3], 0.0), |plane| (plane.normal, plane.roughness))
        });
        let (normals, roughness): (Vec<[f32; 3]>, Vec<f32>) = chosen.unzip();
        (returns.normals, returns.roughness) = (normals, roughness);
        returns.spacing.clear();
        returns.spacing.extend((0..returns.points.len()).map(|i| spacing(neighbours.reach.get(i).copied().unwrap_or(0.0), neighbours.of(i).len())));
        if let Some(step) = self.step {
            add_between(returns, |i| self.neighbours.of(i), spread, step);
        }
    }
}

impl Plane {
    /// Decides whether the plane can be trusted: its neighbours deviate from it no more than noise and the allowed roughness explain, and its direction is
    /// certain.
    fn accept(&mut self, count: usize, noise: f32, settings: &NormalSettings) {
        let uncertainty = self.roughness.max(noise) / self.breadth.max(f32::MIN_POSITIVE);
        self.is_accepted = count >= LEAST && self.is_flat(noise, settings) && uncertainty <= settings.max_uncertainty;
    }

    /// Whether noise and the allowed roughness explain how much the neighbours deviate.
    fn is_flat(&self, noise: f32, settings: &NormalSettings) -> bool {
        /// Noise differs over a scan: a deviation larger than the usual one by this factor still counts as noise.
        const SLACK: f32 = 2.0;
        self.roughness <= (SLACK * noise).max(settings.roughness)
    }

    /// Turns the normal towards the position from which `p` was measured.
    fn face(&mut self, origin: [f32; 3], p: [f32; 3]) {
        if (0..3).map(|k| (origin[k] - p[k]) * self.normal[k]).sum::<f32>() < 0.0 {
            self.normal = self.normal.map(|c| -c);
        }
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

/// Distance between returns that are spread evenly over a surface, `count` of them within `reach` of one.
fn spacing(reach: f32, count: usize) -> f32 {
    reach * (std::f32::consts::PI / count.max(1) as f32).sqrt()
}
