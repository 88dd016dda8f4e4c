//! Beams in the frame and unit in which they are walked: submap frame, voxels.

use super::bundle::bundle;
use super::scale::ScaleRule;
use super::walk::LANES;
use crate::dispatch::{Kernel, dispatch};
use crate::geometry::Rigid;
use crate::octree::BLOCK_EDGE;
use crate::sensor::{larger, smaller};
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
#[derive(Clone, Copy, Debug, Default, PartialEq)]
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
    /// Returns that the beam stands for, see [`super::bundle`].
    pub count: u8,
    /// Whether the local plane is known.
    pub has_plane: bool,
    /// Normal of the local plane, facing the sensor; against the beam where no plane is known.
    pub normal: [f32; 3],
    /// Distance from the sensor to the point.
    pub range: f32,
    /// How far the beam is walked in front of its point and behind it, voxels of the walk's scale.
    pub reach: [f32; 2],
}

impl Beam {
    /// Whether its walk may come to a voxel less than `new` voxels in front of its plane, in the block with smallest corner `corner` and voxels of
    /// 2^`scale` finest ones.
    pub fn makes(&self, corner: [f32; 3], scale: u8, new: f32) -> bool {
        /// How much farther from the plane than its centre a voxel can be met, its edges.
        const CORNER: f32 = 0.87;
        let voxel = f32::from(1u8 << scale);
        let slope = -(0..3).map(|k| self.direction[k] * self.normal[k]).sum::<f32>();
        let (mut enter, mut leave) = (-self.reach[0].min((new + CORNER) / slope.max(1e-3)) * voxel, self.reach[1] * voxel);
        for (k, low) in corner.into_iter().enumerate() {
            let inverse = 1.0 / self.direction[k];
            let [a, b] = [low, low + BLOCK_EDGE as f32].map(|face| (face - self.point[k]) * inverse);
            // Not a number where the beam runs in a face: then neither is taken.
            (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
        }
        enter <= leave + 1e-3
    }
}

/// How returns become beams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToSubmap {
    /// From the lidar frame to the submap's.
    pub t_submap_lidar: Rigid,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Largest range that is kept, metres.
    pub max_range: f32,
    /// Which scale fits.
    pub rule: ScaleRule,
    /// Least sine of the angle between a beam's walk and its plane, 0 to leave it as it was measured.
    pub least_slope: f32,
    /// How far beams are walked in front of their planes and behind them, voxels of the walk's scale.
    pub band: [f32; 2],
    /// How far that may be along a beam, before its point and beyond, in the same voxels.
    pub along: f32,
    /// How wide a bundle of beams may be, voxels of their scale; 0 to leave them single.
    pub bundle_width: f32,
}

/// Moves `returns` into the submap frame and counts in voxels. Those beyond the largest range are left out.
pub(crate) fn to_submap(returns: &Returns<'_>, how: &ToSubmap, beams: &mut Vec<Beam>) {
    const CHUNK: usize = 4096;
    beams.resize(returns.points.len(), Beam::default());
    let limit = how.max_range / how.voxel;
    let kept = beams.par_chunks_mut(CHUNK).enumerate().map(|(chunk, beams)| {
        let part = chunk * CHUNK..chunk * CHUNK + beams.len();
        dispatch(Transform {
            points: &returns.points[part.clone()],
            normals: returns.normals.get(part.clone()).unwrap_or(&[]),
            origins: returns.origins.get(part.clone()).unwrap_or(&[]),
            shades: returns.shades.get(part).unwrap_or(&[]),
            how,
            beams,
        });
        bundle(beams, limit, how.bundle_width)
    });
    let kept: Vec<usize> = kept.collect();
    let mut end = 0;
    for (chunk, kept) in kept.into_iter().enumerate() {
        beams.copy_within(chunk * CHUNK..chunk * CHUNK + kept, end);
        end += kept;
    }
    beams.truncate(end);
}

/// A part of the returns, and the beams that they become. All but the points may be empty.
struct Transform<'a> {
    points: &'a [[f32; 3]],
    normals: &'a [[f32; 3]],
    origins: &'a [[f32; 3]],
    shades: &'a [u8],
    how: &'a ToSubmap,
    beams: &'a mut [Beam],
}

type Lanes = [f32; LANES];

impl Kernel for Transform<'_> {
    #[inline(always)]
    fn run(self) {
        let how = *self.how;
        let per_metre = 1.0 / how.voxel;
        for (step, beams) in self.beams.chunks_mut(LANES).enumerate() {
            let first = step * LANES;
            let (mut p, mut n, mut way) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [[1.0; LANES]; 3]);
            lanes_of(self.points, first, &mut p);
            lanes_of(self.normals, first, &mut n);
            if self.origins.is_empty() {
                way = p;
            } else {
                lanes_of(self.origins, first, &mut way);
                (0..3).for_each(|k| (0..LANES).for_each(|l| way[k][l] = p[k][l] - way[k][l]));
            }
            let walk = Walks::new(&p, &n, &way, &how);
            for (l, beam) in beams.iter_mut().enumerate() {
                let at = |v: &[Lanes; 3]| [v[0][l], v[1][l], v[2][l]];
                *beam = Beam {
                    point: at(&walk.place).map(|c| c * per_metre),
                    scale: walk.scale[l],
                    direction: at(&walk.direction),
                    shade: self.shades.get(first + l).copied().unwrap_or(0),
                    count: 1,
                    has_plane: walk.has_plane[l],
                    normal: at(&walk.normal),
                    range: walk.range[l] * per_metre,
                    reach: [walk.reach[0][l], walk.reach[1][l]],
                };
            }
        }
    }
}

/// Up to sixteen vectors from `first` on, one array an axis; lanes for which there is none are left alone.
#[inline(always)]
fn lanes_of(vectors: &[[f32; 3]], first: usize, lanes: &mut [Lanes; 3]) {
    let rest = vectors.get(first..).unwrap_or(&[]);
    // In most cases sixteen, which are loaded as vectors.
    if let Some(all) = rest.first_chunk::<LANES>() {
        for l in 0..LANES {
            for k in 0..3 {
                lanes[k][l] = all[l][k];
            }
        }
        return;
    }
    for (l, v) in rest.iter().enumerate() {
        (0..3).for_each(|k| lanes[k][l] = v[k]);
    }
}

/// Sixteen beams on their way from metres in the lidar frame; all but `range`, metres, are in the submap frame.
struct Walks {
    place: [Lanes; 3],
    direction: [Lanes; 3],
    normal: [Lanes; 3],
    range: Lanes,
    /// How far they reach before their points and beyond, voxels.
    reach: [Lanes; 2],
    scale: [u32; LANES],
    has_plane: [bool; LANES],
}

impl Walks {
    /// From points, normals and the ways from the sensor to the points.
    #[inline(always)]
    fn new(p: &[Lanes; 3], n: &[Lanes; 3], way: &[Lanes; 3], how: &ToSubmap) -> Self {
        let none = [[0.0; LANES]; 3];
        let lanes = [0.0; LANES];
        let mut walks =
            Self { place: none, direction: none, normal: none, range: lanes, reach: [lanes; 2], scale: [0; LANES], has_plane: [false; LANES] };
        let pose = how.t_submap_lidar;
        for l in 0..LANES {
            let at = |v: &[Lanes; 3]| [v[0][l], v[1][l], v[2][l]];
            let (p, n, way) = (at(p), at(n), at(way));
            let range = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            let per_range = 1.0 / range;
            let direction = pose.rotate(way).map(|c| c * per_range);
            let has_plane = (n[0] != 0.0) | (n[1] != 0.0) | (n[2] != 0.0);
            let rotated = pose.rotate(n);
            let normal = [0, 1, 2].map(|k| if has_plane { rotated[k] } else { -direction[k] });
            let slope = -(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2]);
            let walked = steepened(direction, normal, slope, how.least_slope);
            let per_off = 1.0 / larger(slope, how.least_slope);
            (0..2).for_each(|end| walks.reach[end][l] = smaller(how.band[end] * per_off, how.along));
            let place = pose.apply(p);
            for k in 0..3 {
                (walks.place[k][l], walks.direction[k][l], walks.normal[k][l]) = (place[k], walked[k], normal[k]);
            }
            (walks.range[l], walks.scale[l], walks.has_plane[l]) = (range, how.rule.fitting(range) as u32, has_plane);
        }
        walks
    }
}

/// `direction`, turned towards the plane with `normal` until the sine of the angle between them, which is `slope`, is `least`.
///
/// A beam that grazes the floor passes through one layer of voxels only, and shows no zero crossing across it; what is known
/// at its point is the plane, so it may as well be left at a steeper angle.
#[inline(always)]
fn steepened(direction: [f32; 3], normal: [f32; 3], slope: f32, least: f32) -> [f32; 3] {
    let along = ((1.0 - least * least) / larger(1.0 - slope * slope, 1e-6)).sqrt();
    [0, 1, 2].map(|k| {
        let steep = along * (direction[k] + slope * normal[k]) - least * normal[k];
        if slope >= least { direction[k] } else { steep }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| a[k] * b[k]).sum()
    }

    /// Returns one by one, as plainly as can be said.
    fn one_by_one(returns: &Returns<'_>, how: &ToSubmap) -> Vec<Beam> {
        let of = |i: usize| {
            let (p, n) = (returns.points[i], returns.normals.get(i).copied().unwrap_or_default());
            let origin = returns.origins.get(i).copied().unwrap_or_default();
            let way: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
            let range = dot(way, way).sqrt();
            let ray = how.t_submap_lidar.rotate(way).map(|c| c * (1.0 / range));
            let has_plane = n != [0.0; 3];
            let normal = if has_plane { how.t_submap_lidar.rotate(n) } else { ray.map(|c| -c) };
            let slope = -dot(ray, normal);
            Beam {
                point: how.t_submap_lidar.apply(p).map(|c| c * (1.0 / how.voxel)),
                scale: how.rule.fitting(range) as u32,
                direction: steepened(ray, normal, slope, how.least_slope),
                shade: returns.shades.get(i).copied().unwrap_or(0),
                count: 1,
                has_plane,
                normal,
                range: range * (1.0 / how.voxel),
                reach: how.band.map(|off| (off * (1.0 / slope.max(how.least_slope))).min(how.along)),
            }
        };
        (0..returns.points.len()).map(of).filter(|beam| beam.range <= how.max_range / how.voxel).collect()
    }

    proptest! {
        #[test]
        fn sixteen_at_a_time_are_as_one_by_one(
            returns in prop::collection::vec((prop::array::uniform3(-40f32..40.0), prop::array::uniform3(-1f32..1.0), any::<u8>(), any::<bool>()), 0..100),
            [has_normals, has_shades, has_origins] in any::<[bool; 3]>(),
            translation in prop::array::uniform3(-5f32..5.0),
        ) {
            let points: Vec<[f32; 3]> = returns.iter().map(|r| r.0).collect();
            let normals: Vec<[f32; 3]> = returns.iter().map(|r| if r.3 { r.1.map(|c| c / dot(r.1, r.1).sqrt()) } else { [0.0; 3] }).collect();
            let shades: Vec<u8> = returns.iter().map(|r| r.2).collect();
            let (rotation, smallest_angle) = ([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]], 0.006);
            let returns = Returns {
                points: &points,
                normals: if has_normals { &normals } else { &[] },
                shades: if has_shades { &shades } else { &[] },
                origins: if has_origins { &normals } else { &[] },
                smallest_angle,
            };
            let how = ToSubmap {
                t_submap_lidar: Rigid { rotation, translation },
                voxel: 0.1,
                max_range: 50.0,
                rule: ScaleRule::new(smallest_angle, 0.1, 3, 1.5),
                least_slope: 0.4,
                band: [2.0, 1.5],
                along: 3.0,
                bundle_width: 0.0,
            };
            let mut beams = Vec::new();
            to_submap(&returns, &how, &mut beams);
            prop_assert_eq!(beams, one_by_one(&returns, &how));
        }

        #[test]
        fn blocks_in_which_samples_along_the_walk_make_voxels_are_known(
            [ray, plane] in prop::array::uniform2(prop::array::uniform3(-1f32..1.0).prop_filter("a direction", |v| dot(*v, *v) > 0.1)),
            point in prop::array::uniform3(-20f32..20.0),
            scale in 0u8..4,
        ) {
            let [ray, mut normal] = [ray, plane].map(|v| v.map(|c| c / dot(v, v).sqrt()));
            if dot(ray, normal) > 0.0 {
                normal = normal.map(|c| -c);
            }
            let direction = steepened(ray, normal, -dot(ray, normal), 0.4);
            let beam = Beam { point, direction, normal, reach: [3.0, 2.0], ..Beam::default() };
            let voxel = f32::from(1u8 << scale);
            let mut near = 0;
            for step in 0..=500 {
                let at: [f32; 3] = std::array::from_fn(|k| point[k] + direction[k] * voxel * (-3.0 + 0.01 * step as f32));
                let centre = at.map(|c| ((c / voxel).floor() + 0.5) * voxel);
                let distance = (0..3).map(|k| (centre[k] - point[k]) * normal[k]).sum::<f32>() / voxel;
                let corner = at.map(|c| (c / BLOCK_EDGE as f32).floor() * BLOCK_EDGE as f32);
                if distance < 1.5 {
                    near += 1;
                    prop_assert!(beam.makes(corner, scale, 1.5), "{distance} at {at:?}");
                }
            }
            prop_assert!(near > 0 && !beam.makes(point.map(|c| c + 100.0), scale, 1.5));
        }

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
            let steep = steepened(direction, normal, slope, least);
            prop_assert!((dot(steep, steep) - 1.0).abs() < 1e-4);
            prop_assert!((-dot(steep, normal) - slope.max(least)).abs() < 1e-4);
            let across = [0, 1, 2].map(|k| direction[(k + 1) % 3] * normal[(k + 2) % 3] - direction[(k + 2) % 3] * normal[(k + 1) % 3]);
            prop_assert!(dot(steep, across).abs() < 1e-4 && dot(steep, direction) > 0.0);
        }
    }
}
