#![no_main]

use std::sync::LazyLock;
use voxelastic_fuzz::{check_memory, folder};
use voxelastic_io::images::{self, CAMERAS_FILE, ImageOptions, Images};

const SIZE: [usize; 2] = [24, 16];

/// A folder of one image.
static IMAGES: LazyLock<Images> = LazyLock::new(|| {
    let [width, height] = SIZE;
    let camera = format!(
        "[[camera]]\nname = \"front\"\nimages = \"front\"\nwidth = {width}\nheight = {height}\nfx = 20.0\nfy = 20.0\ncx = 11.5\ncy = 7.5\nt_lidar_camera = [0, 0, 0, 0, 0, 0, 1]\n"
    );
    std::fs::create_dir_all(folder().join("front")).expect("a folder to write to");
    std::fs::write(folder().join("front/1.5.png"), "").expect("space to write to");
    std::fs::write(folder().join(CAMERAS_FILE), camera).expect("space to write to");
    images::open(folder(), &ImageOptions::default()).expect("a folder of images")
});

fn read(data: &[u8]) {
    let images = &*IMAGES;
    std::fs::write(folder().join("front/1.5.png"), data).expect("space to write to");
    for image in images.iter() {
        let image = image.expect("an image that is there");
        if let Ok(picture) = image.decode(&images.cameras()[image.camera]) {
            assert_eq!(([picture.width, picture.height], picture.pixels.len()), (SIZE, SIZE[0] * SIZE[1]));
        }
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
