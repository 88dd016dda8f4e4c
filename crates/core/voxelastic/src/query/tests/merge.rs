//! Merged maps against the submaps that they were made from.

use super::atlas::{atlas, fields};
use super::*;
use crate::atlas::Atlas;
use crate::geometry::{Aabb, Pose};
use crate::query::field::blocks;
use crate::query::shape::moved;
use crate::query::shape_sdf::{BoxSolid, Solid};

fn merged(fields: &[(OccupancyField, Pose)], cell: f32) -> MergedMap {
    AtlasQuery::new(&atlas(fields.to_vec())).merge(&MergeOptions { cell, bounds: None })
}

/// What a submap knows of a cube of the map frame: whether it is occupied anywhere, and whether all of it is free.
fn slow_knows(field: &OccupancyField, pose: &Pose, middle: [f64; 3], edge: f64) -> [bool; 2] {
    let cube = OrientedBox { t_frame_box: pose.inverse() * Pose::translation(middle[0], middle[1], middle[2]), half: [0.5 * edge; 3] };
    let solid = BoxSolid::new(&cube, 1.0 / f64::from(VOXEL));
    let (low, high) = solid.bounds();
    let (first, last) = root(field).corners();
    let inside = (0..3).all(|k| low[k] > first[k] && high[k] < last[k]);
    let touched: Vec<Leaf> = leaves(field).into_iter().filter(|l| solid.meets(l.corners().0, l.corners().1)).collect();
    [touched.iter().any(|l| l.value > 0), inside && touched.iter().all(|l| state_of(l.value) == State::Free)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn cells_are_what_the_submaps_say_of_them(
        fields in fields(3), places in prop::collection::vec(prop::array::uniform3(-3.5..3.5f64), 60), share in prop_oneof![Just(1.0), Just(0.5), 0.4..1.3f32],
    ) {
        let cell = share * VOXEL;
        let map = merged(&fields, cell);
        for p in places {
            let middle = p.map(|c| ((c / f64::from(cell)).floor() + 0.5) * f64::from(cell));
            let state = map.query().state(middle);
            // A sliver more or less, that may count either way.
            let knows = |edge: f64| -> Vec<[bool; 2]> { fields.iter().map(|(f, t)| slow_knows(f, t, middle, edge)).collect() };
            let (more, less) = (knows(1.003 * f64::from(cell)), knows(0.995 * f64::from(cell)));
            let occupied = |all: &[[bool; 2]]| all.iter().any(|k| k[0]);
            let free = |all: &[[bool; 2]]| all.iter().any(|k| k[1]);
            match state {
                State::Occupied => prop_assert!(occupied(&more)),
                State::Free => prop_assert!(!occupied(&less) && free(&less)),
                State::Unknown => prop_assert!(!occupied(&less) && !free(&more)),
            }
        }
    }

    #[test]
    fn distances_shrink_by_no_more_than_a_cells_diagonal(
        fields in fields(3), points in prop::collection::vec(prop::array::uniform3(-2.5..2.5f64), 30), up_to in 0.1..1.5f64, share in prop_oneof![Just(1.0), Just(0.5)],
    ) {
        let cell = share * VOXEL;
        let map = merged(&fields, cell);
        for p in points {
            let nearest = fields.iter().flat_map(|(field, pose)| {
                let local = moved(&pose.inverse(), p).map(|c| c / f64::from(VOXEL));
                leaves(field).into_iter().filter(|l| blocks(l.value, UnknownAs::Free)).map(move |l| {
                    (0..3).map(|k| (f64::from(l.low[k]) - local[k]).max(local[k] - f64::from(l.low[k] + l.edge)).max(0.0).powi(2)).sum::<f64>().sqrt()
                })
            }).fold(f64::INFINITY, f64::min) * f64::from(VOXEL);
            let found = map.query().clearance(p, up_to, UnknownAs::Free);
            let diagonal = 3f64.sqrt() * f64::from(cell);
            let sliver = 2e-3 * f64::from(cell);
            prop_assert!(found <= nearest.min(up_to) + sliver, "{found} is beyond {nearest}");
            prop_assert!(found >= nearest.min(up_to) - diagonal - sliver, "{found} is too near for {nearest}");
        }
    }

    #[test]
    fn the_only_submap_stays_as_it_is(seed in any::<u64>(), rare in 3u64..500, halved in any::<bool>()) {
        let field = random_field(seed, rare);
        let map = merged(&[(field.clone(), Pose::identity())], if halved { 0.5 * VOXEL } else { VOXEL });
        let root = root(&field);
        let per_voxel = if halved { 2 } else { 1 };
        for i in 0..root.edge.pow(3) {
            let c: [i32; 3] = std::array::from_fn(|k| root.low[k] + [i % root.edge, i / root.edge % root.edge, i / root.edge / root.edge][k]);
            for corner in 0..per_voxel * per_voxel * per_voxel {
                let cell: [i32; 3] = std::array::from_fn(|k| per_voxel * c[k] + [corner & 1, corner >> 1 & 1, corner >> 2][k]);
                prop_assert_eq!(map.field().state_at(cell), field.state_at(c), "{:?}", c);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]
    #[test]
    fn threads_change_nothing_and_bounds_cut(fields in fields(3), corner in prop::array::uniform3(-2.0..0.0f32)) {
        let images = [1, 3].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let map = pool.install(|| merged(&fields, VOXEL));
            (map.field().octants_in_order(), leaves(map.field()).iter().map(|l| (l.low, l.edge, l.value)).collect::<Vec<_>>())
        });
        prop_assert_eq!(&images[0], &images[1]);
        let bounds = Aabb { min: corner, max: corner.map(|c| c + 1.2) };
        let part = AtlasQuery::new(&atlas(fields.clone())).merge(&MergeOptions { cell: VOXEL, bounds: Some(bounds) });
        let all = merged(&fields, VOXEL);
        for i in 0..1000 {
            let p: [f64; 3] = std::array::from_fn(|k| f64::from(corner[k]) + 1.2 * (f64::from([i % 10, i / 10 % 10, i / 100][k]) + 0.5) / 10.0);
            prop_assert_eq!(part.query().state(p), all.query().state(p));
        }
        prop_assert_eq!(part.query().state([30.0, 0.0, 0.0]), State::Unknown);
    }
}

#[test]
fn what_is_no_grid_merges_nothing() {
    let atlas = atlas(vec![(random_field(3, 100), Pose::identity())]);
    let query = AtlasQuery::new(&atlas);
    for cell in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-9] {
        assert_eq!(query.merge(&MergeOptions { cell, bounds: None }).query().state([0.1; 3]), State::Unknown, "{cell}");
    }
    let nowhere = Aabb { min: [90.0; 3], max: [91.0; 3] };
    assert!(query.merge(&MergeOptions { cell: VOXEL, bounds: Some(nowhere) }).query().bounds().is_empty());
    assert!(AtlasQuery::new(&Atlas::new(VOXEL)).merge(&MergeOptions { cell: VOXEL, bounds: None }).query().bounds().is_empty());
}
