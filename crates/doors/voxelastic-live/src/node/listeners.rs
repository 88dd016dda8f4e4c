//! Who is told what happens to the map.

use super::exploring::Exploring;
use super::health::Rates;
use super::offers::Offers;
use super::watch::Watch;
use crate::publisher::ShownScan;
use crate::ros::heard::Heard;
use crate::ros::output::{MAP_FRAME, OdometryLink};
use crate::ros::services::Place;
use voxelastic::Pose;
use voxelastic::event::Event;
use voxelastic_io::bag::live::LiveFrames;
use voxelastic_run::{Mapping, Moment, Observer};
use voxelastic_slam::loops::Whereabouts;

/// Where somebody says that the robot is, it is within three standard deviations, but not nearer and not farther than this, metres.
const SAID_WITHIN: [f64; 2] = [2.0, 50.0];

/// A robot's node in a network.
pub struct OnNetwork {
    /// Its name.
    pub node: String,
    /// What it publishes.
    pub offers: Offers,
    /// The frames of what comes; none for a recording.
    pub frames: Option<LiveFrames>,
    /// What comes on which topic; none for a recording.
    pub heard: Option<Heard>,
    /// How often it comes.
    pub rates: Rates,
    /// Where to go next, if it explores.
    pub exploring: Option<Exploring>,
}

/// Who is told what happens to the map.
pub struct Listeners {
    pub watch: Option<Watch>,
    pub network: Option<OnNetwork>,
    /// Of the event that the mapper is about to take: the scan as viewers see it, and whether it is an edge.
    shown: Option<ShownScan>,
    is_edge: bool,
}

impl Listeners {
    /// Viewers, and others in a network.
    pub fn new(watch: Option<Watch>, network: Option<OnNetwork>) -> Self {
        Self { watch, network, shown: None, is_edge: false }
    }

    /// What they are to know of the map of before.
    pub fn show_before(&mut self, mapping: &Mapping) {
        if let Some(watch) = &mut self.watch {
            mapping.log().loops.iter().for_each(|edge| watch.publisher.add_loop(edge.from, edge.to));
            watch.publisher.note(mapping.mapper(), None);
        }
        if let Some(network) = &mut self.network {
            let scans = mapping.log().scans;
            scans.node.iter().zip(&scans.time_s).for_each(|(node, time)| network.offers.outputs.add_scan(*node, *time));
            network.offers.outputs.note(mapping.mapper(), None);
        }
    }
}

impl Observer for Listeners {
    fn before(&mut self, event: &Event, mapping: &Mapping) {
        (self.shown, self.is_edge) = (None, matches!(event, Event::OdometryEdge(_) | Event::LoopEdge(_)));
        match event {
            Event::Scan(scan) => {
                self.shown = self.watch.is_some().then(|| ShownScan::of(&scan.cloud, scan.time));
                if let Some(network) = &mut self.network {
                    network.offers.outputs.take_scan(scan, mapping.mapper().settings().min_range);
                    network.exploring.iter_mut().for_each(|exploring| exploring.add_scan(scan, mapping.mapper().settings()));
                }
            }
            Event::LoopEdge(edge) => {
                if let Some(watch) = &mut self.watch {
                    watch.publisher.add_loop(edge.from, edge.to);
                }
            }
            _ => {}
        }
    }

    fn after(&mut self, moment: &Moment<'_>) {
        if let Some(watch) = &mut self.watch {
            watch.publisher.note(moment.mapping.mapper(), self.shown.as_ref());
        }
        if let Some(network) = self.network.as_mut().filter(|_| !self.is_edge) {
            let link = network.odometry_link(moment);
            network.offers.outputs.note(moment.mapping.mapper(), link);
            network.exploring.iter_mut().for_each(Exploring::note);
        }
    }

    fn rebuilt(&mut self, moment: &Moment<'_>) {
        let mapper = moment.mapping.mapper();
        self.watch.iter_mut().for_each(|watch| watch.publisher.note(mapper, None));
        if let Some(network) = &mut self.network {
            network.offers.outputs.note_rebuilt(mapper);
            network.exploring.iter_mut().for_each(Exploring::note);
        }
    }

    fn restarted(&mut self) {
        if let Some(watch) = &mut self.watch {
            watch.publisher.reset();
        }
        if let Some(network) = &mut self.network {
            network.offers.outputs.reset();
            network.exploring.iter_mut().for_each(Exploring::restart);
        }
    }
}

impl OnNetwork {
    /// A pose of any frame of the robot in that of the map; in words why there is none.
    pub fn in_map(&self, place: &Place) -> Result<Pose, String> {
        let Place { frame, stamp, pose } = place;
        if frame.is_empty() || frame == MAP_FRAME {
            return Ok(*pose);
        }
        let frames = self.frames.as_ref().ok_or_else(|| format!("there is no frame but {MAP_FRAME} in what is played, so none {frame}"))?;
        let link = self.offers.outputs.link();
        let (root, t_map_root) = link.map_or((MAP_FRAME, Pose::identity()), |(link, t_map_odom)| (link.odom.as_str(), *t_map_odom));
        let in_root = |time| {
            let t_root_frame = frames.between(root, frame, time);
            // Where poses are estimated, nobody else says where the robot is.
            t_root_frame.or_else(|| Some(link?.0.t_odom_lidar * frames.between(&frames.lidar()?, frame, time)?))
        };
        match (in_root(*stamp), in_root(None)) {
            (Some(t_root_frame), _) => Ok(t_map_root * t_root_frame * pose),
            (None, Some(_)) => Err(format!(
                "where {frame} was at {:.3} s is not known: ask within some seconds, or with a time stamp of 0 for now",
                stamp.unwrap_or(0.0)
            )),
            (None, None) => {
                let mut known = frames.known();
                known.extend([MAP_FRAME.to_owned(), root.to_owned()]);
                known.sort();
                known.dedup();
                Err(format!("the frame {frame} is not connected with the map; the frames are: {}", known.join(", ")))
            }
        }
    }

    /// About where the lidar is, if the robot's base is at a place whose standard deviation is `sigma`, metres; in words why that is not known.
    pub fn whereabouts(&self, place: &Place, sigma: f64) -> Result<Whereabouts, String> {
        let t_map_base = self.in_map(place)?;
        let mount = self.frames.as_ref().and_then(LiveFrames::base);
        let (_, t_lidar_base) = mount.ok_or("where the lidar is on the robot is not known yet")?;
        let t_map_lidar = t_map_base * t_lidar_base.inverse();
        let x = t_map_lidar.rotation * nalgebra::Vector3::x();
        let mut position = t_map_lidar.translation.vector;
        if t_map_base.translation.z == 0.0 {
            // In two dimensions.
            position.z = 0.0;
        }
        Ok(Whereabouts { position, within: (3.0 * sigma).clamp(SAID_WITHIN[0], SAID_WITHIN[1]), yaw: Some(x.y.atan2(x.x)) })
    }

    /// What else publishes what this node publishes, in words.
    pub fn rival(&self) -> Option<String> {
        let [parent, child] = self.frames.as_ref()?.rival()?;
        Some(format!(
            "somebody else publishes the transform {parent} -> {child}, too: the robot jumps between the two; end one of them, or start this node with --no-tf"
        ))
    }

    /// How the odometry is tied to the last scan.
    fn odometry_link(&self, moment: &Moment<'_>) -> Option<OdometryLink> {
        let frames = self.frames.as_ref()?;
        if let Some((node, time, t_odom_lidar)) = moment.odometry_pose {
            return Some(OdometryLink { odom: "odom".to_owned(), t_odom_lidar, node, time, base: frames.base() });
        }
        let reported = frames.reported()?;
        let node = reported.node + moment.first_node;
        Some(OdometryLink { odom: frames.odom()?, t_odom_lidar: reported.t_odom_lidar, node, time: reported.time, base: None })
    }
}
