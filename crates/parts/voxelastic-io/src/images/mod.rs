//! Images of cameras beside the scans: a folder that `cameras.toml` describes, or topics of a recording.
//!
//! [`open()`] finds out what there is. [`Images::iter`] gives one image after the other, not decoded: whoever does not need one does not pay for it.
//!
//! ```toml
//! # cameras.toml, in the folder of the images or above
//! [[camera]]
//! name = "front"
//! images = "front"                      # folder beside this file; names are times: 1700000000.123456.jpg, or in nanoseconds
//! width = 1280
//! height = 720
//! fx = 640.0
//! fy = 640.0
//! cx = 639.5
//! cy = 359.5
//! model = "plumb_bob"                   # or "equidistant"
//! distortion = [-0.1, 0.02, 0.0, 0.0, 0.0]
//! t_lidar_camera = [0.1, 0.0, -0.05, -0.5, 0.5, -0.5, 0.5]
//! ```

mod camera;
mod cameras_file;
mod decode;
mod image_files;
mod open;
mod options;
mod raw_pixels;
mod timed_image;

pub use camera::Camera;
pub(crate) use cameras_file::{DescribedCamera, distortion};
pub use open::{CAMERAS_FILE, Images, open};
pub use options::ImageOptions;
pub(crate) use raw_pixels::RawPixels;
pub(crate) use timed_image::Content;
pub use timed_image::Image;
