//! Images of cameras in a recording: `sensor_msgs/Image` and `CompressedImage`, with `CameraInfo`.

use super::camera_info::CameraInfo;
use super::decoder::MessageDecoder;
use super::header::Header;
use super::topic_role::TopicRole;
use crate::bag::containers::container::{Container, Encoding, Message, Topic};
use crate::bag::containers::files;
use crate::bag::containers::open::open;
use crate::bag::stream::is_static;
use crate::images::{Camera, Content, DescribedCamera, Image, ImageOptions};
use crate::motion::TransformTree;
use crate::{Error, Result};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use voxelastic::Pose;

const RAW: &str = "sensor_msgs/Image";
const COMPRESSED: &str = "sensor_msgs/CompressedImage";
const INFO: &str = "sensor_msgs/CameraInfo";

/// So many messages without anything new end the search for what describes cameras, if all of them are known.
const ENOUGH: usize = 200;

/// The images of a recording, which are read as they were recorded.
#[derive(Debug)]
pub(crate) struct BagImages {
    files: Vec<PathBuf>,
    /// Topic and time offset of each camera.
    topics: Vec<(String, f64)>,
}

/// What describes the cameras of a recording.
#[derive(Default)]
struct Found {
    /// Type and frame of each topic of images; no frame until one was seen.
    images: BTreeMap<String, (String, Option<String>)>,
    infos: BTreeMap<String, CameraInfo>,
    /// Frames of topics of clouds.
    clouds: BTreeMap<String, String>,
    tree: TransformTree,
}

/// Finds the cameras of the recording `path`.
///
/// # Errors
/// [`Error::Dataset`] if there are no images, or nothing says what their intrinsics or extrinsics are; [`Error::Io`].
pub(crate) fn images(path: &Path, described: Vec<DescribedCamera>, options: &ImageOptions) -> Result<(Vec<Camera>, BagImages, Vec<String>)> {
    let files = files::find(path)?.unwrap_or_default();
    let found = Found::search(&files)?;
    if let Some(missing) = options.topics.iter().find(|topic| !found.images.contains_key(*topic)) {
        let known: Vec<&str> = found.images.keys().map(String::as_str).collect();
        let problem = format!("no images with the topic {missing}");
        return Err(Error::dataset(
            path,
            problem,
            format!("choose of {}", if known.is_empty() { "none: there are no images".to_owned() } else { known.join(", ") }),
        ));
    }
    let is_wanted = |topic: &String| {
        // The same images, as they were and compressed.
        let is_copy = topic.rsplit_once('/').is_some_and(|(of, _)| found.images.contains_key(of));
        if options.topics.is_empty() { !is_copy } else { options.topics.contains(topic) }
    };
    let (mut cameras, mut topics, mut notes) = (Vec::new(), Vec::new(), Vec::new());
    for (topic, (_, frame)) in found.images.iter().filter(|(topic, _)| is_wanted(topic)) {
        let Some(frame) = frame else { continue };
        let by_file = described.iter().find(|camera| camera.topic.as_ref() == Some(topic));
        let of_recording = found.info_of(topic).map(|info| info.camera(is_rectified(topic)));
        let (model, t_camera_frame) = match (by_file, of_recording) {
            (Some(camera), _) => (camera.model, Pose::identity()),
            (None, Some(Ok(camera))) => camera,
            (None, Some(Err(problem))) => {
                notes.push(format!("{topic} is left out: {problem}; --cameras can give its intrinsics"));
                continue;
            }
            (None, None) => {
                notes.push(format!("{topic} is left out: there is no sensor_msgs/CameraInfo of it; --cameras can give its intrinsics"));
                continue;
            }
        };
        let t_lidar_camera = match by_file.and_then(|camera| camera.t_lidar_camera) {
            Some(given) => given,
            None => found.t_lidar_frame(path, topic, frame, options)? * t_camera_frame,
        };
        topics.push((topic.clone(), by_file.map_or(0.0, |camera| camera.time_offset_s)));
        cameras.push(Camera { name: topic.clone(), model, t_lidar_camera });
    }
    if cameras.is_empty() {
        let problem =
            if found.images.is_empty() { "no images in it".to_owned() } else { format!("no images that can be used in it: {}", notes.join("; ")) };
        return Err(Error::dataset(path, problem, "images are sensor_msgs/Image or CompressedImage, with sensor_msgs/CameraInfo or --cameras"));
    }
    Ok((cameras, BagImages { files, topics }, notes))
}

/// Whether a topic has images without distortion, by the names that ROS gives them.
fn is_rectified(topic: &str) -> bool {
    topic.split('/').any(|word| word.starts_with("image_rect"))
}

fn parents(topic: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(topic.rsplit_once('/').map(|(parent, _)| parent), |t| t.rsplit_once('/').map(|(parent, _)| parent))
}

impl Found {
    /// Reads until all topics that there are have been seen; to the end of the recording if one has no messages.
    fn search(files: &[PathBuf]) -> Result<Self> {
        let mut found = Self::default();
        for file in files {
            let mut container = open(file)?;
            let mut nothing_new = 0;
            while let Some(message) = container.next(&is_of_interest) {
                let Ok(message) = message else { continue };
                let topic = container.topics()[message.topic].clone();
                nothing_new = if found.add(file, &topic, &message) { 0 } else { nothing_new + 1 };
                if nothing_new > ENOUGH && found.has_all(container.topics()) {
                    break;
                }
            }
        }
        Ok(found)
    }

    /// Adds what a message says; whether that is new.
    fn add(&mut self, path: &Path, topic: &Topic, message: &Message) -> bool {
        let decoder = MessageDecoder { path, topic, message };
        let frame = || decoder.header().ok().map(|header| header.frame);
        match topic.kind.as_str() {
            RAW | COMPRESSED => {
                let known = self.images.get(&topic.name).is_some_and(|(_, frame)| frame.is_some());
                // Depth and labels come as images, too.
                let is_picture = || topic.kind == COMPRESSED || decoder.raw_image().is_ok_and(|(_, pixels)| pixels.is_known());
                if known || !is_picture() {
                    return false;
                }
                self.images.insert(topic.name.clone(), (topic.kind.clone(), frame()));
            }
            INFO => match decoder.camera_info() {
                Ok((_, info)) if !self.infos.contains_key(&topic.name) => {
                    self.infos.insert(topic.name.clone(), info);
                }
                _ => return false,
            },
            _ if TopicRole::of(topic) == Some(TopicRole::Transforms) => {
                if !is_static(&topic.name) {
                    return false;
                }
                for p in decoder.poses(TopicRole::Transforms).unwrap_or_default() {
                    self.tree.add(&p.parent, &p.child, p.time, p.t_parent_child, true);
                }
            }
            _ => match frame() {
                Some(frame) if !self.clouds.contains_key(&topic.name) => {
                    self.clouds.insert(topic.name.clone(), frame);
                }
                _ => return false,
            },
        }
        true
    }

    fn has_all(&self, topics: &[Topic]) -> bool {
        topics.iter().filter(|topic| is_of_interest(topic)).all(|topic| match topic.kind.as_str() {
            RAW | COMPRESSED => true,
            INFO => self.infos.contains_key(&topic.name),
            _ => TopicRole::of(topic).is_none_or(|role| !role.is_cloud()) || self.clouds.contains_key(&topic.name),
        })
    }

    /// The intrinsics of a topic of images: beside it, or one level up, and so on.
    fn info_of(&self, topic: &str) -> Option<&CameraInfo> {
        parents(topic).find_map(|parent| self.infos.get(&format!("{parent}/camera_info")))
    }

    /// Pose of the frame of a topic of images in the lidar frame.
    fn t_lidar_frame(&self, path: &Path, topic: &str, frame: &str, options: &ImageOptions) -> Result<Pose> {
        if let Some(t_base_camera) = options.t_base_camera {
            return Ok(options.t_base_lidar.unwrap_or_else(Pose::identity).inv_mul(&t_base_camera));
        }
        let lidar = match &options.cloud_topic {
            Some(topic) => self.clouds.get(topic),
            None => self.clouds.values().next(),
        };
        let Some(lidar) = lidar else {
            let remedy = "give the pose of the camera: --t-base-camera, or t_lidar_camera with --cameras";
            return Err(Error::dataset(path, "no clouds in it say which frame is the lidar's", remedy));
        };
        self.tree.fixed(lidar, frame).ok_or_else(|| {
            let problem = format!("no fixed transform leads from {lidar}, the frame of the clouds, to {frame}, the frame of {topic}");
            Error::dataset(path, problem, "give the pose of the camera: --t-base-camera, or t_lidar_camera with --cameras; or record /tf_static, too")
        })
    }
}

fn is_of_interest(topic: &Topic) -> bool {
    let is_of_cameras = topic.encoding != Encoding::Other && matches!(topic.kind.as_str(), RAW | COMPRESSED | INFO);
    is_of_cameras || TopicRole::of(topic).is_some_and(|role| role.is_cloud() || (role == TopicRole::Transforms && is_static(&topic.name)))
}

impl BagImages {
    /// The images of the chosen topics, one file after the other.
    pub(crate) fn play(&self) -> impl Iterator<Item = Result<Image>> + '_ {
        Playing { images: self, files: self.files.iter().collect(), current: None }
    }
}

struct Playing<'a> {
    images: &'a BagImages,
    files: VecDeque<&'a PathBuf>,
    current: Option<(&'a PathBuf, Box<dyn Container>)>,
}

impl Iterator for Playing<'_> {
    type Item = Result<Image>;

    fn next(&mut self) -> Option<Result<Image>> {
        let camera_of = |topic: &Topic| self.images.topics.iter().position(|(name, _)| *name == topic.name);
        loop {
            let Some((path, container)) = &mut self.current else {
                let path = self.files.pop_front()?;
                match open(path) {
                    Ok(container) => self.current = Some((path, container)),
                    Err(error) => return Some(Err(error)),
                }
                continue;
            };
            match container.next(&|topic| camera_of(topic).is_some()) {
                Some(Ok(message)) => {
                    let topic = container.topics()[message.topic].clone();
                    let Some(camera) = camera_of(&topic) else { continue };
                    let decoder = MessageDecoder { path, topic: &topic, message: &message };
                    return Some(
                        decoder.image().map(|(Header { time, .. }, content)| Image::new(time + self.images.topics[camera].1, camera, content)),
                    );
                }
                Some(Err(error)) => return Some(Err(error)),
                None => self.current = None,
            }
        }
    }
}

impl MessageDecoder<'_> {
    /// Stamp and content of an image.
    fn image(&self) -> Result<(Header, Content)> {
        let (path, at) = (self.path.to_owned(), self.message.at);
        if self.topic.kind == RAW {
            return self.raw_image().map(|(header, pixels)| (header, Content::Raw { pixels, path, at }));
        }
        let (header, bytes) = self.compressed_image()?;
        Ok((header, Content::Compressed { bytes, path, at }))
    }
}
