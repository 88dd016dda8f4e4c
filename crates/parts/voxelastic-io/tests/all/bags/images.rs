//! Images of cameras in recordings that other people's software wrote (`images.py`).

use std::path::Path;
use voxelastic_colour::Distortion;
use voxelastic_io::images::{self, ImageOptions};
use voxelastic_io::source::Source;
use voxelastic_io::{OpenOptions, source};
use voxelastic_testing::run_python;

/// What the pixel at column x and row y is.
fn pixel(x: usize, y: usize) -> [u8; 3] {
    [10 * y as u8, 20 * x as u8, (x + y) as u8]
}

#[test]
fn images_of_every_container() {
    let dir = tempfile::tempdir().unwrap();
    let grey = image::RgbImage::from_pixel(8, 6, image::Rgb([90, 140, 60]));
    grey.save(dir.path().join("left.jpg")).unwrap();
    let script = [include_str!("write.py"), include_str!("images.py")].concat();
    if run_python("rosbags, mcap", &script, &[dir.path(), Path::new("images")]).is_none() {
        return;
    }
    for name in ["images.bag", "images.mcap", "images_db3"] {
        check(&dir.path().join(name));
    }
}

fn check(path: &Path) {
    let found = images::open(path, &ImageOptions::default()).unwrap();
    let names: Vec<&str> = found.cameras().iter().map(|camera| camera.name.as_str()).collect();
    // The compressed copy, and 16 bits, are not used.
    assert_eq!(names, ["/front/image_raw", "/left/image_raw/compressed", "/rect/image_rect_color"], "{}", path.display());
    assert!(found.notes().iter().any(|note| note.contains("/bare/image is left out") && note.contains("CameraInfo")), "{:?}", found.notes());
    let [front, left, rect] = [0, 1, 2].map(|k| &found.cameras()[k]);
    assert_eq!((front.model.focal(), front.model.centre(), front.model.width()), ([5.0, 6.0], [3.5, 2.5], 8));
    assert_eq!(front.model.distortion(), Distortion::PlumbBob([-0.1, 0.01, 0.001, 0.002, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(left.model.distortion(), Distortion::Equidistant([0.1, 0.0, 0.0, 0.0]));
    assert_eq!((rect.model.focal(), rect.model.centre(), rect.model.distortion()), ([4.0, 4.5], [3.0, 2.0], Distortion::NONE));
    let at = front.t_lidar_camera.translation;
    assert!((at.x - 0.25).abs() < 1e-9 && (at.z + 0.5).abs() < 1e-9);
    // A metre down in the image is a metre down.
    assert!((left.t_lidar_camera.translation.z + 1.5).abs() < 1e-9, "{}", left.t_lidar_camera);

    let mut counts = [0; 3];
    for image in found.iter() {
        let image = image.unwrap();
        let expected = 100.0 + 0.1 * f64::from(counts[image.camera]);
        assert!((image.time - expected).abs() < 1e-6, "{} {expected}", image.time);
        let picture = image.decode(&found.cameras()[image.camera]).unwrap();
        for (i, p) in picture.pixels.iter().enumerate() {
            let truth = if image.camera == 1 { [90, 140, 60] } else { pixel(i % 8, i / 8) };
            let tolerance = if image.camera == 1 { 4 } else { 0 };
            assert!((0..3).all(|k| p[k].abs_diff(truth[k]) <= tolerance), "{i}: {p:?} {truth:?}");
        }
        counts[image.camera] += 1;
    }
    assert_eq!(counts, [12; 3]);
    let one = ImageOptions { topics: vec!["/front/image_raw/compressed".to_owned()], ..ImageOptions::default() };
    assert_eq!(images::open(path, &one).unwrap().iter().count(), 12);
    // Mapping goes on as without images.
    let Source::Recording(recording) = source::open(path, &OpenOptions::default()).unwrap() else { panic!("a recording") };
    assert_eq!(recording.description().cloud_topic.as_deref(), Some("/points"));
}
