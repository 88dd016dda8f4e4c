//! Ray bundling: rays that are closer together than voxels are walked as one.
//!
//! A wall two metres away is hit by about four beams a voxel, which update the same voxels with the same distances. They are replaced by one ray through the
//! mean of their points, weighted by their number, if they share a plane: a point that is off the plane by more than noise is walked alone. The bundle is
//! walked as far as its first ray would have been.

use super::ray::Ray;

/// Most rays in a bundle.
const MAX_COUNT: u8 = 16;
/// Least cosine of the angle between the planes of rays in a bundle: on surfaces that bend more, rays are walked one by one.
const LEAST_COSINE: f32 = 0.966;
/// Largest distance of a point in a bundle from the plane of its first ray, voxels of their scale.
const OFF_PLANE: f32 = 0.125;

/// Drops rays longer than `limit`, bundles neighbours that are within `width` voxels of their scale, and moves the result to the front of `rays`; returns
/// how many there are.
pub(crate) fn bundle(rays: &mut [Ray], limit: f32, width: f32) -> usize {
    let mut kept = 0;
    let mut from = 0;
    while from < rays.len() {
        let first = rays[from];
        from += 1;
        if first.range > limit {
            continue;
        }
        let (mut bundle, mut members) = (first, 1u8);
        let mut intensities = u32::from(first.intensity);
        let criterion = BundleCriterion::new(&first, width);
        while let Some(next) = rays.get(from).filter(|next| members < MAX_COUNT && next.range <= limit && criterion.accepts(next)) {
            for k in 0..3 {
                bundle.point[k] += next.point[k];
                bundle.direction[k] += next.direction[k];
                bundle.normal[k] += next.normal[k];
            }
            bundle.range += next.range;
            intensities += u32::from(next.intensity);
            members += 1;
            from += 1;
        }
        if members > 1 {
            let share = 1.0 / f32::from(members);
            bundle.point = bundle.point.map(|c| c * share);
            bundle.range *= share;
            bundle.intensity = (intensities / u32::from(members)) as u8;
            bundle.count = members;
            (bundle.direction, bundle.normal) = (unit(bundle.direction), unit(bundle.normal));
        }
        rays[kept] = bundle;
        kept += 1;
    }
    kept
}

/// Which rays belong to the bundle that begins with `first`.
struct BundleCriterion<'a> {
    first: &'a Ray,
    /// Largest distance from the point of `first`, squared, finest voxels.
    max_distance_squared: f32,
    /// Largest distance from the plane of `first`, squared, finest voxels.
    max_offset_squared: f32,
}

impl<'a> BundleCriterion<'a> {
    #[inline(always)]
    fn new(first: &'a Ray, width: f32) -> Self {
        let voxel = (1 << first.scale) as f32;
        let max_distance_squared = if first.has_plane { width * voxel } else { 0.0 };
        Self { first, max_distance_squared: max_distance_squared.powi(2), max_offset_squared: (OFF_PLANE * voxel).powi(2) }
    }

    #[inline(always)]
    fn accepts(&self, next: &Ray) -> bool {
        let Self { first, max_distance_squared, max_offset_squared } = *self;
        let offset = [0, 1, 2].map(|k| next.point[k] - first.point[k]);
        let is_near = (dot(offset, offset) < max_distance_squared) & (dot(offset, first.normal).powi(2) < max_offset_squared);
        next.has_plane & (next.scale == first.scale) & is_near & (dot(next.normal, first.normal) >= LEAST_COSINE)
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(v: [f32; 3]) -> [f32; 3] {
    let per_length = 1.0 / v.iter().map(|c| c * c).sum::<f32>().sqrt().max(1e-9);
    v.map(|c| c * per_length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Rays from far above to points along a row of pixels, on a plane that is tilted here and there.
    fn row() -> impl Strategy<Value = Vec<Ray>> {
        let one = (0f32..0.6, prop_oneof![Just(0f32), Just(0f32), Just(0.3f32)], 0u32..2, any::<bool>(), any::<u8>());
        prop::collection::vec(one, 0..60).prop_map(|steps| {
            let mut x = 0.0;
            let ray = |(step, tilt, scale, has_plane, intensity): (f32, f32, u32, bool, u8)| {
                x += step;
                let normal = [tilt.sin(), 0.0, tilt.cos()];
                Ray {
                    point: [x, 0.0, 3.0 - x * tilt.tan()],
                    direction: [0.0, 0.0, -1.0],
                    normal,
                    range: 40.0 + x,
                    scale,
                    has_plane,
                    intensity,
                    count: 1,
                    ..Ray::default()
                }
            };
            steps.into_iter().map(ray).collect()
        })
    }

    proptest! {
        #[test]
        fn bundles_are_narrow_and_flat_and_contain_every_ray_once(rays in row(), width in 0f32..1.5, limit in 40f32..60.0) {
            let mut bundled = rays.clone();
            let kept = bundle(&mut bundled, limit, width);
            let near: Vec<&Ray> = rays.iter().filter(|ray| ray.range <= limit).collect();
            let mut remaining = &near[..];
            for bundle in &bundled[..kept] {
                let (members, after) = remaining.split_at(bundle.count.into());
                remaining = after;
                let first = members[0];
                if members.len() == 1 {
                    prop_assert_eq!(bundle, first);
                    continue;
                }
                let mean = |of: &dyn Fn(&Ray) -> f32| members.iter().map(|&ray| of(ray)).sum::<f32>() / members.len() as f32;
                for k in 0..3 {
                    prop_assert!((bundle.point[k] - mean(&|ray| ray.point[k])).abs() < 1e-3);
                }
                prop_assert!((bundle.range - mean(&|ray| ray.range)).abs() < 1e-3);
                prop_assert_eq!(bundle.intensity, mean(&|ray| ray.intensity.into()) as u8);
                for ray in members {
                    let apart = (0..3).map(|k| (ray.point[k] - first.point[k]).powi(2)).sum::<f32>().sqrt();
                    let off = (0..3).map(|k| (ray.point[k] - first.point[k]) * first.normal[k]).sum::<f32>().abs();
                    prop_assert!(off <= OFF_PLANE * (1 << first.scale) as f32 + 1e-4, "{off} off the plane");
                    prop_assert!(ray.has_plane && ray.scale == first.scale && apart <= width * (1 << first.scale) as f32 + 1e-4);
                    let bend = (0..3).map(|k| ray.normal[k] * first.normal[k]).sum::<f32>();
                    prop_assert!(bend >= LEAST_COSINE - 1e-4, "planes that differ by {} degrees", bend.acos().to_degrees());
                }
                let length = bundle.normal.iter().map(|c| c * c).sum::<f32>();
                prop_assert!((length - 1.0).abs() < 1e-4);
            }
            prop_assert!(remaining.is_empty(), "{} rays are lost", remaining.len());
            if width == 0.0 {
                prop_assert_eq!(kept, near.len());
            }
        }
    }

    #[test]
    fn a_dense_row_is_bundled_to_the_allowed_width() {
        let ray = |i: usize| Ray {
            point: [i as f32 * 0.125, 0.0, 0.0],
            normal: [0.0, 0.0, 1.0],
            direction: [0.0, 0.0, -1.0],
            has_plane: true,
            count: 1,
            ..Ray::default()
        };
        let mut rays: Vec<Ray> = (0..20).map(ray).collect();
        let kept = bundle(&mut rays, 1.0, 0.5);
        assert_eq!(rays[..kept].iter().map(|ray| ray.count).collect::<Vec<u8>>(), [4, 4, 4, 4, 4]);
        assert_eq!(rays[1].point, [0.6875, 0.0, 0.0]);
    }
}
