//! Bundles: beams that are closer together than voxels are walked as one.
//!
//! A wall two metres away is hit by four beams a voxel, which tell the same voxels the same. What they say together is a plane through
//! the mean of their points, as often as there are beams, and only if there is one: what stands out from it by more than noise is walked alone. It is walked as far as the first of them would have been.

use super::transform::Beam;

/// Most beams of a bundle.
const MOST: u8 = 16;
/// Least cosine of the angle between the planes of beams of a bundle: what bends more is walked beam by beam.
const LEAST_COSINE: f32 = 0.966;
/// Farthest that a beam of a bundle may end from the plane of the first one, voxels of their scale.
const OFF_PLANE: f32 = 0.125;

/// Keeps those of `beams` that are no longer than `limit`, bundles neighbours that are within `width` voxels of their scale, and puts the
/// result first; returns how many that are.
pub(crate) fn bundle(beams: &mut [Beam], limit: f32, width: f32) -> usize {
    let mut kept = 0;
    let mut from = 0;
    while from < beams.len() {
        let first = beams[from];
        from += 1;
        if first.range > limit {
            continue;
        }
        let mut bundle = first;
        let mut shades = u32::from(first.shade);
        let joins = Joins::new(&first, width);
        while let Some(next) = beams.get(from).filter(|next| bundle.count < MOST && next.range <= limit && joins.holds(next)) {
            for k in 0..3 {
                bundle.point[k] += next.point[k];
                bundle.direction[k] += next.direction[k];
                bundle.normal[k] += next.normal[k];
            }
            bundle.range += next.range;
            shades += u32::from(next.shade);
            bundle.count += 1;
            from += 1;
        }
        if bundle.count > 1 {
            let share = 1.0 / f32::from(bundle.count);
            bundle.point = bundle.point.map(|c| c * share);
            bundle.range *= share;
            bundle.shade = (shades / u32::from(bundle.count)) as u8;
            (bundle.direction, bundle.normal) = (unit(bundle.direction), unit(bundle.normal));
        }
        beams[kept] = bundle;
        kept += 1;
    }
    kept
}

/// Which beams are part of the bundle that `first` began.
struct Joins<'a> {
    first: &'a Beam,
    /// Squares, finest voxels.
    farthest: f32,
    off_plane: f32,
}

impl<'a> Joins<'a> {
    #[inline(always)]
    fn new(first: &'a Beam, width: f32) -> Self {
        let voxel = (1 << first.scale) as f32;
        let farthest = if first.has_plane { width * voxel } else { 0.0 };
        Self { first, farthest: farthest.powi(2), off_plane: (OFF_PLANE * voxel).powi(2) }
    }

    #[inline(always)]
    fn holds(&self, next: &Beam) -> bool {
        let Self { first, farthest, off_plane } = *self;
        let way = [0, 1, 2].map(|k| next.point[k] - first.point[k]);
        let is_near = (dot(way, way) < farthest) & (dot(way, first.normal).powi(2) < off_plane);
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

    /// Beams from far above to places along a row of pixels, on a plane that is tilted here and there.
    fn row() -> impl Strategy<Value = Vec<Beam>> {
        let one = (0f32..0.6, prop_oneof![Just(0f32), Just(0f32), Just(0.3f32)], 0u32..2, any::<bool>(), any::<u8>());
        prop::collection::vec(one, 0..60).prop_map(|steps| {
            let mut x = 0.0;
            let beam = |(step, tilt, scale, has_plane, shade): (f32, f32, u32, bool, u8)| {
                x += step;
                let normal = [tilt.sin(), 0.0, tilt.cos()];
                Beam {
                    point: [x, 0.0, 3.0 - x * tilt.tan()],
                    direction: [0.0, 0.0, -1.0],
                    normal,
                    range: 40.0 + x,
                    scale,
                    has_plane,
                    shade,
                    count: 1,
                    ..Beam::default()
                }
            };
            steps.into_iter().map(beam).collect()
        })
    }

    proptest! {
        #[test]
        fn bundles_are_narrow_and_flat_and_stand_for_every_beam_once(beams in row(), width in 0f32..1.5, limit in 40f32..60.0) {
            let mut bundled = beams.clone();
            let kept = bundle(&mut bundled, limit, width);
            let near: Vec<&Beam> = beams.iter().filter(|beam| beam.range <= limit).collect();
            let mut rest = &near[..];
            for bundle in &bundled[..kept] {
                let (members, after) = rest.split_at(bundle.count.into());
                rest = after;
                let first = members[0];
                if members.len() == 1 {
                    prop_assert_eq!(bundle, first);
                    continue;
                }
                let mean = |of: &dyn Fn(&Beam) -> f32| members.iter().map(|&beam| of(beam)).sum::<f32>() / members.len() as f32;
                for k in 0..3 {
                    prop_assert!((bundle.point[k] - mean(&|beam| beam.point[k])).abs() < 1e-3);
                }
                prop_assert!((bundle.range - mean(&|beam| beam.range)).abs() < 1e-3);
                prop_assert_eq!(bundle.shade, mean(&|beam| beam.shade.into()) as u8);
                for beam in members {
                    let apart = (0..3).map(|k| (beam.point[k] - first.point[k]).powi(2)).sum::<f32>().sqrt();
                    let off = (0..3).map(|k| (beam.point[k] - first.point[k]) * first.normal[k]).sum::<f32>().abs();
                    prop_assert!(off <= OFF_PLANE * (1 << first.scale) as f32 + 1e-4, "{off} off the plane");
                    prop_assert!(beam.has_plane && beam.scale == first.scale && apart <= width * (1 << first.scale) as f32 + 1e-4);
                    let bend = (0..3).map(|k| beam.normal[k] * first.normal[k]).sum::<f32>();
                    prop_assert!(bend >= LEAST_COSINE - 1e-4, "planes that differ by {} degrees", bend.acos().to_degrees());
                }
                let length = bundle.normal.iter().map(|c| c * c).sum::<f32>();
                prop_assert!((length - 1.0).abs() < 1e-4);
            }
            prop_assert!(rest.is_empty(), "{} beams are lost", rest.len());
            if width == 0.0 {
                prop_assert_eq!(kept, near.len());
            }
        }
    }

    #[test]
    fn a_dense_row_is_bundled_as_wide_as_is_allowed() {
        let beam = |i: usize| Beam {
            point: [i as f32 * 0.125, 0.0, 0.0],
            normal: [0.0, 0.0, 1.0],
            direction: [0.0, 0.0, -1.0],
            has_plane: true,
            count: 1,
            ..Beam::default()
        };
        let mut beams: Vec<Beam> = (0..20).map(beam).collect();
        let kept = bundle(&mut beams, 1.0, 0.5);
        assert_eq!(beams[..kept].iter().map(|beam| beam.count).collect::<Vec<u8>>(), [4, 4, 4, 4, 4]);
        assert_eq!(beams[1].point, [0.6875, 0.0, 0.0]);
    }
}
