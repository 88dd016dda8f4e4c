//! Holding cubes against the pyramid, eight siblings at a time.

use super::model::{OccupancySettings, free_margin_terms};
use super::visibility::{Reach, Visibility};
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

/// Quantities of eight cubes, one array each, so that the arithmetic becomes SIMD.
type Lanes = [f32; 8];

/// Half of what each of eight siblings measures as the sensor sees it: an upper bound for all of them.
#[derive(Clone, Copy, Debug)]
struct Silhouette {
    /// Towards the sensor and away from it, metres.
    depth: [f32; 2],
    /// In elevation, radians.
    elevation: f32,
    /// In azimuth, radians; infinite above and below the sensor.
    azimuth: f32,
}

/// How far a box with half edges `step` reaches along `w`, times the length of `w`.
#[inline(always)]
fn along(step: &[[f32; 3]; 3], w: [f32; 3]) -> f32 {
    let mut reach = 0.0;
    for s in step {
        reach += (s[0] * w[0] + s[1] * w[1] + s[2] * w[2]).abs();
    }
    reach
}

impl Silhouette {
    /// Of boxes with half edges `step` (lidar frame) whose centres lie no farther than their half diagonal `radius` from
    /// `at` (lidar frame, metres), where `range` = |at| is at least [`WIDE`] radii.
    ///
    /// A box reaches E(w) = sum |step_i . w| along a unit vector w, and E changes by no more than `radius` times the change
    /// of w. So the directions to the middle serve for all siblings, with a little more for their offset from it.
    #[inline(always)]
    fn new(at: [f32; 3], range: f32, step: &[[f32; 3]; 3], radius: f32) -> Self {
        let flat = (at[0] * at[0] + at[1] * at[1]).sqrt();
        // Centres and then points of the boxes are at least this far away.
        let (centres, points) = (range - radius, range - 2.0 * radius);
        let turn = radius / centres;
        let (away, flat_inverse) = (1.0 / range, 1.0 / flat.max(1e-6));
        let depth = along(step, at) * away + radius * turn;
        let outward = 0.5 * radius * radius / points;
        let (flat_centres, flat_points) = (flat - radius, flat - 2.0 * radius);
        if flat_points <= 2.0 * radius {
            // The azimuth is of no use here, and "up" may be any direction.
            return Self { depth: [depth, depth + outward], elevation: radius / points * 1.1, azimuth: f32::INFINITY };
        }
        let sideways = [-at[1] * flat_inverse, at[0] * flat_inverse, 0.0];
        let (cosine, sine) = (flat * away, at[2] * away);
        let upward = [-sine * at[0] * flat_inverse, -sine * at[1] * flat_inverse, cosine];
        let swing = radius / flat_centres;
        Self {
            depth: [depth, depth + outward],
            // Points beside the plane through the centre are a little farther out than they seem from the side.
            elevation: (along(step, upward) + radius * (turn + swing)) / points + 0.5 * radius * radius / (flat_points * points),
            azimuth: (along(step, sideways) + radius * swing) / flat_points,
        }
    }
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
        // Loops, here and below: closures would not take part in the kernel's vector instructions.
        let (mut at, mut step) = ([0f32; 3], [[0f32; 3]; 3]);
        for i in 0..3 {
            for j in 0..3 {
                at[j] += r[i][j] * (centre[i] - self.sensor[i]);
                step[i][j] = 0.5 * half * r[i][j];
            }
        }
        let radius = 0.5 * half * 3f32.sqrt();
        let middle = (at[0] * at[0] + at[1] * at[1] + at[2] * at[2]).sqrt();
        if middle < WIDE * radius {
            return Classes { mixed: u8::MAX, ..Classes::default() };
        }
        let silhouette = Silhouette::new(at, middle, &step, radius);
        let rows = self.visibility.rows();
        let (mut range, mut sine, mut column): (Lanes, Lanes, Lanes) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        let (first, per_radian) = self.visibility.columns_from();
        for lane in 0..8 {
            let (x, y, z) = (SIGNS[0][lane], SIGNS[1][lane], SIGNS[2][lane]);
            let px = at[0] + x * step[0][0] + y * step[1][0] + z * step[2][0];
            let py = at[1] + x * step[0][1] + y * step[1][1] + z * step[2][1];
            let pz = at[2] + x * step[0][2] + y * step[1][2] + z * step[2][2];
            let r = (px * px + py * py + pz * pz).sqrt();
            range[lane] = r;
            sine[lane] = pz / r;
            column[lane] = (atan2(py, px) - first) * per_radian;
        }
        // The sine of the elevation changes by no more than the elevation does.
        let (lowest, highest) = (rows.lowest - silhouette.elevation, rows.highest + silhouette.elevation);
        let mut flags = [false; 8];
        for lane in 0..8 {
            flags[lane] = sine[lane] >= lowest && sine[lane] <= highest;
        }
        let inside = to_bits(flags);
        if inside == 0 {
            return Classes::default();
        }
        let reach = Reach {
            rows: rows.per_radian * silhouette.elevation + SLACK,
            columns: self.visibility.columns_per_radian() * silhouette.azimuth + SLACK,
        };
        let Some(window) = self.visibility.window_for(reach) else {
            return Classes { mixed: inside, ..Classes::default() };
        };
        // No voxel inside is nearer than `nearest`, and a free one must be nearer than what was seen.
        let row = rows.rows(&sine);
        let (mut nearest, mut farthest): (Lanes, Lanes) = ([0.0; 8], [0.0; 8]);
        let (least, margin, depth) = (self.least_margin, self.margin, silhouette.depth);
        for lane in 0..8 {
            let margin = margin[0] + margin[1] * range[lane];
            let seen = range[lane] + if margin > least { margin } else { least };
            nearest[lane] = seen - depth[0];
            farthest[lane] = seen + depth[1];
        }
        let texels = self.visibility.texels(&window, &row, &column);
        let mut unsettled = [false; 8];
        for lane in 0..8 {
            flags[lane] = farthest[lane] < texels.near[lane] && !texels.hole[lane] && !texels.rim[lane];
            unsettled[lane] = nearest[lane] < texels.far[lane];
        }
        let mut classes = Classes { free: inside & to_bits(flags), ..Classes::default() };
        let unsettled = to_bits(unsettled) & inside & !classes.free;
        if unsettled == 0 {
            return classes;
        }
        let close = self.visibility.close_texels(&window, &row, &column);
        let mut mixed = [false; 8];
        for lane in 0..8 {
            flags[lane] = farthest[lane] < close.near[lane];
            mixed[lane] = nearest[lane] < close.far[lane];
        }
        let (open, holed, rim) = (to_bits(flags), to_bits(close.hole), to_bits(close.rim));
        classes.free |= unsettled & open & !holed & !rim;
        classes.mixed = unsettled & to_bits(mixed);
        classes.rim = unsettled & rim;
        classes.holed = unsettled & holed;
        for lane in bits(unsettled & open & holed & !rim) {
            classes.crossed |= u8::from(self.visibility.saw(row[lane], column[lane])) << lane;
        }
        classes.mixed &= !classes.free;
        classes
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

/// A bit for each flag, by a sum that compiles to vector instructions.
#[inline(always)]
fn to_bits(flags: [bool; 8]) -> u8 {
    let mut sum = 0u32;
    for (lane, flag) in flags.into_iter().enumerate() {
        sum |= if flag { 1 << lane } else { 0 };
    }
    sum as u8
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
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn silhouettes_hold_every_point_of_every_sibling(
            direction in prop::array::uniform3(-1f32..1.0), distance in 4.01f32..400.0, angles in prop::array::uniform3(-3.1f32..3.1),
            points in prop::collection::vec((0usize..8, prop::array::uniform3(prop_oneof![Just(-1f32), Just(1f32), -1f32..1.0])), 60),
        ) {
            let length = direction.iter().map(|c| c * c).sum::<f32>().sqrt();
            prop_assume!(length > 0.05);
            let half = 2.0 / 3f32.sqrt(); // the half diagonal is 1
            let rotation = nalgebra::Rotation3::from_euler_angles(angles[0], angles[1], angles[2]);
            let step: [[f32; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * half * rotation[(j, i)]));
            let at = direction.map(|c| c / length * distance);
            let silhouette = Silhouette::new(at, distance, &step, 1.0);
            let add = |p: [f32; 3], by: [f32; 3]| -> [f32; 3] { std::array::from_fn(|j| p[j] + (0..3).map(|i| by[i] * step[i][j]).sum::<f32>()) };
            let polar = |p: [f32; 3]| {
                let p = p.map(f64::from);
                let range = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
                (range, (p[2] / range).asin(), p[1].atan2(p[0]))
            };
            for (lane, inside) in points {
                let centre = add(at, [1, 2, 4].map(|bit| if lane & bit == 0 { -1.0 } else { 1.0 }));
                let (c, p) = (polar(centre), polar(add(centre, inside)));
                let close = 1e-5 * f64::from(distance);
                prop_assert!(p.0 >= c.0 - f64::from(silhouette.depth[0]) - close && p.0 <= c.0 + f64::from(silhouette.depth[1]) + close);
                prop_assert!((p.1 - c.1).abs() <= f64::from(silhouette.elevation) * (1.0 + 1e-4) + 1e-6, "{} {}", p.1 - c.1, silhouette.elevation);
                let turn = (p.2 - c.2 + 3.0 * std::f64::consts::PI).rem_euclid(2.0 * std::f64::consts::PI) - std::f64::consts::PI;
                prop_assert!(turn.abs() <= f64::from(silhouette.azimuth) * (1.0 + 1e-4) + 1e-6, "{turn} {}", silhouette.azimuth);
            }
            // Not only safe: far away, as far up as lidars look, a sibling's silhouette is at most its half diagonal.
            if distance > 100.0 && at[2].abs() < 0.7 * distance {
                prop_assert!(silhouette.elevation * distance < 1.07 && silhouette.depth[1] < 1.03);
            }
        }
    }
}
