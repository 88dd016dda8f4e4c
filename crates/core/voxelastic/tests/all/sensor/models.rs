//! Projection and its inverse.

use proptest::prelude::*;
use voxelastic::sensor::{BeamModel, BeamTables, SensorError, preset, preset_names};

fn preset_model() -> impl Strategy<Value = BeamModel> {
    let names: Vec<&str> = preset_names().collect();
    prop::sample::select(names).prop_map(|name| preset(name).unwrap_or_else(|e| panic!("{e}")))
}

proptest! {
    #[test]
    fn every_pixel_of_every_preset_projects_onto_itself(model in preset_model(), a in 0f32..1.0, b in 0f32..1.0, range in 0.5f32..120.0) {
        let row = (a * model.rows() as f32) as usize;
        let column = (b * model.columns() as f32) as usize;
        let p = model.point(row as f32, column as f32, range);
        let q = model.project(p).ok_or_else(|| TestCaseError::fail("not seen"))?;
        prop_assert!((q.row - row as f32).abs() < 0.02, "row {} became {}", row, q.row);
        let off = (q.column - column as f32).abs();
        prop_assert!(off.min(model.columns() as f32 - off) < 0.02, "column {} became {}", column, q.column);
        prop_assert!((q.range - range).abs() < 1e-5 * range + 1e-6);
        let unit: f32 = model.direction(row as f32, column as f32).iter().map(|c| c * c).sum();
        prop_assert!((unit - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_point_lies_on_the_beam_that_it_projects_to(model in preset_model(), p in prop::array::uniform3(-60f32..60.0)) {
        let far = p.iter().map(|c| c * c).sum::<f32>() > 4.0;
        if let (true, Some(q)) = (far, model.project(p)) {
            prop_assert!(q.row >= -0.5 && q.row < model.rows() as f32 - 0.5);
            prop_assert!(q.column >= -0.5 && q.column < model.columns() as f32 - 0.5);
            let back = model.point(q.row, q.column, q.range);
            // A hundredth of a pixel, and the elevation of a beam is straight between rows only in angle.
            let apart = (0..3).map(|k| (back[k] - p[k]).powi(2)).sum::<f32>().sqrt();
            prop_assert!(apart < 0.02 * model.largest_gap() * q.range + 1e-4, "{:?} {:?} {}", p, back, apart);
        }
    }

    #[test]
    fn firing_and_pixel_columns_invert_each_other(model in preset_model(), a in 0f32..1.0, b in 0f32..1.0) {
        let (row, column) = ((a * model.rows() as f32) as usize, (b * model.columns() as f32) as usize);
        prop_assert_eq!(model.pixel_column(row, model.firing_column(row, column)), column);
    }

    #[test]
    fn rows_may_come_in_any_order(mut rings in prop::collection::vec(-0.4f32..0.4, 2..64), seed in 0u64..1000) {
        rings.sort_by(f32::total_cmp);
        rings.dedup_by(|a, b| (*a - *b).abs() < 1e-3);
        use rand::seq::SliceRandom;
        rings.shuffle(&mut super::scene::rng(seed));
        let model = BeamModel::from_tables(BeamTables { elevations: rings.clone(), columns: 900, ..BeamTables::default() })
            .map_err(|e| TestCaseError::fail(e.to_string()))?;
        for (ring, &elevation) in rings.iter().enumerate() {
            prop_assert_eq!(model.elevations()[usize::from(model.row_of_ring()[ring])], elevation);
        }
    }
}

#[test]
fn bad_tables_are_rejected_with_reasons() {
    let tables = |elevations: &[f32]| BeamTables { elevations: elevations.to_vec(), columns: 100, ..BeamTables::default() };
    let reject = |t: BeamTables| BeamModel::from_tables(t).err();
    assert!(matches!(reject(tables(&[])), Some(SensorError::Size { rows: 0, .. })));
    assert!(matches!(reject(tables(&[0.1, f32::NAN])), Some(SensorError::Angle { row: 1 })));
    assert!(matches!(reject(tables(&[0.1, 2.0])), Some(SensorError::Angle { row: 1 })));
    assert!(matches!(reject(tables(&[0.1, 0.1])), Some(SensorError::RowsCoincide { first: 0, .. })));
    assert!(matches!(reject(BeamTables { columns: 1, ..tables(&[0.1]) }), Some(SensorError::Size { columns: 1, .. })));
    assert!(matches!(reject(BeamTables { azimuth_offsets: vec![0.0], ..tables(&[0.1, 0.0]) }), Some(SensorError::TableLength { .. })));
    assert!(matches!(reject(BeamTables { origin_radius: f32::NAN, ..tables(&[0.1, 0.0]) }), Some(SensorError::Origin { .. })));
    assert!(BeamModel::even(usize::MAX, 1024, 0.3, -0.3).is_err());
    assert!(BeamModel::even(16, 1024, -0.3, -0.3).is_err());
}

#[test]
fn invalid_points_are_not_projected() {
    let model = preset("os1-64").unwrap_or_else(|e| panic!("{e}"));
    for p in [[f32::NAN; 3], [0.0; 3], [f32::INFINITY, 0.0, 0.0], [0.0, 0.0, 5.0]] {
        assert_eq!(model.project(p), None, "{p:?}");
    }
}
