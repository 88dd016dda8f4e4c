//! Propagation of distances between the scales of a block (paper Sec. III-A): means are propagated up, differences down.
//!
//! Arrays are those of one block, x fastest; distances are in steps of the array's own voxels.

use super::voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
use crate::octree::{edge_at, voxel_coords, voxel_index};

#[inline(always)]
fn clamp_i16(x: i32) -> i16 {
    x.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
}

/// Largest weight of an interpolated voxel: small, so that one measurement at its own scale outweighs it.
pub(crate) const INTERPOLATED_WEIGHT: u16 = WEIGHT_ONE / 4;

/// Mean up-propagation: each voxel of `coarse` (at `scale + 1`) becomes the mean of its observed children in `fine` (at `scale`).
///
/// At the end of the truncation band only the children on one side are observed, and their mean is the distance at a point closer to the
/// surface than the parent's centre. So it is extrapolated to the centre along the gradient. Where the gradient is unknown the mean is
/// taken as it is, with a small weight; returns the bit set of these parents.
pub fn propagate_up(fine: &[Voxel], coarse: &mut [Voxel], scale: usize) -> u64 {
    let mut uncertain = 0;
    for (index, parent) in coarse.iter_mut().enumerate() {
        let (mut distance, mut weight, mut count) = (0i32, 0u32, 0i32);
        for child in children(index, scale) {
            let child = fine[child];
            if child.is_observed() {
                distance += i32::from(child.distance);
                weight += u32::from(child.weight);
                count += 1;
            }
        }
        if 0 < count && count < 8 {
            let (change, is_known) = change_to_centre(fine, index, scale);
            distance += change;
            if !is_known {
                uncertain |= 1 << index;
                weight = weight.min(u32::from(INTERPOLATED_WEIGHT) * count as u32);
            }
        }
        // A distance is half as many parent voxels as child voxels. Weights are rounded up so that an observed voxel stays observed.
        *parent = match count {
            0 => Voxel::default(),
            _ => Voxel { distance: clamp_i16(distance / (2 * count)), weight: weight.div_ceil(count as u32) as u16 },
        };
    }
    uncertain
}

/// Sum over the observed children of `parent` of the change of distance from the child to the parent's centre, in the children's steps, and
/// whether the gradient is known along each axis on which the children are not balanced.
fn change_to_centre(fine: &[Voxel], parent: usize, scale: usize) -> (i32, bool) {
    let (mut gradients, mut known, mut sides) = ([0.0; 3], [0; 3], [0; 3]);
    for child in children(parent, scale).filter(|&c| fine[c].is_observed()) {
        let (c, gradient) = (voxel_coords(child, scale), gradient(fine, child, scale));
        for k in 0..3 {
            sides[k] += if c[k] & 1 == 1 { -1 } else { 1 };
            // A distance changes by at most a voxel per voxel; larger gradients are noise or another surface.
            gradients[k] += gradient[k].map_or(0.0, |g| g.clamp(-DISTANCE_STEPS, DISTANCE_STEPS));
            known[k] += i32::from(gradient[k].is_some());
        }
    }
    // Children are half a voxel from the centre; where both sides have equally many, their mean needs no correction.
    let change: f32 = (0..3).map(|k| 0.5 * sides[k] as f32 * gradients[k] / known[k].max(1) as f32).sum();
    (change.round() as i32, (0..3).all(|k| sides[k] == 0 || known[k] > 0))
}

/// Delta down-propagation into an existing finer array: each observed child in `fine` (at `scale`) changes by the difference of its parent in
/// `coarse` (at `scale + 1`) from `base`, with weights up to `max_weight`; unobserved children are interpolated.
pub fn propagate_delta_down(coarse: &[Voxel], base: &[Voxel], fine: &mut [Voxel], scale: usize, max_weight: u16, interpolation: &Interpolation) {
    for (index, (&now, &then)) in coarse.iter().zip(base).enumerate() {
        if !now.is_observed() {
            continue;
        }
        let delta = 2 * (i32::from(now.distance) - i32::from(then.distance));
        let added = now.weight.saturating_sub(then.weight);
        let gradient = gradient(coarse, index, scale + 1).map(Option::unwrap_or_default);
        for child in children(index, scale) {
            let voxel = &mut fine[child];
            if !voxel.is_observed() {
                *voxel = interpolation.child(now, gradient, child, scale);
            } else if then.is_observed() {
                voxel.distance = clamp_i16(i32::from(voxel.distance) + delta);
                voxel.weight = voxel.weight.saturating_add(added).min(max_weight);
            }
        }
    }
}

/// Down-propagation into a new finer array (at `scale`): the children of every observed parent in `coarse` are interpolated.
pub fn propagate_down(coarse: &[Voxel], fine: &mut [Voxel], scale: usize, interpolation: &Interpolation) {
    for (index, &parent) in coarse.iter().enumerate() {
        if parent.is_observed() {
            let gradient = gradient(coarse, index, scale + 1).map(Option::unwrap_or_default);
            for child in children(index, scale) {
                fine[child] = interpolation.child(parent, gradient, child, scale);
            }
        }
    }
}

/// Indices at `scale` of the eight voxels in voxel `parent` at `scale + 1`.
#[inline(always)]
pub fn children(parent: usize, scale: usize) -> impl Iterator<Item = usize> {
    let p = voxel_coords(parent, scale + 1);
    (0..8).map(move |d| voxel_index([2 * p[0] + (d & 1), 2 * p[1] + (d >> 1 & 1), 2 * p[2] + (d >> 2)], scale))
}

/// Change of the distance per voxel along each axis, from observed neighbours within the block; none without any.
fn gradient(voxels: &[Voxel], index: usize, scale: usize) -> [Option<f32>; 3] {
    let c = voxel_coords(index, scale);
    let here = f32::from(voxels[index].distance);
    std::array::from_fn(|axis| {
        let at = |step: isize| {
            let mut n = c;
            n[axis] = c[axis].checked_add_signed(step).filter(|&v| v < edge_at(scale))?;
            let voxel = voxels[voxel_index(n, scale)];
            voxel.is_observed().then(|| f32::from(voxel.distance))
        };
        match (at(-1), at(1)) {
            (Some(below), Some(above)) => Some(0.5 * (above - below)),
            (Some(below), None) => Some(here - below),
            (None, Some(above)) => Some(above - here),
            (None, None) => None,
        }
    })
}

/// How unmeasured voxels are interpolated from a coarser scale: only within a band around the surface.
#[derive(Clone, Copy, Debug)]
pub struct Interpolation {
    /// Largest weight of an interpolated voxel.
    pub weight: u16,
    /// Smallest and largest distance, steps; voxels outside stay unobserved.
    pub band: [i16; 2],
}

impl Interpolation {
    #[cfg(test)]
    /// Interpolates all children, with their parent's weight.
    const ALL: Self = Self { weight: u16::MAX, band: [i16::MIN, i16::MAX] };
    /// Interpolates the children that a surface extraction can need, with their parent's weight: no surface passes between two voxels that
    /// are both farther away.
    pub const NEAR: Self = Self { weight: u16::MAX, band: [(-1.5 * DISTANCE_STEPS) as i16, (1.5 * DISTANCE_STEPS) as i16] };

    /// The value of `child` (at `scale`), extrapolated linearly from its parent's value and gradient.
    fn child(&self, parent: Voxel, gradient: [f32; 3], child: usize, scale: usize) -> Voxel {
        let c = voxel_coords(child, scale);
        // The centres of children are a quarter of a parent voxel from the parent's along each axis.
        let offset: f32 = (0..3).map(|i| if c[i] & 1 == 1 { 0.25 * gradient[i] } else { -0.25 * gradient[i] }).sum();
        let distance = clamp_i16((2.0 * (f32::from(parent.distance) + offset)).round() as i32);
        let [least, most] = self.band;
        if (least..=most).contains(&distance) { Voxel { distance, weight: parent.weight.min(self.weight) } } else { Voxel::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::voxels_at;

    /// Signed distance to a plane, sampled at the voxel centres of a block at `scale`, in that scale's unit.
    fn plane(scale: usize, normal: [f32; 3], offset: f32) -> Vec<Voxel> {
        (0..voxels_at(scale))
            .map(|i| {
                let c = voxel_coords(i, scale);
                let size = (1 << scale) as f32;
                let metric: f32 = (0..3).map(|k| normal[k] * (c[k] as f32 + 0.5) * size).sum::<f32>() - offset;
                Voxel { distance: (metric / size * DISTANCE_STEPS).round() as i16, weight: 10 }
            })
            .collect()
    }

    #[test]
    fn a_plane_is_preserved_by_propagation_up_and_down() {
        let (normal, offset) = ([0.6, 0.48, 0.64], 6.1);
        for scale in 0..3 {
            let (fine, coarse) = (plane(scale, normal, offset), plane(scale + 1, normal, offset));
            let mut up = vec![Voxel::default(); voxels_at(scale + 1)];
            propagate_up(&fine, &mut up, scale);
            assert!(up.iter().zip(&coarse).all(|(a, b)| (a.distance - b.distance).abs() <= 2 && a.weight == 10));
            if scale < 2 {
                let mut down = vec![Voxel::default(); voxels_at(scale)];
                propagate_down(&coarse, &mut down, scale, &Interpolation::ALL);
                assert!(down.iter().zip(&fine).all(|(a, b)| (a.distance - b.distance).abs() <= 8), "scale {scale}");
            }
        }
    }

    #[test]
    fn the_band_of_a_plane_propagates_up_to_the_same_plane() {
        let (normal, offset) = ([0.6, 0.48, 0.64], 6.1);
        let (mut fine, coarse) = (plane(0, normal, offset), plane(1, normal, offset));
        fine.iter_mut().filter(|v| f32::from(v.distance).abs() > 1.5 * DISTANCE_STEPS).for_each(|v| *v = Voxel::default());
        let mut up = vec![Voxel::default(); voxels_at(1)];
        let uncertain = propagate_up(&fine, &mut up, 0);
        let observed: Vec<usize> = (0..up.len()).filter(|&i| up[i].is_observed()).collect();
        let (doubtful, known): (Vec<usize>, Vec<usize>) = observed.iter().partition(|&&i| uncertain >> i & 1 == 1);
        assert!(known.len() > 20 && doubtful.len() * 4 < known.len() && uncertain.count_ones() as usize == doubtful.len());
        assert!(known.iter().all(|&i| (up[i].distance - coarse[i].distance).abs() <= 2));
        // The error is at most half the way from the children to the centre.
        assert!(doubtful.iter().all(|&i| f32::from(up[i].distance - coarse[i].distance).abs() < 0.5 * DISTANCE_STEPS));
    }

    #[test]
    fn interpolated_voxels_are_within_the_band_and_have_its_weight() {
        let coarse = plane(1, [0.6, 0.48, 0.64], 6.1);
        let [mut all, mut near] = [vec![Voxel::default(); voxels_at(0)], vec![Voxel::default(); voxels_at(0)]];
        propagate_down(&coarse, &mut all, 0, &Interpolation::ALL);
        let interpolation = Interpolation { weight: 3, band: [-1000, 3000] };
        propagate_down(&coarse, &mut near, 0, &interpolation);
        let mut count = 0;
        for (all, near) in all.iter().zip(&near) {
            let is_within = (-1000..=3000).contains(&all.distance);
            count += usize::from(is_within);
            assert_eq!(*near, if is_within { Voxel { weight: 3, ..*all } } else { Voxel::default() });
        }
        assert!(50 < count && count < all.len() / 2);
        // The same if some finer voxels existed before.
        let mut known = near.clone();
        known.iter_mut().step_by(2).for_each(|voxel| *voxel = Voxel::default());
        propagate_delta_down(&coarse, &coarse, &mut known, 0, 1000, &interpolation);
        assert_eq!(known, near);
    }

    #[test]
    fn a_change_of_the_parent_is_applied_to_the_children_once() {
        let fine = plane(0, [0.0, 0.0, 1.0], 4.0);
        let mut base = vec![Voxel::default(); voxels_at(1)];
        propagate_up(&fine, &mut base, 0);
        let mut now = base.clone();
        for v in &mut now {
            v.distance -= 100; // the surface moved by 100 / 2048 coarse voxels
            v.weight += 5;
        }
        let mut updated = fine.clone();
        updated[0] = Voxel::default();
        propagate_delta_down(&now, &base, &mut updated, 0, 1000, &Interpolation::ALL);
        for (new, old) in updated.iter().zip(&fine).skip(1) {
            assert_eq!((new.distance, new.weight), (old.distance - 200, old.weight + 5));
        }
        assert!(updated[0].is_observed() && (updated[0].distance - (fine[0].distance - 200)).abs() <= 2);
        let mut unchanged = fine.clone();
        propagate_delta_down(&base, &base, &mut unchanged, 0, 1000, &Interpolation::ALL);
        assert_eq!(unchanged, fine);
    }
}
