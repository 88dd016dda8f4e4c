//! Which rays of a scan are redundant, because they observe again what earlier scans of the same place observed.
//!
//! The memory of a map should grow with the mapped space, not with time. Repeated passes alone would let it grow: beyond some ten metres rays are farther apart
//! than voxels are wide, so every pass observes voxels between those that are known already. So a scan taken where an earlier one was taken
//! skips blocks that have more observations than the scan adds, except octants in which a ray ends where no surface is known.

use super::block_run::{ALL_OCTANTS, octant_bit};
use crate::field::tsdf::{Block, DISTANCE_STEPS, TsdfField, WEIGHT_ONE};
use crate::geometry::Rigid;
use crate::integrate::rays::ray::Ray;
use crate::octree::{BLOCK_EDGE, Cursor, MAX_BLOCK_COORD, block_key, voxel_index};

/// Weight of a voxel that one ray has observed with half its weight, in the fading end of the band behind a surface: it says little about where a surface is.
const HALF_OBSERVED: u16 = WEIGHT_ONE / 2;

/// What earlier passes observed of the place where a scan is taken. By default nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Redundancy<'a> {
    /// Blocks of the scan's own field that existed before the sensor came back.
    pub before: EarlierBlocks<'a>,
    /// Fields of other submaps that cover the place, each with the pose of the scan's submap in it.
    pub elsewhere: Vec<(&'a TsdfField, Rigid)>,
}

/// The blocks of a field that existed at some time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EarlierBlocks<'a> {
    /// Those with ids below this did,
    pub end: u32,
    /// except those for which this is set, by id. In a field that was loaded since, ids do not tell.
    pub later: &'a [bool],
}

impl EarlierBlocks<'_> {
    /// Whether block `id` did.
    #[inline(always)]
    pub fn contains(&self, id: u32) -> bool {
        id < self.end && !self.later.get(id as usize).is_some_and(|later| *later)
    }
}

impl Redundancy<'_> {
    /// The octants of block `id` of the scan's own `field` in which `rays` add information, a bit each: all, or those in which a ray ends where the field has no
    /// surface. `corner` is the smallest corner of the block, finest voxels.
    #[inline(always)]
    pub fn new_octants<'b>(&self, field: &TsdfField, id: u32, corner: [f32; 3], rays: impl ExactSizeIterator<Item = &'b Ray>) -> u8 {
        let block = field.block(id);
        if !self.before.contains(id) || block.observation_count.get() < rays.len() as u32 {
            return ALL_OCTANTS;
        }
        octants_without_surface(corner, rays, |octant, point| has_surface(field, block, octant, std::array::from_fn(|k| point[k] - corner[k])))
    }

    /// Look-ups in the fields of other submaps, whose finest voxels are `voxel` metres wide.
    pub(super) fn other_fields(&self, voxel: f32) -> OtherFields<'_> {
        OtherFields { fields: self.elsewhere.iter().map(|(field, pose)| (*field, *pose, Cursor::new(field.tree()))).collect(), voxel }
    }
}

/// Look-ups in the fields of other submaps, fastest in Morton order.
pub(super) struct OtherFields<'a> {
    fields: Vec<(&'a TsdfField, Rigid, Cursor)>,
    voxel: f32,
}

impl OtherFields<'_> {
    /// The octants of a block with smallest corner `corner`, finest voxels, in which `rays` add information, a bit each: all, or those in which a ray ends where
    /// no other field has a surface.
    #[inline(always)]
    pub fn new_octants<'b>(&mut self, corner: [f32; 3], rays: impl ExactSizeIterator<Item = &'b Ray>) -> u8 {
        if self.fields.is_empty() || self.observation_count(corner.map(|c| c + 0.5 * BLOCK_EDGE as f32)) < rays.len() as u32 {
            return ALL_OCTANTS;
        }
        octants_without_surface(corner, rays, |_, point| self.have_surface(point))
    }

    /// Sum of the observation counts of the other fields' blocks around `point`, finest voxels.
    fn observation_count(&mut self, point: [f32; 3]) -> u32 {
        let counts = self.fields.iter_mut().filter_map(|other| Some(Self::find(other, self.voxel, point)?.0.observation_count.get()));
        counts.sum()
    }

    /// Whether another field has a surface at `point`, finest voxels.
    fn have_surface(&mut self, point: [f32; 3]) -> bool {
        self.fields.iter_mut().any(|other| {
            let field = other.0;
            let found = Self::find(other, self.voxel, point);
            found.is_some_and(|(block, within)| has_surface(field, block, octant_bit(within, [0.0; 3]), within))
        })
    }

    /// The block of a field around `point` and the position in it, finest voxels.
    #[inline(always)]
    fn find<'b>((field, pose, cursor): &mut (&'b TsdfField, Rigid, Cursor), voxel: f32, point: [f32; 3]) -> Option<(&'b Block, [f32; 3])> {
        let there = pose.apply(point.map(|c| c * voxel)).map(|c| c / voxel);
        let coords = there.map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
        if coords.iter().any(|c| c.abs() >= MAX_BLOCK_COORD) {
            return None;
        }
        let block = field.block(cursor.block(field.tree(), block_key(coords))?);
        Some((block, std::array::from_fn(|k| there[k] - (coords[k] * BLOCK_EDGE as i32) as f32)))
    }
}

/// The octants of a block with smallest corner `corner` in which a ray ends without a known surface, a bit each.
#[inline(always)]
fn octants_without_surface<'b>(corner: [f32; 3], rays: impl Iterator<Item = &'b Ray>, mut has_surface: impl FnMut(u8, [f32; 3]) -> bool) -> u8 {
    let mut octants = 0;
    for ray in rays {
        let octant = octant_bit(ray.point, corner);
        if octants & octant != octant && !has_surface(octant, ray.point) {
            octants |= octant;
        }
    }
    octants
}

/// Whether `block` of `field` has a surface at `within`, finest voxels from its smallest corner: the voxel there is within one voxel of a surface, or it is
/// unobserved, or observed by half a ray behind a surface, in an octant that has observed voxels.
#[inline(always)]
fn has_surface(field: &TsdfField, block: &Block, octant: u8, within: [f32; 3]) -> bool {
    let scale = usize::from(block.scale);
    // Rounding may put a point on the far face.
    let place = within.map(|c| (c.max(0.0) as usize).min(BLOCK_EDGE - 1) >> scale);
    let voxel = field.voxel(block, voxel_index(place, scale));
    if voxel.is_observed() && voxel.weight != HALF_OBSERVED {
        f32::from(voxel.distance).abs() < DISTANCE_STEPS
    } else {
        field.observed_octants(block) & octant != 0
    }
}
