//! `/initialpose`: somebody says about where the robot is, as viewers let people do.

use super::middleware::{Delivery, Handle, Middleware, MiddlewareError, TopicProfile};
use super::names::Names;
use super::services::{Request, RequestSender, place};
use voxelastic_io::ros::MessageReader;

/// `geometry_msgs/PoseWithCovarianceStamped`.
fn initial_pose(message: &[u8]) -> Option<Request> {
    let mut reader = MessageReader::new(message)?;
    let place = place(&mut reader)?;
    let mut variances = [0.0; 36];
    for variance in &mut variances {
        *variance = reader.f64()?;
    }
    // What is no number is not known.
    let variance = if variances[0].is_nan() || variances[7].is_nan() { f64::INFINITY } else { variances[0].max(variances[7]) };
    Some(Request::InitialPose { place, sigma: variance.max(0.0).sqrt() })
}

/// Listens to `/initialpose` (`geometry_msgs/PoseWithCovarianceStamped`), as viewers publish it.
///
/// # Errors
/// When the network refuses.
pub fn listen(middleware: &mut dyn Middleware, names: &Names, requests: &RequestSender) -> Result<Handle, MiddlewareError> {
    let requests = requests.clone();
    let deliver = move |message: Vec<u8>| match initial_pose(&message) {
        Some(request) => requests.tell(request),
        None => tracing::warn!("a message on the topic of initial poses is none"),
    };
    let kind = "geometry_msgs/msg/PoseWithCovarianceStamped".to_owned();
    let profile = TopicProfile { name: names.resolve("initialpose"), kind, delivery: Delivery::Reliable, depth: 1 };
    middleware.subscribe(&profile, Box::new(deliver))
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic_io::ros::MessageWriter;

    #[test]
    fn a_pose_is_read_with_how_sure_it_is() {
        let mut variances = [0.0; 36];
        (variances[0], variances[7], variances[35]) = (0.25, 4.0, 9.0);
        let message = |variances: &[f64; 36]| {
            MessageWriter::new().u32(5).u32(0).text("map").f64s(&[1.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0]).f64s(variances).finish()
        };
        let unknown = initial_pose(&message(&[f64::NAN; 36]));
        assert!(matches!(unknown, Some(Request::InitialPose { sigma: f64::INFINITY, .. })), "{unknown:?}");
        let message = message(&variances);
        let Some(Request::InitialPose { place, sigma }) = initial_pose(&message) else { panic!() };
        assert_eq!((place.frame.as_str(), place.stamp, sigma), ("map", Some(5.0), 2.0));
        assert!((place.pose.rotation.angle() - std::f64::consts::PI).abs() < 1e-9 && place.pose.translation.y == 2.0);
        assert_eq!(initial_pose(&message[..message.len() - 1]), None);
    }
}
