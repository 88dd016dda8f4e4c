//! Which topics of a network are a robot's: found by their types and by the namespace of the node.

use super::middleware::Middleware;
use super::names::Names;
use super::output::profiles;
use std::borrow::Cow;
use std::collections::HashSet;
use std::time::{Duration, Instant};
use voxelastic_io::bag::live::LiveTopics;
use voxelastic_io::{Error, OpenOptions};

/// How often it is looked which topics there are.
const LOOK: Duration = Duration::from_millis(50);
/// Once what is needed is there, others may still appear, until nothing new did for this long.
const SETTLING: Duration = Duration::from_millis(400);
/// Without a topic of poses it is waited for so long before they are estimated.
const PATIENCE: Duration = Duration::from_secs(2);
/// It is said that something is waited for after this time.
const SILENCE: Duration = Duration::from_secs(3);

/// The topics of transforms as they are called where nothing is remapped.
const TRANSFORMS: [&str; 2] = ["/tf", "/tf_static"];
const TRANSFORM_KIND: &str = "tf2_msgs/msg/TFMessage";
/// Names by which inputs can be remapped.
const CLOUDS: &str = "points";
const POSES: &str = "odom";
const IMU: &str = "imu";
const CORRECTIONS: &str = "corrections";

/// Waits until the topics are there that are needed, and chooses among them: in the namespace of the node if it has one. Without a topic of poses they are to be
/// estimated, which the second value says; `estimates_poses` asks for that. None if `is_stopped` became true.
///
/// # Errors
/// [`Error::Ambiguous`] where several topics could be meant.
pub fn discover(
    middleware: &dyn Middleware,
    names: &Names,
    options: &OpenOptions,
    estimates_poses: bool,
    is_stopped: &dyn Fn() -> bool,
) -> Result<Option<(LiveTopics, bool)>, Error> {
    let own: HashSet<String> =
        profiles(names).into_iter().map(|(_, profile)| profile.name).filter(|name| !TRANSFORMS.contains(&name.as_str())).collect();
    let (options, begin, mut said) = (named(options, names), Instant::now(), false);
    let (mut known, mut changed, mut appeared) = (Vec::new(), Instant::now(), None);
    loop {
        if is_stopped() {
            return Ok(None);
        }
        let mut there = middleware.published();
        there.retain(|(name, kind)| kind == TRANSFORM_KIND || !own.contains(name) && !name.starts_with(&format!("{}/", names.full())));
        if there != known {
            (known, changed) = (there, Instant::now());
        }
        let transforms = transforms(&known, names, options.cloud_topic.as_deref());
        let usable = usable(&known, names, &transforms, &options);
        let chosen = LiveTopics::choose(middleware.name(), &usable, estimates_poses, &options);
        let is_settled = changed.elapsed() >= SETTLING;
        let for_long = |appeared: &mut Option<Instant>| appeared.get_or_insert_with(Instant::now).elapsed() >= PATIENCE;
        let with_names = |topics: LiveTopics| topics.with_transforms([&transforms[0], &transforms[1]]);
        match chosen {
            Ok(topics) if is_settled => return Ok(Some((with_names(topics), estimates_poses))),
            Err(Error::NoPoses { .. }) if for_long(&mut appeared) && is_settled && options.pose_topic.is_none() => {
                let topics = LiveTopics::choose(middleware.name(), &usable, true, &options)?;
                return Ok(Some((with_names(topics), true)));
            }
            Err(error @ Error::Ambiguous { .. }) if for_long(&mut appeared) && is_settled => return Err(error),
            Err(error) if begin.elapsed() >= SILENCE && !std::mem::replace(&mut said, true) => tracing::info!("waiting: {error}"),
            _ => {}
        }
        std::thread::sleep(LOOK);
    }
}

/// The options with names as they are in the network: flags may be relative to the namespace, and remaps name inputs, too.
fn named(options: &OpenOptions, names: &Names) -> OpenOptions {
    let mut options = options.clone();
    let resolve = |name: &mut String| {
        // Without a namespace, a name without a slash was always one at the root.
        *name = names.resolve(name);
    };
    let inputs = [
        (CLOUDS, &mut options.cloud_topic),
        (POSES, &mut options.pose_topic),
        (IMU, &mut options.imu_topic),
        (CORRECTIONS, &mut options.correction_topic),
    ];
    for (input, topic) in inputs {
        match topic {
            Some(name) => resolve(name),
            None if names.is_remapped(input) => *topic = Some(names.resolve(input)),
            None => {}
        }
    }
    options.more_sensors.iter_mut().for_each(|sensor| resolve(&mut sensor.topic));
    options
}

/// The topics of transforms: as they are remapped; else those of the namespace of the node, or of the topic of the clouds, if somebody publishes them; else `/tf` and `/tf_static`.
fn transforms(there: &[(String, String)], names: &Names, clouds: Option<&str>) -> [String; 2] {
    let is_there = |name: &str| there.iter().any(|(there, kind)| there == name && kind == TRANSFORM_KIND);
    let mut spaces: Vec<&str> = vec![names.namespace()];
    // `/robot1` and nothing of `/robot1/lidar/points`: the robot is the outermost.
    spaces.extend(clouds.and_then(|topic| topic.match_indices('/').nth(1).map(|(at, _)| &topic[..at])));
    spaces.retain(|space| !space.is_empty());
    let near = spaces.into_iter().find(|space| TRANSFORMS.iter().any(|name| is_there(&format!("{space}{name}"))));
    TRANSFORMS.map(|name| if names.is_remapped(name) { names.resolve(name) } else { format!("{}{name}", near.unwrap_or_default()) })
}

/// The topics that may be the robot's: those in its namespace and those that are named, with one pair of transforms, under the usual names.
fn usable<'a>(there: &'a [(String, String)], names: &Names, transforms: &[String; 2], options: &OpenOptions) -> Vec<(String, String)> {
    let named = [&options.cloud_topic, &options.pose_topic, &options.imu_topic, &options.correction_topic].into_iter().flatten();
    let named: HashSet<&str> = named.chain(options.more_sensors.iter().map(|sensor| &sensor.topic)).map(String::as_str).collect();
    let space = format!("{}/", names.namespace());
    let usual = |(name, kind): &'a (String, String)| -> Option<(Cow<'a, str>, &'a str)> {
        if kind == TRANSFORM_KIND {
            let at = transforms.iter().position(|transform| transform == name)?;
            return Some((Cow::Borrowed(TRANSFORMS[at]), kind));
        }
        (name.starts_with(&space) || named.contains(name.as_str())).then_some((Cow::Borrowed(name.as_str()), kind))
    };
    there.iter().filter_map(usual).map(|(name, kind)| (name.into_owned(), kind.to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::middleware::{Answer, Deliver, Handle, MiddlewareError, Sink, TopicProfile};

    struct There(Vec<(String, String)>);

    impl Middleware for There {
        fn name(&self) -> &'static str {
            "test"
        }
        fn published(&self) -> Vec<(String, String)> {
            self.0.clone()
        }
        fn subscribe(&mut self, _: &TopicProfile, _: Deliver) -> Result<Handle, MiddlewareError> {
            Ok(Handle::new(()))
        }
        fn advertise(&mut self, _: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
            Err(MiddlewareError::new("advertise", "not here"))
        }
        fn serve(&mut self, _: &str, _: &str, _: Answer) -> Result<Handle, MiddlewareError> {
            Ok(Handle::new(()))
        }
    }

    /// Two robots in namespaces, and one without, each with all its topics.
    fn three_robots() -> There {
        let kinds =
            [("points", "sensor_msgs/msg/PointCloud2"), ("odom", "nav_msgs/msg/Odometry"), ("tf", TRANSFORM_KIND), ("tf_static", TRANSFORM_KIND)];
        let of = |space: &'static str| kinds.map(|(name, kind)| (format!("{space}/{name}"), kind.to_owned()));
        There(["/robot1", "/robot2", ""].into_iter().flat_map(of).collect())
    }

    fn found(there: &There, node: &str, remaps: &[&str], options: &OpenOptions) -> Vec<String> {
        let remaps: Vec<String> = remaps.iter().map(|remap| (*remap).to_owned()).collect();
        let names = Names::parse(node, &remaps).unwrap();
        let (topics, _) = discover(there, &names, options, false, &|| false).unwrap().unwrap();
        topics.subscriptions().iter().map(|topic| topic.name.clone()).collect()
    }

    #[test]
    fn each_robot_has_the_topics_of_its_namespace() {
        let (there, usual) = (three_robots(), OpenOptions::default());
        for robot in ["/robot1", "/robot2"] {
            let all = ["points", "odom", "tf", "tf_static"].map(|name| format!("{robot}/{name}"));
            assert_eq!(found(&there, "mapper", &[&format!("__ns:={robot}")], &usual), all);
            assert_eq!(found(&there, &format!("{robot}/mapper"), &[], &usual), all);
            // Without a namespace, topics can be named.
            let named = OpenOptions { cloud_topic: Some(all[0].clone()), pose_topic: Some(all[1].clone()), ..OpenOptions::default() };
            assert_eq!(found(&there, "mapper", &[], &named), all);
            let remaps = ["points:=", "odom:="].map(|name| format!("{name}{robot}/{}", name.trim_end_matches(":=")));
            assert_eq!(found(&there, "mapper", &[&remaps[0], &remaps[1]], &usual), all);
        }
        let remapped = found(&there, "mapper", &["__ns:=/robot1", "/tf:=/tf", "/tf_static:=/robot2/tf_static", "odom:=/odom"], &usual);
        assert_eq!(remapped, ["/robot1/points", "/odom", "/robot1/tf", "/robot2/tf_static"]);
    }

    #[test]
    fn what_is_published_here_is_no_input() {
        let mut there = There(three_robots().0.split_off(8));
        there.0.extend(["/voxelastic/surface_points", "/cells"].map(|name| (name.to_owned(), "sensor_msgs/msg/PointCloud2".to_owned())));
        let usual = OpenOptions::default();
        assert_eq!(found(&there, "voxelastic", &["~/distance_slice:=/cells"], &usual)[0], "/points");
    }
}
