//! How distances pass between the scales of a block (paper Sec. III-A): means go up, differences go down.

use super::voxel::Voxel;
use crate::octree::{edge_at, voxel_coords, voxel_index};

#[inline(always)]
fn clamp_i16(x: i32) -> i16 {
    x.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16
}

/// Mean up-propagation: each voxel of `coarse` (at `scale + 1`) becomes the mean of its observed children in `fine`.
pub fn propagate_up(fine: &[Voxel], coarse: &mut [Voxel], scale: usize) {
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
        // Half as many parent voxels as child voxels fit in a distance; weights round up so that "observed" survives.
        *parent = match count {
            0 => Voxel::default(),
            _ => Voxel { distance: (distance / (2 * count)) as i16, weight: weight.div_ceil(count as u32) as u16 },
        };
    }
}

/// Delta down-propagation into voxels that were there before: each observed child moves by what its parent learnt
/// since `past`, up to `max_weight`; unobserved children are interpolated from the parent's neighbourhood and weigh at most
/// `interpolated`.
pub fn propagate_delta_down(coarse: &[Voxel], past: &[Voxel], fine: &mut [Voxel], scale: usize, [max_weight, interpolated]: [u16; 2]) {
    for (index, (&now, &then)) in coarse.iter().zip(past).enumerate() {
        if !now.is_observed() {
            continue;
        }
        let delta = 2 * (i32::from(now.distance) - i32::from(then.distance));
        let learnt = now.weight.saturating_sub(then.weight);
        let gradient = gradient(coarse, index, scale + 1);
        for child in children(index, scale) {
            let voxel = &mut fine[child];
            if !voxel.is_observed() {
                *voxel = interpolate(Voxel { weight: now.weight.min(interpolated), ..now }, gradient, child, scale);
            } else if then.is_observed() {
                voxel.distance = clamp_i16(i32::from(voxel.distance) + delta);
                voxel.weight = voxel.weight.saturating_add(learnt).min(max_weight);
            }
        }
    }
}

/// Down-propagation into a new finer array: every child of an observed parent is interpolated. The children start with
/// at most `max_weight`, so that real fine measurements soon outweigh the interpolation.
pub fn propagate_down(coarse: &[Voxel], fine: &mut [Voxel], scale: usize, max_weight: u16) {
    for (index, &parent) in coarse.iter().enumerate() {
        if parent.is_observed() {
            let parent = Voxel { weight: parent.weight.min(max_weight), ..parent };
            let gradient = gradient(coarse, index, scale + 1);
            for child in children(index, scale) {
                fine[child] = interpolate(parent, gradient, child, scale);
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

/// Change of the distance per voxel along each axis, from the observed neighbours within the block.
fn gradient(voxels: &[Voxel], index: usize, scale: usize) -> [f32; 3] {
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
            (Some(below), Some(above)) => 0.5 * (above - below),
            (Some(below), None) => here - below,
            (None, Some(above)) => above - here,
            (None, None) => 0.0,
        }
    })
}

/// The child's value on the plane through the parent's value with the parent's gradient, in the child's unit.
fn interpolate(parent: Voxel, gradient: [f32; 3], child: usize, scale: usize) -> Voxel {
    let c = voxel_coords(child, scale);
    // Children's centres lie a quarter of a parent voxel to either side of the parent's.
    let offset: f32 = (0..3).map(|i| if c[i] & 1 == 1 { 0.25 * gradient[i] } else { -0.25 * gradient[i] }).sum();
    Voxel { distance: clamp_i16((2.0 * (f32::from(parent.distance) + offset)).round() as i32), weight: parent.weight }
}

#[cfg(test)]
mod tests {
    use super::super::voxel::DISTANCE_STEPS;
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
                propagate_down(&coarse, &mut down, scale, 100);
                assert!(down.iter().zip(&fine).all(|(a, b)| (a.distance - b.distance).abs() <= 8), "scale {scale}");
            }
        }
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
        propagate_delta_down(&now, &past, &mut updated, 0, [1000; 2]);
        for (new, old) in updated.iter().zip(&fine).skip(1) {
            assert_eq!((new.distance, new.weight), (old.distance - 200, old.weight + 5));
        }
        assert!(updated[0].is_observed() && (updated[0].distance - (fine[0].distance - 200)).abs() <= 2);
        let mut unchanged = fine.clone();
        propagate_delta_down(&past, &past, &mut unchanged, 0, [1000; 2]);
        assert_eq!(unchanged, fine);
    }
}
