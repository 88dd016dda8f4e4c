#![no_main]

use std::path::Path;
use voxelastic_io::{CloudFormat, ply};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    voxelastic_fuzz::read_cloud(data, CloudFormat::Ply);
    if let Ok(mesh) = ply::parse_mesh(data, Path::new("a")) {
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
        assert!(mesh.colours.is_none_or(|c| c.len() == mesh.positions.len()));
    }
});
