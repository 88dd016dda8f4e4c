//! Colours of a mesh from images of cameras.

use crate::failure::{Failure, one_line};
use crate::texturing::{MeshTexture, TextureSummary};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use voxelastic::Pose;
use voxelastic::event::NodeId;
use voxelastic::surface::Mesh;
use voxelastic_colour::{PaintOptions, Painted, Painter, Picture, Places, PoseTrack, Surface};
use voxelastic_io::images::{self, Image, ImageOptions, Images};
use voxelastic_io::poses;
use voxelastic_report::RunLog;
use voxelastic_run::map_files::LoadedMap;

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

/// What was done, as `--json` has it.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PaintSummary {
    /// Cameras.
    cameras: usize,
    /// Images that there are.
    found: usize,
    /// Images that show some of the surface.
    used: usize,
    left_out: ImagesLeftOut,
    /// Vertices that an image shows.
    vertices_visible: usize,
    /// Vertices that have the colour of neighbours.
    vertices_filled: usize,
    /// Vertices without a colour: mid grey, or the colour of the scans if they have any.
    vertices_uncoloured: usize,
    /// Smallest and largest exposure of an image, of all channels; their geometric mean is 1. Null without images, or with `--keep-exposure`.
    exposures: Option<[f32; 2]>,
    /// Null without `--texture`.
    texture: Option<TextureSummary>,
    paint_s: f64,
}

/// Images that were not used, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ImagesLeftOut {
    /// By `--image-every`.
    not_chosen: usize,
    /// No pose is known for their time.
    without_pose: usize,
    /// Damaged, cut, or of another size than the intrinsics are for.
    unreadable: usize,
    /// None of the surface is in them.
    show_nothing: usize,
}

impl ImageArgs {
    /// Where the images are, if they are to be used.
    pub fn data(&self) -> Option<&Path> {
        self.images.as_deref()
    }

    /// Whether there is to be a texture.
    pub fn has_texture(&self) -> bool {
        self.texture.is_some()
    }

    fn options(&self) -> ImageOptions {
        ImageOptions {
            cameras: self.cameras.clone(),
            topics: self.image_topic.clone(),
            cloud_topic: self.cloud_topic.clone(),
            t_base_camera: self.t_base_camera,
            t_base_lidar: self.t_base_lidar,
        }
    }

    /// Poses of the lidar by time, without the map's origin.
    fn track(&self, map: &LoadedMap, path: &Path) -> anyhow::Result<PoseTrack> {
        let t_base_lidar = self.t_base_lidar.unwrap_or_else(Pose::identity);
        let read = |file: &Path| -> anyhow::Result<Vec<(f64, Pose)>> {
            let trajectory = poses::read(file)?;
            let Some(times) = trajectory.times else {
                return Err(Failure::new(format!("{}: its poses have no times", file.display()), "give a trajectory with times, such as TUM").into());
            };
            Ok(times.into_iter().zip(trajectory.poses.into_iter().map(|t_map_base| t_map_base * t_base_lidar)).collect())
        };
        if let Some(file) = &self.image_poses {
            return Ok(PoseTrack::new(read(file)?.into_iter().map(|(time, pose)| (time, map.origin.to_local(pose))).collect()));
        }
        let track = PoseTrack::new(corrected_poses(map, path)?);
        Ok(match &self.image_motion {
            Some(file) => track.with_motion(read(file)?),
            None => track,
        })
    }

    /// Colours `mesh`, the surface of `map`, which was loaded from `path`, and makes a texture if there is to be one. Vertices that no image shows keep the
    /// colours that they have.
    ///
    /// # Errors
    /// Where images or poses cannot be read, and if no image could be used.
    pub fn paint(&self, data: &Path, map: &LoadedMap, path: &Path, mesh: &mut Mesh) -> anyhow::Result<(PaintSummary, Option<MeshTexture>)> {
        let clock = Instant::now();
        let track = self.track(map, path)?;
        let images = images::open(data, &self.options())?;
        images.notes().iter().for_each(|note| tracing::warn!("{}: {note}", data.display()));
        let surface = Surface { positions: &mesh.positions, normals: &mesh.normals, triangles: &mesh.triangles };
        let options = PaintOptions {
            reach: self.image_range,
            accuracy: map.settings.voxel_size,
            even_exposure: !self.keep_exposure,
            ..PaintOptions::default()
        };
        let mut painting =
            Painting { painter: Painter::new(surface, options), summary: PaintSummary::default(), first_problem: None, counted: Counted::default() };
        painting.summary.cameras = images.cameras().len();
        painting.add_all(&images, &track, self.image_every as usize);
        let Painting { painter, mut summary, first_problem, mut counted } = painting;
        if summary.used == 0 {
            return Err(nothing_used(data, &summary, &track, first_problem));
        }
        let painted = painter.finish();
        summary.add(&painted, self.keep_exposure);
        let Painted { known, colours, exposures, .. } = painted;
        if mesh.colours.is_empty() {
            mesh.colours = colours;
        } else {
            let known = known.into_iter().zip(colours);
            mesh.colours.iter_mut().zip(known).filter(|(_, (known, _))| *known).for_each(|(old, (_, new))| *old = new);
        }
        let surface = Surface { positions: &mesh.positions, normals: &mesh.normals, triangles: &mesh.triangles };
        let paint = |places: Places<'_>| {
            let painter = Painter::of_places(surface, places, options);
            counted.is_known = true;
            let mut again = Painting { painter, summary: PaintSummary::default(), first_problem: None, counted: std::mem::take(&mut counted) };
            again.add_all(&images, &track, self.image_every as usize);
            counted = again.counted;
            again.painter.finish_with(&exposures)
        };
        let texture = self.texture.map(|texel| MeshTexture::paint(surface, &mesh.colours, texel, paint)).transpose()?;
        summary.texture = texture.as_ref().map(MeshTexture::summary);
        summary.paint_s = clock.elapsed().as_secs_f64();
        summary.log();
        Ok((summary, texture))
    }
}

/// The poses of the scans of a map as they are now, with the times that the log of the run has.
fn corrected_poses(map: &LoadedMap, path: &Path) -> anyhow::Result<Vec<(f64, Pose)>> {
    let log: Option<RunLog> = voxelastic_run::map_files::run_log(&voxelastic_run::map_files::open(path)?);
    let mut times: Vec<(NodeId, f64)> = log.map(|log| log.scans.node.into_iter().zip(log.scans.time_s).collect()).unwrap_or_default();
    times.sort_by_key(|(node, _)| *node);
    let mut timed = Vec::new();
    for submap in map.atlas.submaps() {
        for (node, t_submap_lidar) in submap.corrected_scans() {
            if let Ok(at) = times.binary_search_by_key(&node, |(node, _)| *node) {
                timed.push((times[at].1, submap.t_map_submap() * t_submap_lidar));
            }
        }
    }
    if timed.is_empty() {
        let remedy = "name a trajectory of the lidar with times, in the map frame, with --image-poses";
        return Err(Failure::new(format!("{}: the map has no log (run.json) with the times of its scans", path.display()), remedy).into());
    }
    Ok(timed)
}

/// A mesh that is being coloured.
struct Painting<'a> {
    painter: Painter<'a>,
    summary: PaintSummary,
    first_problem: Option<anyhow::Error>,
    counted: Counted,
}

/// Which images the painter counted when they were looked at first, problems being said then.
#[derive(Debug, Default)]
struct Counted {
    is_known: bool,
    /// By image, in the order in which they come.
    images: Vec<bool>,
}

/// Problems with single images that are warned of one by one.
const MOST_WARNINGS: usize = 3;

impl Painting<'_> {
    fn add_all(&mut self, images: &Images, track: &PoseTrack, every: usize) {
        let batch = 2 * rayon::current_num_threads();
        let mut waiting: Vec<(usize, Image, Pose)> = Vec::new();
        for (k, image) in images.iter().enumerate() {
            self.summary.found += 1;
            if !self.counted.is_known {
                self.counted.images.push(false);
            }
            if k % every != 0 {
                self.summary.left_out.not_chosen += 1;
                continue;
            }
            match image {
                Ok(image) => match track.at(image.time) {
                    Some(t_map_lidar) => waiting.push((k, image, t_map_lidar)),
                    None => self.summary.left_out.without_pose += 1,
                },
                Err(problem) => self.leave_out(problem.into()),
            }
            if waiting.len() >= batch {
                self.add_batch(images, std::mem::take(&mut waiting));
            }
        }
        self.add_batch(images, waiting);
    }

    /// Decodes images beside each other and adds them in their order.
    fn add_batch(&mut self, images: &Images, batch: Vec<(usize, Image, Pose)>) {
        // An image that was good once is not decoded again where it is too far away.
        let is_far = |k: usize, t_map_camera: &Pose| self.counted.is_known && self.counted.images[k] && self.painter.sees_none(t_map_camera);
        let decode = |(k, image, t_map_lidar): &(usize, Image, Pose)| {
            let camera = &images.cameras()[image.camera];
            (!is_far(*k, &(t_map_lidar * camera.t_lidar_camera))).then(|| image.decode(camera))
        };
        let pictures: Vec<Option<voxelastic_io::Result<Picture>>> = batch.par_iter().map(decode).collect();
        for ((k, image, t_map_lidar), picture) in batch.into_iter().zip(pictures) {
            let camera = &images.cameras()[image.camera];
            let Some(picture) = picture else {
                self.painter.skip();
                continue;
            };
            let added = picture.map_err(anyhow::Error::from).and_then(|picture| {
                let t_map_camera = t_map_lidar * camera.t_lidar_camera;
                self.painter.add(&camera.model, &t_map_camera, &picture).map_err(anyhow::Error::from)
            });
            if !self.counted.is_known {
                self.counted.images[k] = added.is_ok();
            }
            match added {
                Ok(0) => self.summary.left_out.show_nothing += 1,
                Ok(_) => self.summary.used += 1,
                Err(problem) => self.leave_out(problem),
            }
        }
    }

    fn leave_out(&mut self, problem: anyhow::Error) {
        self.summary.left_out.unreadable += 1;
        match self.summary.left_out.unreadable {
            _ if self.counted.is_known => {}
            count if count <= MOST_WARNINGS => tracing::warn!("left out: {}", one_line(&problem)),
            count if count == MOST_WARNINGS + 1 => tracing::warn!("left out: more images for such reasons"),
            _ => {}
        }
        self.first_problem.get_or_insert(problem);
    }
}

/// Why no image could be used.
fn nothing_used(data: &Path, summary: &PaintSummary, track: &PoseTrack, first_problem: Option<anyhow::Error>) -> anyhow::Error {
    let PaintSummary { found, left_out, .. } = summary;
    // The most frequent reason.
    if let Some(problem) = first_problem.filter(|_| left_out.unreadable >= left_out.without_pose.max(left_out.show_nothing)) {
        return problem.context("no image can be used");
    }
    let (what, remedy) = if *found == 0 {
        ("there are no images".to_owned(), "record images, or name their topic with --image-topic")
    } else if left_out.without_pose >= left_out.show_nothing {
        let [from, to] = track.span().unwrap_or_default();
        let what = format!(
            "{} of {found} images were taken when no pose of the lidar is known: the poses are from {from:.3} to {to:.3} s",
            left_out.without_pose
        );
        (what, "check that clouds and images have the same clock (time_offset_s in cameras.toml), and that it is the map of this drive")
    } else {
        (
            format!("{} of {found} images show nothing of the surface", left_out.show_nothing),
            "check the extrinsics: x to the right, y down, z ahead; and --image-range",
        )
    };
    Failure::new(format!("{}: no image can be used: {what}", data.display()), remedy).into()
}

impl PaintSummary {
    fn add(&mut self, painted: &Painted, keeps_exposure: bool) {
        self.vertices_visible = painted.visible;
        self.vertices_filled = painted.filled;
        self.vertices_uncoloured = painted.known.iter().filter(|known| !**known).count();
        let all = || painted.exposures.iter().flatten().copied();
        let round = |value: f32| (value * 1e3).round() / 1e3;
        let range = all().fold(None, |range: Option<[f32; 2]>, e| Some(range.map_or([e; 2], |[low, high]| [low.min(e), high.max(e)])));
        self.exposures = range.filter(|_| !keeps_exposure).map(|range| range.map(round));
    }

    fn log(&self) {
        let ImagesLeftOut { without_pose, unreadable, show_nothing, .. } = self.left_out;
        let all = self.vertices_visible + self.vertices_filled + self.vertices_uncoloured;
        let exposures = self.exposures.map_or_else(String::new, |[low, high]| format!("; exposures from {low:.2} to {high:.2} evened out"));
        tracing::info!(
            "{} of {} images colour {:.0} % of the vertices{exposures}",
            self.used,
            self.found,
            100.0 * (all - self.vertices_uncoloured) as f64 / all.max(1) as f64
        );
        if without_pose + unreadable + show_nothing > 0 {
            tracing::warn!(
                "left out: {without_pose} images without a pose for their time, {unreadable} that cannot be used, {show_nothing} that show nothing of the surface"
            );
        }
    }
}
