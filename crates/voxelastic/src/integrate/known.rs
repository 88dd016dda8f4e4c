//! What a scan need not tell again, because the sensor is where it was before.
//!
//! The memory of a map is to grow with the space that it shows, not with the time spent in it. Surfaces never stop taking memory by themselves:
//! farther than some ten metres beams are farther apart than voxels are wide, so that every pass meets voxels that no beam has met, beside those
//! that have. So a scan that is taken where an earlier one was does not tell a block that was told more than it has to say.

use super::formation::octant_bit;
use super::transform::Beam;
use crate::field::tsdf::{Block, DISTANCE_STEPS, TsdfField};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, Cursor, MAX_BLOCK_COORD, block_key, voxel_index};

/// What is known of the place that a scan is taken at. By default nothing.
#[derive(Clone, Debug, Default)]
pub(crate) struct Known<'a> {
    /// Blocks of the scan's own field below this id were there before the sensor came back.
    pub before: u32,
    /// Other fields that know the place, each with the pose of the own one in it.
    pub elsewhere: Vec<(&'a TsdfField, Rigid)>,
}

impl Known<'_> {
    /// The octants of block `id` of the scan's own `field` that `beams` may tell something, a bit each: all, or those in which beams end where the
    /// field shows no surface. `corner` is the block's smallest, finest voxels.
    #[inline(always)]
    pub fn open_octants<'b>(&self, field: &TsdfField, id: u32, corner: [f32; 3], beams: impl ExactSizeIterator<Item = &'b Beam>) -> u8 {
        let block = field.block(id);
        if id >= self.before || block.told.beams() < beams.len() as u32 {
            return u8::MAX;
        }
        open_octants(corner, beams, |octant, point| shows(field, block, octant, std::array::from_fn(|k| point[k] - corner[k])))
    }

    /// Look-ups in the other fields, whose finest voxels have an edge of `voxel` metres.
    pub fn elsewhere(&self, voxel: f32) -> Elsewhere<'_> {
        Elsewhere { fields: self.elsewhere.iter().map(|(field, pose)| (*field, *pose, Cursor::new(field.tree()))).collect(), voxel }
    }
}

/// Look-ups in other fields, best in Morton order.
pub(crate) struct Elsewhere<'a> {
    fields: Vec<(&'a TsdfField, Rigid, Cursor)>,
    voxel: f32,
}

impl Elsewhere<'_> {
    /// The octants of a block with smallest corner `corner`, finest voxels, that `beams` may tell something, a bit each: all, or those in which beams end
    /// where no other field has observed anything.
    #[inline(always)]
    pub fn open_octants<'b>(&mut self, corner: [f32; 3], beams: impl ExactSizeIterator<Item = &'b Beam>) -> u8 {
        if self.fields.is_empty() || self.told(corner.map(|c| c + 0.5 * BLOCK_EDGE as f32)) < beams.len() as u32 {
            return u8::MAX;
        }
        open_octants(corner, beams, |_, point| self.show(point))
    }

    /// Beams that told the other fields something of the block around `point`, finest voxels.
    fn told(&mut self, point: [f32; 3]) -> u32 {
        let told = self.fields.iter_mut().filter_map(|other| Some(Self::find(other, self.voxel, point)?.0.told.beams()));
        told.sum()
    }

    /// Whether another field shows a surface at `point`, finest voxels.
    fn show(&mut self, point: [f32; 3]) -> bool {
        self.fields.iter_mut().any(|other| {
            let field = other.0;
            let found = Self::find(other, self.voxel, point);
            found.is_some_and(|(block, within)| shows(field, block, octant_bit(within, [0.0; 3]), within))
        })
    }

    /// The block of a field around `point`, and where in it that lies.
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

/// The octants of a block with smallest corner `corner` in which beams end where nothing is shown, a bit each.
#[inline(always)]
fn open_octants<'b>(corner: [f32; 3], beams: impl Iterator<Item = &'b Beam>, mut is_shown: impl FnMut(u8, [f32; 3]) -> bool) -> u8 {
    let mut open = 0;
    for beam in beams {
        let octant = octant_bit(beam.point, corner);
        if open & octant != octant && !is_shown(octant, beam.point) {
            open |= octant;
        }
    }
    open
}

/// Whether `block` of `field` shows a surface `within` it, finest voxels from its smallest corner: the voxel there lies beside one, or it is a gap in
/// what was observed in its octant.
#[inline(always)]
fn shows(field: &TsdfField, block: &Block, octant: u8, within: [f32; 3]) -> bool {
    let scale = usize::from(block.scale);
    // Rounding may put a point on the far face.
    let place = within.map(|c| (c.max(0.0) as usize).min(BLOCK_EDGE - 1) >> scale);
    let voxel = field.voxel(block, voxel_index(place, scale));
    if voxel.is_observed() { f32::from(voxel.distance).abs() < DISTANCE_STEPS } else { field.observed_octants(block) & octant != 0 }
}
