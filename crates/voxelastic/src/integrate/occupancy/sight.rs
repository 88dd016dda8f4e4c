//! Holding cubes against the pyramid, the children of many at a time.
#![allow(clippy::needless_range_loop)] // A lane, or a cube, is an index into many arrays here.

use super::model::{OccupancySettings, free_margin_terms};
use super::silhouette::Silhouette;
use super::texel::{HOLE_BIT, RIM_BIT, far_of, near_of};
use super::visibility::{LANES, LEVELS, Looks, Visibility, level_for};
use crate::dispatch::{Kernel, dispatch};
use crate::geometry::Rigid;
use crate::sensor::atan2;

/// What a scan says about eight sibling cubes, a bit each. Cubes that are neither free nor mixed hold nothing free: no beam
/// passed through them, or all of them lies behind what was seen, or too close before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Classes {
    /// Every beam through the cube went on beyond it.
    pub free: u8,
    /// Some part may be free.
    pub mixed: u8,
    /// The mixed cubes of which a part lies outside of the field of view.
    pub rim: u8,
    /// The mixed cubes through which, or beside which, beams without return pass.
    pub holed: u8,
    /// The holed cubes through whose middle a beam went on beyond, and all those with a return around it too: free, if small.
    pub crossed: u8,
}

/// Looks at cubes of the submap from where a scan was taken.
#[derive(Clone, Copy)]
pub(super) struct Sight<'a> {
    visibility: &'a Visibility,
    /// Columns are the lidar's axes in the submap.
    rotation: [[f32; 3]; 3],
    sensor: [f32; 3],
    /// A voxel counts as free only this far before a return: least margin, and margin per metre of range.
    least_margin: f32,
    margin: [f32; 2],
}

/// Nearer than this many of its half diagonals, a cube fills the view: nothing can be said of it as a whole.
const WIDE: f32 = 4.0;
/// Around a silhouette, in pixels: half a pixel reaches the beams on all sides, because between two beams only what is before
/// both is known to be free; the rest is the inaccuracy of rows, columns and arithmetic.
const SLACK: f32 = 0.55;

/// Which way each of eight siblings lies from their common centre.
const SIGNS: [[f32; 8]; 3] =
    [[-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0], [-1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, 1.0], [-1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0]];

/// Cubes whose children are looked at together.
const COHORT: usize = LANES / 8;

/// Memory for looking at many cubes: one array per quantity, so that the arithmetic becomes SIMD, and no array is cleared.
#[derive(Clone, Debug)]
pub(super) struct Scratch {
    looks: Looks,
    /// Of each cube: the middle in the lidar frame, its distance, and what its children measure.
    at: [[f32; COHORT]; 3],
    middle: [f32; COHORT],
    depth: [[f32; COHORT]; 2],
    elevation: [f32; COHORT],
    reach: [[f32; COHORT]; 2],
    level: [u32; COHORT],
    start: [u32; COHORT],
    start_closer: [u32; COHORT],
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

impl Scratch {
    pub fn new() -> Self {
        let (cubes, children) = ([0.0; COHORT], [0.0; LANES]);
        Self {
            looks: Looks::new(),
            at: [cubes; 3],
            middle: cubes,
            depth: [cubes; 2],
            elevation: cubes,
            reach: [cubes; 2],
            level: [0; COHORT],
            start: [0; COHORT],
            start_closer: [0; COHORT],
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

/// Which way each child lies from the middle, for all children of a cohort.
const WAYS: [[f32; LANES]; 3] = {
    let mut ways = [[0.0; LANES]; 3];
    let mut lane = 0;
    while lane < LANES {
        (ways[0][lane], ways[1][lane], ways[2][lane]) = (SIGNS[0][lane % 8], SIGNS[1][lane % 8], SIGNS[2][lane % 8]);
        lane += 1;
    }
    ways
};

/// The level of cubes for which no texel is large enough.
const UNFIT: u32 = 8;

// What is known of a child, a bit each.
const INSIDE: u8 = 1;
const FREE: u8 = 2;
const MIXED: u8 = 4;
const RIM: u8 = 8;
const HOLED: u8 = 16;
const CROSSED: u8 = 32;

/// `flag` if the condition holds.
#[inline(always)]
fn when(condition: bool, flag: u8) -> u8 {
    if condition { flag } else { 0 }
}

/// Gives each of eight children what is known of their parent.
#[inline(always)]
fn hand_down<T: Copy>(parents: &[T], children: &mut [T]) {
    for (children, &parent) in children.as_chunks_mut::<8>().0.iter_mut().zip(parents) {
        *children = [parent; 8];
    }
}

/// The children of which `flags` has `flag`, a bit each.
#[inline(always)]
fn having(flags: u64, flag: u8) -> u8 {
    const LOWEST: u64 = 0x0101_0101_0101_0101;
    // Each byte's lowest bit is moved to its place in the topmost byte.
    ((flags >> flag.trailing_zeros() & LOWEST).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
}

/// Cubes of the same size to classify the children of.
struct Look<'a> {
    sight: &'a Sight<'a>,
    centres: &'a [[f32; 3]],
    half: f32,
    scratch: &'a mut Scratch,
    classes: &'a mut Vec<Classes>,
}

impl Kernel for Look<'_> {
    #[inline(always)]
    fn run(self) {
        for centres in self.centres.chunks(COHORT) {
            self.sight.classify_cohort(centres, self.half, self.scratch, self.classes);
        }
    }
}

impl<'a> Sight<'a> {
    pub fn new(visibility: &'a Visibility, settings: &OccupancySettings, t_submap_lidar: &Rigid) -> Self {
        let (least_margin, margin) = free_margin_terms(settings);
        Self { visibility, rotation: t_submap_lidar.rotation, sensor: t_submap_lidar.translation, least_margin, margin }
    }

    /// Classifies the eight cubes of edge `half` around each of `centres` (submap frame, metres).
    pub fn classify(&self, centres: &[[f32; 3]], half: f32, scratch: &mut Scratch, classes: &mut Vec<Classes>) {
        classes.clear();
        dispatch(Look { sight: self, centres, half, scratch, classes });
    }

    // Loops, here and below: closures would not take part in the kernel's vector instructions.
    #[inline(always)]
    fn classify_cohort(&self, centres: &[[f32; 3]], half: f32, scratch: &mut Scratch, classes: &mut Vec<Classes>) {
        let (cubes, lanes) = (centres.len().min(COHORT), 8 * centres.len().min(COHORT));
        let mut step = [[0f32; 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                step[i][j] = 0.5 * half * self.rotation[i][j];
            }
        }
        let radius = 0.5 * half * 3f32.sqrt();
        self.measure(centres, &step, radius, scratch);
        self.point(&step, lanes, scratch);
        self.judge(lanes, scratch);
        let flags = scratch.flags[..lanes].as_chunks::<8>().0;
        for (cube, &flags) in flags.iter().enumerate().take(cubes) {
            let flags = u64::from_le_bytes(flags);
            classes.push(if scratch.middle[cube] < WIDE * radius {
                Classes { mixed: u8::MAX, ..Classes::default() }
            } else if scratch.level[cube] == UNFIT {
                Classes { mixed: having(flags, INSIDE), ..Classes::default() }
            } else {
                Classes {
                    free: having(flags, FREE),
                    mixed: having(flags, MIXED),
                    rim: having(flags, RIM),
                    holed: having(flags, HOLED),
                    crossed: having(flags, CROSSED),
                }
            });
        }
    }

    /// Where the cubes' middles are and what their children measure.
    #[inline(always)]
    fn measure(&self, centres: &[[f32; 3]], step: &[[f32; 3]; 3], radius: f32, scratch: &mut Scratch) {
        let (r, sensor) = (&self.rotation, self.sensor);
        let (rows, columns) = (self.visibility.rows().per_radian, self.visibility.columns_per_radian());
        let Scratch { at, middle, depth, elevation, reach, level, start, start_closer, .. } = scratch;
        for i in 0..centres.len().min(COHORT) {
            let offset = [centres[i][0] - sensor[0], centres[i][1] - sensor[1], centres[i][2] - sensor[2]];
            let mut p = [0f32; 3];
            for j in 0..3 {
                p[j] = r[0][j] * offset[0] + r[1][j] * offset[1] + r[2][j] * offset[2];
            }
            let range = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
            let silhouette = Silhouette::new(p, range, step, radius);
            (at[0][i], at[1][i], at[2][i], middle[i]) = (p[0], p[1], p[2], range);
            (depth[0][i], depth[1][i], elevation[i]) = (silhouette.depth[0], silhouette.depth[1], silhouette.elevation);
            (reach[0][i], reach[1][i]) = (rows * silhouette.elevation + SLACK, columns * silhouette.azimuth + SLACK);
            // What no texel is large enough for is settled without one.
            let fits = (range >= WIDE * radius) & (level_for(reach[0][i], reach[1][i]) < LEVELS as u32);
            level[i] = if fits { level_for(reach[0][i], reach[1][i]) } else { UNFIT };
            (reach[0][i], reach[1][i]) = if fits { (reach[0][i], reach[1][i]) } else { (SLACK, SLACK) };
        }
        // Siblings are looked at in one level: where it starts need not be looked up for each.
        for i in 0..centres.len().min(COHORT) {
            (start[i], start_closer[i]) = self.visibility.starts_of(level[i] & !UNFIT);
        }
    }

    /// Which way the children lie from the sensor, and how far.
    #[inline(always)]
    fn point(&self, step: &[[f32; 3]; 3], lanes: usize, scratch: &mut Scratch) {
        let Scratch {
            looks,
            at,
            depth,
            elevation,
            reach,
            level,
            start,
            start_closer,
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
            hand_down(&at[k], &mut child_at[k][..lanes]);
        }
        for k in 0..2 {
            hand_down(&depth[k], &mut child_depth[k][..lanes]);
            hand_down(&reach[k], &mut looks.reach[k][..lanes]);
        }
        hand_down(start, &mut looks.start[..lanes]);
        hand_down(start_closer, &mut looks.start_closer[..lanes]);
        hand_down(elevation, &mut child_elevation[..lanes]);
        hand_down(level, &mut looks.level[..lanes]);
        let (first, per_radian) = self.visibility.columns_from();
        let [xs, ys, zs] = child_at;
        for i in 0..lanes {
            let (x, y, z) = (WAYS[0][i], WAYS[1][i], WAYS[2][i]);
            let px = xs[i] + x * step[0][0] + y * step[1][0] + z * step[2][0];
            let py = ys[i] + x * step[0][1] + y * step[1][1] + z * step[2][1];
            let pz = zs[i] + x * step[0][2] + y * step[1][2] + z * step[2][2];
            let r = (px * px + py * py + pz * pz).sqrt();
            range[i] = r;
            sine[i] = pz / r;
            looks.column[i] = (atan2(py, px) - first) * per_radian;
            looks.level[i] &= !UNFIT;
        }
        self.visibility.rows().rows(&sine[..lanes], &mut looks.row, bins, next);
    }

    /// Holds the children against what was seen.
    #[inline(always)]
    fn judge(&self, lanes: usize, scratch: &mut Scratch) {
        let Scratch { looks, child_depth: [before, behind], child_elevation, range, sine, nearest, farthest, flags, .. } = scratch;
        let (rows, step) = (self.visibility.rows(), self.visibility.metres_per_step());
        let (lowest, highest) = (rows.lowest, rows.highest);
        self.visibility.texels(looks, lanes);
        let (least, margin) = (self.least_margin, self.margin);
        let mut unsettled = 0u8;
        for i in 0..lanes {
            // No voxel inside is nearer than `nearest`, and a free one must be nearer than what was seen.
            let margin = margin[0] + margin[1] * range[i];
            let seen = range[i] + if margin > least { margin } else { least };
            (nearest[i], farthest[i]) = (seen - before[i], seen + behind[i]);
            // The sine of the elevation changes by no more than the elevation does.
            let inside = (sine[i] >= lowest - child_elevation[i]) & (sine[i] <= highest + child_elevation[i]);
            let texel = looks.texel[i];
            let open = (farthest[i] < near_of(texel) * step) & (texel & (HOLE_BIT | RIM_BIT) == 0);
            let mixed = nearest[i] < far_of(texel) * step;
            let flag = if open { INSIDE | FREE } else { INSIDE | when(mixed, MIXED) };
            flags[i] = if inside { flag } else { 0 };
            unsettled |= flags[i] & MIXED;
        }
        if unsettled == 0 {
            return;
        }
        self.visibility.close_texels(looks, lanes);
        let mut crossed = 0u8;
        for i in 0..lanes {
            let texel = looks.texel[i];
            let open = farthest[i] < near_of(texel) * step;
            let (holed, rim) = (texel & HOLE_BIT != 0, texel & RIM_BIT != 0);
            let free = open & !holed & !rim;
            let mixed = (nearest[i] < far_of(texel) * step) & !free;
            let flag = INSIDE | when(free, FREE) | when(mixed, MIXED) | when(rim, RIM) | when(holed, HOLED) | when(open & holed & !rim, CROSSED);
            flags[i] = if flags[i] & MIXED != 0 { flag } else { flags[i] };
            crossed |= flags[i] & CROSSED;
        }
        if crossed == 0 {
            return;
        }
        self.visibility.pixels(looks, lanes);
        for i in 0..lanes {
            let saw = looks.texel[i] & (HOLE_BIT | RIM_BIT) == 0;
            flags[i] &= if saw { u8::MAX } else { !CROSSED };
        }
    }

    /// Distance from the sensor to a point of the submap.
    #[inline(always)]
    pub fn range(&self, p: [f32; 3]) -> f32 {
        let (x, y, z) = (p[0] - self.sensor[0], p[1] - self.sensor[1], p[2] - self.sensor[2]);
        (x * x + y * y + z * z).sqrt()
    }

    /// Angle between neighbouring beams where they are farthest apart, radians.
    pub fn spacing(&self) -> f32 {
        1.0 / self.visibility.rows().per_radian.min(self.visibility.columns_per_radian())
    }
}

/// Bits that are set, lowest first.
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
        fn cubes_are_seen_in_company_as_alone(
            ranges in prop::collection::vec(prop_oneof![8 => 20f32..40.0, 1 => Just(0f32)], 16 * 64),
            turn in prop::array::uniform3(-0.5f64..0.5), half in prop_oneof![Just(0.2f32), Just(1.0), Just(4.0)],
            centres in prop::collection::vec(prop::array::uniform3(-40f32..40.0), 1..3 * COHORT),
        ) {
            let model = BeamModel::even(16, 64, 0.3, -0.3).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let mut visibility = Visibility::new(&model);
            visibility.build(&RangeImage { rows: 16, columns: 64, ranges, points: Vec::new() }, 60.0, false, false);
            let t_submap_lidar = Rigid::from(&Pose::new(nalgebra::Vector3::new(1.0, 2.0, 0.5), nalgebra::Vector3::from(turn)));
            let sight = Sight::new(&visibility, &OccupancySettings::default(), &t_submap_lidar);
            let (mut scratch, mut together, mut alone) = (Scratch::new(), Vec::new(), Vec::new());
            sight.classify(&centres, half, &mut scratch, &mut together);
            prop_assert_eq!(together.len(), centres.len());
            for (centre, classes) in centres.iter().zip(&together) {
                sight.classify(&[*centre], half, &mut scratch, &mut alone);
                prop_assert_eq!(&alone[..], &[*classes]);
                prop_assert_eq!(classes.free & classes.mixed, 0);
            }
        }
    }
}
