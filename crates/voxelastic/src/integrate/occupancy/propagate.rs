//! Up-propagation (paper Sec. III-A): what an octant's ancestors know, and free space merged into the coarsest octant.

use crate::field::occupancy::{OccupancyField, Summary};
use crate::octree::{NONE, Octant};

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

    /// Recomputes the summaries of all ancestors, lowest first; eight equal uniform siblings become their parent.
    pub fn propagate(mut self, field: &mut OccupancyField) {
        let root_level = field.tree.root_level();
        self.parents.resize(root_level as usize, Vec::new());
        for level in 1..=root_level {
            let mut prefixes = std::mem::take(&mut self.parents[level as usize - 1]);
            prefixes.sort_unstable();
            prefixes.dedup();
            for prefix in prefixes {
                if let Some(parent) = field.tree.octant_mut(prefix << (3 * level), level)
                    && parent.link != NONE
                {
                    let group = parent.link;
                    let summary = merge(field, group);
                    if let Some(octant) = field.tree.octant_mut(prefix << (3 * level), level) {
                        match summary {
                            Merged::Uniform(payload) => *octant = Octant { link: NONE, payload },
                            Merged::Mixed(payload) => octant.payload = payload,
                        }
                    }
                    if matches!(summary, Merged::Uniform(_)) {
                        field.tree.remove_group(group);
                    }
                }
                if level < root_level {
                    self.parents[level as usize].push(prefix >> 3);
                }
            }
        }
    }
}

enum Merged {
    Uniform(Summary),
    Mixed(Summary),
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
