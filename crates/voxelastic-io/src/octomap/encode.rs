//! Serialising the tree.

use voxelastic::field::occupancy::LOG_ODDS_STEPS;
use voxelastic::geometry::morton::{AXIS_BITS, encode as morton};
use voxelastic::query::Cube;

/// Level of the root: it spans 2^16 smallest voxels.
const ROOT: u32 = 16;
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
        let mut leaves: Vec<Leaf> = Vec::with_capacity(cubes.len());
        let mut end = 0;
        for cube in cubes {
            let leaf = leaf(cube)?;
            if leaf.key < end {
                return Err("the cubes overlap, or are not in Morton order".to_owned());
            }
            end = leaf.key + (1 << (3 * leaf.level));
            leaves.push(leaf);
        }
        Ok(Self { leaves })
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
    let mut encoder = Encoder { out: Vec::new(), nodes: 0 };
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

struct Encoder {
    out: Vec<u8>,
    nodes: usize,
}

impl Encoder {
    /// An inner node of `level` without values.
    fn states(&mut self, leaves: &[Leaf], level: u32) {
        const FREE: u16 = 0b01;
        const OCCUPIED: u16 = 0b10;
        const INNER: u16 = 0b11;
        self.nodes += 1;
        let children = children(leaves, level);
        let mut bits = 0u16;
        for (i, child) in children.iter().enumerate().filter(|(_, c)| !c.is_empty()) {
            let state = whole(child, level).map_or(INNER, |leaf| if leaf.value > 0 { OCCUPIED } else { FREE });
            bits |= state << (2 * i);
        }
        self.out.extend(bits.to_le_bytes());
        for child in children.into_iter().filter(|c| !c.is_empty()) {
            match whole(child, level) {
                Some(_) => self.nodes += 1,
                None => self.states(child, level - 1),
            }
        }
    }

    /// An inner node of `level` with values; returns its own.
    fn log_odds(&mut self, leaves: &[Leaf], level: u32) -> i8 {
        let children = children(leaves, level);
        let mask = children.iter().enumerate().fold(0u8, |mask, (i, c)| mask | u8::from(!c.is_empty()) << i);
        let at = self.out.len();
        self.node(0, mask);
        let mut largest = i8::MIN;
        for child in children.into_iter().filter(|c| !c.is_empty()) {
            let value = match whole(child, level) {
                Some(leaf) => {
                    self.node(leaf.value, 0);
                    leaf.value
                }
                None => self.log_odds(child, level - 1),
            };
            largest = largest.max(value);
        }
        self.out[at..at + 4].copy_from_slice(&log_odds_bytes(largest));
        largest
    }

    fn node(&mut self, value: i8, children: u8) {
        self.nodes += 1;
        self.out.extend(log_odds_bytes(value));
        self.out.push(children);
    }
}

/// The log-odds of an occupancy value, as bytes.
fn log_odds_bytes(value: i8) -> [u8; 4] {
    (f32::from(value) / LOG_ODDS_STEPS).to_le_bytes()
}
