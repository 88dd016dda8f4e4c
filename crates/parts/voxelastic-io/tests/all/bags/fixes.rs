//! Fixes in recordings that rosbags wrote, and in a KITTI raw drive.

use std::fs;
use voxelastic_earth::{Fix, Geodetic, Heights, Place};
use voxelastic_io::{Error, fixes};
use voxelastic_testing::run_python;

fn place(fix: &Fix) -> [f64; 3] {
    match fix.place {
        Place::Geodetic(Geodetic { latitude, longitude, height }) => [latitude, longitude, height],
        Place::Projected(point) => point,
    }
}

fn near(a: [f64; 3], b: [f64; 3]) -> bool {
    (0..3).all(|k| (a[k] - b[k]).abs() < 1e-9)
}

#[test]
fn fixes_of_all_message_types_are_those_that_rosbags_wrote() {
    let dir = tempfile::tempdir().unwrap();
    if run_python("rosbags, mcap", include_str!("fixes.py"), &[dir.path()]).is_none() {
        return;
    }
    for name in ["fixes.bag", "fixes"] {
        let read = fixes::read(dir.path().join(name), None).unwrap();
        assert_eq!((read.all.len(), read.without_position, read.heights), (3, 1, Heights::Ellipsoid), "{name}");
        let last = &read.all[2];
        assert!((last.time.unwrap() - 1003.25).abs() < 1e-6 && near(place(last), [48.1 + 3e-5, 11.5, 523.0]), "{last:?}");
        let covariance = last.covariance.unwrap();
        assert_eq!((covariance[(0, 0)], covariance[(0, 1)], covariance[(2, 2)]), (0.01, 0.001, 0.09));
        // Odometry is in metres of a system that the user names, so the topic is named, too.
        let utm = fixes::read(dir.path().join(name), Some("/utm")).unwrap();
        assert!(utm.all.len() == 4 && near(place(&utm.all[1]), [691_651.0, 5_334_754.0, 519.0]) && utm.heights == Heights::Unknown);
        assert!((utm.all[0].sigmas().unwrap()[1] - 0.2).abs() < 1e-12);
    }
    let gps = fixes::read(dir.path().join("gps"), None).unwrap();
    assert!(gps.all.len() == 4 && near(place(&gps.all[1]), [48.1 + 1e-5, 11.5, 521.0]));
    assert!((gps.all[0].sigmas().unwrap()[0] - 1.0).abs() < 1e-9 && (gps.all[0].sigmas().unwrap()[2] - 2.0).abs() < 1e-9);
    let sentences = fixes::read(dir.path().join("sentences"), None).unwrap();
    assert_eq!((sentences.all.len(), sentences.all[3].time), (4, Some(1003.25)), "times are those of the headers");
    assert!(near(place(&sentences.all[0]), [48.1, 11.5, 520.0]));
    let two = fixes::read(dir.path().join("two"), None).unwrap_err();
    assert!(matches!(two, Error::Ambiguous { .. }) && two.to_string().contains("/fix_2"), "{two}");
    assert!(fixes::read(dir.path().join("gps"), Some("/none")).unwrap_err().to_string().contains("/none"));
}

#[test]
fn oxts_of_kitti_have_times_and_accuracies() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("oxts/data");
    fs::create_dir_all(&data).unwrap();
    fs::write(dir.path().join("oxts/timestamps.txt"), "2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.064389445\n").unwrap();
    for k in 0..2 {
        let mut numbers = vec!["49.015".to_owned(), format!("8.43{k}"), "112.8".to_owned()];
        numbers.extend((3..30).map(|n| if n == 23 { "0.05".to_owned() } else { "0".to_owned() }));
        fs::write(data.join(format!("{k:010}.txt")), numbers.join(" ")).unwrap();
    }
    let read = fixes::read(dir.path(), None).unwrap();
    assert!(read.all.len() == 2 && near(place(&read.all[1]), [49.015, 8.431, 112.8]) && read.heights == Heights::Unknown);
    let apart = read.all[1].time.unwrap() - read.all[0].time.unwrap();
    assert!((apart - 0.1).abs() < 1e-6 && (read.all[0].sigmas().unwrap()[0] - 0.05).abs() < 1e-12);
    fs::write(data.join("0000000001.txt"), "49.015 x 112.8").unwrap();
    assert!(fixes::read(dir.path(), None).unwrap_err().to_string().contains("longitude"));
}
