//! `map --interpolate` and `mesh --interpolated`.

use crate::{json, works};
use voxelastic_io::ply;

#[test]
fn gaps_between_rings_are_closed_where_that_is_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --spacing 1 --scans 12 --drift 0");
    works(dir.path(), "map street -o street.vox --poses groundtruth --hold-out 6 --voxel-size 0.1 --interpolate 3");
    let measured = json(dir.path(), "mesh street.vox -o measured.ply --json");
    assert!(measured["interpolated"].is_null(), "{measured}");
    let all = json(dir.path(), "mesh street.vox -o all.ply --interpolated --json");
    let marked = all["interpolated"].as_u64().unwrap();
    assert!(marked * 10 > all["vertices"].as_u64().unwrap(), "{all}");
    assert_eq!(ply::read_mesh(dir.path().join("all.ply")).unwrap().positions.len() as u64, all["vertices"].as_u64().unwrap());
    // In GLB files as in PLY files.
    std::fs::create_dir(dir.path().join("glb")).unwrap();
    works(dir.path(), "mesh street.vox -o glb/all.glb --interpolated");
    let bytes = std::fs::read(dir.path().join("glb/all.glb")).unwrap();
    let json_length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let document: serde_json::Value = serde_json::from_slice(&bytes[20..20 + json_length]).unwrap();
    let accessor = &document["meshes"][0]["primitives"][0]["attributes"]["_INTERPOLATED"];
    let view = &document["bufferViews"][document["accessors"][accessor.as_u64().unwrap() as usize]["bufferView"].as_u64().unwrap() as usize];
    let (from, length) = (view["byteOffset"].as_u64().unwrap() as usize + 28 + json_length, view["byteLength"].as_u64().unwrap() as usize);
    assert_eq!(bytes[from..from + length].iter().step_by(4).map(|mark| u64::from(*mark)).sum::<u64>(), marked);
    // The validator takes tiles.
    let root = serde_json::json!({
        "boundingVolume": { "box": [0, 0, 0, 1000, 0, 0, 0, 1000, 0, 0, 0, 1000] }, "geometricError": 0, "refine": "REPLACE", "content": { "uri": "all.glb" },
    });
    let tileset = serde_json::json!({ "asset": { "version": "1.1" }, "geometricError": 1, "root": root });
    std::fs::write(dir.path().join("glb/tileset.json"), tileset.to_string()).unwrap();
    if let Some((is_valid, said)) = crate::tiles::validate(&dir.path().join("glb")) {
        assert!(is_valid && said["glb"] == 1, "{said}");
    }
    let within = |more: &str| {
        let held_out = json(dir.path(), &format!("heldout street.vox street --poses groundtruth --hold-out 6 --max-range 60 --json {more}"));
        held_out["distances"]["fraction_under_10cm"].as_f64().unwrap()
    };
    let (without, with) = (within(""), within("--interpolated"));
    assert!(with > without, "{with} {without}");
    assert!(works(dir.path(), "info street.vox --json").contains("\"interpolate\":\"3\""));
}
