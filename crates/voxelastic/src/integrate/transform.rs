//! Beams in the frame and unit in which they are walked: submap frame, voxels.

use crate::geometry::Rigid;
use rayon::prelude::*;

/// The returns of one scan, as the integrators take them. All slices are equally long.
#[derive(Clone, Copy, Debug)]
pub struct Returns<'a> {
    /// Points in the lidar frame, metres.
    pub points: &'a [[f32; 3]],
    /// Unit normals of the local surface, facing the sensor, in the lidar frame; zero where no plane is known.
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
    /// Unit vector from the sensor to the point.
    pub direction: [f32; 3],
    /// Strength of the return.
    pub shade: f32,
    /// Normal of the local plane, facing the sensor; against the beam where no plane is known.
    pub normal: [f32; 3],
    /// Distance from the sensor to the point.
    pub range: f32,
}

/// Moves `returns` into the submap frame and counts in voxels of `voxel` metres; `scale_of` maps metres to a scale.
pub(crate) fn to_submap(returns: &Returns<'_>, t_submap_lidar: &Rigid, voxel: f32, scale_of: impl Fn(f32) -> usize + Sync, beams: &mut Vec<Beam>) {
    const CHUNK: usize = 4096;
    beams.resize(returns.points.len(), Beam::default());
    let per_metre = 1.0 / voxel;
    beams.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, beams)| {
        let first = chunk * CHUNK;
        for (i, beam) in beams.iter_mut().enumerate() {
            let p = returns.points[first + i];
            let n = returns.normals[first + i];
            let origin = returns.origins.get(first + i).copied().unwrap_or([0.0; 3]);
            let way: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
            let range = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            let ray = t_submap_lidar.rotate(way);
            let place = t_submap_lidar.apply(p);
            let direction = ray.map(|c| c / range);
            let has_plane = n != [0.0; 3];
            let plane = t_submap_lidar.rotate(n);
            *beam = Beam {
                point: place.map(|c| c * per_metre),
                scale: scale_of(range) as u32,
                direction,
                shade: returns.shades.get(first + i).map_or(0.0, |&s| f32::from(s)),
                normal: if has_plane { plane } else { direction.map(|c| -c) },
                range: range * per_metre,
            };
        }
    });
}
