#![no_main]

use std::path::Path;
use voxelastic_io::{PoseFormat, g2o, poses};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let (text, path) = (String::from_utf8_lossy(data), Path::new("a"));
    for format in [PoseFormat::TUM, PoseFormat::KITTI, PoseFormat::NEWER_COLLEGE, PoseFormat::G2o] {
        if let Ok(trajectory) = poses::parse(&text, path, format) {
            assert!(trajectory.poses.iter().all(|p| (p.rotation.norm() - 1.0).abs() < 1e-9));
            assert!(trajectory.times.is_none_or(|t| t.windows(2).all(|w| w[0] < w[1])));
        }
    }
    let _ = (g2o::parse(&text, path), poses::parse_times(&text, path));
});
