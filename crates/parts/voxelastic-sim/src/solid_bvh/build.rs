//! Construction by the surface area heuristic (binned; Wald, "On fast construction of SAH-based bounding volume
//! hierarchies", 2007).

use super::node::{MAX_DEPTH, Node, SLACK, SolidBvh};
use crate::solid::{Solid, Vec3};

/// Candidate splits per axis, plus one.
const BINS: usize = 16;
/// Most solids of a leaf.
const LEAF: usize = 3;
/// Cost of visiting a node, in units of intersecting a solid.
const VISIT: f64 = 0.6;

#[derive(Clone, Copy)]
struct Bounds {
    min: Vec3,
    max: Vec3,
}

impl Bounds {
    const EMPTY: Self =
        Self { min: Vec3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY), max: Vec3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY) };

    fn join(self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }

    fn area(&self) -> f64 {
        let s = (self.max - self.min).map(|c| c.max(0.0));
        s.x * s.y + s.y * s.z + s.z * s.x
    }
}

struct Item {
    index: u32,
    bounds: Bounds,
    centre: Vec3,
}

impl SolidBvh {
    /// The hierarchy over bounded solids, and the order into which they have to be sorted: entry k is the former index of solid k.
    pub(crate) fn build(solids: &[Solid]) -> (Self, Vec<u32>) {
        build(solids)
    }
}

fn build(solids: &[Solid]) -> (SolidBvh, Vec<u32>) {
    let mut items: Vec<Item> = (0u32..)
        .zip(solids)
        .map(|(index, solid)| {
            let (min, max) = solid.bounds();
            Item { index, bounds: Bounds { min, max }, centre: (min + max) / 2.0 }
        })
        .collect();
    let mut nodes = Vec::with_capacity(items.len().max(1));
    if !items.is_empty() {
        nodes.push(Node { min: [0.0; 3], max: [0.0; 3], first: 0, count: 0, axis: 0 });
        let mut stack = vec![(0usize, 0usize, items.len(), 1usize)];
        while let Some((node, start, end, depth)) = stack.pop() {
            let split = if depth < MAX_DEPTH { partition(&mut items[start..end]) } else { None };
            let bounds = items[start..end].iter().fold(Bounds::EMPTY, |b, i| b.join(&i.bounds));
            nodes[node] = Node {
                min: std::array::from_fn(|k| bounds.min[k] as f32 - SLACK),
                max: std::array::from_fn(|k| bounds.max[k] as f32 + SLACK),
                first: start as u32,
                count: (end - start) as u32,
                axis: 0,
            };
            if let Some((axis, left)) = split {
                let child = nodes.len();
                nodes.extend([nodes[node]; 2]);
                nodes[node] = Node { first: child as u32, count: 0, axis: axis as u32, ..nodes[node] };
                stack.push((child, start, start + left, depth + 1));
                stack.push((child + 1, start + left, end, depth + 1));
            }
        }
    }
    (SolidBvh { nodes }, items.iter().map(|i| i.index).collect())
}

/// Partitions the items into two sides. Returns the axis and the size of the first side, or `None` for a leaf.
fn partition(items: &mut [Item]) -> Option<(usize, usize)> {
    if items.len() <= 1 {
        return None;
    }
    let centres = items.iter().fold(Bounds::EMPTY, |b, i| b.join(&Bounds { min: i.centre, max: i.centre }));
    let whole = items.iter().fold(Bounds::EMPTY, |b, i| b.join(&i.bounds)).area().max(1e-12);
    let best = (0..3).filter_map(|axis| best_split(items, axis, &centres)).min_by(|a, b| a.0.total_cmp(&b.0));
    let leaf_cost = items.len() as f64;
    match best {
        Some((cost, axis, cut)) if items.len() > LEAF || VISIT + cost / whole < leaf_cost => {
            // A stable sort, so that the tree depends on nothing but the list.
            items.sort_by_key(|i| i.centre[axis] >= cut);
            Some((axis, items.partition_point(|i| i.centre[axis] < cut)))
        }
        // All centres coincide: split in halves, unless they fit into a leaf.
        _ if items.len() > LEAF => Some((0, items.len() / 2)),
        _ => None,
    }
}

/// The cheapest split along an axis: its cost (sum of area times solids of both sides), the axis, the coordinate.
fn best_split(items: &[Item], axis: usize, centres: &Bounds) -> Option<(f64, usize, f64)> {
    let (low, high) = (centres.min[axis], centres.max[axis]);
    if high - low < 1e-9 {
        return None;
    }
    let cut_at = |bin: usize| low + (high - low) * bin as f64 / BINS as f64;
    (1..BINS)
        .filter_map(|bin| {
            let cut = cut_at(bin);
            let mut sides = [(Bounds::EMPTY, 0usize); 2];
            for item in items {
                let side = &mut sides[usize::from(item.centre[axis] >= cut)];
                *side = (side.0.join(&item.bounds), side.1 + 1);
            }
            let cost = sides.iter().map(|(b, n)| b.area() * *n as f64).sum::<f64>();
            sides.iter().all(|s| s.1 > 0).then_some((cost, axis, cut))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0))
}
