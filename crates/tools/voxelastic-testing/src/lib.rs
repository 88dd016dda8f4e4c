//! What tests need from outside of the repository: recorded data, Python packages, a browser. A test that lacks one of them skips.
//!
//! | variable | meaning |
//! | --- | --- |
//! | `VOXELASTIC_DATA` | folder of the recorded data; default `../shared/data` beside the repository |
//! | `VOXELASTIC_PYTHON` | Python interpreter with the packages that results are compared with; default `python3` |
//! | `VOXELASTIC_NODE_MODULES` | folder `node_modules` with the packages of `.ci/npm`, for Node.js |
//! | `VOXELASTIC_REQUIRE` | comma-separated list of `data`, `python`, `browser`, `node`, `fastdds`: a test that would skip for want of it fails |
//! | `VOXELASTIC_SKIPS` | file that each skip appends a line to: what is missing, and the test. `.ci/run` prints their number |
//!
//! ```no_run
//! # fn a_test() {
//! let Some(hall) = voxelastic_testing::data("hall") else { return };
//! let Some(text) = voxelastic_testing::run_python("numpy", "import numpy; print(numpy.pi)", &[]) else { return };
//! # }
//! ```

mod browser;
mod domain;
pub mod packets;
mod page;
mod skip;
mod small_disk;

pub use browser::Browser;
pub use domain::Domain;
pub use page::Page;
pub use skip::{Need, skip};
pub use small_disk::SmallDisk;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// A test that waits longer than this hangs: it is not slow, however busy the machine.
pub const PATIENCE: Duration = Duration::from_secs(600);

/// Processor time of this thread, which other programs do not lengthen; elsewhere than on Unix, time.
pub fn thread_cpu_time() -> Duration {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
    }
    #[cfg(not(unix))]
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default()
}

/// A file or folder of the recorded data; none, after noting the skip, where it is absent.
///
/// # Panics
/// When it is absent and data is required.
pub fn data(relative: &str) -> Option<PathBuf> {
    let path = data_folder().join(relative);
    if path.exists() {
        return Some(path);
    }
    skip(Need::Data, &format!("{} does not exist (VOXELASTIC_DATA)", path.display()));
    None
}

/// The folder of the recorded data, whether or not it exists.
pub fn data_folder() -> PathBuf {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    std::env::var_os("VOXELASTIC_DATA").map_or_else(default, PathBuf::from)
}

/// The folder with packages for Node.js; none, after noting the skip, without it.
///
/// # Panics
/// When it is absent, and Node.js is required.
pub fn node_modules() -> Option<PathBuf> {
    let folder = std::env::var_os("VOXELASTIC_NODE_MODULES").map(PathBuf::from).filter(|folder| folder.is_dir());
    if folder.is_none() {
        skip(Need::Node, "there are no packages for Node.js (VOXELASTIC_NODE_MODULES)");
    }
    folder
}

/// A Python interpreter that can import the modules, given as in an `import` statement; none, after noting the skip, without one.
///
/// # Panics
/// When it cannot, and Python is required.
pub fn python(modules: &str) -> Option<String> {
    let interpreter = std::env::var("VOXELASTIC_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let probe = Command::new(&interpreter).args(["-c", &format!("import {modules}")]).output();
    if probe.is_ok_and(|p| p.status.success()) {
        return Some(interpreter);
    }
    skip(Need::Python, &format!("{interpreter} cannot import {modules} (VOXELASTIC_PYTHON)"));
    None
}

/// Runs a Python script that needs the modules, and returns what it prints; none, after noting the skip, where Python lacks one of them.
///
/// # Panics
/// When the script fails, or a module is missing and Python is required.
pub fn run_python(modules: &str, script: &str, arguments: &[&Path]) -> Option<String> {
    let interpreter = python(modules)?;
    let output = Command::new(&interpreter).args(["-c", script]).args(arguments).output();
    let output = output.unwrap_or_else(|e| panic!("cannot run {interpreter}: {e}"));
    assert!(output.status.success(), "the Python script failed: {}", String::from_utf8_lossy(&output.stderr));
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// This program again, with one test of it, ignored otherwise, and the variables.
    fn child(variables: &[(&str, &str)]) -> std::process::Output {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["tests::lacks_data", "--exact", "--ignored", "--nocapture"]);
        command.env_remove("VOXELASTIC_REQUIRE").env_remove("VOXELASTIC_SKIPS");
        command.envs(variables.iter().copied()).output().unwrap()
    }

    #[test]
    #[ignore = "run by the other tests, as a process of its own"]
    fn lacks_data() {
        assert_eq!(data("no such file"), None);
    }

    #[test]
    fn a_skip_is_noted_with_the_test() {
        let list = std::env::temp_dir().join(format!("voxelastic-skips-{}", std::process::id()));
        let said = child(&[("VOXELASTIC_SKIPS", list.to_str().unwrap()), ("VOXELASTIC_REQUIRE", "python,browser")]);
        assert!(said.status.success());
        let noted = std::fs::read_to_string(&list).unwrap();
        std::fs::remove_file(&list).unwrap();
        assert!(noted.starts_with("data: tests::lacks_data: ") && noted.lines().count() == 1, "{noted}");
    }

    #[test]
    fn a_skip_of_what_is_required_fails() {
        let said = child(&[("VOXELASTIC_REQUIRE", "browser, data")]);
        assert!(!said.status.success());
        assert!(String::from_utf8_lossy(&said.stderr).contains("VOXELASTIC_REQUIRE lists data"));
    }
}
