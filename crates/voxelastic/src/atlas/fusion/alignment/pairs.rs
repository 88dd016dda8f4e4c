//! Pairs of places on the surfaces of two fields that are taken for the same surface.

use super::displacement::{Cell, Displacement, around, cell_of};
use super::surface_points::SurfacePoint;
use crate::atlas::SubmapId;
use crate::octree::BLOCK_EDGE;
use hashbrown::{HashMap, HashSet};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Largest distance along the normal between two places that are taken for the same surface, voxels.
pub(super) const REACH: f32 = 5.0;
/// Largest distance between them along the surface, voxels.
const BESIDE: f32 = 8.0;
/// Least cosine of the angle between their normals.
const SAME_WAY: f32 = 0.85;
/// Two fields are pulled together in a cell only if this share of the places of one of them, at least, has a partner: of two surfaces that are the same one,
/// one may be seen in part, but hardly both.
const MOST: f64 = 0.5;
/// Bending two fields onto each other must leave at most this share of the mean distance of their pairs: 0.2 to 0.6 where submaps had drifted apart, 0.7 to 0.9 in a hall
/// where they had not, whose surface became worse by it.
const MOST_LEFT: f64 = 0.65;
/// So many pairs in a cell weigh half as much as any number of them.
const HALF_KNOWN: f64 = 4.0;

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

/// The places of all fields, by where they are.
pub(super) struct Pairs {
    points: Vec<SurfacePoint>,
    fields: usize,
    /// By two fields, ascending: places of both in cells in which the other one has places, too.
    common: BTreeMap<[u32; 2], u64>,
}

/// A place and its partner in another field.
#[derive(Clone, Copy)]
struct Pair {
    /// The cell of the place.
    cell: Cell,
    /// The field of the place, and that of the partner.
    fields: [u32; 2],
    /// Half way between both normals.
    normal: [f32; 3],
    /// Distance of the place beyond its partner, along the normal, without displacements ...
    apart: f32,
    /// ... and with them.
    moved_apart: f32,
    /// The displacement of the place minus that of its partner, along the normal, beyond what the vectors of the cell make.
    beyond_cell: f32,
}

/// Pairs that were found, and places without a partner.
pub(super) struct Found {
    pairs: Vec<Pair>,
    reach: f32,
    /// Places by cell, their field and the other field: where the other field has places around, too.
    places: HashMap<(Cell, u32, u32), u32>,
}

/// What pairs of two fields in a cell ask for: the displacement of the first minus that of the second is `gap` in the directions of `normals`.
#[derive(Clone, Debug)]
pub(super) struct Term {
    pub cell: Cell,
    /// Ascending.
    pub fields: [usize; 2],
    pub normals: Matrix3<f64>,
    pub gap: Vector3<f64>,
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
        let moved: Vec<[f32; 3]> = self.points.par_iter().map(|point| moved(point, &displacements[point.field as usize])).collect();
        let mut order: Vec<(Cell, u32)> = moved.par_iter().enumerate().map(|(i, p)| (bucket_of(*p), i as u32)).collect();
        order.par_sort_unstable();
        let mut buckets: HashMap<Cell, Range<usize>> = HashMap::new();
        let mut start = 0;
        for bucket in order.chunk_by(|a, b| a.0 == b.0) {
            buckets.insert(bucket[0].0, start..start + bucket.len());
            start += bucket.len();
        }
        let search = |i: usize| self.partners(i, &moved, &order, &buckets, reach);
        let partners: Vec<Vec<(u32, Option<u32>)>> = (0..moved.len()).into_par_iter().with_min_len(256).map(search).collect();
        let mut found = Found { pairs: Vec::new(), reach, places: HashMap::new() };
        for (i, partners) in partners.into_iter().enumerate() {
            let cell = cell_of(self.points[i].position);
            for (field, partner) in partners {
                *found.places.entry((cell, self.points[i].field, field)).or_default() += 1;
                found.pairs.extend(partner.map(|j| self.pair(cell, [i, j as usize], &moved, displacements)));
            }
        }
        found
    }

    /// The other fields with places around place `i`, and the nearest one of each that may be the same surface.
    fn partners(
        &self,
        i: usize,
        moved: &[[f32; 3]],
        order: &[(Cell, u32)],
        buckets: &HashMap<Cell, Range<usize>>,
        reach: f32,
    ) -> Vec<(u32, Option<u32>)> {
        let (own, at) = (&self.points[i], moved[i]);
        let mut nearest: Vec<Option<(f32, Option<u32>)>> = vec![None; self.fields];
        for bucket in around(bucket_of(at)).filter_map(|bucket| buckets.get(&bucket)) {
            for &(_, j) in &order[bucket.clone()] {
                let other = &self.points[j as usize];
                if other.field == own.field {
                    continue;
                }
                let best = nearest[other.field as usize].get_or_insert((f32::MAX, None));
                let normal = half_way(own.normal, other.normal);
                let between: [f32; 3] = std::array::from_fn(|k| at[k] - moved[j as usize][k]);
                let (distance2, along) = (dot(between, between), dot(between, normal));
                let is_same = dot(own.normal, other.normal) >= SAME_WAY && along.abs() <= reach && distance2 - along * along <= BESIDE * BESIDE;
                if is_same && distance2 < best.0 {
                    *best = (distance2, Some(j));
                }
            }
        }
        nearest.into_iter().zip(0..).filter_map(|(best, field)| best.map(|(_, partner)| (field, partner))).collect()
    }

    fn pair(&self, cell: Cell, [i, j]: [usize; 2], moved: &[[f32; 3]], displacements: &[Displacement]) -> Pair {
        let (one, other) = (&self.points[i], &self.points[j]);
        let normal = half_way(one.normal, other.normal);
        let along = |a: [f32; 3], b: [f32; 3]| dot(std::array::from_fn(|k| a[k] - b[k]), normal);
        let beyond = |n: usize| {
            let (point, of_cell) = (&self.points[n], displacements[self.points[n].field as usize].of_cell(&cell));
            along(moved[n], point.position) - dot(of_cell, normal)
        };
        Pair {
            cell,
            fields: [one.field, other.field],
            normal,
            apart: along(one.position, other.position),
            moved_apart: along(moved[i], moved[j]),
            beyond_cell: beyond(i) - beyond(j),
        }
    }
}

impl Found {
    /// What the pairs ask for, by cell and fields, ascending; nothing where most places of both fields have no partner.
    pub fn terms(&self) -> Vec<Term> {
        #[derive(Default)]
        struct Sums {
            normals: Matrix3<f64>,
            gap: Vector3<f64>,
            weight: f64,
            matched: [u32; 2],
        }
        let mut sums: HashMap<(Cell, [u32; 2]), Sums> = HashMap::new();
        for pair in &self.pairs {
            let is_turned = pair.fields[0] > pair.fields[1];
            let [a, b] = pair.fields;
            let sum = sums.entry((pair.cell, [a.min(b), a.max(b)])).or_default();
            sum.matched[usize::from(is_turned)] += 1;
            let share = 1.0 - f64::from(pair.moved_apart / self.reach).powi(2);
            let (weight, normal) = ((share * share).max(0.0), Vector3::from(pair.normal.map(f64::from)));
            let gap = -f64::from(pair.apart + pair.beyond_cell) * if is_turned { -1.0 } else { 1.0 };
            sum.normals += weight * normal * normal.transpose();
            sum.gap += weight * gap * normal;
            sum.weight += weight;
        }
        let places = |cell: Cell, from: u32, to: u32| f64::from(self.places.get(&(cell, from, to)).copied().unwrap_or(0)).max(1.0);
        let is_same = |(cell, [a, b]): &(Cell, [u32; 2]), sum: &Sums| {
            f64::from(sum.matched[0]) >= MOST * places(*cell, *a, *b) || f64::from(sum.matched[1]) >= MOST * places(*cell, *b, *a)
        };
        let mut terms: Vec<Term> = sums
            .iter()
            .filter(|(key, sum)| is_same(key, sum))
            .map(|(&(cell, fields), sum)| {
                let scale = 1.0 / (sum.weight + HALF_KNOWN);
                Term { cell, fields: fields.map(|f| f as usize), normals: sum.normals * scale, gap: sum.gap * scale }
            })
            .collect();
        terms.sort_unstable_by_key(|term| (term.cell, term.fields));
        terms
    }

    /// Pairs of fields, ascending, whose pairs here are hardly nearer to each other in `after`.
    pub fn not_explained(&self, after: &Self) -> HashSet<[usize; 2]> {
        let after = after.distances();
        let mean = |(count, sum): (u64, f64)| sum / count.max(1) as f64;
        let is_left = |fields: &[u32; 2], before| after.get(fields).is_some_and(|after| mean(*after) > MOST_LEFT * mean(before));
        self.distances().into_iter().filter(|(fields, before)| is_left(fields, *before)).map(|(fields, _)| fields.map(|f| f as usize)).collect()
    }

    /// Number of pairs of two fields, and the sum of their distances.
    fn distances(&self) -> BTreeMap<[u32; 2], (u64, f64)> {
        let mut sums: BTreeMap<[u32; 2], (u64, f64)> = BTreeMap::new();
        for pair in &self.pairs {
            let [a, b] = pair.fields;
            let (count, sum) = sums.entry([a.min(b), a.max(b)]).or_default();
            *count += 1;
            *sum += f64::from(pair.moved_apart.abs());
        }
        sums
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
