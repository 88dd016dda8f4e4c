//! What pairs of places ask for, and how far fields are apart by them.

use super::displacement::Cell;
use hashbrown::{HashMap, HashSet};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Two fields are pulled together in a cell only if this share of the places of one of them, at least, has a partner: of two surfaces that are the same one,
/// one may be seen in part, but hardly both.
const MOST: f64 = 0.5;
/// Bending two fields onto each other must leave at most this share of the mean distance of their pairs: 0.7 to 0.9 was left in a hall, and 0.5 in a street with foliage,
/// where poses were right and the surface became worse by bending.
const MOST_LEFT: f64 = 0.4;
/// So many pairs in a cell weigh half as much as any number of them.
const HALF_KNOWN: f64 = 4.0;
/// Cells are summed up in so many groups side by side, each of which looks at all pairs: sums keep their order.
const GROUPS: i32 = 8;

/// A place and its partner in another field.
#[derive(Clone, Copy)]
pub(super) struct Pair {
    /// The cell of the place.
    pub cell: Cell,
    /// The field of the place, and that of the partner.
    pub fields: [u32; 2],
    /// Half way between both normals.
    pub normal: [f32; 3],
    /// Distance of the place beyond its partner, along the normal, without displacements ...
    pub apart: f32,
    /// ... and with them.
    pub moved_apart: f32,
    /// The displacement of the place minus that of its partner, along the normal, beyond what the vectors of the cell make.
    pub beyond_cell: f32,
}

/// Pairs that were found, and places without a partner.
pub(super) struct Found {
    pub pairs: Vec<Pair>,
    pub reach: f32,
    /// Places by cell, their field and the other field: where the other field has places around, too.
    pub places: HashMap<(Cell, u32, u32), u32>,
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
        let add = |sums: &mut HashMap<(Cell, [u32; 2]), Sums>, pair: &Pair| {
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
        };
        let places = |cell: Cell, from: u32, to: u32| f64::from(self.places.get(&(cell, from, to)).copied().unwrap_or(0)).max(1.0);
        let is_same = |(cell, [a, b]): &(Cell, [u32; 2]), sum: &Sums| {
            f64::from(sum.matched[0]) >= MOST * places(*cell, *a, *b) || f64::from(sum.matched[1]) >= MOST * places(*cell, *b, *a)
        };
        let term = |(&(cell, fields), sum): (&(Cell, [u32; 2]), &Sums)| {
            let scale = 1.0 / (sum.weight + HALF_KNOWN);
            Term { cell, fields: fields.map(|f| f as usize), normals: sum.normals * scale, gap: sum.gap * scale }
        };
        let of_group = |group: i32| {
            let mut sums = HashMap::new();
            self.pairs.iter().filter(|pair| group_of(pair.cell) == group).for_each(|pair| add(&mut sums, pair));
            sums.iter().filter(|(key, sum)| is_same(key, sum)).map(term).collect::<Vec<Term>>()
        };
        let mut terms: Vec<Term> = (0..GROUPS).into_par_iter().flat_map_iter(of_group).collect();
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
    pub fn distances(&self) -> BTreeMap<[u32; 2], (u64, f64)> {
        let mut sums: HashMap<[u32; 2], (u64, f64)> = HashMap::new();
        for pair in &self.pairs {
            let [a, b] = pair.fields;
            let (count, sum) = sums.entry([a.min(b), a.max(b)]).or_default();
            *count += 1;
            *sum += f64::from(pair.moved_apart.abs());
        }
        sums.into_iter().collect()
    }
}

fn group_of(cell: Cell) -> i32 {
    (cell[0] + 3 * cell[1] + 5 * cell[2]).rem_euclid(GROUPS)
}
