//! Bad clouds: what each is answered.

use crate::common::encode::{Field, Table};
use std::path::Path;
use voxelastic_io::{CloudFormat, Error, Position, clouds, pcd, ply};

fn table(n: usize) -> Table {
    let fields = vec![Field("x", 'F', 4, 1), Field("y", 'F', 4, 1), Field("z", 'F', 4, 1), Field("ring", 'U', 2, 1)];
    Table { fields, rows: (0..n).map(|k| vec![1.0 + k as f64, 2.0, 3.0, 1.0]).collect(), width: n, height: 1 }
}

fn answer(bytes: &[u8], format: CloudFormat) -> Error {
    clouds::parse(bytes, Path::new("scan.x"), format).expect_err("taken for a good cloud")
}

fn edited(from: &str, to: &str) -> Error {
    let bytes = table(10).pcd("ascii");
    let text = String::from_utf8(bytes).unwrap();
    assert!(text.contains(from), "{from} is not in the file");
    answer(text.replacen(from, to, 1).as_bytes(), CloudFormat::Pcd)
}

#[test]
fn pcd_headers() {
    for (from, to, expected) in [
        ("FIELDS x y z", "FIELDS x y w", "field `z`: missing among the fields x y w ring"),
        ("TYPE F F F", "TYPE F F U", "field `z`: is an unsigned 32-bit integer; coordinates must be"),
        ("TYPE F F F", "TYPE F F Q", "field `z`: has type Q of size 4"),
        ("SIZE 4 4 4", "SIZE 4 4 3", "field `z`: has type F of size 3"),
        ("COUNT 1 1 1", "COUNT 1 1 2", "field `z`: is 2 numbers"),
        ("SIZE 4 4 4 2", "SIZE 4 4 4", "another number of SIZE"),
        ("WIDTH 10", "WIDTH ten", "line 7: WIDTH is \"ten\", not a number"),
        ("WIDTH 10", "WIDTH 9", "POINTS is 10, but WIDTH x HEIGHT is 9"),
        ("WIDTH 10", "WIDTH 18446744073709551615", "POINTS is 10"),
        ("HEIGHT 1", "HEIGHT 1\nHEIGTH 1", "line 9: unknown header entry"),
        ("DATA ascii", "DATA zip", "it must be ascii, binary or binary_compressed"),
        ("DATA ascii", "", "unknown header entry"),
        ("5 2 3 1", "5 two 3 1", "line 16, field y: \"two\" is not a number"),
        ("5 2 3 1", "5 2 3", "line 16: 3 numbers instead of 4"),
        ("10 2 3 1\n", "", "line 21: the file ends with 9 of the 10"),
        ("10 2 3 1\n", "10 2 3 1\n1 1 1 1\n", "line 22: there is more after the 10 points"),
    ] {
        let error = edited(from, to).to_string();
        assert!(error.starts_with("scan.x") && error.contains(expected), "{from} -> {to}: {error}");
    }
}

#[test]
fn shorter_than_claimed() {
    let binary = table(10).pcd("binary");
    let error = answer(&binary[..binary.len() - 1], CloudFormat::Pcd);
    assert_eq!(error.position(), Position::Byte(binary.len() as u64 - 1));
    assert!(error.to_string().contains("with 9 of the 10 points"), "{error}");
    assert!(error.remedy().contains("truncated"));
    let ply = table(10).ply("binary_little_endian");
    assert!(answer(&ply[..ply.len() - 60], CloudFormat::Ply).to_string().contains("ends within row"));
    let packed = table(10).pcd("binary_compressed");
    assert!(answer(&packed[..packed.len() - 1], CloudFormat::Pcd).to_string().contains("the file ends here"));
}

#[test]
fn damaged_compression() {
    let good = table(200).pcd("binary_compressed");
    let body = good.windows(6).position(|w| w == b"essed\n").unwrap() + 6;
    let mut bad = good.clone();
    bad[body + 8] = 0xff; // a copy from before the beginning
    let error = answer(&bad, CloudFormat::Pcd);
    assert_eq!(error.position(), Position::Byte(body as u64 + 8));
    assert!(error.to_string().contains("damaged"), "{error}");
    let mut bad = good;
    bad[body + 4] ^= 1; // the unpacked size
    assert!(answer(&bad, CloudFormat::Pcd).to_string().contains("unpacked bytes"));
}

#[test]
fn nothing_in_it() {
    for format in [CloudFormat::Pcd, CloudFormat::Ply] {
        assert!(answer(&[], format).to_string().contains("header"), "{format}");
        assert!(answer(&[0; 4096], format).to_string().contains("convert it again"), "{format}");
    }
    assert!(matches!(answer(&[0; 4096], CloudFormat::KittiBin), Error::NoReturn { points: 256, .. }));
    let nan = |n: usize| {
        let mut table = table(10);
        table.rows.iter_mut().take(n).for_each(|r| r[..3].fill(f64::NAN));
        table.pcd("binary")
    };
    assert!(matches!(answer(&nan(10), CloudFormat::Pcd), Error::NoReturn { points: 10, .. }));
    assert_eq!(pcd::parse(&nan(9), Path::new("a")).unwrap().cloud.len(), 10);
    assert!(matches!(answer(&table(0).pcd("binary"), CloudFormat::Pcd), Error::NoReturn { points: 0, .. }));
}

#[test]
fn ply_headers() {
    let good = String::from_utf8(table(3).ply("ascii")).unwrap();
    for (from, to, expected) in [
        ("ply\n", "obj\n", "line 1: the file does not begin with ply"),
        ("format ascii 1.0", "format text 1.0", "line 2: unknown format"),
        ("format ascii 1.0\n", "", "lacks a format line"),
        ("element vertex 3", "element vertex many", "element vertex has the count \"many\""),
        ("element vertex 3", "element point 3", "the file has no vertices"),
        ("property float x", "property float u", "field `x`: missing"),
        ("property float x", "property int x", "field `x`: is a 32-bit integer"),
        ("property float x", "property real x", "no type that PLY knows"),
        ("property float x", "property list uchar float x", "the vertices hold lists"),
        ("end_header\n", "", "unknown header entry"),
    ] {
        assert!(good.contains(from), "{from}");
        let error = answer(good.replacen(from, to, 1).as_bytes(), CloudFormat::Ply).to_string();
        assert!(error.contains(expected), "{from} -> {to}: {error}");
    }
}

#[test]
fn no_file_and_no_format() {
    assert!(matches!(clouds::read("no/such.pcd"), Err(Error::Io { .. })));
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notes.txt");
    std::fs::write(&path, "hello").unwrap();
    assert!(clouds::read(&path).unwrap_err().to_string().contains("clouds are .pcd, .ply, .bin, .las, .laz or .e57"));
    assert!(matches!(ply::read_mesh(dir.path()), Err(Error::Io { .. })));
}
