//! Up-propagation (paper Sec. III-A): updates the summaries of ancestors and merges uniform siblings into their parent.

use super::change_log::{Flip, FlipKind};
use super::field::OccupancyField;
use super::value::Summary;
use crate::octree::{Cursor, NONE, Octant, Octree, prefetch_item};
use rayon::prelude::*;

/// The octants that a scan changed, by level.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChangedOctants {
    /// Prefixes of the parents of changed octants: `parents[l]` are at level l + 1.
    parents: Vec<Vec<u64>>,
    /// Those in which voxels changed their state.
    flips: Vec<Flip>,
}

impl ChangedOctants {
    /// Adds the octant of `level` that contains block `key`.
    #[inline(always)]
    pub fn add(&mut self, key: u64, level: u32) {
        let level = level as usize;
        if self.parents.len() <= level {
            self.parents.resize(level + 1, Vec::new());
        }
        let parent = key >> (3 * (level + 1));
        let list = &mut self.parents[level];
        // Consecutive octants in Morton order often share a parent, so this avoids most duplicates.
        if list.last() != Some(&parent) {
            list.push(parent);
        }
    }

    /// Notes that voxels in the octant of `level` that contains block `key` changed their state.
    #[inline(always)]
    pub fn add_flip(&mut self, key: u64, level: u32, kind: FlipKind) {
        if kind.any() {
            self.flips.push(Flip { key: key >> (3 * level) << (3 * level), level: level as u8, kind });
        }
    }

    /// Removes all octants and keeps the capacity.
    pub fn clear(&mut self) {
        self.flips.clear();
        self.parents.iter_mut().for_each(Vec::clear);
    }

    /// Adds all octants of `others`.
    pub fn append(&mut self, others: &Self) {
        self.flips.extend_from_slice(&others.flips);
        let levels = self.parents.len().max(others.parents.len());
        self.parents.resize(levels, Vec::new());
        for (own, others) in self.parents.iter_mut().zip(&others.parents) {
            own.extend_from_slice(others);
        }
    }

    /// Recomputes the summaries of all ancestors, lowest first, and merges eight equal uniform siblings into their parent. Logs the noted flips.
    pub fn propagate(mut self, field: &mut OccupancyField) {
        field.changes.push(std::mem::take(&mut self.flips));
        self.propagate_summaries(field);
    }

    /// As [`propagate`](Self::propagate), for octants whose flips were not noted.
    pub fn propagate_unlogged(self, field: &mut OccupancyField) {
        field.changes.push_unknown();
        self.propagate_summaries(field);
    }

    fn propagate_summaries(mut self, field: &mut OccupancyField) {
        let root_level = field.tree.root_level();
        self.parents.resize(root_level as usize, Vec::new());
        for level in 1..root_level {
            let mut prefixes = std::mem::take(&mut self.parents[level as usize - 1]);
            // A stable sort is faster here, because the list consists of a few sorted runs.
            prefixes.sort();
            prefixes.dedup();
            for Ancestor { group, index, link, merged } in ancestors(field, &prefixes, level) {
                if link != NONE {
                    merged.apply(&mut field.tree, link, |tree| &mut tree.siblings_mut(group)[index]);
                }
            }
            prefixes.iter().for_each(|prefix| self.add(prefix << (3 * level), level));
        }
        let link = field.tree.root().link;
        if link != NONE && self.parents.last().is_some_and(|list| !list.is_empty()) {
            merge(field, link).apply(&mut field.tree, link, Octree::root_mut);
        }
    }
}

/// An octant with its link and, if it has children, the result of merging them.
#[derive(Clone, Copy, Debug)]
struct Ancestor {
    group: u32,
    index: usize,
    link: u32,
    merged: Merged,
}

/// Looks up the octants of `level` (below the root's) with the given sorted prefixes and merges their children, in parallel, because most
/// of them are not cached.
fn ancestors(field: &OccupancyField, prefixes: &[u64], level: u32) -> Vec<Ancestor> {
    /// Small enough for an even load, large enough that cursors seldom start from the root.
    const PER_TASK: usize = 512;
    let mut all = vec![Ancestor { group: NONE, index: 0, link: NONE, merged: Merged::Mixed(Summary::default()) }; prefixes.len()];
    all.par_chunks_mut(PER_TASK).zip(prefixes.par_chunks(PER_TASK)).for_each(|(all, prefixes)| {
        let mut cursor = Cursor::new(&field.tree);
        for (ancestor, prefix) in all.iter_mut().zip(prefixes) {
            let Some((group, index)) = cursor.find_at(&field.tree, prefix << (3 * level), level) else { continue };
            let link = field.tree.siblings(group)[index].link;
            if link != NONE {
                prefetch_item(&raw const *field.tree.siblings(link));
            }
            *ancestor = Ancestor { group, index, link, ..*ancestor };
        }
        for ancestor in all.iter_mut().filter(|ancestor| ancestor.link != NONE) {
            ancestor.merged = merge(field, ancestor.link);
        }
    });
    all
}

/// The result of merging eight siblings.
#[derive(Clone, Copy, Debug)]
enum Merged {
    /// All are uniform with this summary: the parent replaces them.
    Uniform(Summary),
    /// They are kept, and this is the parent's summary.
    Mixed(Summary),
}

impl Merged {
    /// Writes the result to the parent, whose children are group `link`; frees the group if it is uniform.
    fn apply(self, tree: &mut Octree<Summary>, link: u32, octant: impl FnOnce(&mut Octree<Summary>) -> &mut Octant<Summary>) {
        match self {
            Self::Uniform(payload) => {
                *octant(tree) = Octant { link: NONE, payload };
                tree.remove_group(link);
            }
            Self::Mixed(payload) => octant(tree).payload = payload,
        }
    }
}

fn merge(field: &OccupancyField, group: u32) -> Merged {
    let siblings = field.tree.siblings(group);
    let first = siblings[0].payload;
    if siblings.iter().all(|o| o.link == NONE && o.payload == first) {
        Merged::Uniform(first)
    } else {
        Merged::Mixed(Summary::of(siblings.iter().map(|o| o.payload)))
    }
}
