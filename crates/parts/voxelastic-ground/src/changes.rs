//! Where a map has changed since it was looked at last.

use std::collections::HashMap;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId, SurfaceState};
use voxelastic::geometry::box_around;
use voxelastic::octree::{BLOCK_EDGE, block_coords};

/// A box, its lowest and its highest corner, metres.
pub(crate) type Box3 = [[f64; 3]; 2];

/// Surfaces between voxels depend on what is one voxel of the coarsest scale around them, in blocks.
const AROUND: f64 = 1.0;

/// The state of a map in which it was looked at. The source of a fusion is known apart: its surfaces are not those of a submap.
#[derive(Clone, Debug, Default)]
pub(crate) struct Looked(HashMap<(SubmapId, bool), LookedAt>);

#[derive(Clone, Debug)]
struct LookedAt {
    t_map_submap: Pose,
    occupancy: u64,
    surface: SurfaceState,
    /// Around all that it has, and had, in its own frame.
    bounds: Box3,
}

impl Looked {
    /// Looks at the map, and calls `mark` with boxes of the map frame that contain all that has changed since the last time: states of space, and surfaces.
    pub fn look(&mut self, atlas: &Atlas, mut mark: impl FnMut(Box3)) {
        let mut gone = std::mem::take(&mut self.0);
        let count = atlas.submaps().len();
        for (k, (submap, t_map_submap)) in atlas.placed().enumerate() {
            let key = (submap.id(), k >= count);
            let before = gone.remove(&key);
            let mut now = LookedAt {
                t_map_submap,
                occupancy: submap.occupancy().revision(),
                surface: submap.surface_state(),
                bounds: before.as_ref().map_or(NOTHING, |before| before.bounds),
            };
            let grown = before.as_ref().is_some_and(|before| before.t_map_submap == t_map_submap && now.grow(before, submap, &mut mark));
            if !grown {
                before.iter().for_each(|before| before.mark_all(&mut mark));
                now.bounds = around_all(submap);
                now.mark_all(&mut mark);
            }
            self.0.insert(key, now);
        }
        gone.values().for_each(|gone| gone.mark_all(&mut mark));
    }
}

impl LookedAt {
    fn mark_all(&self, mark: &mut impl FnMut(Box3)) {
        if self.bounds[0][0] <= self.bounds[1][0] {
            mark(box_around(&self.t_map_submap, self.bounds));
        }
    }

    /// Marks what scans have changed in a submap; false if that is not known.
    fn grow(&mut self, before: &Self, submap: &Submap, mark: &mut impl FnMut(Box3)) -> bool {
        let flips = submap.occupancy().changes_since(before.occupancy);
        let (Some(flips), Some(blocks)) = (flips, submap.surface_changes_since(before.surface)) else { return false };
        let octants = flips.map(|flip| (flip.key, u32::from(flip.level), 0.0)).chain(blocks.map(|key| (key, 0, AROUND)));
        for (key, level, around) in octants {
            let octant = octant_box(submap, key, level, around);
            join(&mut self.bounds, octant);
            mark(box_around(&self.t_map_submap, octant));
        }
        true
    }
}

/// A box without content.
const NOTHING: Box3 = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];

fn join(bounds: &mut Box3, other: Box3) {
    for k in 0..3 {
        bounds[0][k] = bounds[0][k].min(other[0][k]);
        bounds[1][k] = bounds[1][k].max(other[1][k]);
    }
}

/// An octant, `around` blocks larger, in the frame of its submap.
fn octant_box(submap: &Submap, key: u64, level: u32, around: f64) -> Box3 {
    let block = BLOCK_EDGE as f64 * f64::from(submap.voxel_size());
    let low = block_coords(key).map(f64::from);
    [low.map(|c| (c - around) * block), low.map(|c| (c + f64::from(1u32 << level) + around) * block)]
}

/// Around all that a submap has, in its own frame.
fn around_all(submap: &Submap) -> Box3 {
    let known = submap.query().bounds();
    let mut bounds = if known.is_empty() { NOTHING } else { [known.min.map(f64::from), known.max.map(f64::from)] };
    let tsdf = submap.tsdf();
    tsdf.ids().for_each(|id| join(&mut bounds, octant_box(submap, tsdf.block(id).key, 0, AROUND)));
    bounds
}
