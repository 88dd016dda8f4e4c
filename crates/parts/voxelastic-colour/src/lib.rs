//! Colours of a mesh from images of cameras whose poses are known.
//!
//! A [`Painter`] takes one image after the other ([`Painter::add`]): vertices are projected with the distortion of the lens ([`CameraModel`]), those that
//! something hides are left out by a depth image drawn from the mesh, and each vertex keeps its best observations. [`Painter::finish`] evens out the
//! exposures of the images and takes a robust mean. Poses at the times of images come from a [`PoseTrack`].
//!
//! A texture is painted in the same way: [`texture_pages`] cuts a large mesh into parts with an image each, a [`TextureLayout`] says where on the mesh the texels of an
//! image lie, and [`Painter::of_places`] colours those.
//!
//! Light is added up on a linear scale; pictures and results are sRGB. The same images in the same order give the same bits for any number of threads.
//!
//! ```
//! use voxelastic::Pose;
//! use voxelastic_colour::{CameraModel, Distortion, PaintOptions, Painter, Picture, Surface};
//!
//! // A triangle that faces the origin, 2 m ahead of a camera that looks along z.
//! let positions = [[-0.1, -0.1, 2.0], [0.1, -0.1, 2.0], [0.0, 0.1, 2.0]];
//! let surface = Surface { positions: &positions, normals: &[[0.0, 0.0, -1.0]; 3], triangles: &[[0, 2, 1]] };
//! let camera = CameraModel::new([64, 48], [60.0, 60.0], [31.5, 23.5], Distortion::NONE)?;
//! let red = Picture { width: 64, height: 48, pixels: vec![[200, 20, 20]; 64 * 48] };
//!
//! let mut painter = Painter::new(surface, PaintOptions::default());
//! painter.add(&camera, &Pose::identity(), &red)?;
//! let painted = painter.finish();
//! assert_eq!((painted.visible, painted.colours[0]), (3, [200, 20, 20]));
//! # Ok::<(), voxelastic_colour::ColourError>(())
//! ```

mod blend;
mod camera;
mod depth_image;
mod error;
mod exposure;
mod light;
mod observations;
mod painter;
mod picture;
mod pose_track;
mod spread;
mod texture;
mod texture_pages;

pub use camera::{CameraModel, Distortion};
pub use error::{ColourError, Result};
pub use light::{to_linear, to_srgb};
pub use painter::{PaintOptions, Painted, Painter, Places, Surface};
pub use picture::Picture;
pub use pose_track::{LONGEST_GAP_S, PoseTrack};
pub use texture::{Texel, TextureLayout};
pub use texture_pages::texture_pages;
