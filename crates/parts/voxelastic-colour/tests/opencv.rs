//! The camera models against those of OpenCV.

use std::fmt::Write as _;
use voxelastic_colour::{CameraModel, Distortion};

/// Projects the points of a file with each camera of another; prints pixels.
const SCRIPT: &str = r#"
import sys
import cv2
import numpy as np
folder = sys.argv[1]
points = np.loadtxt(f"{folder}/points.txt")
zero = np.zeros(3)
for line in open(f"{folder}/cameras.txt"):
    kind, *numbers = line.split()
    fx, fy, cx, cy, *k = map(float, numbers)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if kind == "fisheye":
        pixels, _ = cv2.fisheye.projectPoints(points.reshape(1, -1, 3), zero, zero, K, np.array(k))
    else:
        pixels, _ = cv2.projectPoints(points.reshape(1, -1, 3), zero, zero, K, np.array(k))
    for u, v in pixels.reshape(-1, 2):
        print(f"{u:.9f} {v:.9f}")
"#;

#[test]
fn points_are_projected_as_opencv_does() {
    let cameras = [
        Distortion::NONE,
        Distortion::PlumbBob([-0.28, 0.07, 4e-4, -3e-4, -0.01, 0.0, 0.0, 0.0]),
        Distortion::PlumbBob([0.1, -0.02, -2e-3, 1e-3, 0.004, 0.0, 0.0, 0.0]),
        Distortion::PlumbBob([5.2, 2.9, 1e-4, -2e-4, 0.13, 5.5, 4.4, 0.8]),
        Distortion::Equidistant([-0.013, 0.02, -0.012, 0.002]),
        Distortion::Equidistant([0.05, 0.0, 0.01, 0.0]),
    ];
    let (focal, centre) = ([612.5, 609.25], [641.5, 357.75]);
    // A grid of directions in front of the camera, at several depths.
    let points: Vec<[f64; 3]> = (0..2000)
        .map(|i| {
            let (x, y, z) = (f64::from(i % 20) / 19.0 - 0.5, f64::from(i / 20 % 20) / 19.0 - 0.5, 0.5 + f64::from(i / 400) * 3.1);
            [1.7 * x * z, 1.3 * y * z, z]
        })
        .collect();
    let dir = tempfile::tempdir().unwrap();
    let mut text = String::new();
    points.iter().for_each(|p| writeln!(text, "{:?} {:?} {:?}", p[0], p[1], p[2]).unwrap());
    std::fs::write(dir.path().join("points.txt"), text).unwrap();
    let mut text = String::new();
    for distortion in cameras {
        let (kind, coefficients) = match distortion {
            Distortion::PlumbBob(k) => ("pinhole", k.to_vec()),
            Distortion::Equidistant(k) => ("fisheye", k.to_vec()),
        };
        let numbers: Vec<String> = focal.iter().chain(&centre).chain(&coefficients).map(|n| format!("{n:?}")).collect();
        writeln!(text, "{kind} {}", numbers.join(" ")).unwrap();
    }
    std::fs::write(dir.path().join("cameras.txt"), text).unwrap();
    let Some(output) = voxelastic_testing::run_python("cv2, numpy", SCRIPT, &[dir.path()]) else { return };
    let mut lines = output.lines();
    let mut most = 0.0f64;
    for distortion in cameras {
        let camera = CameraModel::new([1280, 720], focal, centre, distortion).unwrap();
        let mut seen = 0;
        for point in &points {
            let expected: Vec<f64> = lines.next().unwrap().split(' ').map(|n| n.parse().unwrap()).collect();
            // Beyond the limit of its polynomial, OpenCV folds what the lens does not see into the image.
            let Some(pixel) = camera.project(*point) else { continue };
            most = most.max((pixel[0] - expected[0]).abs()).max((pixel[1] - expected[1]).abs());
            seen += 1;
        }
        assert!(seen > 1500, "{distortion:?}: {seen}");
    }
    assert!(most < 1e-6, "{most} pixels");
}
