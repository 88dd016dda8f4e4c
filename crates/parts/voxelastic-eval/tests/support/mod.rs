//! Input for other programs and for the tests.

use std::path::Path;
use voxelastic::Pose;

/// Numbers of a text separated by white space.
pub fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|t| t.parse().unwrap()).collect()
}

/// Writes points as little-endian f32 triples.
pub fn write_points(path: &Path, points: &[[f32; 3]]) {
    let bytes: Vec<u8> = points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    std::fs::write(path, bytes).unwrap();
}

/// Little-endian f32 numbers of a file.
pub fn read_f32(path: &Path) -> Vec<f32> {
    std::fs::read(path).unwrap().chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect()
}

/// A scan of `hall` (binary PCD of x y z as f32) and its pose in the map.
pub fn hall_scan(folder: &Path, number: usize) -> (Vec<[f32; 3]>, Pose) {
    let bytes = std::fs::read(folder.join(format!("scans/{number:06}.pcd"))).unwrap();
    let mark = b"DATA binary\n";
    let start = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
    let value = |b: &[u8], k: usize| f32::from_le_bytes(b[4 * k..4 * k + 4].try_into().unwrap());
    let points = bytes[start..].chunks_exact(12).map(|b| [value(b, 0), value(b, 1), value(b, 2)]).collect();
    let poses = std::fs::read_to_string(folder.join("poses.tum")).unwrap();
    let line = poses.lines().filter(|l| !l.starts_with('#')).nth(number).unwrap();
    let v = numbers(line);
    let q = nalgebra::Quaternion::new(v[7], v[4], v[5], v[6]);
    let pose = Pose::from_parts(nalgebra::Translation3::new(v[1], v[2], v[3]), nalgebra::UnitQuaternion::from_quaternion(q));
    (points, pose)
}

/// Numbers in 0..1 that look random and are the same every time.
pub fn random(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}
