//! Several fields at different poses.

use super::*;
use crate::atlas::Atlas;
use crate::geometry::Pose;
use crate::query::collision::with_solid;
use crate::query::field::blocks;
use crate::query::shape::moved;
use crate::query::shape_sdf::{BoxSolid, Solid};
use std::collections::HashMap;

pub(super) fn atlas(fields: Vec<(OccupancyField, Pose)>) -> Atlas {
    let submaps = fields.into_iter().enumerate().map(|(i, (field, pose))| {
        let mut submap = crate::atlas::Submap::new(i as u32, VOXEL, pose);
        submap.occupancy = field;
        submap
    });
    Atlas::from_submaps(VOXEL, submaps.collect())
}

pub(super) fn fields(count: usize) -> impl Strategy<Value = Vec<(OccupancyField, Pose)>> {
    prop::collection::vec(((any::<u64>(), 60u64..4000).prop_map(|(seed, rare)| random_field(seed, rare)), pose()), 1..=count)
}

/// State at a point: asked of every submap.
fn slow_state(fields: &[(OccupancyField, Pose)], p: [f64; 3]) -> State {
    let local = |(field, pose): &(OccupancyField, Pose)| field.state_at(moved(&pose.inverse(), p).map(|c| (c / f64::from(VOXEL)).floor() as i32));
    fields.iter().map(local).max().unwrap_or(State::Unknown)
}

/// Whether no submap has an occupied leaf that the shape touches, and of every cube's part in the shape some submap knows
/// all to be free.
fn slow_is_free(fields: &[(OccupancyField, Pose)], shape: &Shape, unknown: UnknownAs) -> bool {
    let voxel = f64::from(VOXEL);
    let all: Vec<(Vec<Leaf>, &Pose, Leaf)> = fields.iter().map(|(f, p)| (leaves(f), p, root(f))).collect();
    let touches = |(leaves, pose, root): &(Vec<Leaf>, &Pose, Leaf), cube: Option<&OrientedBox>, unknown: UnknownAs| {
        let local = shape.moved(&pose.inverse());
        let cube = cube.map(|c| BoxSolid::new(&OrientedBox { t_frame_box: pose.inverse() * c.t_frame_box, ..*c }, 1.0 / voxel));
        with_solid!(&local, 1.0 / voxel, |solid| {
            let (mut low, mut high) = solid.bounds();
            if let Some(cube) = &cube {
                let (l, h) = cube.bounds();
                low = std::array::from_fn(|k| low[k].max(l[k]));
                high = std::array::from_fn(|k| high[k].min(h[k]));
            }
            let apart = (0..3).any(|k| low[k] > high[k]);
            let (first, last) = root.corners();
            let leaves_root = !apart && (0..3).any(|k| low[k] <= first[k] || high[k] >= last[k]);
            let meets = |l: &Leaf| {
                let (a, b) = l.corners();
                blocks(l.value, unknown) && solid.meets(a, b) && cube.as_ref().is_none_or(|c| c.meets(a, b))
            };
            (leaves_root && unknown == UnknownAs::Blocked) || leaves.iter().any(meets)
        })
    };
    if all.iter().any(|part| touches(part, None, UnknownAs::Free)) {
        return false;
    }
    if unknown == UnknownAs::Free {
        return true;
    }
    let (low, high) = shape.bounds();
    let [first, last] = [low, high].map(|p| p.map(|c| (c / voxel).floor() as i64));
    let origin = Pose::translation(-(first[0] as f64) * voxel, -(first[1] as f64) * voxel, -(first[2] as f64) * voxel);
    let near = shape.moved(&origin);
    for (z, y, x) in (first[2]..=last[2]).flat_map(|z| (first[1]..=last[1]).flat_map(move |y| (first[0]..=last[0]).map(move |x| (z, y, x)))) {
        let at = [x, y, z];
        let meets = with_solid!(&near, 1.0 / voxel, |solid| {
            let low: [f32; 3] = std::array::from_fn(|k| (at[k] - first[k]) as f32);
            solid.meets(low, low.map(|c| c + 1.0))
        });
        let middle = at.map(|c| (c as f64 + 0.5) * voxel);
        let cube = OrientedBox { t_frame_box: Pose::translation(middle[0], middle[1], middle[2]), half: [0.5 * voxel; 3] };
        if meets && all.iter().all(|part| touches(part, Some(&cube), UnknownAs::Blocked)) {
            return false;
        }
    }
    true
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn points_take_the_strongest_state(fields in fields(4), points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f64), 200)) {
        let atlas = atlas(fields.clone());
        let query = AtlasQuery::new(&atlas);
        for p in points {
            prop_assert_eq!(query.state(p), slow_state(&fields, p));
        }
    }

    #[test]
    fn many_points_at_once_are_as_one_by_one(fields in fields(3), seed in any::<u64>(), apart in prop::sample::select(vec![0.0, 40_000.0])) {
        // Also in a map of kilometres, in which the cells that points are sorted by are larger than blocks.
        let fields: Vec<_> = fields.into_iter().enumerate().map(|(i, (field, pose))| (field, Pose::translation(i as f64 * apart, 0.0, 0.0) * pose)).collect();
        let atlas = atlas(fields.clone());
        let query = AtlasQuery::new(&atlas);
        let mut numbers = Numbers(seed);
        let mut within = |limit: f64| limit * (numbers.below(1 << 20) as f64 / f64::from(1 << 19) - 1.0);
        let mut points: Vec<[f64; 3]> = (0..5000).map(|i| [within(4.0) + (i % 3) as f64 * apart, within(4.0), within(4.0)]).collect();
        points[5] = [f64::NAN, 0.0, 0.0];
        points[6] = [1e300, 0.0, f64::NEG_INFINITY];
        let expected: Vec<State> = points.iter().map(|p| query.state(*p)).collect();
        prop_assert!(expected.contains(&State::Free) || expected.contains(&State::Occupied));
        prop_assert_eq!(&query.states(&points), &expected);
        prop_assert_eq!(&query.states(&points[..100]), &expected[..100]);
        prop_assert_eq!(AtlasQuery::new(&Atlas::new(VOXEL)).states(&points), vec![State::Unknown; points.len()]);
    }

    #[test]
    fn rays_end_where_no_submap_says_free(fields in fields(3), rays in prop::collection::vec(ray(), 20), unknown in policy()) {
        let atlas = atlas(fields.clone());
        let query = AtlasQuery::new(&atlas);
        for ray in rays.iter().filter_map(Ray::normalised) {
            let at = query.ray_cast(&ray, unknown).map_or(ray.length, |hit| hit.distance);
            let mut cuts: Vec<f64> = vec![0.0, ray.length];
            for (field, pose) in &fields {
                let t = pose.inverse();
                let local = Ray { origin: moved(&t, ray.origin), direction: (t.rotation * nalgebra::Vector3::from(ray.direction)).into(), ..ray };
                cuts.extend(leaves(field).iter().filter_map(|l| slab(&local, l, 0.0)).flat_map(|s| [s.0, s.1]).map(|c| c * f64::from(VOXEL)));
            }
            cuts.retain(|c| (0.0..=ray.length).contains(c));
            cuts.sort_by(f64::total_cmp);
            let along = |t: f64| -> [f64; 3] { std::array::from_fn(|k| ray.origin[k] + t * ray.direction[k]) };
            let stop = cuts.windows(2).filter(|w| w[1] - w[0] > 1e-5).find(|w| match slow_state(&fields, along(0.5 * (w[0] + w[1]))) {
                State::Free => false,
                State::Unknown => unknown == UnknownAs::Blocked,
                State::Occupied => true,
            });
            let expected = stop.map_or(ray.length, |w| w[0]);
            // Slivers that a ray touches for less than a hundredth of a millimetre may count either way.
            let sliver = at < expected && slow_state(&fields, along(at + 1e-9)) != State::Free;
            prop_assert!((at - expected).abs() < 1e-4 || sliver, "{ray:?}: {at} instead of {expected}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]
    #[test]
    fn a_submap_that_is_being_fused_still_counts(fields in fields(3), by in pose(), points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f64), 100)) {
        prop_assume!(fields.len() > 1);
        let mut atlas = atlas(fields.clone());
        // It follows its target from now on.
        let t_target_submap = fields[0].1.inverse() * fields[1].1;
        atlas.begin_fusion(1, 0, t_target_submap);
        atlas.submaps_mut()[0].t_map_submap = by * fields[0].1;
        let mut moved = fields.clone();
        (0..2).for_each(|i| moved[i].1 = by * fields[i].1);
        let query = AtlasQuery::new(&atlas);
        for p in points {
            prop_assert_eq!(query.state(p), slow_state(&moved, p));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn shapes_may_be_free_in_parts(fields in fields(3), shapes in prop::collection::vec(shape(), 6), unknown in policy()) {
        let atlas = atlas(fields.clone());
        let query = AtlasQuery::new(&atlas);
        for shape in &shapes {
            prop_assert_eq!(query.is_free(shape, unknown), slow_is_free(&fields, shape, unknown), "{:?}", shape);
            let alone = |unknown| move |(f, pose): &(OccupancyField, Pose)| FieldQuery::new(f, VOXEL).is_free(&shape.moved(&pose.inverse()), unknown);
            let by_one = fields.iter().any(alone(UnknownAs::Blocked)) && fields.iter().all(alone(UnknownAs::Free));
            prop_assert_eq!(query.is_free_by_one(shape), by_one, "{:?}", shape);
        }
    }

    #[test]
    fn some_submaps_answer_as_if_there_were_no_others(
        fields in fields(3), mask in 0u32..8, shapes in prop::collection::vec(shape(), 6), points in prop::collection::vec(prop::array::uniform3(-4.0..4.0f64), 50), unknown in policy()
    ) {
        let atlas = atlas(fields.clone());
        let some = AtlasQuery::of_submaps(&atlas, |id| mask >> id & 1 == 1);
        let included: Vec<_> = (0..).zip(&fields).filter(|(id, _)| mask >> id & 1 == 1).map(|(_, field)| field.clone()).collect();
        for p in points {
            prop_assert_eq!(some.state(p), slow_state(&included, p));
        }
        for shape in &shapes {
            prop_assert_eq!(some.is_free(shape, unknown), slow_is_free(&included, shape, unknown), "{:?}", shape);
        }
    }

    #[test]
    fn the_same_grid_gives_the_same_states(seed in any::<u64>(), rare in 3u64..300, states_only in any::<bool>(), double in any::<bool>()) {
        let field = random_field(seed, rare);
        let fields = vec![(field.clone(), Pose::identity())];
        let atlas = atlas(fields);
        let query = AtlasQuery::new(&atlas);
        let scale = if double { 2 } else { 1 };
        let cubes = query.resample(&Resampling { voxel: query.voxel_size() * f64::from(scale), states_only });
        let mut known: HashMap<[i32; 3], i8> = HashMap::new();
        for cube in &cubes {
            let edge = 1 << cube.level;
            prop_assert!(cube.corner.iter().all(|c| c & (edge as u32 - 1) == 0));
            prop_assert!(!states_only || cube.value >= -1);
            for i in 0..edge * edge * edge {
                let c: [i32; 3] = std::array::from_fn(|k| cube.corner[k] as i32 - (1 << 20) + [i % edge, i / edge % edge, i / edge / edge][k]);
                prop_assert!(known.insert(c, cube.value).is_none(), "cubes overlap");
            }
        }
        let root = root(&field);
        let count = root.edge / scale;
        for i in 0..count * count * count {
            let c: [i32; 3] = std::array::from_fn(|k| root.low[k] / scale + [i % count, i / count % count, i / count / count][k]);
            let region = FieldQuery::new(&field, VOXEL).at_level(c.map(|v| (f64::from(v * scale) + 0.5) * f64::from(VOXEL)), u32::from(double));
            let value = known.get(&c).copied().unwrap_or(UNKNOWN);
            prop_assert_eq!(state_of(value), region.state(), "{:?}", c);
            if !states_only && state_of(value) != State::Unknown {
                prop_assert_eq!(value, region.max);
            }
        }
    }

    #[test]
    fn cubes_by_themselves_are_those_of_the_whole(fields in fields(3), factor in 1.0..2.5f64, level in 4u32..7) {
        let atlas = atlas(fields);
        let query = AtlasQuery::new(&atlas);
        let to = Resampling { voxel: query.voxel_size() * factor, states_only: true };
        let smallest = |cubes: &[Cube]| -> HashMap<[u32; 3], i8> {
            let within = |cube: &Cube| {
                let (edge, corner, value) = (1 << cube.level, cube.corner, cube.value);
                (0..edge * edge * edge).map(move |i| ([corner[0] + i % edge, corner[1] + i / edge % edge, corner[2] + i / edge / edge], value))
            };
            cubes.iter().flat_map(within).collect()
        };
        let whole = smallest(&query.resample(&to));
        let mut corners: Vec<[u32; 3]> = whole.keys().map(|corner| corner.map(|c| c >> level << level)).collect();
        corners.sort_unstable();
        corners.dedup();
        let parts: Vec<Cube> = corners.into_iter().flat_map(|corner| query.resample_cube(&to, corner, level)).collect();
        prop_assert_eq!(smallest(&parts), whole);
        prop_assert!(query.resample_cube(&to, [0; 3], level).is_empty(), "far away");
    }

    #[test]
    fn turned_maps_keep_all_that_is_occupied(fields in fields(3), factor in 1.0..2.5f64) {
        let atlas = atlas(fields.clone());
        let query = AtlasQuery::new(&atlas);
        let voxel = query.voxel_size() * factor;
        let cubes = query.resample(&Resampling { voxel, states_only: true });
        let by_corner: HashMap<[u32; 4], i8> = cubes.iter().map(|c| ([c.corner[0], c.corner[1], c.corner[2], c.level], c.value)).collect();
        let value = |p: [f64; 3]| {
            let c = p.map(|c| ((c / voxel).floor() as i64 + (1 << 20)) as u32);
            (0..20).find_map(|level| {
                let mask = !((1u32 << level) - 1);
                by_corner.get(&[c[0] & mask, c[1] & mask, c[2] & mask, level]).copied()
            })
        };
        for (field, pose) in &fields {
            for leaf in leaves(field).iter().filter(|l| l.value > 0) {
                let middle = leaf.low.map(|c| (f64::from(c) + 0.5) * f64::from(VOXEL));
                prop_assert!(value(moved(pose, middle)).is_some_and(|v| v > 0), "{leaf:?} is lost");
            }
        }
        let samples = (factor - 1e-6).ceil();
        for cube in cubes.iter().filter(|c| c.value < 0) {
            // The first point that the first of its smallest cubes is asked at.
            let sample = cube.corner.map(|c| (f64::from(c) - f64::from(1 << 20) + 0.5 / samples) * voxel);
            prop_assert_eq!(slow_state(&fields, sample), State::Free, "{:?}", cube);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn a_sphere_within_the_clearance_is_free_and_one_a_voxel_beyond_is_not(
        fields in fields(3), points in prop::collection::vec(prop::array::uniform3(-1.5..1.5f64), 20), up_to in 0.1..1.2f64, unknown in policy(),
    ) {
        let atlas = atlas(fields);
        let query = AtlasQuery::new(&atlas);
        for p in points {
            let found = query.clearance(p, up_to, unknown);
            let sphere = |radius| Sphere { centre: p, radius }.into();
            // Bounds of shapes have a thousandth of a voxel to spare.
            let within = found - 2e-3 * f64::from(VOXEL);
            prop_assert!(within < 0.0 || query.is_free(&sphere(within), unknown), "{found} is too far");
            let diagonal = (3f64.sqrt() + 1e-2) * f64::from(VOXEL);
            prop_assert!(found >= up_to - diagonal || !query.is_free(&sphere(found + diagonal), unknown), "{found} is too near");
        }
    }
}
