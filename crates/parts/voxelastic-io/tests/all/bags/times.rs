//! Times of points as drivers, recorders and converters write them: twelve encodings and two more, four orders, three clocks, two formats. Each is read right, or as none.

use super::message_bag::Bag;
use std::path::Path;
use voxelastic::Cloud;
use voxelastic_io::{OpenOptions, raw};

const SCANS: usize = 5;
const COLUMNS: usize = 64;
const RINGS: usize = 8;
/// Duration of a sweep and time between sweeps, seconds.
const SWEEP: f64 = 0.1;
/// By the clock of the machine, and by that of a sensor that counts from its start.
const EPOCH: f64 = 1_700_000_000.5;
const BOOT: f64 = 1234.5;

/// A field for times, its type (letter and bytes of PCD, number of `sensor_msgs/PointField`), and what it holds: of the time since the sweep began, the time by the sensor's
/// clock, and the time since the recording began, seconds.
struct Encoding {
    field: &'static str,
    kind: (char, usize, u8),
    value: fn(f64, f64, f64) -> f64,
    /// Whether it cannot hold what it claims.
    is_lost: bool,
    is_absolute: bool,
}

const F32: (char, usize, u8) = ('F', 4, 7);
const F64: (char, usize, u8) = ('F', 8, 8);
const U32: (char, usize, u8) = ('U', 4, 6);

fn encodings() -> Vec<Encoding> {
    let of = |field, kind, value| Encoding { field, kind, value, is_lost: false, is_absolute: false };
    let absolute = |scale| Encoding { is_absolute: true, ..of("timestamp", F64, scale) };
    vec![
        of("t", U32, |t, _, _| t * 1e9),
        of("timestamp", U32, |t, _, _| t * 1e6),
        of("time", F32, |t, _, _| t),
        of("time", F32, |t, _, _| t - SWEEP),
        of("time", F32, |t, _, _| t * 1e3),
        of("time", F32, |t, _, _| t * 1e6),
        of("curvature", F32, |t, _, _| t * 1e3),
        of("timestamp", F64, |t, _, _| t / SWEEP),
        absolute(|_, clock, _| clock),
        absolute(|_, clock, _| clock * 1e3),
        absolute(|_, clock, _| clock * 1e6),
        absolute(|_, clock, _| clock * 1e9),
        of("time", F32, |_, _, since| since),
        Encoding { is_lost: true, ..of("time", F32, |_, clock, _| clock + EPOCH) },
    ]
}

/// One cloud: each point with the time since its sweep began.
fn points(order: usize, k: usize) -> Vec<([f32; 3], f64)> {
    let at = |column: usize, ring: usize| {
        let azimuth = column as f32 / COLUMNS as f32 * std::f32::consts::TAU;
        // The first ring begins without returns.
        let is_return = ring != 0 || column > 15;
        let point = if is_return { [10.0 * azimuth.cos(), 10.0 * azimuth.sin(), ring as f32] } else { [f32::NAN; 3] };
        (point, column as f64 / COLUMNS as f64 * SWEEP)
    };
    let mut all: Vec<([f32; 3], f64)> = (0..COLUMNS * RINGS).map(|i| at(i / RINGS, i % RINGS)).collect();
    match order {
        0 => {}
        1 => all.sort_by(|a, b| a.0[2].total_cmp(&b.0[2])),
        2 => all.reverse(),
        _ => all.sort_by_key(|(point, t)| (u64::from(point[0].to_bits()) * 2_654_435_761 + (t * 1e6) as u64 + k as u64) % 1009),
    }
    all
}

fn put(value: f64, (letter, bytes, _): (char, usize, u8), out: &mut Vec<u8>) {
    match (letter, bytes) {
        ('F', 4) => out.extend((value as f32).to_le_bytes()),
        ('F', _) => out.extend(value.to_le_bytes()),
        _ => out.extend((value.round() as u32).to_le_bytes()),
    }
}

fn write_pcd(folder: &Path, stamp: f64, encoding: &Encoding, data: &[u8], count: usize) {
    let (letter, bytes, _) = encoding.kind;
    let name = encoding.field;
    let head = format!(
        "VERSION 0.7\nFIELDS x y z {name}\nSIZE 4 4 4 {bytes}\nTYPE F F F {letter}\nCOUNT 1 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA binary\n"
    );
    std::fs::write(folder.join(format!("{stamp:.6}.pcd")), [head.as_bytes(), data].concat()).unwrap();
}

/// When messages are recorded, seconds after the clouds in them began.
const LATE: f64 = 0.125;

fn add_cloud(bag: &mut Bag, [stamp, recorded]: [f64; 2], encoding: &Encoding, data: &[u8], count: usize) {
    let (_, bytes, number) = encoding.kind;
    bag.add(("/points", "sensor_msgs/PointCloud2"), recorded, |body| {
        let fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), (encoding.field, 12, number)];
        let body = fields.into_iter().fold(body.header(stamp, "lidar").u32(1).u32(count).u32(4), |body, (name, offset, kind)| {
            body.text(name).u32(offset).bytes(&[kind]).u32(1)
        });
        body.bytes(&[0]).u32(12 + bytes).u32((12 + bytes) * count).sequence(data).bytes(&[1])
    });
}

/// Errors of the times within the clouds, and of those of the clock: the largest, seconds; none where clouds have no times.
fn errors(path: &Path, order: usize, begins: &[f64]) -> Option<(f64, f64)> {
    let scans: Vec<_> = raw::open(path, &OpenOptions::default()).unwrap().iter().map(Result::unwrap).collect();
    assert_eq!(scans.len(), SCANS);
    let (mut within, mut by_clock) = (0.0f64, 0.0f64);
    for (k, scan) in scans.iter().enumerate() {
        let times = scan.cloud.time.as_ref()?;
        let truth = points(order, k);
        let of_returns = || {
            times.iter().zip(&truth).zip(&scan.cloud.points).filter(|(_, p)| Cloud::is_return(p)).map(|((t, (_, right)), _)| (f64::from(*t), *right))
        };
        let first = of_returns().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        within = of_returns().map(|(t, right)| (t - first.0 - (right - first.1)).abs()).fold(within, f64::max);
        by_clock = of_returns().map(|(t, right)| (scan.time + t - begins[k] - right).abs()).fold(by_clock, f64::max);
    }
    Some((within, by_clock))
}

#[test]
fn times_are_read_right_or_as_none() {
    let dir = tempfile::tempdir().unwrap();
    let (mut right, mut none) = (0, 0);
    for (number, encoding) in encodings().iter().enumerate() {
        for (order, clock, is_bag) in (0..24).map(|c| (c % 4, c / 4 % 3, c / 12 == 1)) {
            let case = format!("encoding {number} ({}), order {order}, clock {clock}, bag {is_bag}", encoding.field);
            let path = dir.path().join(format!("{number}-{order}-{clock}{}", if is_bag { ".db3" } else { "" }));
            let mut bag = Bag::new(true);
            if !is_bag {
                std::fs::create_dir(&path).unwrap();
            }
            let begins: Vec<f64> = (0..SCANS).map(|k| EPOCH + SWEEP * k as f64).collect();
            for (k, begin) in begins.iter().enumerate() {
                // The header has the begin of the sweep, its end, or the begin by another clock than the points'.
                let stamp = if clock == 1 { begin + SWEEP } else { *begin };
                let all = points(order, k);
                let mut data = Vec::new();
                for (point, t) in &all {
                    point.iter().for_each(|v| put(f64::from(*v), F32, &mut data));
                    let by_sensor = if clock == 2 { BOOT + begin - EPOCH } else { *begin } + t;
                    // Where there is no return, drivers write zero.
                    let value = if point[0].is_nan() { 0.0 } else { (encoding.value)(*t, by_sensor, SWEEP * k as f64 + t) };
                    put(value, encoding.kind, &mut data);
                }
                if is_bag {
                    add_cloud(&mut bag, [stamp, begin + LATE], encoding, &data, all.len())
                } else {
                    write_pcd(&path, stamp, encoding, &data, all.len())
                }
            }
            if is_bag {
                bag.write(&path);
            }
            match errors(&path, order, &begins) {
                None => {
                    assert!(encoding.is_lost, "{case}: no times");
                    none += 1;
                }
                Some((within, by_clock)) => {
                    assert!(!encoding.is_lost && within < 1e-3, "{case}: {within} s");
                    let is_known = clock == 0 && number != 3 || encoding.is_absolute && clock < 2;
                    assert!(!is_known || by_clock < 1e-3, "{case}: {by_clock} s by the clock");
                    right += 1;
                }
            }
        }
    }
    println!("{right} read right, {none} as none");
}

#[test]
fn clouds_without_a_stamp_have_the_time_at_which_they_were_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("zero.db3");
    let encoding = &encodings()[0];
    let mut data = Vec::new();
    for (point, t) in points(0, 0) {
        point.iter().for_each(|v| put(f64::from(*v), F32, &mut data));
        put((encoding.value)(t, 0.0, 0.0), encoding.kind, &mut data);
    }
    let write = |stamp: fn(usize) -> f64| {
        let mut bag = Bag::new(true);
        (0..SCANS).for_each(|k| add_cloud(&mut bag, [stamp(k), EPOCH + SWEEP * k as f64], encoding, &data, COLUMNS * RINGS));
        bag.write(&path);
        let scans = raw::open(&path, &OpenOptions::default()).unwrap();
        let said = scans.description().to_owned();
        (said, scans.iter().map(|scan| scan.unwrap().time).collect::<Vec<f64>>())
    };
    let (said, times) = write(|_| 0.0);
    assert!(said.contains("/points: time stamps are zero"), "{said}");
    assert!(times.iter().enumerate().all(|(k, t)| (t - EPOCH - SWEEP * k as f64).abs() < 1e-6), "{times:?}");
    // A simulator's clock begins at zero.
    let (said, times) = write(|k| SWEEP * k as f64);
    assert!(!said.contains("zero") && times.len() == SCANS && times[0] == 0.0, "{said} {times:?}");
}
