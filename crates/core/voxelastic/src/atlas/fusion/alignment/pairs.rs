//! Pairs of places on the surfaces of two fields that are taken for the same surface.

use super::displacement::{Cell, Displacement, around, cell_of};
use super::found::{Found, Pair};
use super::surface_points::SurfacePoint;
use crate::atlas::SubmapId;
use crate::octree::BLOCK_EDGE;
use hashbrown::HashMap;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Largest distance along the normal between two places that are taken for the same surface, voxels.
pub(super) const REACH: f32 = 5.0;
/// Largest distance between them along the surface, voxels.
const BESIDE: f32 = 8.0;
/// Least cosine of the angle between their normals.
const SAME_WAY: f32 = 0.85;
/// Places whose partners are searched together.
const PLACES_PER_PART: usize = 1024;

/// How two submaps agree where both have a surface. Distances are in finest voxels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PairAgreement {
    /// The two submaps.
    pub submaps: [SubmapId; 2],
    /// Places on the surface of one of them, at most one for each block, in cells of 64 voxels in which the other one has a surface, too.
    pub places: u64,
    /// Of these, places with a surface of the other one within five voxels that faces the same way.
    pub matched: u64,
    /// Mean distance between matched surfaces along the normal, with the poses as they are.
    pub apart: f64,
    /// The same after the submaps were bent onto each other.
    pub left: f64,
}

impl PairAgreement {
    /// Surfaces that are farther apart along the normal than this, voxels, are not matched.
    pub const REACH: f64 = REACH as f64;
}

/// The places of all fields, by where they are.
pub(super) struct Pairs {
    points: Vec<SurfacePoint>,
    fields: usize,
    /// By two fields, ascending: places of both in cells in which the other one has places, too.
    common: BTreeMap<[u32; 2], u64>,
}

/// A place where its displacement puts it.
#[derive(Clone, Copy)]
struct Placed {
    position: [f32; 3],
    normal: [f32; 3],
    field: u32,
    /// Among all places.
    number: u32,
}

/// All places by where they are: those of a bucket follow each other in memory.
struct Nearby {
    places: Vec<Placed>,
    buckets: HashMap<Cell, Range<u32>>,
}

/// What is found for some places.
#[derive(Default)]
struct Part {
    pairs: Vec<Pair>,
    places: HashMap<(Cell, u32, u32), u32>,
}

impl Pairs {
    pub fn new(points: Vec<SurfacePoint>, fields: usize) -> Self {
        let mut counts: HashMap<Cell, BTreeMap<u32, u64>> = HashMap::new();
        for point in &points {
            *counts.entry(cell_of(point.position)).or_default().entry(point.field).or_default() += 1;
        }
        let mut common: BTreeMap<[u32; 2], u64> = BTreeMap::new();
        for counts in counts.values() {
            for (a, one) in counts {
                counts.range(a + 1..).for_each(|(b, other)| *common.entry([*a, *b]).or_default() += one + other);
            }
        }
        Self { points, fields, common }
    }

    /// How the fields agree, by pairs of fields, ascending, as pairs `before` and `after` they were displaced say.
    pub fn agreement(&self, before: &Found, after: &Found) -> Vec<PairAgreement> {
        let (before, after) = (before.distances(), after.distances());
        let mean =
            |of: &BTreeMap<[u32; 2], (u64, f64)>, fields: &[u32; 2]| of.get(fields).map_or((0, 0.0), |(count, sum)| (*count, sum / *count as f64));
        let of = |(fields, places): (&[u32; 2], &u64)| {
            let ((matched, apart), (_, left)) = (mean(&before, fields), mean(&after, fields));
            PairAgreement { submaps: *fields, places: *places, matched, apart, left }
        };
        self.common.iter().map(of).collect()
    }

    /// Finds for each place the nearest one in each other field, at most `reach` voxels away along the normal once both are displaced.
    pub fn find(&self, displacements: &[Displacement], reach: f32) -> Found {
        let place = |(point, number): (&SurfacePoint, u32)| {
            let SurfacePoint { normal, field, .. } = *point;
            Placed { position: moved(point, &displacements[field as usize]), normal, field, number }
        };
        let placed: Vec<Placed> = self.points.par_iter().zip(0..self.points.len() as u32).map(place).collect();
        let nearby = Nearby::new(&placed);
        let part = |places: &[Placed]| {
            let (mut part, mut nearest) = (Part::default(), Nearest::of(self.fields));
            for place in places {
                let cell = cell_of(self.points[place.number as usize].position);
                nearest.find(place, &nearby, reach);
                for (field, partner) in nearest.by_field() {
                    *part.places.entry((cell, place.field, field)).or_default() += 1;
                    part.pairs.extend(partner.map(|other| self.pair(cell, [place, &nearby.places[other as usize]], displacements)));
                }
            }
            part
        };
        let parts: Vec<Part> = placed.par_chunks(PLACES_PER_PART).map(part).collect();
        let mut found = Found { pairs: Vec::with_capacity(parts.iter().map(|part| part.pairs.len()).sum()), reach, places: HashMap::new() };
        for part in parts {
            found.pairs.extend(part.pairs);
            part.places.into_iter().for_each(|(key, count)| *found.places.entry(key).or_default() += count);
        }
        found
    }

    fn pair(&self, cell: Cell, placed: [&Placed; 2], displacements: &[Displacement]) -> Pair {
        let [one, other] = placed.map(|place| &self.points[place.number as usize]);
        let normal = half_way(one.normal, other.normal);
        let along = |a: [f32; 3], b: [f32; 3]| dot(std::array::from_fn(|k| a[k] - b[k]), normal);
        let beyond = |point: &SurfacePoint, place: &Placed| {
            along(place.position, point.position) - dot(displacements[point.field as usize].of_cell(&cell), normal)
        };
        Pair {
            cell,
            fields: [one.field, other.field],
            normal,
            apart: along(one.position, other.position),
            moved_apart: along(placed[0].position, placed[1].position),
            beyond_cell: beyond(one, placed[0]) - beyond(other, placed[1]),
        }
    }
}

impl Nearby {
    fn new(placed: &[Placed]) -> Self {
        let mut order: Vec<(Cell, u32)> = placed.par_iter().map(|place| (bucket_of(place.position), place.number)).collect();
        order.par_sort_unstable();
        let mut buckets: HashMap<Cell, Range<u32>> = HashMap::with_capacity(order.len());
        let mut start = 0;
        for bucket in order.chunk_by(|a, b| a.0 == b.0) {
            let end = start + bucket.len() as u32;
            buckets.insert(bucket[0].0, start..end);
            start = end;
        }
        Self { places: order.par_iter().map(|(_, number)| placed[*number as usize]).collect(), buckets }
    }
}

/// The nearest partner of a place in each field, found for one place after the other.
struct Nearest {
    /// By field: square of the distance of the partner, and its index, if the field has any place around.
    best: Vec<Option<(f32, Option<u32>)>>,
    /// The fields that have.
    around: Vec<u32>,
}

impl Nearest {
    fn of(fields: usize) -> Self {
        Self { best: vec![None; fields], around: Vec::new() }
    }

    fn find(&mut self, own: &Placed, nearby: &Nearby, reach: f32) {
        for field in self.around.drain(..) {
            self.best[field as usize] = None;
        }
        for bucket in around(bucket_of(own.position)).filter_map(|bucket| nearby.buckets.get(&bucket)) {
            for (other, number) in nearby.places[bucket.start as usize..bucket.end as usize].iter().zip(bucket.start..) {
                if other.field == own.field {
                    continue;
                }
                let best = &mut self.best[other.field as usize];
                if best.is_none() {
                    self.around.push(other.field);
                }
                let best = best.get_or_insert((f32::MAX, None));
                let cosine = dot(own.normal, other.normal);
                if cosine < SAME_WAY {
                    continue;
                }
                let normal = half_way(own.normal, other.normal);
                let between: [f32; 3] = std::array::from_fn(|k| own.position[k] - other.position[k]);
                let (distance2, along) = (dot(between, between), dot(between, normal));
                if distance2 < best.0 && along.abs() <= reach && distance2 - along * along <= BESIDE * BESIDE {
                    *best = (distance2, Some(number));
                }
            }
        }
        self.around.sort_unstable();
    }

    /// The other fields with places around, ascending, and the index of the partner in each.
    fn by_field(&self) -> impl Iterator<Item = (u32, Option<u32>)> + '_ {
        self.around.iter().map(|field| (*field, self.best[*field as usize].and_then(|(_, partner)| partner)))
    }
}

fn moved(point: &SurfacePoint, displacement: &Displacement) -> [f32; 3] {
    let by = displacement.at(point.position);
    std::array::from_fn(|k| point.position[k] + by[k])
}

/// The bucket of a place: as large as a block.
fn bucket_of(point: [f32; 3]) -> Cell {
    point.map(|c| (c / BLOCK_EDGE as f32).floor() as i32)
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The direction half way between two. The distance of two places of one sphere along it is zero, so that curvature does not count as distance.
fn half_way(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    let sum: [f32; 3] = std::array::from_fn(|k| a[k] + b[k]);
    let length = dot(sum, sum).sqrt().max(1e-6);
    sum.map(|v| v / length)
}
