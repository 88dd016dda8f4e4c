//! Which states occur in a part of a field.

use crate::field::occupancy::{State, Summary, UNKNOWN, state_of};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, NONE, Octant, block_coords, voxel_coords};
use crate::query::FieldQuery;
use crate::query::shape_sdf::Solid;

/// The states that occur in a cube.
#[derive(Clone, Copy, Default)]
pub(super) struct StateSet {
    pub free: bool,
    pub unknown: bool,
    pub occupied: bool,
}

impl StateSet {
    fn add(&mut self, value: i8) {
        match state_of(value) {
            State::Free => self.free = true,
            State::Unknown => self.unknown = true,
            State::Occupied => self.occupied = true,
        }
    }
}

impl FieldQuery<'_> {
    /// The states of the leaves that the solid touches; incomplete if one of them is occupied.
    pub(super) fn states_in<S: Solid>(&self, solid: &S) -> StateSet {
        let tree = self.field.tree();
        let corner = block_coords(tree.root_key()).map(|c| c << BLOCK_SHIFT);
        let edge = (BLOCK_EDGE as f32) * (1u32 << tree.root_level()) as f32;
        let (low, high) = solid.bounds();
        let is_inside = (0..3).all(|k| low[k] > corner[k] as f32 && high[k] < corner[k] as f32 + edge);
        let mut states = StateSet { unknown: !is_inside, ..StateSet::default() };
        self.add_states(tree.root(), corner, tree.root_level(), solid, &mut states);
        states
    }

    fn add_states<S: Solid>(&self, octant: &Octant<Summary>, corner: [i32; 3], level: u32, solid: &S, states: &mut StateSet) {
        let summary = octant.payload;
        let is_free = summary.observed && summary.max < 0;
        let nothing_new = (is_free && states.free) || (summary.max <= 0 && states.free && states.unknown);
        let edge = (BLOCK_EDGE << level) as i32;
        let meets = |low: [i32; 3], edge: i32| solid.meets(low.map(|c| c as f32), low.map(|c| (c + edge) as f32));
        if states.occupied || nothing_new || !meets(corner, edge) {
            return;
        }
        if is_free || summary.max == UNKNOWN {
            states.add(summary.max);
        } else if octant.link == NONE {
            states.add(summary.value);
        } else if level == 0 {
            let block = self.field.block(octant.link);
            let scale = usize::from(block.scale);
            for (i, &value) in self.field.values(block).iter().enumerate() {
                let c = voxel_coords(i, scale);
                if meets(std::array::from_fn(|k| corner[k] + (c[k] << scale) as i32), 1 << scale) {
                    states.add(value);
                }
            }
        } else {
            for (i, child) in self.field.tree().siblings(octant.link).iter().enumerate() {
                let at = std::array::from_fn(|k| corner[k] + if i >> k & 1 == 1 { edge / 2 } else { 0 });
                self.add_states(child, at, level - 1, solid, states);
            }
        }
    }
}
