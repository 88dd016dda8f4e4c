//! A reader in Python that was written from the book's description of the format alone (`read_map.py`) finds in a map what is in it.

use crate::store::world::{Walk, details, made_up_atlas};
use serde_json::{Value, json};
use std::process::Command;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::field::occupancy::{OccupancyField, UNKNOWN};
use voxelastic::field::tsdf::{TsdfField, Voxel};
use voxelastic_io::store::MapWriter;

fn by_scale(scales: impl Iterator<Item = u8>) -> [usize; 4] {
    scales.fold([0; 4], |mut counts, scale| {
        counts[usize::from(scale)] += 1;
        counts
    })
}

fn tsdf(field: &TsdfField) -> Value {
    let ids = field.ids_in_morton_order();
    let voxels: Vec<Voxel> = ids.iter().flat_map(|&id| field.stored_voxels(id)).filter(|v| *v != Voxel::default()).collect();
    let intensities: u64 = ids.iter().flat_map(|&id| field.stored_intensities(id)).map(u64::from).sum();
    json!({
        "blocks": ids.len(),
        // Python's numbers do not end.
        "keys": ids.iter().map(|&id| field.head(id).key as f64).sum::<f64>(),
        "scales": by_scale(ids.iter().map(|&id| field.head(id).scale)),
        "voxels": voxels.len(),
        "distances": voxels.iter().map(|v| i64::from(v.distance)).sum::<i64>(),
        "weights": voxels.iter().map(|v| u64::from(v.weight)).sum::<u64>(),
        "intensities": intensities,
    })
}

fn colours(field: &TsdfField) -> Value {
    let blocks: Vec<_> = field.ids().filter_map(|id| field.colours().block(id)).collect();
    let sum =
        |part: fn(&voxelastic::field::tsdf::ColourVoxel) -> u8| blocks.iter().flat_map(|(_, all)| *all).map(|c| u64::from(part(c))).sum::<u64>();
    json!({
        "blocks": blocks.len(),
        "red": sum(|c| c.rgb[0]),
        "green": sum(|c| c.rgb[1]),
        "blue": sum(|c| c.rgb[2]),
        "observations": sum(|c| c.observations),
    })
}

fn occupancy(field: &OccupancyField) -> Value {
    let (octants, ids) = (field.octants_in_order(), field.ids_in_morton_order());
    let known: Vec<i8> = ids.iter().flat_map(|&id| field.values(field.block(id))).copied().filter(|v| *v != UNKNOWN).collect();
    json!({
        "octants": octants.len(),
        "blocks": ids.len(),
        "linked": octants.iter().filter(|o| o.linked).count(),
        "observed": octants.iter().filter(|o| o.summary.observed).count(),
        "values": octants.iter().map(|o| i64::from(o.summary.value)).sum::<i64>(),
        "maxima": octants.iter().map(|o| i64::from(o.summary.max)).sum::<i64>(),
        "scales": by_scale(ids.iter().map(|&id| field.block(id).scale)),
        "known": known.len(),
        "voxels": known.iter().map(|v| i64::from(*v)).sum::<i64>(),
    })
}

fn submap(submap: &Submap) -> Value {
    let (t, q) = (submap.t_map_submap().translation.vector, submap.t_map_submap().rotation.coords);
    let pose = [t.x, t.y, t.z, q.x, q.y, q.z, q.w];
    let mut found = json!({ "id": submap.id(), "scans": submap.scans().len(), "origin": [submap.scans().len(), submap.travelled(), pose] });
    if !submap.tsdf().is_empty() {
        found["tsdf"] = tsdf(submap.tsdf());
    }
    if !submap.tsdf().colours().is_empty() {
        found["colr"] = colours(submap.tsdf());
    }
    if !submap.occupancy().is_empty() {
        found["occu"] = occupancy(submap.occupancy());
    }
    found
}

#[test]
fn a_reader_written_from_the_description_finds_what_is_in_a_map() {
    let Some(python) = voxelastic_testing::python("numpy, zstandard") else { return };
    let mut atlas: Atlas = made_up_atlas(5, 4, 60);
    // A real one, of several pages, with blocks that changed their scale.
    let (mut walk, field) = (Walk::new(true), atlas.submap_mut(2).unwrap().tsdf_mut());
    *field = TsdfField::default();
    (0..6).for_each(|_| walk.scan_into(field));
    let dir = tempfile::tempdir().unwrap();
    MapWriter::create(dir.path()).unwrap().save(&atlas, &details("python")).unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/store/read_map.py");
    let output = Command::new(python).arg(script).arg(dir.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut found: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    for submap in &mut found {
        if let Some(keys) = submap.pointer_mut("/tsdf/keys") {
            *keys = json!(keys.as_f64());
        }
    }
    let expected: Vec<Value> = atlas.submaps().iter().map(submap).collect();
    assert!(expected.iter().any(|s| s["occu"]["blocks"].as_u64() > Some(0)) && expected[2]["tsdf"]["blocks"].as_u64() > Some(1000));
    for (found, expected) in found.iter().zip(&expected) {
        let keys = |v: &Value| v.pointer("/tsdf/keys").and_then(Value::as_f64).unwrap_or(1.0);
        assert!((keys(found) / keys(expected) - 1.0).abs() < 1e-12);
        let without = |v: &Value| {
            let mut v = v.clone();
            v.pointer_mut("/tsdf/keys").map(Value::take);
            v
        };
        assert_eq!(without(found), without(expected));
    }
    assert_eq!(found.len(), expected.len());
}
