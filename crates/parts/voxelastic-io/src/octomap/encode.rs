//! Serialising the tree.

use rayon::prelude::*;
use voxelastic::field::occupancy::LOG_ODDS_STEPS;
use voxelastic::geometry::morton::{AXIS_BITS, encode as morton};
use voxelastic::query::Cube;

/// Level of the root: it spans 2^16 smallest voxels.
const ROOT: u32 = 16;
/// Level from which on the children of a node are encoded side by side: 512 smallest voxels.
const PARALLEL_LEVEL: u32 = 9;
/// Smallest voxels along an axis, to either side of the origin.
pub(super) const REACH: u32 = 1 << 15;
/// Coordinate of the origin in a [`Cube`].
const ORIGIN: u32 = 1 << (AXIS_BITS - 1);

/// What the file stores per node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NodeValues {
    States,
    LogOdds,
}

/// A leaf and its position in the tree.
#[derive(Clone, Copy)]
struct Leaf {
    key: u64,
    level: u32,
    value: i8,
}

/// The leaves in depth-first order.
pub(super) struct Tree {
    leaves: Vec<Leaf>,
}

impl Tree {
    /// Builds the tree; the error says why the cubes do not form one.
    pub fn new(cubes: &[Cube]) -> Result<Self, String> {
        let leaves: Vec<Leaf> = cubes.par_iter().map(leaf).collect::<Result<_, _>>()?;
        let is_in_order = |pair: &[Leaf]| pair[0].key + (1 << (3 * pair[0].level)) <= pair[1].key;
        if leaves.par_windows(2).all(is_in_order) { Ok(Self { leaves }) } else { Err("the cubes overlap, or are not in Morton order".to_owned()) }
    }
}

fn leaf(cube: &Cube) -> Result<Leaf, String> {
    let low = ORIGIN - REACH;
    let reaches_out = || format!("the map reaches farther from the origin than the {REACH} voxels that an OctoMap can hold; choose larger voxels");
    let mut place = [0; 3];
    for (place, &c) in place.iter_mut().zip(&cube.corner) {
        *place = c.checked_sub(low).filter(|p| *p < 2 * REACH).ok_or_else(reaches_out)?;
    }
    if cube.level >= ROOT {
        return Err(reaches_out());
    }
    if place.iter().any(|p| p & ((1 << cube.level) - 1) != 0) {
        return Err(format!("a cube of level {} does not start at a multiple of its size", cube.level));
    }
    Ok(Leaf { key: morton(place), level: cube.level, value: cube.value })
}

/// Number of nodes, and their bytes.
pub(super) fn encode(tree: &Tree, values: NodeValues) -> (usize, Vec<u8>) {
    let mut encoder = Encoder::default();
    if !tree.leaves.is_empty() {
        match values {
            NodeValues::States => encoder.states(&tree.leaves, ROOT),
            NodeValues::LogOdds => drop(encoder.log_odds(&tree.leaves, ROOT)),
        }
    }
    (encoder.nodes, encoder.out)
}

/// The leaves below each child of a node of `level`.
fn children(leaves: &[Leaf], level: u32) -> [&[Leaf]; 8] {
    let digit = |leaf: &Leaf| (leaf.key >> (3 * (level - 1))) as usize & 7;
    let mut rest = leaves;
    std::array::from_fn(|i| {
        let (child, others) = rest.split_at(rest.partition_point(|leaf| digit(leaf) <= i));
        rest = others;
        child
    })
}

/// The leaf that fills a child of a node of `level`, if there is one.
fn whole(child: &[Leaf], level: u32) -> Option<&Leaf> {
    child.first().filter(|leaf| leaf.level + 1 == level)
}

#[derive(Default)]
struct Encoder {
    out: Vec<u8>,
    nodes: usize,
}

impl Encoder {
    /// An inner node of `level` without values, and all below.
    fn states(&mut self, leaves: &[Leaf], level: u32) {
        const FREE: u16 = 0b01;
        const OCCUPIED: u16 = 0b10;
        const INNER: u16 = 0b11;
        let mut children = children(leaves, level);
        let mut bits = 0u16;
        self.nodes += 1;
        for (i, child) in children.iter_mut().enumerate().filter(|(_, c)| !c.is_empty()) {
            if let Some(leaf) = whole(child, level) {
                bits |= if leaf.value > 0 { OCCUPIED } else { FREE } << (2 * i);
                self.nodes += 1;
                *child = &[];
            } else {
                bits |= INNER << (2 * i);
            }
        }
        self.out.extend(bits.to_le_bytes());
        self.below(&children, level, |encoder, child| encoder.states(child, level - 1), |()| {});
    }

    /// A node of `level` with values, and all below; returns its own.
    fn log_odds(&mut self, leaves: &[Leaf], level: u32) -> i8 {
        if let Some(leaf) = whole(leaves, level + 1) {
            self.node(leaf.value, 0);
            return leaf.value;
        }
        let children = children(leaves, level);
        let mask = children.iter().enumerate().fold(0u8, |mask, (i, c)| mask | u8::from(!c.is_empty()) << i);
        let at = self.out.len();
        self.node(0, mask);
        let mut largest = i8::MIN;
        self.below(&children, level, |encoder, child| encoder.log_odds(child, level - 1), |value| largest = largest.max(value));
        self.out[at..at + 4].copy_from_slice(&log_odds_bytes(largest));
        largest
    }

    fn node(&mut self, value: i8, children: u8) {
        self.nodes += 1;
        self.out.extend(log_odds_bytes(value));
        self.out.push(children);
    }

    /// Appends those children of a node of `level` that have leaves by `encode`, large ones side by side; `take` gets what each returns.
    fn below<R: Send>(&mut self, children: &[&[Leaf]; 8], level: u32, encode: impl Fn(&mut Self, &[Leaf]) -> R + Sync, mut take: impl FnMut(R)) {
        let some = children.iter().filter(|child| !child.is_empty());
        if level < PARALLEL_LEVEL {
            some.for_each(|child| take(encode(self, child)));
            return;
        }
        let encoded = |child: &&&[Leaf]| {
            let mut part = Self::default();
            let returned = encode(&mut part, child);
            (part, returned)
        };
        for (part, returned) in some.collect::<Vec<_>>().par_iter().map(encoded).collect::<Vec<_>>() {
            self.out.extend(part.out);
            self.nodes += part.nodes;
            take(returned);
        }
    }
}

/// The log-odds of an occupancy value, as bytes.
fn log_odds_bytes(value: i8) -> [u8; 4] {
    (f32::from(value) / LOG_ODDS_STEPS).to_le_bytes()
}
