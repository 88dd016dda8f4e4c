//! Transforms the returns of a scan into rays of the submap frame, once for both fields.
//!
//! The TSDF takes *surface rays*: they carry the local plane, are turned towards it where they graze it, and neighbours are bundled. Occupancy takes
//! *measured rays*, exactly as the sensor measured them.

use super::dda::LANES;
use super::ray::Ray;
use super::ray_bundling::bundle;
use super::returns::ReturnsView;
use super::scale::ScaleRule;
use crate::geometry::Rigid;
use crate::simd::{Kernel, dispatch};
use crate::simd::{larger, smaller};
use rayon::prelude::*;

/// The frame and unit of the rays, common to both fields.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayFrame {
    /// From the lidar frame to the submap's.
    pub t_submap_lidar: Rigid,
    /// Edge of the finest voxel, metres.
    pub voxel: f32,
    /// Returns farther than this are dropped, metres.
    pub max_range: f32,
}

/// How returns become surface rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfaceRayParams {
    /// Integration scale by range.
    pub rule: ScaleRule,
    /// Least sine of the angle between a ray and its plane, 0 to leave directions as measured.
    pub least_slope: f32,
    /// How far rays are walked in front of their planes and behind them, perpendicular to the plane, voxels of the integration scale.
    pub band: [f32; 2],
    /// The most of that along a ray, before its point and beyond, in the same voxels.
    pub max_reach: f32,
    /// Largest width of a bundle of rays, voxels of their scale; 0 to bundle none.
    pub bundle_width: f32,
}

/// Surface rays to be made.
pub(crate) struct SurfaceRays<'a> {
    pub params: SurfaceRayParams,
    pub rays: &'a mut Vec<Ray>,
}

/// Measured rays to be made. Their reach is left at zero.
pub(crate) struct MeasuredRays<'a> {
    /// Integration scale by range.
    pub rule: ScaleRule,
    pub rays: &'a mut Vec<Ray>,
}

/// Returns that one task transforms.
const CHUNK: usize = 4096;

/// Transforms `returns` into rays of the submap frame, in the order of the returns; those beyond the largest range are dropped. What each field needs is
/// made in the same pass.
pub(crate) fn build_rays(returns: &ReturnsView<'_>, frame: &RayFrame, surface: Option<SurfaceRays<'_>>, measured: Option<MeasuredRays<'_>>) {
    let count = returns.points.len();
    let limit = frame.max_range / frame.voxel;
    let (surface_params, surface) = surface.map(|SurfaceRays { params, rays }| (params, rays)).unzip();
    let (measured_rule, measured) = measured.map(|MeasuredRays { rule, rays }| (rule, rays)).unzip();
    let (mut surface, mut measured) = (surface, measured);
    let chunks = chunks_of(surface.as_deref_mut(), count).into_par_iter().zip(chunks_of(measured.as_deref_mut(), count));
    let kept = chunks.enumerate().map(|(chunk, (mut surface, mut measured))| {
        let part = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
        dispatch(Transform {
            points: &returns.points[part.clone()],
            normals: returns.normals.get(part.clone()).unwrap_or(&[]),
            origins: returns.origins.get(part.clone()).unwrap_or(&[]),
            intensities: returns.intensities.get(part.clone()).unwrap_or(&[]),
            spacing: returns.spacing.get(part.clone()).unwrap_or(&[]),
            frame,
            surface: surface_params.zip(surface.as_deref_mut()),
            measured: measured_rule.zip(measured.as_deref_mut()),
        });
        let width = surface_params.map_or(0.0, |params| params.bundle_width);
        [surface.map_or(0, |rays| bundle(rays, limit, width)), measured.map_or(0, |rays| keep_within(rays, limit))]
    });
    let kept: Vec<[usize; 2]> = kept.collect();
    for (field, rays) in [surface, measured].into_iter().enumerate() {
        if let Some(rays) = rays {
            join_chunks(rays, kept.iter().map(|kept| kept[field]));
        }
    }
}

/// Room for `count` rays, cut into chunks; as many times nothing where no rays are wanted.
fn chunks_of(rays: Option<&mut Vec<Ray>>, count: usize) -> Vec<Option<&mut [Ray]>> {
    let Some(rays) = rays else { return (0..count.div_ceil(CHUNK)).map(|_| None).collect() };
    rays.resize(count, Ray::default());
    rays.chunks_mut(CHUNK).map(Some).collect()
}

/// Moves the rays that are no longer than `limit` to the front, in order; returns how many there are.
fn keep_within(rays: &mut [Ray], limit: f32) -> usize {
    let mut kept = 0;
    for i in 0..rays.len() {
        if rays[i].range > limit {
            continue;
        }
        rays[kept] = rays[i];
        kept += 1;
    }
    kept
}

/// Moves the kept rays of all chunks together; each chunk has its own first.
fn join_chunks(rays: &mut Vec<Ray>, kept: impl Iterator<Item = usize>) {
    let mut end = 0;
    for (chunk, kept) in kept.enumerate() {
        rays.copy_within(chunk * CHUNK..chunk * CHUNK + kept, end);
        end += kept;
    }
    rays.truncate(end);
}

/// A chunk of the returns, and the rays that are made of it. All but the points may be empty.
struct Transform<'a> {
    points: &'a [[f32; 3]],
    normals: &'a [[f32; 3]],
    origins: &'a [[f32; 3]],
    intensities: &'a [u8],
    spacing: &'a [f32],
    frame: &'a RayFrame,
    surface: Option<(SurfaceRayParams, &'a mut [Ray])>,
    measured: Option<(ScaleRule, &'a mut [Ray])>,
}

type Lanes = [f32; LANES];

impl Kernel for Transform<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { points, normals, origins, intensities, spacing, frame, mut surface, mut measured } = self;
        let per_metre = 1.0 / frame.voxel;
        for (step, points) in points.chunks(LANES).enumerate() {
            let first = step * LANES;
            let (mut p, mut n, mut way) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [[1.0; LANES]; 3]);
            load_lanes(points, 0, &mut p);
            load_lanes(normals, first, &mut n);
            if origins.is_empty() {
                way = p;
            } else {
                load_lanes(origins, first, &mut way);
                (0..3).for_each(|k| (0..LANES).for_each(|l| way[k][l] = p[k][l] - way[k][l]));
            }
            let lanes = MeasuredLanes::new(&p, &way, &frame.t_submap_lidar);
            if let Some((rule, rays)) = &mut measured {
                for (l, ray) in rays[first..].iter_mut().take(points.len()).enumerate() {
                    *ray = lanes.ray(l, rule, per_metre);
                }
            }
            if let Some((params, rays)) = &mut surface {
                let planes = SurfaceLanes::new(&lanes, &n, &frame.t_submap_lidar, params);
                for (l, ray) in rays[first..].iter_mut().take(points.len()).enumerate() {
                    let intensity = intensities.get(first + l).copied().unwrap_or(0);
                    *ray = Ray {
                        direction: lane(&planes.direction, l),
                        intensity,
                        has_plane: planes.has_plane[l],
                        normal: lane(&planes.normal, l),
                        reach: [planes.reach[0][l], planes.reach[1][l]],
                        ..lanes.ray(l, &params.rule, per_metre)
                    };
                }
                for (ray, &spacing) in rays[first..].iter_mut().take(points.len()).zip(spacing.get(first..).unwrap_or(&[])) {
                    ray.scale = params.rule.fitting_between(spacing) as u32;
                }
            }
        }
    }
}

/// The vector in one lane.
#[inline(always)]
fn lane(v: &[Lanes; 3], l: usize) -> [f32; 3] {
    [v[0][l], v[1][l], v[2][l]]
}

/// Up to sixteen vectors from `first` on, one array an axis; lanes without a vector are left alone.
#[inline(always)]
fn load_lanes(vectors: &[[f32; 3]], first: usize, lanes: &mut [Lanes; 3]) {
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

/// Sixteen rays as they were measured: submap frame, metres.
struct MeasuredLanes {
    point: [Lanes; 3],
    direction: [Lanes; 3],
    range: Lanes,
}

impl MeasuredLanes {
    /// From points and the vectors from the sensor to them, lidar frame.
    #[inline(always)]
    fn new(p: &[Lanes; 3], way: &[Lanes; 3], pose: &Rigid) -> Self {
        let mut lanes = Self { point: [[0.0; LANES]; 3], direction: [[0.0; LANES]; 3], range: [0.0; LANES] };
        for l in 0..LANES {
            let way = lane(way, l);
            let range = (way[0] * way[0] + way[1] * way[1] + way[2] * way[2]).sqrt();
            let per_range = 1.0 / range;
            let (point, direction) = (pose.apply(lane(p, l)), pose.rotate(way));
            for k in 0..3 {
                (lanes.point[k][l], lanes.direction[k][l]) = (point[k], direction[k] * per_range);
            }
            lanes.range[l] = range;
        }
        lanes
    }

    /// The ray in one lane, without a plane.
    #[inline(always)]
    fn ray(&self, l: usize, rule: &ScaleRule, per_metre: f32) -> Ray {
        let direction = lane(&self.direction, l);
        Ray {
            point: lane(&self.point, l).map(|c| c * per_metre),
            scale: rule.fitting(self.range[l]) as u32,
            direction,
            intensity: 0,
            count: 1,
            has_plane: false,
            normal: direction.map(|c| -c),
            range: self.range[l] * per_metre,
            reach: [0.0; 2],
        }
    }
}

/// What the local planes add to sixteen rays; submap frame.
struct SurfaceLanes {
    /// Turned towards the plane where a ray grazes it.
    direction: [Lanes; 3],
    normal: [Lanes; 3],
    /// How far they reach before their points and beyond, voxels of the integration scale.
    reach: [Lanes; 2],
    has_plane: [bool; LANES],
}

impl SurfaceLanes {
    /// For rays whose planes have normals `n`, lidar frame; zero for none.
    #[inline(always)]
    fn new(rays: &MeasuredLanes, n: &[Lanes; 3], pose: &Rigid, params: &SurfaceRayParams) -> Self {
        let none = [[0.0; LANES]; 3];
        let mut lanes = Self { direction: none, normal: none, reach: [[0.0; LANES]; 2], has_plane: [false; LANES] };
        for l in 0..LANES {
            let (n, direction) = (lane(n, l), lane(&rays.direction, l));
            let has_plane = (n[0] != 0.0) | (n[1] != 0.0) | (n[2] != 0.0);
            let rotated = pose.rotate(n);
            let normal = [0, 1, 2].map(|k| if has_plane { rotated[k] } else { -direction[k] });
            let slope = -(direction[0] * normal[0] + direction[1] * normal[1] + direction[2] * normal[2]);
            let steep = steepened(direction, normal, slope, params.least_slope);
            let per_slope = 1.0 / larger(slope, params.least_slope);
            (0..2).for_each(|end| lanes.reach[end][l] = smaller(params.band[end] * per_slope, params.max_reach));
            for k in 0..3 {
                (lanes.direction[k][l], lanes.normal[k][l]) = (steep[k], normal[k]);
            }
            lanes.has_plane[l] = has_plane;
        }
        lanes
    }
}

/// `direction`, turned towards the plane with `normal` until the sine of the angle between them, which is `slope`, is `least`.
///
/// A ray that grazes the floor passes through one layer of voxels only and produces no zero crossing. All that is measured at its point is the plane, so the
/// plane may be sampled along a steeper line through the point.
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
    use crate::octree::BLOCK_EDGE;
    use proptest::prelude::*;

    fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| a[k] * b[k]).sum()
    }

    /// The rays of single returns, computed the obvious way; as measured without `params`.
    fn one_by_one(returns: &ReturnsView<'_>, frame: &RayFrame, rule: &ScaleRule, params: Option<&SurfaceRayParams>) -> Vec<Ray> {
        let of = |i: usize| {
            let (p, n) = (returns.points[i], returns.normals.get(i).copied().unwrap_or_default());
            let origin = returns.origins.get(i).copied().unwrap_or_default();
            let way: [f32; 3] = std::array::from_fn(|k| p[k] - origin[k]);
            let range = dot(way, way).sqrt();
            let direction = frame.t_submap_lidar.rotate(way).map(|c| c * (1.0 / range));
            let ray = Ray {
                point: frame.t_submap_lidar.apply(p).map(|c| c * (1.0 / frame.voxel)),
                scale: rule.fitting(range) as u32,
                direction,
                count: 1,
                normal: direction.map(|c| -c),
                range: range * (1.0 / frame.voxel),
                ..Ray::default()
            };
            let Some(params) = params else { return ray };
            let has_plane = n != [0.0; 3];
            let normal = if has_plane { frame.t_submap_lidar.rotate(n) } else { ray.normal };
            let slope = -dot(direction, normal);
            Ray {
                scale: returns.spacing.get(i).map_or(ray.scale, |&spacing| rule.fitting_between(spacing) as u32),
                direction: steepened(direction, normal, slope, params.least_slope),
                intensity: returns.intensities.get(i).copied().unwrap_or(0),
                has_plane,
                normal,
                reach: params.band.map(|off| (off * (1.0 / slope.max(params.least_slope))).min(params.max_reach)),
                ..ray
            }
        };
        (0..returns.points.len()).map(of).filter(|ray| ray.range <= frame.max_range / frame.voxel).collect()
    }

    proptest! {
        #[test]
        fn rays_made_sixteen_at_a_time_equal_rays_made_one_by_one(
            returns in prop::collection::vec((prop::array::uniform3(-40f32..40.0), prop::array::uniform3(-1f32..1.0), any::<u8>(), any::<bool>()), 0..100),
            [has_normals, has_intensities, has_origins, has_spacing] in any::<[bool; 4]>(),
            translation in prop::array::uniform3(-5f32..5.0),
            measured_points in 0usize..120,
        ) {
            let points: Vec<[f32; 3]> = returns.iter().map(|r| r.0).collect();
            let normals: Vec<[f32; 3]> = returns.iter().map(|r| if r.3 { r.1.map(|c| c / dot(r.1, r.1).sqrt()) } else { [0.0; 3] }).collect();
            let intensities: Vec<u8> = returns.iter().map(|r| r.2).collect();
            let spacing: Vec<f32> = points.iter().map(|p| 0.02 * p[0].abs()).collect();
            let (rotation, smallest_angle) = ([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]], 0.006);
            let returns = ReturnsView {
                points: &points,
                normals: if has_normals { &normals } else { &[] },
                intensities: if has_intensities { &intensities } else { &[] },
                origins: if has_origins { &normals } else { &[] },
                spacing: if has_spacing { &spacing } else { &[] },
                measured: measured_points.min(points.len()),
                smallest_angle,
            };
            let frame = RayFrame { t_submap_lidar: Rigid { rotation, translation }, voxel: 0.1, max_range: 50.0 };
            let rule = ScaleRule::new(smallest_angle, 0.1, 3, 1.5);
            let params = SurfaceRayParams { rule, least_slope: 0.4, band: [2.0, 1.5], max_reach: 3.0, bundle_width: 0.0 };
            let expected = [one_by_one(&returns, &frame, &rule, Some(&params)), one_by_one(&returns, &frame, &rule, None)];
            let [mut surface, mut measured] = [Vec::new(), Vec::new()];
            for (has_surface, has_measured) in [(true, true), (true, false), (false, true)] {
                surface.clear();
                measured.clear();
                let to_surface = has_surface.then_some(SurfaceRays { params, rays: &mut surface });
                let to_measured = has_measured.then_some(MeasuredRays { rule, rays: &mut measured });
                build_rays(&returns, &frame, to_surface, to_measured);
                prop_assert!(!has_surface || surface == expected[0], "{surface:?} is not {:?}", expected[0]);
                prop_assert!(!has_measured || measured == expected[1], "{measured:?} is not {:?}", expected[1]);
            }
        }

        #[test]
        fn blocks_in_which_samples_of_the_ray_create_voxels_are_recognised(
            [ray, plane] in prop::array::uniform2(prop::array::uniform3(-1f32..1.0).prop_filter("a direction", |v| dot(*v, *v) > 0.1)),
            point in prop::array::uniform3(-20f32..20.0),
            scale in 0u8..4,
        ) {
            let [ray, mut normal] = [ray, plane].map(|v| v.map(|c| c / dot(v, v).sqrt()));
            if dot(ray, normal) > 0.0 {
                normal = normal.map(|c| -c);
            }
            let direction = steepened(ray, normal, -dot(ray, normal), 0.4);
            let ray = Ray { point, direction, normal, reach: [3.0, 2.0], ..Ray::default() };
            let voxel = f32::from(1u8 << scale);
            let mut near = 0;
            for step in 0..=500 {
                let at: [f32; 3] = std::array::from_fn(|k| point[k] + direction[k] * voxel * (-3.0 + 0.01 * step as f32));
                let centre = at.map(|c| ((c / voxel).floor() + 0.5) * voxel);
                let distance = (0..3).map(|k| (centre[k] - point[k]) * normal[k]).sum::<f32>() / voxel;
                let corner = at.map(|c| (c / BLOCK_EDGE as f32).floor() * BLOCK_EDGE as f32);
                if distance < 1.5 {
                    near += 1;
                    prop_assert!(ray.creates_voxels_in(corner, scale, 1.5), "{distance} at {at:?}");
                }
            }
            prop_assert!(near > 0 && !ray.creates_voxels_in(point.map(|c| c + 100.0), scale, 1.5));
        }

        #[test]
        fn steepened_rays_stay_in_the_plane_of_ray_and_normal(
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
