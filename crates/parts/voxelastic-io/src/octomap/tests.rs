//! What is written, as a reader of ours and as OctoMap itself read it.
// Tests say when they skip.
#![allow(clippy::print_stdout)]

use super::encode::REACH;
use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;
use voxelastic::geometry::morton;

/// Disjoint cubes around the origin, in Morton order.
fn cubes() -> impl Strategy<Value = Vec<Cube>> {
    let cube = (prop::array::uniform3(-20i32..20), 0u32..3, prop_oneof![-64i8..0, 1i8..=112]);
    prop::collection::vec(cube, 0..60).prop_map(|cubes| {
        let mut sorted: BTreeMap<u64, Cube> = BTreeMap::new();
        for (c, level, value) in cubes {
            let corner = c.map(|v| ((v >> level << level) + (1 << 20)) as u32);
            sorted.insert(morton::encode(corner), Cube { corner, level, value });
        }
        let mut end = 0;
        sorted.retain(|key, cube| {
            let is_apart = *key >= end;
            end = end.max(key + (1 << (3 * cube.level)));
            is_apart
        });
        sorted.into_values().collect()
    })
}

/// Splits a file into its number of nodes and its data.
fn take_apart(file: &[u8]) -> (usize, &[u8]) {
    let marker = b"\ndata\n";
    let start = file.windows(marker.len()).position(|w| w == marker).unwrap() + marker.len();
    let head = std::str::from_utf8(&file[..start]).unwrap();
    let size = head.lines().find_map(|l| l.strip_prefix("size ")).unwrap().parse().unwrap();
    (size, &file[start..])
}

/// Reads a `.bt` tree: the leaves with the sign of their state.
fn read_bt(data: &mut &[u8], corner: [u32; 3], level: u32, out: &mut Vec<Cube>) -> usize {
    let (head, rest) = data.split_at(2);
    *data = rest;
    let bits = u16::from_le_bytes([head[0], head[1]]);
    let mut nodes = 1;
    for i in 0..8u32 {
        let at = std::array::from_fn(|k| corner[k] + ((i >> k & 1) << (level - 1)));
        match bits >> (2 * i) & 3 {
            0 => {}
            3 => nodes += read_bt(data, at, level - 1, out),
            state => {
                out.push(Cube { corner: at, level: level - 1, value: if state == 2 { 1 } else { -1 } });
                nodes += 1;
            }
        }
    }
    nodes
}

/// Reads a `.ot` tree; returns the number of nodes and the value of this one.
fn read_ot(data: &mut &[u8], corner: [u32; 3], level: u32, out: &mut Vec<Cube>) -> (usize, i8) {
    let (head, rest) = data.split_at(5);
    *data = rest;
    let value = (f32::from_le_bytes([head[0], head[1], head[2], head[3]]) * 32.0) as i8;
    if head[4] == 0 {
        out.push(Cube { corner, level, value });
    }
    let (mut nodes, mut largest) = (1, i8::MIN);
    for i in (0..8u32).filter(|i| head[4] >> i & 1 == 1) {
        let at = std::array::from_fn(|k| corner[k] + ((i >> k & 1) << (level - 1)));
        let (below, child) = read_ot(data, at, level - 1, out);
        nodes += below;
        largest = largest.max(child);
    }
    assert!(head[4] == 0 || largest == value, "an inner node has the largest value below");
    (nodes, value)
}

proptest! {
    #[test]
    fn files_hold_the_cubes(cubes in cubes()) {
        let dir = tempfile::tempdir().unwrap();
        let (bt, ot) = (dir.path().join("a.bt"), dir.path().join("a.ot"));
        write_bt(&bt, 0.1, &cubes).unwrap();
        write_ot(&ot, 0.1, &cubes).unwrap();
        let corner = [(1 << 20) - REACH; 3];
        let (bt, ot) = (std::fs::read(bt).unwrap(), std::fs::read(ot).unwrap());
        let ((bt_size, mut bt), (ot_size, mut ot)) = (take_apart(&bt), take_apart(&ot));
        let (mut states, mut values) = (Vec::new(), Vec::new());
        if !cubes.is_empty() {
            prop_assert_eq!(read_bt(&mut bt, corner, 16, &mut states), bt_size);
            prop_assert_eq!(read_ot(&mut ot, corner, 16, &mut values).0, ot_size);
        }
        prop_assert!(bt.is_empty() && ot.is_empty());
        prop_assert_eq!(&values, &cubes);
        let signs: Vec<Cube> = cubes.iter().map(|c| Cube { value: c.value.signum(), ..*c }).collect();
        prop_assert_eq!(states, signs);
    }
}

#[test]
fn what_octomap_cannot_hold_is_refused() {
    let path = Path::new("x.bt");
    let at = |x: i32, level: u32| Cube { corner: [((1 << 20) + x) as u32, 1 << 20, 1 << 20], level, value: -1 };
    let message = |cubes: &[Cube], voxel: f64| write_bt(path, voxel, cubes).unwrap_err().to_string();
    assert!(message(&[at(32_768, 0)], 0.1).contains("choose larger voxels"));
    assert!(message(&[at(-32_769, 0)], 0.1).contains("choose larger voxels"));
    assert!(message(&[at(0, 16)], 0.1).contains("choose larger voxels"));
    assert!(message(&[at(1, 1)], 0.1).contains("multiple"));
    assert!(message(&[at(0, 1), at(1, 0)], 0.1).contains("overlap"));
    assert!(message(&[], f64::NAN).contains("NaN"));
    assert!(!path.exists());
}

/// Runs the script on a file with the real library; none when it is not installed.
fn octomap_leaves(path: &Path) -> Option<String> {
    voxelastic_testing::run_python("pyoctomap", include_str!("leaves.py"), &[path])
}

#[test]
fn octomap_itself_reads_the_same_states() {
    let mut cubes = Vec::new();
    for i in 0..3000u64 {
        // A wall with a hole, free space before it, in cubes of two sizes; Morton order by the key.
        let c = morton::decode(i).map(|v| v + (1 << 20) - 8);
        let value = if c[0] % 7 == 0 && c[1] % 5 != 0 { 80 } else { -(1 + (i % 60) as i8) };
        if i / 8 % 3 != 0 {
            cubes.push(Cube { corner: c, level: 0, value });
        } else if i % 8 == 0 {
            cubes.push(Cube { corner: c, level: 1, value });
        }
    }
    let dir = tempfile::tempdir().unwrap();
    for (name, states) in [("map.bt", true), ("map.ot", false)] {
        let path = dir.path().join(name);
        let written = if states { write_bt(&path, 0.065, &cubes) } else { write_ot(&path, 0.065, &cubes) };
        written.unwrap();
        let Some(text) = octomap_leaves(&path) else { return };
        let mut lines = text.lines().map(|l| l.split_whitespace().map(|n| n.parse::<f64>().unwrap()).collect::<Vec<f64>>());
        assert_eq!(lines.next().unwrap()[1], 0.065);
        let mut read: Vec<([i64; 3], i64, f64)> = lines
            .map(|l| {
                let low = std::array::from_fn(|k| ((l[k] - 0.5 * l[3]) / 0.065).round() as i64);
                (low, (l[3] / 0.065).round() as i64, l[4])
            })
            .collect();
        let mut expected: Vec<([i64; 3], i64, f64)> =
            cubes.iter().map(|c| (c.corner.map(|v| i64::from(v) - (1 << 20)), 1 << c.level, f64::from(c.value) / 32.0)).collect();
        read.sort_by_key(|l| l.0);
        expected.sort_by_key(|l| l.0);
        assert_eq!(read.len(), expected.len(), "{name}");
        for (a, b) in read.iter().zip(&expected) {
            let is_equal = if states { (a.2 > 0.0) == (b.2 > 0.0) } else { (a.2 - b.2).abs() < 1e-6 };
            assert!(a.0 == b.0 && a.1 == b.1 && is_equal, "{name}: {a:?} instead of {b:?}");
        }
    }
}
