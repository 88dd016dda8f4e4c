//! Up-propagation (paper Sec. III-A): what an octant's ancestors know, and free space merged into the coarsest octant.

use crate::field::occupancy::{OccupancyField, Summary};
use crate::octree::{Cursor, NONE, Octant, Octree, ask_for_all};
use rayon::prelude::*;

/// Octants that a scan changed, by level.
#[derive(Clone, Debug, Default)]
pub(crate) struct Touched {
    /// Prefixes of the changed octants' parents: `parents[l]` at level l + 1.
    parents: Vec<Vec<u64>>,
}

impl Touched {
    /// Notes that the octant of `level` at block key `key` changed.
    #[inline(always)]
    pub fn add(&mut self, key: u64, level: u32) {
        let level = level as usize;
        if self.parents.len() <= level {
            self.parents.resize(level + 1, Vec::new());
        }
        let parent = key >> (3 * (level + 1));
        let list = &mut self.parents[level];
        // Neighbours in Morton order share a parent: most repeats are gone here already.
        if list.last() != Some(&parent) {
            list.push(parent);
        }
    }

    /// Forgets everything, but not the room for it.
    pub fn clear(&mut self) {
        self.parents.iter_mut().for_each(Vec::clear);
    }

    /// Notes what `others` noted.
    pub fn append(&mut self, others: &Self) {
        let levels = self.parents.len().max(others.parents.len());
        self.parents.resize(levels, Vec::new());
        for (own, others) in self.parents.iter_mut().zip(&others.parents) {
            own.extend_from_slice(others);
        }
    }

    /// Recomputes the summaries of all ancestors, lowest first; eight equal uniform siblings become their parent.
    pub fn propagate(mut self, field: &mut OccupancyField) {
        let root_level = field.tree.root_level();
        self.parents.resize(root_level as usize, Vec::new());
        for level in 1..root_level {
            let mut prefixes = std::mem::take(&mut self.parents[level as usize - 1]);
            // Stable, because that makes use of the few sorted runs that there are.
            prefixes.sort();
            prefixes.dedup();
            for Ancestor { group, place, link, merged } in ancestors(field, &prefixes, level) {
                if link != NONE {
                    merged.settle(&mut field.tree, link, |tree| &mut tree.siblings_mut(group)[place]);
                }
            }
            prefixes.iter().for_each(|prefix| self.add(prefix << (3 * level), level));
        }
        let link = field.tree.root().link;
        if link != NONE && self.parents.last().is_some_and(|list| !list.is_empty()) {
            merge(field, link).settle(&mut field.tree, link, Octree::root_mut);
        }
    }
}

/// An octant, and what the group below it, if there is one, says about it.
#[derive(Clone, Copy, Debug)]
struct Ancestor {
    group: u32,
    place: usize,
    link: u32,
    merged: Merged,
}

/// The octants of `level` (below the root's) with `prefixes`, which are sorted; looked at side by side, because most are far away in memory.
fn ancestors(field: &OccupancyField, prefixes: &[u64], level: u32) -> Vec<Ancestor> {
    /// Few enough that threads share evenly, many enough that a cursor seldom starts anew.
    const PER_TASK: usize = 512;
    let mut all = vec![Ancestor { group: NONE, place: 0, link: NONE, merged: Merged::Mixed(Summary::default()) }; prefixes.len()];
    all.par_chunks_mut(PER_TASK).zip(prefixes.par_chunks(PER_TASK)).for_each(|(all, prefixes)| {
        let mut cursor = Cursor::new(&field.tree);
        for (ancestor, prefix) in all.iter_mut().zip(prefixes) {
            let Some((group, place)) = cursor.find_at(&field.tree, prefix << (3 * level), level) else { continue };
            let link = field.tree.siblings(group)[place].link;
            if link != NONE {
                ask_for_all(&raw const *field.tree.siblings(link));
            }
            *ancestor = Ancestor { group, place, link, ..*ancestor };
        }
        for ancestor in all.iter_mut().filter(|ancestor| ancestor.link != NONE) {
            ancestor.merged = merge(field, ancestor.link);
        }
    });
    all
}

#[derive(Clone, Copy, Debug)]
enum Merged {
    Uniform(Summary),
    Mixed(Summary),
}

impl Merged {
    /// Writes it to an octant, of which the group `link` is below: that goes if all is the same.
    fn settle(self, tree: &mut Octree<Summary>, link: u32, octant: impl FnOnce(&mut Octree<Summary>) -> &mut Octant<Summary>) {
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
