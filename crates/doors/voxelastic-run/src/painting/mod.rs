//! Colours of a mesh from images of cameras, by the poses of its map.

mod texture;

pub use texture::{MeshTexture, TextureSummary};

use crate::error::{Error, Result};
use crate::map_files::{self, LoadedMap};
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

/// Which images colour a surface, and how.
#[derive(Clone, Debug)]
pub struct Painting {
    /// A folder with cameras.toml, or a recording.
    pub data: PathBuf,
    /// Where its cameras are; poses are of the lidar.
    pub images: ImageOptions,
    /// Trajectory with times, map frame, instead of the corrected poses of the map.
    pub poses: Option<PathBuf>,
    /// Trajectory with times that is denser than the scans of the map: what it moved between two scans is used.
    pub motion: Option<PathBuf>,
    /// One of so many images is used, 1 or more.
    pub every: usize,
    /// Largest distance from a camera at which surfaces are coloured, metres.
    pub reach: f32,
    /// Distance between texels, metres, if there is to be a texture.
    pub texel: Option<f32>,
    /// Whether the exposures of the images are taken as they are.
    pub keep_exposure: bool,
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

impl Painting {
    /// Poses of the lidar by time, without the map's origin.
    fn track(&self, map: &LoadedMap, path: &Path) -> Result<PoseTrack> {
        let t_base_lidar = self.images.t_base_lidar.unwrap_or_else(Pose::identity);
        let read = |file: &Path| -> Result<Vec<(f64, Pose)>> {
            let trajectory = poses::read(file)?;
            let Some(times) = trajectory.times else {
                return Err(Error::new(format!("{}: its poses have no times", file.display()), "give a trajectory with times, such as TUM"));
            };
            Ok(times.into_iter().zip(trajectory.poses.into_iter().map(|t_map_base| t_map_base * t_base_lidar)).collect())
        };
        if let Some(file) = &self.poses {
            return Ok(PoseTrack::new(read(file)?.into_iter().map(|(time, pose)| (time, map.origin.to_local(pose))).collect()));
        }
        let track = PoseTrack::new(corrected_poses(map, path)?);
        Ok(match &self.motion {
            Some(file) => track.with_motion(read(file)?),
            None => track,
        })
    }

    /// Colours `mesh`, the surface of `map`, which was loaded from `path`, and makes a texture if there is to be one. Vertices that no image shows keep the
    /// colours that they have.
    ///
    /// # Errors
    /// Where images or poses cannot be read, and if no image could be used.
    pub fn paint(&self, map: &LoadedMap, path: &Path, mesh: &mut Mesh) -> Result<(PaintSummary, Option<MeshTexture>)> {
        let clock = Instant::now();
        let track = self.track(map, path)?;
        let images = images::open(&self.data, &self.images)?;
        images.notes().iter().for_each(|note| tracing::warn!("{}: {note}", self.data.display()));
        let surface = Surface { positions: &mesh.positions, normals: &mesh.normals, triangles: &mesh.triangles };
        let options =
            PaintOptions { reach: self.reach, accuracy: map.settings.voxel_size, even_exposure: !self.keep_exposure, ..PaintOptions::default() };
        let mut painting =
            Pass { painter: Painter::new(surface, options), summary: PaintSummary::default(), first_problem: None, counted: Counted::default() };
        painting.summary.cameras = images.cameras().len();
        painting.add_all(&images, &track, self.every);
        let Pass { painter, mut summary, first_problem, mut counted } = painting;
        if summary.used == 0 {
            return Err(nothing_used(&self.data, &summary, &track, first_problem));
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
            let mut again = Pass { painter, summary: PaintSummary::default(), first_problem: None, counted: std::mem::take(&mut counted) };
            again.add_all(&images, &track, self.every);
            counted = again.counted;
            again.painter.finish_with(&exposures)
        };
        let texture = self.texel.map(|texel| MeshTexture::paint(surface, &mesh.colours, texel, paint)).transpose()?;
        summary.texture = texture.as_ref().map(MeshTexture::summary);
        summary.paint_s = clock.elapsed().as_secs_f64();
        summary.log();
        Ok((summary, texture))
    }
}

/// The poses of the scans of a map as they are now, with the times that the log of the run has.
fn corrected_poses(map: &LoadedMap, path: &Path) -> Result<Vec<(f64, Pose)>> {
    let log: Option<RunLog> = map_files::run_log(&map_files::open(path)?);
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
        return Err(Error::new(format!("{}: the map has no log (run.json) with the times of its scans", path.display()), remedy));
    }
    Ok(timed)
}

/// A mesh that is being coloured, while all images are looked at once.
struct Pass<'a> {
    painter: Painter<'a>,
    summary: PaintSummary,
    first_problem: Option<Error>,
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

impl Pass<'_> {
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
            let added = picture.map_err(Error::from).and_then(|picture| {
                let t_map_camera = t_map_lidar * camera.t_lidar_camera;
                self.painter.add(&camera.model, &t_map_camera, &picture).map_err(Error::from)
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

    fn leave_out(&mut self, problem: Error) {
        self.summary.left_out.unreadable += 1;
        match self.summary.left_out.unreadable {
            _ if self.counted.is_known => {}
            count if count <= MOST_WARNINGS => tracing::warn!("left out: {}", problem.one_line()),
            count if count == MOST_WARNINGS + 1 => tracing::warn!("left out: more images for such reasons"),
            _ => {}
        }
        self.first_problem.get_or_insert(problem);
    }
}

/// Why no image could be used.
fn nothing_used(data: &Path, summary: &PaintSummary, track: &PoseTrack, first_problem: Option<Error>) -> Error {
    let PaintSummary { found, left_out, .. } = summary;
    // The most frequent reason.
    if let Some(problem) = first_problem.filter(|_| left_out.unreadable >= left_out.without_pose.max(left_out.show_nothing)) {
        return Error::During { doing: "no image can be used".to_owned(), source: Box::new(problem) };
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
    Error::new(format!("{}: no image can be used: {what}", data.display()), remedy)
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
