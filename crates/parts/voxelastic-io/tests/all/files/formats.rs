//! All encodings of the same points are the same cloud.

use crate::common::encode::{Field, Table};
use proptest::prelude::*;
use std::path::Path;
use std::time::Instant;
use voxelastic::Cloud;
use voxelastic_io::bin::{self, BinLayout};
use voxelastic_io::{pcd, ply};

const NAME: &str = "a";

fn pcd_cloud(bytes: &[u8]) -> Cloud {
    pcd::parse(bytes, Path::new(NAME)).unwrap().cloud
}

fn ply_cloud(bytes: &[u8]) -> Cloud {
    ply::parse_cloud(bytes, Path::new(NAME)).unwrap().cloud
}

/// Fields in random order and of random types, padding among them, with random points.
fn tables() -> impl Strategy<Value = Table> {
    let float = prop_oneof![Just(4usize), Just(8)];
    let integer = prop_oneof![Just(('U', 1usize)), Just(('U', 2)), Just(('I', 4)), Just(('F', 4))];
    let fields = (prop::array::uniform3(float), integer.clone(), integer, prop::sample::select(vec![1usize, 4, 13]));
    let fields = fields.prop_flat_map(|([x, y, z], ring, strength, padding)| {
        Just(vec![
            Field("x", 'F', x, 1),
            Field("y", 'F', y, 1),
            Field("z", 'F', z, 1),
            Field("ring", ring.0, ring.1, 1),
            Field("intensity", strength.0, strength.1, 1),
            Field("t", 'U', 4, 1),
            Field("_", 'U', 1, padding),
            Field("normal_x", 'F', 4, 1),
        ])
        .prop_shuffle()
    });
    let row = (prop::array::uniform3(-200i32..200), 0u8..128, 0u8..100, 0u32..100_000_000);
    (fields, 1usize..4, prop::collection::vec(row, 1..30)).prop_map(|(fields, height, rows)| {
        let width = rows.len().div_ceil(height);
        let mut rows: Vec<Vec<f64>> = rows
            .into_iter()
            .map(|(p, ring, strength, t)| {
                let value = |f: &Field| match f.0 {
                    "x" => f64::from(p[0]) * 0.125 + 0.0625,
                    "y" => f64::from(p[1]) * 0.125,
                    "z" => f64::from(p[2]) * 0.125,
                    "ring" => f64::from(ring),
                    "intensity" => f64::from(strength),
                    "t" => f64::from(t),
                    _ => 1.0,
                };
                fields.iter().map(value).collect()
            })
            .collect();
        rows.resize(width * height, rows[0].clone());
        Table { fields, rows, width, height }
    })
}

fn expected(table: &Table) -> Cloud {
    let column = |name: &str| -> Vec<f64> {
        let k = table.fields.iter().position(|f| f.0 == name).unwrap();
        table.rows.iter().map(|r| r[k]).collect()
    };
    let (x, y, z) = (column("x"), column("y"), column("z"));
    Cloud {
        points: (0..x.len()).map(|k| [x[k] as f32, y[k] as f32, z[k] as f32]).collect(),
        width: table.width,
        height: table.height,
        intensity: Some(column("intensity").iter().map(|v| *v as f32).collect()),
        ring: Some(column("ring").iter().map(|v| *v as u16).collect()),
        time: Some(column("t").iter().map(|v| (v * 1e-9) as f32).collect()),
        ..Cloud::default()
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn every_encoding_is_the_same_cloud(table in tables()) {
        let expected = expected(&table);
        for data in ["ascii", "binary", "binary_compressed"] {
            prop_assert_eq!(&pcd_cloud(&table.pcd(data)), &expected, "{}", data);
        }
        let table = Table { fields: table.fields.iter().map(|f| Field(f.0, f.1, f.2, 1)).collect(), width: table.rows.len(), height: 1, ..table };
        let expected = Cloud { width: table.width, height: 1, ..expected };
        for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
            prop_assert_eq!(&ply_cloud(&table.ply(format)), &expected, "{}", format);
        }
    }

    #[test]
    fn written_clouds_read_back(points in prop::collection::vec(prop::array::uniform3(-500.0f32..500.0), 1..50), channels: [bool; 4], rows in 1usize..3) {
        let n = points.len() / rows * rows;
        prop_assume!(n > 0 && points[..n].iter().any(Cloud::is_return));
        let mut points = points[..n].to_vec();
        if n > 1 {
            points[n - 1] = [f32::NAN; 3];
        }
        let channel = |scale: f32| (0..n).map(|k| k as f32 * scale).collect::<Vec<f32>>();
        let cloud = Cloud {
            width: n / rows,
            height: rows,
            intensity: channels[0].then(|| channel(3.5)),
            time: channels[1].then(|| channel(0.001)),
            ring: channels[2].then(|| (0..n as u16).collect()),
            colours: channels[3].then(|| (0..n).map(|k| [k as u8, 255 - k as u8, 7]).collect()),
            points,
            ..Cloud::default()
        };
        let dir = tempfile::tempdir().unwrap();
        pcd::write(dir.path().join("c.pcd"), &cloud).unwrap();
        let back = pcd::read(dir.path().join("c.pcd")).unwrap().cloud;
        let bits = |c: &Cloud| c.points.iter().flatten().map(|v| v.to_bits()).collect::<Vec<_>>();
        prop_assert_eq!(bits(&back), bits(&cloud));
        prop_assert_eq!((back.width, back.height), (cloud.width, cloud.height));
        prop_assert_eq!((back.intensity, back.colours, back.time, back.ring), (cloud.intensity, cloud.colours, cloud.time, cloud.ring));
    }
}

#[test]
#[ignore = "a measurement, for a quiet machine: cargo test --release -p voxelastic-io --test all files -- --ignored --nocapture"]
fn a_million_points_a_second_at_least() {
    // A sweep as drivers write it: x y z intensity time ring, 131,072 points.
    let fields = vec![
        Field("x", 'F', 4, 1),
        Field("y", 'F', 4, 1),
        Field("z", 'F', 4, 1),
        Field("intensity", 'F', 4, 1),
        Field("time", 'F', 4, 1),
        Field("ring", 'U', 2, 1),
    ];
    let row = |k: usize| {
        let a = k as f64 * 0.01;
        vec![20.0 * a.cos(), 20.0 * a.sin(), (k % 128) as f64 * 0.1 - 3.0, (k % 200) as f64, k as f64 * 7e-7, (k % 128) as f64]
    };
    let n = 1 << 17;
    let table = Table { fields, rows: (0..n).map(row).collect(), width: n, height: 1 };
    let time = |name: &str, bytes: Vec<u8>, parse: &dyn Fn(&[u8]) -> Cloud| {
        let best = (0..5)
            .map(|_| {
                let start = Instant::now();
                assert_eq!(parse(&bytes).len(), n);
                start.elapsed().as_secs_f64()
            })
            .fold(f64::INFINITY, f64::min);
        let rate = n as f64 / best / 1e6;
        eprintln!("{name}: {:.2} ms, {rate:.1} M points/s, {:.0} MB/s", best * 1e3, bytes.len() as f64 / best / 1e6);
        assert!(rate > 1.0, "{name}: {rate} M points/s");
    };
    for data in ["ascii", "binary", "binary_compressed"] {
        time(&format!("PCD {data}"), table.pcd(data), &pcd_cloud);
    }
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        time(&format!("PLY {format}"), table.ply(format), &ply_cloud);
    }
    let bin: Vec<u8> = table.rows.iter().flat_map(|r| r[..4].iter().flat_map(|v| (*v as f32).to_le_bytes())).collect();
    time("KITTI bin", bin, &|bytes| bin::parse(bytes, Path::new(NAME), BinLayout::Kitti).unwrap().cloud);
}
