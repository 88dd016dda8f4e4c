//! Beams in the frame and unit in which they are walked: submap frame, voxels.

use crate::geometry::Rigid;
use rayon::prelude::*;

/// The returns of one scan, as the integrators take them. All slices are equally long, or empty where that is said.
#[derive(Clone, Copy, Debug)]
pub struct Returns<'a> {
    /// Points in the lidar frame, metres.
    pub points: &'a [[f32; 3]],
    /// Unit normals of the local surface, facing the sensor, in the lidar frame; zero where no plane is known. Occupancy does without, then
    /// they may be empty.
    pub normals: &'a [[f32; 3]],
    /// Strength of each return, 0 to 255; empty when the scan has none.
    pub shades: &'a [u8],
    /// Where the lidar was when it measured each return, lidar frame, metres; empty when it stood still.
    pub origins: &'a [[f32; 3]],
    /// Smallest angle between adjacent rays, radians.
    pub smallest_angle: f32,
}

/// One beam, ready to be walked. Lengths count finest voxels; the frame is the submap's.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(crate) struct Beam {
    /// The measured point.
    pub point: [f32; 3],
    /// Scale that the beam's cone fits at its range.
    pub scale: u32,
    /// Unit vector along which it is walked: from the sensor to the point, but see [`steepened`].
    pub direction: [f32; 3],
    /// Strength of the return.
    pub shade: u8,
    /// Normal of the local plane, facing the sensor; against the beam where no plane is known.
    pub normal: [f32; 3],
    /// Distance from the sensor to the point.
    pub range: f32,
}

/// How returns become beams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToSubmap {
    /// From the lidar frame to the submap's.
    pub t_submap_lidar: Rigid,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Least sine of the angle between a beam's walk and its plane, 0 to leave it as it was measured.
    pub least_slope: f32,
}

/// Moves `returns` into the submap frame and counts in voxels; `scale_of` maps metres to a scale.
pub(crate) fn to_submap(returns: &Returns<'_>, how: &ToSubmap, scale_of: impl Fn(f32) -> usize + Sync, beams: &mut Vec<Beam>) {
    const CHUNK: usize = 4096;
    beams.resize(returns.points.len(), Beam::default());
    let ToSubmap { t_submap_lidar, voxel, least_slope } = how;
    let per_metre = 1.0 / voxel;
    beams.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, beams)| {
        let first = chunk * CHUNK;
        for (i, beam) in beams.iter_mut().enumerate() {
            let p = returns.points[first + i];
            let n = returns.normals.get(first + i).copied().unwrap_or([0.0; 3]);
            let origin = returns.origins.get(first + i).copied().unwrap_or([0.0; 3]);
            let way: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
            let range = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            let ray = t_submap_lidar.rotate(way);
            let place = t_submap_lidar.apply(p);
            let per_range = 1.0 / range;
            let direction = ray.map(|c| c * per_range);
            let has_plane = n != [0.0; 3];
            let normal = if has_plane { t_submap_lidar.rotate(n) } else { direction.map(|c| -c) };
            *beam = Beam {
                point: place.map(|c| c * per_metre),
                scale: scale_of(range) as u32,
                direction: steepened(direction, normal, *least_slope),
                shade: returns.shades.get(first + i).copied().unwrap_or(0),
                normal,
                range: range * per_metre,
            };
        }
    });
}

/// `direction`, turned towards the plane with `normal` until the sine of the angle between them is `least`.
///
/// A beam that grazes the floor passes through one layer of voxels only, and shows no zero crossing across it; what is known
/// at its point is the plane, so it may as well be left at a steeper angle.
#[inline(always)]
fn steepened(direction: [f32; 3], normal: [f32; 3], least: f32) -> [f32; 3] {
    let slope = -(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2]);
    if slope >= least {
        return direction;
    }
    let along = ((1.0 - least * least) / (1.0 - slope * slope).max(1e-6)).sqrt();
    std::array::from_fn(|k| along * (direction[k] + slope * normal[k]) - least * normal[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| a[k] * b[k]).sum()
    }

    proptest! {
        #[test]
        fn steepened_walks_keep_to_the_plane_of_beam_and_normal(
            [a, b] in prop::array::uniform2(prop::array::uniform3(-1f32..1.0).prop_filter("a direction", |v| dot(*v, *v) > 0.1)),
            least in 0f32..0.9,
        ) {
            let [direction, mut normal] = [a, b].map(|v| v.map(|c| c / dot(v, v).sqrt()));
            if dot(direction, normal) > 0.0 {
                normal = normal.map(|c| -c);
            }
            let slope = -dot(direction, normal);
            prop_assume!(slope < 0.999);
            let steep = steepened(direction, normal, least);
            prop_assert!((dot(steep, steep) - 1.0).abs() < 1e-4);
            prop_assert!((-dot(steep, normal) - slope.max(least)).abs() < 1e-4);
            let across = [0, 1, 2].map(|k| direction[(k + 1) % 3] * normal[(k + 2) % 3] - direction[(k + 2) % 3] * normal[(k + 1) % 3]);
            prop_assert!(dot(steep, across).abs() < 1e-4 && dot(steep, direction) > 0.0);
        }
    }
}
