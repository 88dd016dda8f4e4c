//! How distances pass between the scales of a block (paper Sec. III-A): means go up, differences go down.

use super::voxel::{DISTANCE_STEPS, Voxel, WEIGHT_ONE};
use crate::octree::{edge_at, voxel_coords, voxel_index};

#[inline(always)]
fn clamp_i16(x: i32) -> i16 {
    x.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
}

/// What an interpolated or guessed voxel weighs, at most: little, because a measurement at its own scale must outweigh it at once.
pub(crate) const GUESSED_WEIGHT: u16 = WEIGHT_ONE / 4;

/// Mean up-propagation: each voxel of `coarse` (at `scale + 1`) becomes the mean of its observed children in `fine`.
///
/// Where the band ends, only the children on one side are observed, and their mean is the distance of a place closer to the surface than the
/// parent's centre. So it is continued to the centre along the gradient. Where nothing tells that, the mean is a guess, which weighs little; returns
/// which parents those are, a bit each.
pub fn propagate_up(fine: &[Voxel], coarse: &mut [Voxel], scale: usize) -> u64 {
    let mut guessed = 0;
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
            let (change, is_known) = to_centre(fine, index, scale);
            distance += change;
            if !is_known {
                guessed |= 1 << index;
                weight = weight.min(u32::from(GUESSED_WEIGHT) * count as u32);
            }
        }
        // Half as many parent voxels as child voxels fit in a distance; weights round up so that "observed" survives.
        *parent = match count {
            0 => Voxel::default(),
            _ => Voxel { distance: clamp_i16(distance / (2 * count)), weight: weight.div_ceil(count as u32) as u16 },
        };
    }
    guessed
}

/// By how much the distance changes from the observed children of `parent` to its centre, in sum, in the children's unit, and whether the
/// gradient is known wherever it matters.
fn to_centre(fine: &[Voxel], parent: usize, scale: usize) -> (i32, bool) {
    let (mut gradients, mut known, mut sides) = ([0.0; 3], [0; 3], [0; 3]);
    for child in children(parent, scale).filter(|&c| fine[c].is_observed()) {
        let (c, gradient) = (voxel_coords(child, scale), gradient(fine, child, scale));
        for k in 0..3 {
            sides[k] += if c[k] & 1 == 1 { -1 } else { 1 };
            // No distance changes by more than a voxel in a voxel; what does is noise, or another surface.
            gradients[k] += gradient[k].map_or(0.0, |g| g.clamp(-DISTANCE_STEPS, DISTANCE_STEPS));
            known[k] += i32::from(gradient[k].is_some());
        }
    }
    // Children lie half a voxel from the centre; where as many are on one side as on the other, it is between them.
    let change: f32 = (0..3).map(|k| 0.5 * sides[k] as f32 * gradients[k] / known[k].max(1) as f32).sum();
    (change.round() as i32, (0..3).all(|k| sides[k] == 0 || known[k] > 0))
}

/// Delta down-propagation into voxels that were there before: each observed child moves by what its parent learnt
/// since `past`, up to `max_weight`; unobserved children are guessed from the parent's neighbourhood.
pub fn propagate_delta_down(coarse: &[Voxel], past: &[Voxel], fine: &mut [Voxel], scale: usize, max_weight: u16, guesses: &Guesses) {
    for (index, (&now, &then)) in coarse.iter().zip(past).enumerate() {
        if !now.is_observed() {
            continue;
        }
        let delta = 2 * (i32::from(now.distance) - i32::from(then.distance));
        let learnt = now.weight.saturating_sub(then.weight);
        let gradient = gradient(coarse, index, scale + 1).map(Option::unwrap_or_default);
        for child in children(index, scale) {
            let voxel = &mut fine[child];
            if !voxel.is_observed() {
                *voxel = guesses.guess(now, gradient, child, scale);
            } else if then.is_observed() {
                voxel.distance = clamp_i16(i32::from(voxel.distance) + delta);
                voxel.weight = voxel.weight.saturating_add(learnt).min(max_weight);
            }
        }
    }
}

/// Down-propagation into a new finer array: the children of every observed parent are guessed.
pub fn propagate_down(coarse: &[Voxel], fine: &mut [Voxel], scale: usize, guesses: &Guesses) {
    for (index, &parent) in coarse.iter().enumerate() {
        if parent.is_observed() {
            let gradient = gradient(coarse, index, scale + 1).map(Option::unwrap_or_default);
            for child in children(index, scale) {
                fine[child] = guesses.guess(parent, gradient, child, scale);
            }
        }
    }
}

/// The eight voxels at `scale` below voxel `parent` at `scale + 1`.
#[inline(always)]
pub fn children(parent: usize, scale: usize) -> impl Iterator<Item = usize> {
    let p = voxel_coords(parent, scale + 1);
    (0..8).map(move |d| voxel_index([2 * p[0] + (d & 1), 2 * p[1] + (d >> 1 & 1), 2 * p[2] + (d >> 2)], scale))
}

/// Change of the distance per voxel along each axis, from the observed neighbours within the block, where there are any.
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

/// What finer voxels are given that nobody measured: interpolated values, within the band in which measurements make voxels.
#[derive(Clone, Copy, Debug)]
pub struct Guesses {
    /// Most that one weighs: little, because a measurement at its own scale must outweigh it at once.
    pub weight: u16,
    /// Least and largest distance, steps: what is farther from the surface is of no use to anyone.
    pub band: [i16; 2],
}

impl Guesses {
    #[cfg(test)]
    /// All of them, with the weight of what they are made from.
    const ALL: Self = Self { weight: u16::MAX, band: [i16::MIN, i16::MAX] };
    /// Those that a surface can need, with the weight of what they are made from. No surface passes between two voxels that are both farther away.
    pub const NEAR: Self = Self { weight: u16::MAX, band: [(-1.5 * DISTANCE_STEPS) as i16, (1.5 * DISTANCE_STEPS) as i16] };

    /// The child's value on the plane through the parent's value with the parent's gradient, in the child's unit.
    fn guess(&self, parent: Voxel, gradient: [f32; 3], child: usize, scale: usize) -> Voxel {
        let c = voxel_coords(child, scale);
        // Children's centres lie a quarter of a parent voxel to either side of the parent's.
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
    fn a_plane_survives_going_up_and_down() {
        let (normal, offset) = ([0.6, 0.48, 0.64], 6.1);
        for scale in 0..3 {
            let (fine, coarse) = (plane(scale, normal, offset), plane(scale + 1, normal, offset));
            let mut up = vec![Voxel::default(); voxels_at(scale + 1)];
            propagate_up(&fine, &mut up, scale);
            assert!(up.iter().zip(&coarse).all(|(a, b)| (a.distance - b.distance).abs() <= 2 && a.weight == 10));
            if scale < 2 {
                let mut down = vec![Voxel::default(); voxels_at(scale)];
                propagate_down(&coarse, &mut down, scale, &Guesses::ALL);
                assert!(down.iter().zip(&fine).all(|(a, b)| (a.distance - b.distance).abs() <= 8), "scale {scale}");
            }
        }
    }

    #[test]
    fn a_band_goes_up_as_the_plane_that_it_is_of() {
        let (normal, offset) = ([0.6, 0.48, 0.64], 6.1);
        let (mut fine, coarse) = (plane(0, normal, offset), plane(1, normal, offset));
        fine.iter_mut().filter(|v| f32::from(v.distance).abs() > 1.5 * DISTANCE_STEPS).for_each(|v| *v = Voxel::default());
        let mut up = vec![Voxel::default(); voxels_at(1)];
        let guessed = propagate_up(&fine, &mut up, 0);
        let observed: Vec<usize> = (0..up.len()).filter(|&i| up[i].is_observed()).collect();
        let (guesses, known): (Vec<usize>, Vec<usize>) = observed.iter().partition(|&&i| guessed >> i & 1 == 1);
        assert!(known.len() > 20 && guesses.len() * 4 < known.len() && guessed.count_ones() as usize == guesses.len());
        assert!(known.iter().all(|&i| (up[i].distance - coarse[i].distance).abs() <= 2));
        // Halfway between the children and the centre, at most.
        assert!(guesses.iter().all(|&i| f32::from(up[i].distance - coarse[i].distance).abs() < 0.5 * DISTANCE_STEPS));
    }

    #[test]
    fn guesses_are_made_within_their_band_and_weigh_little() {
        let coarse = plane(1, [0.6, 0.48, 0.64], 6.1);
        let [mut all, mut near] = [vec![Voxel::default(); voxels_at(0)], vec![Voxel::default(); voxels_at(0)]];
        propagate_down(&coarse, &mut all, 0, &Guesses::ALL);
        let guesses = Guesses { weight: 3, band: [-1000, 3000] };
        propagate_down(&coarse, &mut near, 0, &guesses);
        let mut made = 0;
        for (all, near) in all.iter().zip(&near) {
            let is_within = (-1000..=3000).contains(&all.distance);
            made += usize::from(is_within);
            assert_eq!(*near, if is_within { Voxel { weight: 3, ..*all } } else { Voxel::default() });
        }
        assert!(50 < made && made < all.len() / 2);
        // The same where some finer voxels were there before.
        let mut known = near.clone();
        known.iter_mut().step_by(2).for_each(|voxel| *voxel = Voxel::default());
        propagate_delta_down(&coarse, &coarse, &mut known, 0, 1000, &guesses);
        assert_eq!(known, near);
    }

    #[test]
    fn what_the_parent_learnt_reaches_the_children_once() {
        let fine = plane(0, [0.0, 0.0, 1.0], 4.0);
        let mut past = vec![Voxel::default(); voxels_at(1)];
        propagate_up(&fine, &mut past, 0);
        let mut now = past.clone();
        for v in &mut now {
            v.distance -= 100; // the surface came nearer by 100 / 2048 coarse voxels
            v.weight += 5;
        }
        let mut updated = fine.clone();
        updated[0] = Voxel::default();
        propagate_delta_down(&now, &past, &mut updated, 0, 1000, &Guesses::ALL);
        for (new, old) in updated.iter().zip(&fine).skip(1) {
            assert_eq!((new.distance, new.weight), (old.distance - 200, old.weight + 5));
        }
        assert!(updated[0].is_observed() && (updated[0].distance - (fine[0].distance - 200)).abs() <= 2);
        let mut unchanged = fine.clone();
        propagate_delta_down(&past, &past, &mut unchanged, 0, 1000, &Guesses::ALL);
        assert_eq!(unchanged, fine);
    }
}
