//! Holding cubes against the pyramid, eight at a time.

use super::model::{OccupancySettings, free_margin_terms};
use super::visibility::{Patch, Visibility};
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
    /// The mixed cubes at the rim of what was seen: beams without return, or outside of the field of view, pass there too.
    pub rim: u8,
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

/// Beyond this ratio of radius to distance a cube fills the view: nothing can be said of it as a whole.
const WIDE: f32 = 0.5;
/// asin(x) is at most this times x, up to [`WIDE`].
const ARC: f32 = 1.05;
/// Inaccuracy of rows, columns and arithmetic, in pixels.
const SLACK: f32 = 0.05;

/// Eight cubes at once, one array per quantity, so that the arithmetic becomes SIMD.
#[derive(Default)]
struct Lanes {
    range: [f32; 8],
    sine: [f32; 8],
    column: [f32; 8],
    row_radius: [f32; 8],
    column_radius: [f32; 8],
    margin: [f32; 8],
}

impl<'a> Sight<'a> {
    pub fn new(visibility: &'a Visibility, settings: &OccupancySettings, t_submap_lidar: &Rigid) -> Self {
        let (least_margin, margin) = free_margin_terms(settings);
        Self { visibility, rotation: t_submap_lidar.rotation, sensor: t_submap_lidar.translation, least_margin, margin }
    }

    /// Classifies the eight cubes of edge `half` around `centre` (submap frame, metres).
    #[inline(always)]
    pub fn classify(&self, centre: [f32; 3], half: f32) -> Classes {
        let r = &self.rotation;
        let offset: [f32; 3] = std::array::from_fn(|k| centre[k] - self.sensor[k]);
        let at: [f32; 3] = std::array::from_fn(|j| r[0][j] * offset[0] + r[1][j] * offset[1] + r[2][j] * offset[2]);
        let step: [[f32; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * half * r[i][j]));
        let radius = 0.5 * half * 3f32.sqrt();
        let rows = self.visibility.rows();
        let (rows_per_radian, columns_per_radian) = (rows.per_radian, self.visibility.columns_per_radian());
        let mut lanes = Lanes::default();
        for lane in 0..8 {
            let [x, y, z] = [1, 2, 4].map(|bit| if lane & bit == 0 { -1f32 } else { 1.0 });
            let p: [f32; 3] = std::array::from_fn(|j| at[j] + x * step[0][j] + y * step[1][j] + z * step[2][j]);
            let square = p[0] * p[0] + p[1] * p[1];
            let flat = square.sqrt();
            let range = (square + p[2] * p[2]).sqrt();
            lanes.range[lane] = range;
            lanes.sine[lane] = p[2] / range;
            lanes.column[lane] = self.visibility.column(atan2(p[1], p[0]));
            lanes.row_radius[lane] = ARC * rows_per_radian * radius / range + SLACK;
            // Too wide to have a silhouette: no texel is that large.
            lanes.column_radius[lane] = if radius > WIDE * flat { f32::MAX } else { ARC * columns_per_radian * radius / flat + SLACK };
            let margin = self.margin[0] + self.margin[1] * range;
            lanes.margin[lane] = if margin > self.least_margin { margin } else { self.least_margin };
        }
        let angle = ARC * radius;
        let mut classes = Classes::default();
        for lane in 0..8 {
            let (range, sine) = (lanes.range[lane], lanes.sine[lane]);
            if radius > WIDE * range {
                classes.mixed |= 1 << lane;
                continue;
            }
            // The sine of the elevation changes by no more than the angle does.
            if (sine - rows.highest) * range > angle || (rows.lowest - sine) * range > angle {
                continue;
            }
            let patch = Patch {
                row: rows.row(sine),
                column: lanes.column[lane],
                row_radius: lanes.row_radius[lane],
                column_radius: lanes.column_radius[lane],
            };
            // No voxel inside is nearer than `nearest`, and a free one must be nearer than what was seen.
            let (nearest, farthest) = (range - radius + lanes.margin[lane], range + radius + lanes.margin[lane]);
            let Some(texel) = self.visibility.texel(&patch) else {
                classes.mixed |= 1 << lane;
                continue;
            };
            if farthest < texel.near {
                classes.free |= 1 << lane;
            } else if nearest < texel.far
                && let Some(close) = self.visibility.close_texel(&patch)
            {
                classes.free |= u8::from(farthest < close.near) << lane;
                classes.mixed |= u8::from(nearest < close.far) << lane;
                classes.rim |= u8::from(close.near == 0.0) << lane;
            }
        }
        classes.mixed &= !classes.free;
        classes
    }

    /// Distance from the sensor to a point of the submap.
    #[inline(always)]
    pub fn range(&self, p: [f32; 3]) -> f32 {
        (0..3).map(|k| (p[k] - self.sensor[k]).powi(2)).sum::<f32>().sqrt()
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
