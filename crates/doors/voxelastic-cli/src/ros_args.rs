//! Arguments as those who start nodes of ROS 2 type them: `--ros-args -r FROM:=TO -p NAME:=VALUE --log-level LEVEL`, up to a `--` or the end.

use std::ffi::OsString;

/// The arguments with flags of this program instead: remaps and parameters, of which each is a setting or `use_sim_time`. What is not known stays as it is, for the parser to refuse.
pub fn translated(arguments: impl IntoIterator<Item = impl Into<OsString>>) -> Vec<OsString> {
    let (mut all, mut is_ros) = (Vec::new(), false);
    let mut arguments = arguments.into_iter().map(Into::into);
    while let Some(argument) = arguments.next() {
        match argument.to_str() {
            Some("--ros-args") => is_ros = true,
            Some("--") if is_ros => is_ros = false,
            Some(flag @ ("-r" | "--remap" | "-p" | "--param" | "--log-level")) if is_ros => {
                let value = arguments.next();
                match value.as_ref().and_then(|value| flags(flag, value.to_str()?)) {
                    Some(flags) => all.extend(flags.into_iter().map(OsString::from)),
                    None => all.extend([Some(argument), value].into_iter().flatten()),
                }
            }
            _ => all.push(argument),
        }
    }
    all
}

fn flags(flag: &str, value: &str) -> Option<Vec<String>> {
    match flag {
        "-r" | "--remap" => Some(vec![format!("--remap={value}")]),
        "--log-level" => match value.rsplit(":=").next()?.to_ascii_lowercase().as_str() {
            "debug" => Some(vec!["-v".to_owned()]),
            "info" => Some(Vec::new()),
            "warn" | "error" | "fatal" => Some(vec!["-q".to_owned()]),
            _ => None,
        },
        _ => {
            let (name, value) = value.split_once(":=")?;
            match (name, value.trim_matches(['"', '\''])) {
                ("use_sim_time", "true" | "True") => Some(vec!["--use-sim-time".to_owned()]),
                ("use_sim_time", "false" | "False") => Some(Vec::new()),
                (name, value) => Some(vec![format!("--{}={value}", name.replace('_', "-"))]),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        translated(text.split_whitespace()).into_iter().map(|word| word.into_string().unwrap()).collect()
    }

    #[test]
    fn what_users_of_ros_type_becomes_flags() {
        let typed =
            "voxelastic live --ros2 --ros-args -r __ns:=/robot1 --remap /tf:=tf -p use_sim_time:=true -p voxel_size:=0.1 --log-level debug -- --slam";
        let meant = "voxelastic live --ros2 --remap=__ns:=/robot1 --remap=/tf:=tf --use-sim-time --voxel-size=0.1 -v --slam";
        assert_eq!(words(typed), words(meant));
        assert_eq!(words("voxelastic map -r x -- y"), ["voxelastic", "map", "-r", "x", "--", "y"]);
        assert_eq!(words("live --ros-args --params-file x.yaml -p wrong"), ["live", "--params-file", "x.yaml", "-p", "wrong"]);
        assert_eq!(words("live --ros-args -r"), ["live", "-r"]);
    }
}
