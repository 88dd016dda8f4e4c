//! Which images colour a mesh.

use clap::Args;
use std::path::PathBuf;
use voxelastic::Pose;
use voxelastic_io::images::ImageOptions;
use voxelastic_run::painting::Painting;

/// Arguments that select images to colour a mesh with.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Colours from images")]
pub struct ImageArgs {
    /// Colour vertices by images: a folder with cameras.toml, or a recording with sensor_msgs/Image or CompressedImage. The map says where the lidar was
    #[arg(long, value_name = "DATA")]
    images: Option<PathBuf>,
    /// Intrinsics and extrinsics of the cameras, if the file is not cameras.toml in DATA, or the recording lacks them
    #[arg(long, value_name = "FILE.toml", requires = "images")]
    cameras: Option<PathBuf>,
    /// The topics of the images in a recording [default: all with intrinsics]
    #[arg(long, value_name = "TOPIC", requires = "images")]
    image_topic: Vec<String>,
    /// The topic of the clouds that were mapped, whose frame is the lidar's, if the recording has several
    #[arg(long, value_name = "TOPIC", requires = "images", hide_short_help = true)]
    cloud_topic: Option<String>,
    /// Pose of the camera in the vehicle frame (x right, y down, z ahead), if neither cameras.toml nor /tf_static has it
    #[arg(long, value_name = "\"X Y Z QX QY QZ QW\"", value_parser = crate::args::data::pose, allow_hyphen_values = true, requires = "images")]
    t_base_camera: Option<Pose>,
    /// Pose of the lidar in the vehicle frame [default: the lidar is the vehicle]
    #[arg(long, value_name = "\"X Y Z QX QY QZ QW\"", value_parser = crate::args::data::pose, allow_hyphen_values = true, requires = "images")]
    t_base_lidar: Option<Pose>,
    /// Trajectory with times that is denser than the scans of the map, such as that of odometry: what it moved between two scans is used, not where it was
    #[arg(long, value_name = "FILE", requires = "images")]
    image_motion: Option<PathBuf>,
    /// Trajectory with times, map frame, instead of the corrected poses in the map
    #[arg(long, value_name = "FILE", requires = "images", conflicts_with = "image_motion")]
    image_poses: Option<PathBuf>,
    /// Use one of every N images
    #[arg(long, value_name = "N", default_value_t = 1, requires = "images", value_parser = clap::value_parser!(u32).range(1..))]
    image_every: u32,
    /// Largest distance from a camera at which surfaces are coloured, metres
    #[arg(long, value_name = "M", default_value_t = 40.0, requires = "images", value_parser = reach)]
    image_range: f32,
    /// With .glb: a texture instead of colours of vertices, with texels so many metres apart, such as 0.01
    #[arg(long, value_name = "M", requires = "images", value_parser = texel)]
    texture: Option<f32>,
    /// Do not even out the exposures of the images: for cameras with a fixed exposure
    #[arg(long, requires = "images")]
    keep_exposure: bool,
}

fn reach(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|m: &f32| *m >= 0.1 && *m <= 1e4).ok_or_else(|| "must be a number from 0.1 to 10000".to_owned())
}

fn texel(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|m: &f32| *m >= 0.001 && *m <= 10.0).ok_or_else(|| "must be a number from 0.001 to 10".to_owned())
}

impl ImageArgs {
    /// What is to be done, if images are named.
    pub fn painting(&self) -> Option<Painting> {
        Some(Painting {
            data: self.images.clone()?,
            images: ImageOptions {
                cameras: self.cameras.clone(),
                topics: self.image_topic.clone(),
                cloud_topic: self.cloud_topic.clone(),
                t_base_camera: self.t_base_camera,
                t_base_lidar: self.t_base_lidar,
            },
            poses: self.image_poses.clone(),
            motion: self.image_motion.clone(),
            every: self.image_every as usize,
            reach: self.image_range,
            texel: self.texture,
            keep_exposure: self.keep_exposure,
        })
    }
}
