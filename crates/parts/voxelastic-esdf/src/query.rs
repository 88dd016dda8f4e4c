//! Distances and gradients in the map frame.

use crate::atlas::Esdf;
use crate::frame::{SubmapFrame, corner_below};
use crate::layer::{Distances, FAR, Layer};
use crate::point_order::by_cells;
use crate::submap::SubmapEsdf;
use crate::surfaces::Surfaces;
use rayon::prelude::*;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::octree::{BLOCK_EDGE, BLOCK_SHIFT, block_key};

/// Points that a thread takes at a time.
const PER_TASK: usize = 2048;
/// Nearer than this to a surface, metres, there is no direction away from it.
const LEAST: f32 = 1e-5;
const NOTHING: EsdfSample = EsdfSample { distance: 0.0, gradient: [0.0; 3] };

/// The distance at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct EsdfSample {
    /// Distance to the nearest obstacle, or to the nearest space that is not free, metres; at most the field's largest distance.
    pub distance: f32,
    /// Its gradient in the map frame: away from the obstacle, about of unit length; zero where everything is farther than the largest distance.
    pub gradient: [f32; 3],
}

/// Queries of an [`Esdf`].
pub struct EsdfQuery<'a> {
    voxel: f64,
    max_distance: f32,
    /// Whether unknown space ends distances, too.
    with_unknown: bool,
    parts: Vec<Part<'a>>,
    surfaces: &'a Surfaces,
    /// Distances in metres by squared distances in voxels.
    roots: Vec<f32>,
}

/// The field of a submap and where it is.
struct Part<'a> {
    esdf: &'a SubmapEsdf,
    submap: &'a Submap,
    frame: SubmapFrame,
}

impl Part<'_> {
    fn in_map(&self, sample: EsdfSample) -> EsdfSample {
        EsdfSample { gradient: self.frame.to_map(sample.gradient), ..sample }
    }
}

/// Replaces what is larger than in `known`; nothing if that is empty. Also for a point that is not finite, which is in no submap.
fn lower(answers: &mut [EsdfSample], known: &[EsdfSample]) {
    for (answer, known) in answers.iter_mut().zip(known) {
        if known.distance < answer.distance {
            *answer = *known;
        }
    }
}

/// Looks up voxels of a layer and remembers the last block.
struct Lookup<'a> {
    layer: &'a Layer,
    /// Where a block is missing, voxels that are not free are at distance zero; of a layer of distances to what is not free.
    not_free: Option<&'a OccupancyField>,
    last: Option<(u64, Option<&'a Distances>)>,
}

impl<'a> Lookup<'a> {
    fn new(layer: &'a Layer, not_free: Option<&'a OccupancyField>) -> Self {
        Self { layer, not_free, last: None }
    }

    #[inline]
    fn block(&mut self, key: u64) -> Option<&'a Distances> {
        match self.last {
            Some((last, block)) if last == key => block,
            _ => {
                let block = self.layer.get(key);
                self.last = Some((key, block));
                block
            }
        }
    }

    /// The squared distance in all voxels of a block that is missing and has voxel `c`.
    fn of_missing(&self, c: [i32; 3]) -> u16 {
        if self.not_free.is_some_and(|field| field.state_at(c) != State::Free) { 0 } else { FAR }
    }

    /// Whether a block around the voxel at `base` and next above it may be stored.
    #[inline]
    fn may_have(&self, base: [i32; 3]) -> bool {
        let Some([low, high]) = self.layer.bounds() else { return false };
        (0..3).all(|k| (base[k] + 1) >> BLOCK_SHIFT >= low[k] && base[k] >> BLOCK_SHIFT <= high[k])
    }

    /// The eight voxels at `base` and next above it, x fastest.
    #[inline]
    fn corners(&mut self, base: [i32; 3]) -> [u16; 8] {
        // Most often all of them are in one block.
        let across = (0..3).fold(0, |across, k| across | usize::from(base[k] & 7 == 7) << k);
        if across == 0 {
            return match self.block(block_key(base.map(|v| v >> BLOCK_SHIFT))) {
                Some(distances) => {
                    let first = index(base);
                    std::array::from_fn(|i| distances[first + (i & 1) + (i >> 1 & 1) * BLOCK_EDGE + (i >> 2) * BLOCK_EDGE * BLOCK_EDGE])
                }
                None => [self.of_missing(base); 8],
            };
        }
        let mut corners = [FAR; 8];
        // Each of the blocks once: in the next one along each of some of the axes along which the voxels are in two blocks.
        for next in (0..8).filter(|next| next & !across == 0) {
            let voxel = |i: usize| -> [i32; 3] { std::array::from_fn(|k| base[k] + (i >> k & 1) as i32) };
            let block = self.block(block_key(voxel(next).map(|v| v >> BLOCK_SHIFT)));
            let of_missing = if block.is_none() { self.of_missing(voxel(next)) } else { FAR };
            for i in (0..8).filter(|i| i & across == next) {
                corners[i] = block.map_or(of_missing, |distances| distances[index(voxel(i))]);
            }
        }
        corners
    }
}

/// Index of a finest voxel in its block.
#[inline]
fn index(c: [i32; 3]) -> usize {
    let [x, y, z] = c.map(|v| (v & 7) as usize);
    x + BLOCK_EDGE * (y + BLOCK_EDGE * z)
}

impl Esdf {
    /// Queries in the map frame, with every submap of `atlas` at its current root pose. The field must be up to date.
    pub fn query<'a>(&'a self, atlas: &'a Atlas) -> EsdfQuery<'a> {
        EsdfQuery::new(self, atlas)
    }
}

impl<'a> EsdfQuery<'a> {
    fn new(esdf: &'a Esdf, atlas: &'a Atlas) -> Self {
        let voxel = esdf.voxel_size;
        let max_distance = esdf.settings().max_distance;
        let part = |(submap, t_map_submap): (&'a Submap, Pose)| {
            let frame = SubmapFrame::new(submap, &t_map_submap, voxel, max_distance);
            Some(Part { esdf: esdf.submaps.get(&submap.id())?, submap, frame })
        };
        let farthest = (max_distance / voxel).ceil().powi(2) as usize;
        Self {
            voxel,
            max_distance: max_distance as f32,
            with_unknown: esdf.has_unknown(),
            parts: atlas.placed().filter_map(part).collect(),
            surfaces: &esdf.surfaces,
            roots: (0..=farthest).map(|squared| ((squared as f64).sqrt() * voxel).min(max_distance) as f32).collect(),
        }
    }

    /// The distance at `p` (metres, map frame), interpolated between the eight voxels around it. To obstacles it is the least of all submaps. To space that is not
    /// free it is never too large: everything nearer is free in one submap and occupied in none.
    pub fn sample(&self, p: [f64; 3]) -> EsdfSample {
        let mut answer = [NOTHING];
        let known = self.look_up(&[p], &mut answer);
        lower(&mut answer, &known);
        answer[0]
    }

    /// The distance at each of `points` (metres, map frame), as [`sample`](Self::sample) gives it. Uses the threads of the current pool.
    pub fn sample_many<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<EsdfSample> {
        let mut samples = vec![NOTHING; points.len()];
        let Some(order) = by_cells(points) else {
            samples.par_chunks_mut(PER_TASK).zip(points.par_chunks(PER_TASK)).for_each(|(samples, points)| {
                let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(Into::into)).collect();
                let known = self.look_up(&points, samples);
                lower(samples, &known);
            });
            return samples;
        };
        let ordered = order.par_chunks(PER_TASK).flat_map_iter(|numbers| {
            let points: Vec<[f64; 3]> = numbers.iter().map(|i| points[*i as usize].map(Into::into)).collect();
            let mut samples = vec![NOTHING; points.len()];
            let known = self.look_up(&points, &mut samples);
            lower(&mut samples, &known);
            samples
        });
        let ordered: Vec<EsdfSample> = ordered.collect();
        order.iter().zip(ordered).for_each(|(i, sample)| samples[*i as usize] = sample);
        samples
    }

    /// As [`sample_many`](Self::sample_many), but the distance to obstacles is that to the nearest triangle of the submaps' surfaces (their meshes at full detail), with
    /// the gradient away from it, of unit length. It is exact, at most the field's largest distance. Voxels decide only where the map has no surface no farther
    /// than a voxel behind the nearest occupied one. The first question makes triangles around its points, which stay for the next ones.
    pub fn sample_many_to_surfaces<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<EsdfSample> {
        let points: Vec<[f64; 3]> = points.iter().map(|p| p.map(Into::into)).collect();
        let mut voxels = vec![NOTHING; points.len()];
        let chunks = voxels.par_chunks_mut(PER_TASK).zip(points.par_chunks(PER_TASK));
        let known: Vec<EsdfSample> = chunks.flat_map_iter(|(voxels, points)| self.look_up(points, voxels)).collect();
        let mut nearest: Vec<Option<EsdfSample>> = vec![None; points.len()];
        for part in self.parts.iter().filter(|part| !part.submap.tsdf().is_empty()) {
            let ball = |(p, voxels): (&[f64; 3], &EsdfSample)| self.ball(part, *p, voxels);
            let surface = self.surfaces.near(part.submap, self.voxel, points.iter().zip(&voxels).filter_map(ball));
            nearest.par_iter_mut().zip(&points).zip(&voxels).with_min_len(PER_TASK).for_each(|((nearest, p), voxels)| {
                let Some((local, radius)) = self.ball(part, *p, voxels) else { return };
                let radius = nearest.map_or(radius, |nearest| radius.min(f64::from(nearest.distance)));
                let Some(found) = surface.nearest(local, radius) else { return };
                let distance = found.squared.sqrt();
                // The first of equals stays.
                if nearest.is_none_or(|nearest| distance < nearest.distance) {
                    let away = std::array::from_fn(|k| (local[k] as f32 - found.point[k]) / distance);
                    let gradient = if distance > LEAST { part.frame.to_map(away) } else { voxels.gradient };
                    *nearest = Some(EsdfSample { distance, gradient });
                }
            });
        }
        let mut answers: Vec<EsdfSample> = nearest.into_iter().zip(voxels).map(|(nearest, voxels)| nearest.unwrap_or(voxels)).collect();
        lower(&mut answers, &known);
        answers
    }

    /// Where the surface of a submap may be that is nearest to `p`: around this point of the submap frame, within this radius, metres.
    fn ball(&self, part: &Part<'_>, p: [f64; 3], voxels: &EsdfSample) -> Option<([f64; 3], f64)> {
        if voxels.distance >= self.max_distance {
            return None;
        }
        let local = part.frame.to_submap(p);
        part.frame.reaches(&local).then(|| (local, (f64::from(voxels.distance) + self.voxel).min(f64::from(self.max_distance))))
    }

    /// Writes distances to obstacles, and returns those to what is not free, if unknown space ends distances: of the two, the smaller one counts.
    fn look_up(&self, points: &[[f64; 3]], answers: &mut [EsdfSample]) -> Vec<EsdfSample> {
        answers.fill(EsdfSample { distance: self.max_distance, gradient: [0.0; 3] });
        for part in &self.parts {
            let mut obstacles = Lookup::new(&part.esdf.obstacles, None);
            for (answer, p) in answers.iter_mut().zip(points) {
                let local = part.frame.to_submap(*p);
                if !part.frame.reaches(&local) {
                    continue;
                }
                let sample = self.interpolate(&mut obstacles, local);
                // The first of equals stays.
                if sample.distance < answer.distance {
                    *answer = part.in_map(sample);
                }
            }
        }
        let mut known = vec![NOTHING; if self.with_unknown { points.len() } else { 0 }];
        for part in &self.parts {
            let Some(layer) = part.esdf.not_free.as_ref().filter(|_| self.with_unknown) else { continue };
            let mut not_free = Lookup::new(layer, Some(part.submap.occupancy()));
            for ((known, p), answer) in known.iter_mut().zip(points).zip(&*answers) {
                // Beyond this it does not matter: surfaces are at most a voxel farther than what voxels say.
                if known.distance >= (answer.distance + self.voxel as f32).min(self.max_distance) {
                    continue;
                }
                let local = part.frame.to_submap(*p);
                if part.frame.reaches(&local) {
                    let sample = self.interpolate(&mut not_free, local);
                    if sample.distance > known.distance {
                        *known = part.in_map(sample);
                    }
                }
            }
        }
        known
    }

    /// Interpolates between the eight voxels around `p`, submap frame.
    #[inline]
    fn interpolate(&self, lookup: &mut Lookup<'_>, p: [f64; 3]) -> EsdfSample {
        let Some((base, [fx, fy, fz])) = corner_below(p, self.voxel) else {
            return EsdfSample { distance: if lookup.not_free.is_some() { 0.0 } else { self.max_distance }, gradient: [0.0; 3] };
        };
        if lookup.not_free.is_none() && !lookup.may_have(base) {
            return EsdfSample { distance: self.max_distance, gradient: [0.0; 3] };
        }
        let squared = lookup.corners(base);
        if squared == [FAR; 8] {
            return EsdfSample { distance: self.max_distance, gradient: [0.0; 3] };
        }
        let corners = squared.map(|squared| self.roots.get(usize::from(squared)).copied().unwrap_or(self.max_distance));
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let steps: [f32; 4] = std::array::from_fn(|i| corners[2 * i + 1] - corners[2 * i]);
        let rows: [f32; 4] = std::array::from_fn(|i| corners[2 * i] + steps[i] * fx);
        let [low, high] = [mix(rows[0], rows[1], fy), mix(rows[2], rows[3], fy)];
        let differences =
            [mix(mix(steps[0], steps[1], fy), mix(steps[2], steps[3], fy), fz), mix(rows[1] - rows[0], rows[3] - rows[2], fz), high - low];
        EsdfSample { distance: mix(low, high, fz), gradient: differences.map(|difference| difference / self.voxel as f32) }
    }
}
