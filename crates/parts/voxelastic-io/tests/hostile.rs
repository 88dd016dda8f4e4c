//! Files that were damaged or made to harm: nothing panics, and memory follows the file and not its claims. A process of its own, because it measures
//! its peak of memory.

#[path = "all/common/damage.rs"]
mod damage;
#[path = "all/common/encode.rs"]
mod encode;

use damage::{Random, soak};
use encode::{Field, Table};
use std::path::Path;
use std::time::Duration;
use voxelastic::Cloud;
use voxelastic_io::bin::{self, BinLayout};
use voxelastic_io::{PoseFormat, g2o, pcd, ply, poses};

fn is_consistent(cloud: &Cloud) -> bool {
    let n = cloud.points.len();
    let fits = |len: Option<usize>| len.is_none_or(|len| len == n);
    cloud.width * cloud.height == n
        && cloud.points.iter().any(Cloud::is_return)
        && fits(cloud.intensity.as_ref().map(Vec::len))
        && fits(cloud.colours.as_ref().map(Vec::len))
        && fits(cloud.ring.as_ref().map(Vec::len))
        && fits(cloud.time.as_ref().map(Vec::len))
}

type Reader = Box<dyn Fn(&[u8])>;

/// A good file of every format, and a reader that checks what it gets.
fn formats() -> Vec<(String, Vec<u8>, Reader)> {
    let path = Path::new("a");
    let mut fields: Vec<Field> = ["x", "y", "z", "intensity"].map(|n| Field(n, 'F', 4, 1)).to_vec();
    fields.extend([Field("ring", 'U', 2, 1), Field("t", 'U', 4, 1)]);
    let row = |k: usize| vec![k as f64 * 0.5, 1.0, -2.0, (k % 7) as f64, (k % 64) as f64, k as f64 * 1e5];
    let table = Table { fields, rows: (0..60).map(row).collect(), width: 20, height: 3 };
    let mut all: Vec<(String, Vec<u8>, Reader)> = Vec::new();
    for data in ["ascii", "binary", "binary_compressed"] {
        let read = move |b: &[u8]| assert!(pcd::parse(b, path).is_ok_and(|c| is_consistent(&c.cloud)) || pcd::parse(b, path).is_err());
        all.push((format!("PCD {data}"), table.pcd(data), Box::new(read)));
    }
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let read = move |b: &[u8]| {
            if let Ok(read) = ply::parse_cloud(b, path) {
                assert!(is_consistent(&read.cloud));
            }
            if let Ok(mesh) = ply::parse_mesh(b, path) {
                assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
            }
        };
        all.push((format!("PLY {format}"), table.ply(format), Box::new(read)));
    }
    let bin: Vec<u8> = table.rows.iter().flat_map(|r| r[..4].iter().flat_map(|v| (*v as f32).to_le_bytes())).collect();
    all.push(("KITTI bin".into(), bin, Box::new(move |b| drop(bin::parse(b, path, BinLayout::Kitti)))));

    let unit = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1";
    let lines = |line: &dyn Fn(usize) -> String| (0..20).map(line).collect::<String>().into_bytes();
    for (format, text) in [
        (PoseFormat::TUM, lines(&|k| format!("{k}.5 1 2 3 0 0.6 0 0.8\n"))),
        (PoseFormat::KITTI, lines(&|k| format!("1 0 0 {k} 0 1e0 0 2 0 0 1 3\n"))),
        (PoseFormat::NEWER_COLLEGE, lines(&|k| format!("{k},500000000,1,2,3,0,0.6,0,0.8\n"))),
        (PoseFormat::G2o, lines(&|k| format!("VERTEX_SE3:QUAT {k} 1 2 3 0 0 0 1\nEDGE_SE3:QUAT 0 {} 1 0 0 0 0 0 1 {unit}\n", k.max(1)))),
    ] {
        let read = move |b: &[u8]| {
            let text = String::from_utf8_lossy(b);
            if let Ok(trajectory) = poses::parse(&text, path, format) {
                assert!(trajectory.poses.iter().all(|p| (p.rotation.norm() - 1.0).abs() < 1e-9));
                assert!(trajectory.times.is_none_or(|t| t.windows(2).all(|w| w[0] < w[1])));
            }
            let _ = (g2o::parse(&text, path), poses::parse_times(&text, path));
        };
        read(&text);
        poses::parse(&String::from_utf8_lossy(&text), path, format).unwrap();
        all.push((format.to_string(), text, Box::new(read)));
    }
    all
}

#[test]
fn flipped_bytes_truncations_zeros_and_noise() {
    let mut random = Random::new();
    for (name, good, read) in formats() {
        read(&good);
        soak(&name, &good, 2000, Duration::from_secs(5), |bad| {
            read(bad);
            true
        });
        (0..good.len()).for_each(|end| read(&good[..end]));
        let noise: Vec<u8> = (0..4096).map(|_| random.below(256) as u8).collect();
        (0..64).for_each(|k| read(&noise[..k * 64]));
        read(&[0; 4096]);
        // A good beginning with noise behind it.
        (0..200).for_each(|_| read(&[&good[..random.below(good.len())], &noise[..]].concat()));
    }
    assert!(peak_mb().is_none_or(|mb| mb < 512.0), "memory for claims: {:?} MB", peak_mb());
}

#[test]
fn ten_gigabytes_claimed_by_a_kilobyte() {
    let before = peak_mb();
    let huge = 10_000_000_000usize;
    let mut claims: Vec<(String, Vec<u8>)> = Vec::new();
    for data in ["ascii", "binary", "binary_compressed"] {
        for (count, points) in [(1, huge), (huge, 1), (huge, huge), (usize::MAX, usize::MAX), (1, usize::MAX)] {
            let header = format!(
                "VERSION 0.7\nFIELDS x y z p\nSIZE 4 4 4 8\nTYPE F F F F\nCOUNT 1 1 1 {count}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {data}\n"
            );
            let body = if data == "binary_compressed" { [0xff; 1024] } else { [b'1'; 1024] };
            claims.push((format!("PCD {data} {count} x {points}"), [header.as_bytes(), &body].concat()));
        }
    }
    for (name, bytes) in &claims {
        assert!(pcd::parse(bytes, Path::new("a")).is_err(), "{name}");
    }
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        for count in [huge, usize::MAX] {
            let xyz = "property float x\nproperty float y\nproperty float z\n";
            let vertices = format!("ply\nformat {format} 1.0\nelement vertex {count}\n{xyz}end_header\n");
            let empty = format!("ply\nformat {format} 1.0\nelement nothing {count}\nelement vertex {count}\n{xyz}end_header\n");
            let list = format!("ply\nformat {format} 1.0\nelement a 1\nproperty list uint float l\nelement vertex 1\n{xyz}end_header\n");
            let faces =
                format!("ply\nformat {format} 1.0\nelement vertex 0\n{xyz}element face {count}\nproperty list uint int vertex_indices\nend_header\n");
            for header in [vertices, empty, list, faces] {
                let bytes = [header.as_bytes(), &[0xf0; 1024]].concat();
                assert!(ply::parse_cloud(&bytes, Path::new("a")).is_err());
                assert!(ply::parse_mesh(&bytes, Path::new("a")).is_err());
            }
            let no_rows = format!("ply\nformat {format} 1.0\nelement vertex 0\n{xyz}element face {count}\nend_header\n");
            let _ = ply::parse_mesh(no_rows.as_bytes(), Path::new("a"));
        }
    }
    let (Some(before), Some(after)) = (before, peak_mb()) else {
        voxelastic_testing::skip(voxelastic_testing::Need::System, "the peak of memory is unknown on this system");
        return;
    };
    assert!(after - before < 512.0, "claims took {} MB", after - before);
}

/// The most address space that this process has had, in megabytes. Counts what was asked for, touched or not.
fn peak_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmPeak:"))?;
    line.split_ascii_whitespace().nth(1)?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}
