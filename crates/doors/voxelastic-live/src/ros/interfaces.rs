//! Types of messages and services: what DDS and Zenoh call them.

/// The hash of a type's definition in ROS 2 Jazzy (REP 2016), which is part of Zenoh's keys: subscribers ask for it. The tests compute them again with another
/// implementation.
const HASHES: &[(&str, &str)] = &[
    ("sensor_msgs/msg/PointCloud2", "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"),
    ("sensor_msgs/msg/Imu", "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"),
    ("visualization_msgs/msg/MarkerArray", "86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf"),
    ("nav_msgs/msg/OccupancyGrid", "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"),
    ("map_msgs/msg/OccupancyGridUpdate", "c4095b0be2e4363f8978a1570e0293ee093436f1e1c61d99b48502ac317025e8"),
    ("nav_msgs/msg/Odometry", "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
    ("nav_msgs/msg/Path", "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"),
    ("octomap_msgs/msg/Octomap", "9891a19a05b70ec20aa8f45db3f8300b9ab80afff32c61c549d25087da9625b0"),
    ("geometry_msgs/msg/PoseArray", "af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0"),
    ("geometry_msgs/msg/PoseStamped", "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
    ("geometry_msgs/msg/PoseWithCovarianceStamped", "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"),
    ("diagnostic_msgs/msg/DiagnosticArray", "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"),
    ("tf2_msgs/msg/TFMessage", "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"),
    ("std_srvs/srv/Trigger", "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"),
    ("std_srvs/srv/SetBool", "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"),
    ("nav_msgs/srv/GetPlan", "234f7aff100f5edb8150366601687b027bcdc253db47decb88fff846193fe5e8"),
    ("nav_msgs/srv/GetMap", "c8ae77c9995b3554b5ba80e4d4d443f970ac65143102a1d893ec24fc07b31147"),
    ("nav_msgs/srv/LoadMap", "1a192ac56c40fed2767dac26f0b371785372276bd465c902676d2dca135aae5a"),
    ("voxelastic_msgs/srv/GetDistances", "ef40534d30cf0c442ea35e62a106215ff9e5b2932b29fe4a3e742b7c313a0224"),
    ("rcl_interfaces/srv/ListParameters", "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d"),
    ("rcl_interfaces/srv/GetParameters", "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc"),
    ("rcl_interfaces/srv/GetParameterTypes", "da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca"),
    ("rcl_interfaces/srv/DescribeParameters", "845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff"),
    ("rcl_interfaces/srv/SetParameters", "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0"),
    ("rcl_interfaces/srv/SetParametersAtomically", "0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd"),
    ("lifecycle_msgs/srv/GetState", "800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795"),
    ("lifecycle_msgs/srv/ChangeState", "356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5"),
    ("lifecycle_msgs/srv/GetAvailableStates", "00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d"),
    ("lifecycle_msgs/srv/GetAvailableTransitions", "59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc"),
    ("rosgraph_msgs/msg/Clock", "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564"),
];

/// The type's hash as Zenoh's keys have it; that of an unknown type is all zeros, which only programs that do not look at it match.
pub fn hash(kind: &str) -> String {
    let known = HASHES.iter().find(|(name, _)| *name == kind).map_or(&[b'0'; 64][..], |(_, hash)| hash.as_bytes());
    format!("RIHS01_{}", String::from_utf8_lossy(known))
}

/// Package and name of `package/msg/Name` or `package/srv/Name`.
pub fn parts(kind: &str) -> Option<(&str, &str)> {
    let (package, rest) = kind.split_once('/')?;
    Some((package, rest.rsplit('/').next()?))
}

/// `package/msg/Name` of `package::msg::dds_::Name_`.
pub fn of_dds(kind: &str) -> Option<String> {
    let (path, name) = kind.strip_suffix('_')?.split_once("::dds_::")?;
    Some(format!("{}/{name}", path.replace("::", "/")))
}

/// `package::msg::dds_::Name_` of `package/msg/Name`.
pub fn to_dds(kind: &str) -> Option<String> {
    let (path, name) = kind.rsplit_once('/')?;
    Some(format!("{}::dds_::{name}_", path.replace('/', "::")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_have_their_names_in_dds() {
        let [ros, dds] = ["sensor_msgs/msg/PointCloud2", "sensor_msgs::msg::dds_::PointCloud2_"];
        assert_eq!((to_dds(ros).as_deref(), of_dds(dds).as_deref(), parts(ros)), (Some(dds), Some(ros), Some(("sensor_msgs", "PointCloud2"))));
        assert_eq!((of_dds("x"), to_dds("x"), parts("x")), (None, None, None));
    }

    #[test]
    fn hashes_are_those_that_ros_makes() {
        let script = include_str!("../../tests/ros2/type_hashes.py");
        let distances = include_str!("../../ros/voxelastic_msgs/srv/GetDistances.srv");
        let names: Vec<&std::path::Path> = [distances].into_iter().chain(HASHES.iter().map(|(name, _)| *name)).map(std::path::Path::new).collect();
        let Some(theirs) = voxelastic_testing::run_python("rosbags", script, &names) else { return };
        let ours: Vec<String> = HASHES.iter().map(|(name, _)| hash(name)).collect();
        assert_eq!(theirs.lines().collect::<Vec<_>>(), ours);
        assert!(hash("x/msg/Y").ends_with("_0000000000000000000000000000000000000000000000000000000000000000"));
    }
}
