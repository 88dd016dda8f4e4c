//! Classification of cubes on the range pyramid, the children of many cubes at a time.
#![allow(clippy::needless_range_loop)] // Lanes and cubes index many arrays at once.

use super::evidence::free_margin_terms;
use super::extent::Extent;
use super::range_pyramid::{LANES, LEVELS, PyramidQueries, RangePyramid, level_for};
use super::settings::OccupancySettings;
use super::texel::{HOLE_BIT, RIM_BIT, far_of, near_of};
use crate::geometry::Rigid;
use crate::simd::atan2;
use crate::simd::{Kernel, dispatch};

/// The classes of eight sibling cubes, a bit each. Cubes that are neither free nor mixed contain no free space: no ray passed through them, or all of the cube is
/// behind the returns or too close in front of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Classes {
    /// Every ray through the cube has its return beyond it.
    pub free: u8,
    /// Some part may be free.
    pub mixed: u8,
    /// The mixed cubes of which a part is outside of the field of view.
    pub rim: u8,
    /// The mixed cubes through or beside which rays without return pass.
    pub holed: u8,
    /// The holed cubes through whose centre a ray passes that has its return beyond the cube, as have all other rays with a return: free, if the cube is small.
    pub crossed: u8,
}

/// Classifies cubes of the submap on the range pyramid of a scan.
#[derive(Clone, Copy)]
pub(super) struct Classifier<'a> {
    pyramid: &'a RangePyramid,
    /// From the lidar to the submap: columns are the lidar's axes in the submap frame.
    rotation: [[f32; 3]; 3],
    sensor: [f32; 3],
    /// A voxel counts as free only this far before a return, metres: the least margin, and a margin linear in the range.
    least_margin: f32,
    margin: [f32; 2],
}

/// Cubes nearer than this many of their half diagonals cover too much of the image to be classified as a whole.
const WIDE: f32 = 4.0;
/// Margin around an extent, in pixels: half a pixel includes the rays on all sides, because between two rays only what is in front of both returns is known to
/// be free; the rest covers the inaccuracy of rows, columns and arithmetic.
const SLACK: f32 = 0.55;

/// The direction of each of eight siblings from their common centre.
const SIGNS: [[f32; 8]; 3] =
    [[-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0], [-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0]];

/// Cubes whose children are classified together.
const CUBES: usize = LANES / 8;

/// Scratch memory of a classification: one array per quantity, so that the arithmetic is vectorised; no array is cleared.
#[derive(Clone, Debug)]
pub(super) struct ClassifyScratch {
    queries: PyramidQueries,
    /// Of each cube: the centre in the lidar frame, its distance, and the extents of its children.
    at: [[f32; CUBES]; 3],
    middle: [f32; CUBES],
    depth: [[f32; CUBES]; 2],
    elevation: [f32; CUBES],
    reach: [[f32; CUBES]; 2],
    level: [u32; CUBES],
    start: [u32; CUBES],
    start_finer: [u32; CUBES],
    /// The same of each child.
    child_at: [[f32; LANES]; 3],
    child_depth: [[f32; LANES]; 2],
    child_elevation: [f32; LANES],
    range: [f32; LANES],
    sine: [f32; LANES],
    bins: [u32; LANES],
    next: [f32; LANES],
    nearest: [f32; LANES],
    farthest: [f32; LANES],
    flags: [u8; LANES],
}

impl ClassifyScratch {
    pub fn new() -> Self {
        let (cubes, children) = ([0.0; CUBES], [0.0; LANES]);
        Self {
            queries: PyramidQueries::new(),
            at: [cubes; 3],
            middle: cubes,
            depth: [cubes; 2],
            elevation: cubes,
            reach: [cubes; 2],
            level: [0; CUBES],
            start: [0; CUBES],
            start_finer: [0; CUBES],
            child_at: [children; 3],
            child_depth: [children; 2],
            child_elevation: children,
            range: children,
            sine: children,
            bins: [0; LANES],
            next: children,
            nearest: children,
            farthest: children,
            flags: [0; LANES],
        }
    }
}

/// The direction of each child from the centre of its cube, for all lanes.
const CHILD_SIGNS: [[f32; LANES]; 3] = {
    let mut signs = [[0.0; LANES]; 3];
    let mut lane = 0;
    while lane < LANES {
        (signs[0][lane], signs[1][lane], signs[2][lane]) = (SIGNS[0][lane % 8], SIGNS[1][lane % 8], SIGNS[2][lane % 8]);
        lane += 1;
    }
    signs
};

/// The level of cubes that are larger than the texels of the coarsest level.
const NO_LEVEL: u32 = 8;

// Flags of a child.
const INSIDE: u8 = 1;
const FREE: u8 = 2;
const MIXED: u8 = 4;
const RIM: u8 = 8;
const HOLED: u8 = 16;
const CROSSED: u8 = 32;

/// `flag` if the condition holds, else no flag.
#[inline(always)]
fn flag_if(condition: bool, flag: u8) -> u8 {
    if condition { flag } else { 0 }
}

/// Copies each cube's value to its eight children.
#[inline(always)]
fn broadcast_to_children<T: Copy>(parents: &[T], children: &mut [T]) {
    for (children, &parent) in children.as_chunks_mut::<8>().0.iter_mut().zip(parents) {
        *children = [parent; 8];
    }
}

/// The children of which `flags` has `flag`, a bit each.
#[inline(always)]
fn children_with(flags: u64, flag: u8) -> u8 {
    const LOWEST: u64 = 0x0101_0101_0101_0101;
    // The lowest bit of each byte is moved to its position in the topmost byte.
    ((flags >> flag.trailing_zeros() & LOWEST).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

/// Cubes of equal size whose children are to be classified.
struct ClassifyKernel<'a> {
    classifier: &'a Classifier<'a>,
    centres: &'a [[f32; 3]],
    half: f32,
    scratch: &'a mut ClassifyScratch,
    classes: &'a mut Vec<Classes>,
}

impl Kernel for ClassifyKernel<'_> {
    #[inline(always)]
    fn run(self) {
        for centres in self.centres.chunks(CUBES) {
            self.classifier.classify_batch(centres, self.half, self.scratch, self.classes);
        }
    }
}

impl<'a> Classifier<'a> {
    pub fn new(pyramid: &'a RangePyramid, settings: &OccupancySettings, t_submap_lidar: &Rigid) -> Self {
        let (least_margin, margin) = free_margin_terms(settings);
        Self { pyramid, rotation: t_submap_lidar.rotation, sensor: t_submap_lidar.translation, least_margin, margin }
    }

    /// Classifies the eight cubes of edge `half` around each of `centres` (submap frame, metres).
    pub fn classify(&self, centres: &[[f32; 3]], half: f32, scratch: &mut ClassifyScratch, classes: &mut Vec<Classes>) {
        classes.clear();
        dispatch(ClassifyKernel { classifier: self, centres, half, scratch, classes });
    }

    // Loops, here and below: closures would not be compiled for the wide instructions of the kernel.
    #[inline(always)]
    fn classify_batch(&self, centres: &[[f32; 3]], half: f32, scratch: &mut ClassifyScratch, classes: &mut Vec<Classes>) {
        let (cubes, lanes) = (centres.len().min(CUBES), 8 * centres.len().min(CUBES));
        let mut step = [[0f32; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                step[i][j] = 0.5 * half * self.rotation[i][j];
            }
        }
        let radius = 0.5 * half * 3f32.sqrt();
        self.measure_cubes(centres, &step, radius, scratch);
        self.project_children(&step, lanes, scratch);
        self.classify_children(lanes, scratch);
        let flags = scratch.flags[..lanes].as_chunks::<8>().0;
        for (cube, &flags) in flags.iter().enumerate().take(cubes) {
            let flags = u64::from_le_bytes(flags);
            classes.push(if scratch.middle[cube] < WIDE * radius {
                Classes { mixed: u8::MAX, ..Classes::default() }
            } else if scratch.level[cube] == NO_LEVEL {
                Classes { mixed: children_with(flags, INSIDE), ..Classes::default() }
            } else {
                Classes {
                    free: children_with(flags, FREE),
                    mixed: children_with(flags, MIXED),
                    rim: children_with(flags, RIM),
                    holed: children_with(flags, HOLED),
                    crossed: children_with(flags, CROSSED),
                }
            });
        }
    }

    /// Computes the positions of the cubes' centres and the extents of their children.
    #[inline(always)]
    fn measure_cubes(&self, centres: &[[f32; 3]], step: &[[f32; 3]; 3], radius: f32, scratch: &mut ClassifyScratch) {
        let (r, sensor) = (&self.rotation, self.sensor);
        let (rows, columns) = (self.pyramid.rows().per_radian, self.pyramid.columns_per_radian());
        let ClassifyScratch { at, middle, depth, elevation, reach, level, start, start_finer, .. } = scratch;
        for i in 0..centres.len().min(CUBES) {
            let offset = [centres[i][0] - sensor[0], centres[i][1] - sensor[1], centres[i][2] - sensor[2]];
            let mut p = [0f32; 3];
            for j in 0..3 {
                p[j] = r[0][j] * offset[0] + r[1][j] * offset[1] + r[2][j] * offset[2];
            }
            let range = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            let extent = Extent::new(p, range, step, radius);
            (at[0][i], at[1][i], at[2][i], middle[i]) = (p[0], p[1], p[2], range);
            (depth[0][i], depth[1][i], elevation[i]) = (extent.depth[0], extent.depth[1], extent.elevation);
            (reach[0][i], reach[1][i]) = (rows * extent.elevation + SLACK, columns * extent.azimuth + SLACK);
            // Cubes without a level are queried with the smallest reach; the result is not used.
            let fits = (range >= WIDE * radius) & (level_for(reach[0][i], reach[1][i]) < LEVELS as u32);
            level[i] = if fits { level_for(reach[0][i], reach[1][i]) } else { NO_LEVEL };
            (reach[0][i], reach[1][i]) = if fits { (reach[0][i], reach[1][i]) } else { (SLACK, SLACK) };
        }
        // Siblings share a level, so its start is looked up once for all of them.
        for i in 0..centres.len().min(CUBES) {
            (start[i], start_finer[i]) = self.pyramid.starts_of(level[i] & !NO_LEVEL);
        }
    }

    /// Computes the rows, columns and ranges of the children.
    #[inline(always)]
    fn project_children(&self, step: &[[f32; 3]; 3], lanes: usize, scratch: &mut ClassifyScratch) {
        let ClassifyScratch {
            queries,
            at,
            depth,
            elevation,
            reach,
            level,
            start,
            start_finer,
            child_at,
            child_depth,
            child_elevation,
            range,
            sine,
            bins,
            next,
            ..
        } = scratch;
        for k in 0..3 {
            broadcast_to_children(&at[k], &mut child_at[k][..lanes]);
        }
        for k in 0..2 {
            broadcast_to_children(&depth[k], &mut child_depth[k][..lanes]);
            broadcast_to_children(&reach[k], &mut queries.reach[k][..lanes]);
        }
        broadcast_to_children(start, &mut queries.start[..lanes]);
        broadcast_to_children(start_finer, &mut queries.start_finer[..lanes]);
        broadcast_to_children(elevation, &mut child_elevation[..lanes]);
        broadcast_to_children(level, &mut queries.level[..lanes]);
        let (first, per_radian) = self.pyramid.columns_from();
        let [xs, ys, zs] = child_at;
        for i in 0..lanes {
            let (x, y, z) = (CHILD_SIGNS[0][i], CHILD_SIGNS[1][i], CHILD_SIGNS[2][i]);
            let px = xs[i] + x * step[0][0] + y * step[1][0] + z * step[2][0];
            let py = ys[i] + x * step[0][1] + y * step[1][1] + z * step[2][1];
            let pz = zs[i] + x * step[0][2] + y * step[1][2] + z * step[2][2];
            let r = (px * px + py * py + pz * pz).sqrt();
            range[i] = r;
            sine[i] = pz / r;
            queries.column[i] = (atan2(py, px) - first) * per_radian;
            queries.level[i] &= !NO_LEVEL;
        }
        self.pyramid.rows().rows(&sine[..lanes], &mut queries.row, bins, next);
    }

    /// Classifies the children by comparing their ranges with the texels of the pyramid.
    #[inline(always)]
    fn classify_children(&self, lanes: usize, scratch: &mut ClassifyScratch) {
        let ClassifyScratch { queries, child_depth: [before, behind], child_elevation, range, sine, nearest, farthest, flags, .. } = scratch;
        let (rows, step) = (self.pyramid.rows(), self.pyramid.metres_per_step());
        let (lowest, highest) = (rows.lowest, rows.highest);
        self.pyramid.texels(queries, lanes);
        let (least, margin) = (self.least_margin, self.margin);
        let mut has_mixed = 0u8;
        for i in 0..lanes {
            // Ranges of the nearest and the farthest voxel inside plus the margin: free voxels must be nearer than the returns by the margin.
            let margin = margin[0] + margin[1] * range[i];
            let reference = range[i] + if margin > least { margin } else { least };
            (nearest[i], farthest[i]) = (reference - before[i], reference + behind[i]);
            // The sine of the elevation changes by at most as much as the elevation.
            let inside = (sine[i] >= lowest - child_elevation[i]) & (sine[i] <= highest + child_elevation[i]);
            let texel = queries.texel[i];
            let is_in_front = (farthest[i] < near_of(texel) * step) & (texel & (HOLE_BIT | RIM_BIT) == 0);
            let mixed = nearest[i] < far_of(texel) * step;
            let flag = if is_in_front { INSIDE | FREE } else { INSIDE | flag_if(mixed, MIXED) };
            flags[i] = if inside { flag } else { 0 };
            has_mixed |= flags[i] & MIXED;
        }
        if has_mixed == 0 {
            return;
        }
        self.pyramid.finer_texels(queries, lanes);
        let mut crossed = 0u8;
        for i in 0..lanes {
            let texel = queries.texel[i];
            let is_in_front = farthest[i] < near_of(texel) * step;
            let (holed, rim) = (texel & HOLE_BIT != 0, texel & RIM_BIT != 0);
            let free = is_in_front & !holed & !rim;
            let mixed = (nearest[i] < far_of(texel) * step) & !free;
            let flag = INSIDE
                | flag_if(free, FREE)
                | flag_if(mixed, MIXED)
                | flag_if(rim, RIM)
                | flag_if(holed, HOLED)
                | flag_if(is_in_front & holed & !rim, CROSSED);
            flags[i] = if flags[i] & MIXED != 0 { flag } else { flags[i] };
            crossed |= flags[i] & CROSSED;
        }
        if crossed == 0 {
            return;
        }
        self.pyramid.pixels(queries, lanes);
        for i in 0..lanes {
            let has_return = queries.texel[i] & (HOLE_BIT | RIM_BIT) == 0;
            flags[i] &= if has_return { u8::MAX } else { !CROSSED };
        }
    }

    /// Distance from the sensor to a point of the submap, metres.
    #[inline(always)]
    pub fn range(&self, p: [f32; 3]) -> f32 {
        let (x, y, z) = (p[0] - self.sensor[0], p[1] - self.sensor[1], p[2] - self.sensor[2]);
        (x * x + y * y + z * z).sqrt()
    }

    /// Largest angle between neighbouring rays, radians.
    pub fn spacing(&self) -> f32 {
        1.0 / self.pyramid.rows().per_radian.min(self.pyramid.columns_per_radian())
    }
}

/// Indices of the set bits, lowest first.
#[inline(always)]
pub(super) fn bits(mut mask: u8) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = (mask != 0).then(|| mask.trailing_zeros() as usize);
        mask &= mask.wrapping_sub(1);
        bit
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::sensor::{BeamModel, RangeImage};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn cubes_classified_together_equal_cubes_classified_alone(
            ranges in prop::collection::vec(prop_oneof![8 => 20f32..40.0, 1 => Just(0f32)], 16 * 64),
            turn in prop::array::uniform3(-0.5f64..0.5), half in prop_oneof![Just(0.2f32), Just(1.0), Just(4.0)],
            centres in prop::collection::vec(prop::array::uniform3(-40f32..40.0), 1..3 * CUBES),
        ) {
            let model = BeamModel::even(16, 64, 0.3, -0.3).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let mut pyramid = RangePyramid::new(&model);
            pyramid.build(&RangeImage { rows: 16, columns: 64, ranges, points: Vec::new() }, 60.0, false, false);
            let t_submap_lidar = Rigid::from(&Pose::new(nalgebra::Vector3::new(1.0, 2.0, 0.5), nalgebra::Vector3::from(turn)));
            let classifier = Classifier::new(&pyramid, &OccupancySettings::default(), &t_submap_lidar);
            let (mut scratch, mut together, mut alone) = (ClassifyScratch::new(), Vec::new(), Vec::new());
            classifier.classify(&centres, half, &mut scratch, &mut together);
            prop_assert_eq!(together.len(), centres.len());
            for (centre, classes) in centres.iter().zip(&together) {
                classifier.classify(&[*centre], half, &mut scratch, &mut alone);
                prop_assert_eq!(&alone[..], &[*classes]);
                prop_assert_eq!(classes.free & classes.mixed, 0);
            }
        }
    }
}
