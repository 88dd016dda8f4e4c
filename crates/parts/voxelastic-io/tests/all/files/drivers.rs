//! Field layouts as drivers and LIO systems write them.

use crate::common::encode::{Field, Table};
use std::path::Path;
use voxelastic_io::{StampedCloud, pcd};

fn read(fields: &[Field], rows: &[Vec<f64>]) -> StampedCloud {
    let table = Table { fields: fields.to_vec(), rows: rows.to_vec(), width: rows.len(), height: 1 };
    pcd::parse(&table.pcd("binary"), Path::new("a.pcd")).unwrap()
}

fn xyz() -> Vec<Field> {
    ["x", "y", "z"].map(|n| Field(n, 'F', 4, 1)).to_vec()
}

fn close(times: &Option<Vec<f32>>, expected: [f32; 2]) {
    let times = times.as_ref().unwrap();
    assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{times:?}");
}

#[test]
fn ouster() {
    let mut fields = xyz();
    fields.extend([
        Field("_", 'U', 1, 4),
        Field("intensity", 'F', 4, 1),
        Field("t", 'U', 4, 1),
        Field("reflectivity", 'U', 2, 1),
        Field("ring", 'U', 2, 1),
        Field("ambient", 'U', 2, 1),
        Field("range", 'U', 4, 1),
    ]);
    let row = |t, ring| vec![1.0, 2.0, 3.0, 0.0, 55.0, t, 7.0, ring, 9.0, 3741.0];
    let read = read(&fields, &[row(0.0, 3.0), row(99_000_000.0, 127.0)]);
    close(&read.cloud.time, [0.0, 0.099]);
    assert_eq!((read.cloud.ring, read.cloud.intensity), (Some(vec![3, 127]), Some(vec![55.0; 2])));
    assert_eq!(read.stamp, None);
}

#[test]
fn velodyne_and_lio_sam() {
    let mut fields = xyz();
    fields.extend([Field("intensity", 'F', 4, 1), Field("ring", 'U', 2, 1), Field("time", 'F', 4, 1)]);
    let read = read(&fields, &[vec![1.0, 0.0, 0.0, 4.0, 15.0, -0.05], vec![1.0, 0.0, 0.0, 4.0, 0.0, 0.05]]);
    close(&read.cloud.time, [-0.05, 0.05]);
    assert_eq!(read.cloud.ring, Some(vec![15, 0]));
}

#[test]
fn livox() {
    let mut fields = xyz();
    fields.extend([Field("reflectivity", 'U', 1, 1), Field("tag", 'U', 1, 1), Field("line", 'U', 1, 1), Field("offset_time", 'U', 4, 1)]);
    let read = read(&fields, &[vec![1.0, 0.0, 0.0, 200.0, 16.0, 5.0, 0.0], vec![1.0, 0.0, 0.0, 10.0, 16.0, 0.0, 1e8]]);
    close(&read.cloud.time, [0.0, 0.1]);
    assert_eq!((read.cloud.ring, read.cloud.intensity), (Some(vec![5, 0]), Some(vec![200.0, 10.0])));
}

#[test]
fn fast_lio() {
    let mut fields = xyz();
    fields.extend(["intensity", "normal_x", "normal_y", "normal_z", "curvature"].map(|n| Field(n, 'F', 4, 1)));
    let read = read(&fields, &[vec![1.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0], vec![1.0, 0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 98.5]]);
    close(&read.cloud.time, [0.0, 0.0985]);
}

#[test]
fn hesai_and_robosense() {
    let mut fields = xyz();
    fields.extend([Field("intensity", 'F', 4, 1), Field("timestamp", 'F', 8, 1), Field("ring", 'U', 2, 1)]);
    let t0 = 1_700_000_000.25;
    let read = read(&fields, &[vec![1.0, 0.0, 0.0, 9.0, t0, 0.0], vec![1.0, 0.0, 0.0, 9.0, t0 + 0.0625, 1.0]]);
    assert_eq!(read.cloud.time, Some(vec![0.0, 0.0625]));
    assert_eq!(read.stamp, Some(t0));
}
