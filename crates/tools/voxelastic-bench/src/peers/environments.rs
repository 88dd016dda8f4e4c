//! Where peers run: in one Python, or each in a virtual environment of its own, since they want versions of Python and numpy that exclude each other.

use crate::workspace::Workspace;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// What is installed for a peer.
#[derive(Debug)]
pub(crate) struct Package {
    /// Name of its environment.
    pub name: &'static str,
    /// What pip is asked for.
    pub pip: &'static [&'static str],
    /// Versions of Python that it has wheels for, in the order in which they are tried.
    pub pythons: &'static [&'static str],
}

const ANY: &[&str] = &["3.11", "3.12", "3.10"];
pub(crate) const DUFOMAP: Package = Package { name: "dufomap", pip: &["dufomap", "scipy"], pythons: ANY };
pub(crate) const EVALIO: Package = Package { name: "evalio", pip: &["evalio"], pythons: ANY };
pub(crate) const GENZ_ICP: Package = Package { name: "genz-icp", pip: &["genz-icp"], pythons: ANY };
pub(crate) const GENZ_LIO: Package = Package { name: "genz-lio", pip: &["genz-lio"], pythons: ANY };
pub(crate) const KISS: Package = Package { name: "kiss", pip: &["kiss-icp", "kiss-slam", "map-closures"], pythons: ANY };
pub(crate) const OCTOMAP: Package = Package { name: "octomap", pip: &["pyoctomap"], pythons: ANY };
pub(crate) const OPEN3D: Package = Package { name: "open3d", pip: &["open3d-cpu"], pythons: ANY };
pub(crate) const PELORUS: Package = Package { name: "pelorus", pip: &["pelorus", "numpy"], pythons: ANY };
// It imports the last two, and does not ask for them.
pub(crate) const RETRO_SLAM: Package = Package { name: "retro-slam", pip: &["retro-slam", "map-closures", "pydantic-settings"], pythons: ANY };
pub(crate) const RKO_LIO: Package = Package { name: "rko-lio", pip: &["rko-lio"], pythons: ANY };
// Its wheels end with Python 3.10, and were compiled for the numpy of then.
pub(crate) const VDBFUSION: Package = Package { name: "vdbfusion", pip: &["vdbfusion", "numpy<2"], pythons: &["3.10"] };

/// The Python interpreters of peers.
#[derive(Clone, Debug)]
pub enum Interpreters {
    /// One for all; whether a peer is installed there is seen when its adapter runs.
    One(String),
    /// One for each, in environments below this folder that are made when they are first needed.
    Each(PathBuf),
}

impl Interpreters {
    /// Environments below the folder of a workspace, which stay there.
    pub fn each(workspace: &Workspace) -> Self {
        Self::Each(workspace.folder().join("environments"))
    }

    /// The interpreter that has a package; the error says why there is none.
    pub(crate) fn of(&self, package: &Package) -> Result<String, String> {
        match self {
            Self::One(python) => Ok(python.clone()),
            Self::Each(folder) => environment(&folder.join(package.name), package),
        }
    }
}

/// The interpreter of an environment, which is made unless it is there.
fn environment(folder: &Path, package: &Package) -> Result<String, String> {
    let (python, stamp, wanted) = (folder.join("bin/python"), folder.join("installed"), package.pip.join("\n"));
    let python = std::path::absolute(python).map_err(|e| e.to_string())?.display().to_string();
    if std::fs::read_to_string(&stamp).is_ok_and(|made| made == wanted) {
        return Ok(python);
    }
    let base = package.pythons.iter().find_map(|version| interpreter(version));
    let base = base.ok_or_else(|| format!("no Python {} on this machine", package.pythons.join(" or ")))?;
    tracing::info!("pip install {}", package.pip.join(" "));
    run(&base, &["-m", "venv", "--clear", &folder.display().to_string()])?;
    run(&python, &[&["-m", "pip", "install", "--quiet", "--disable-pip-version-check"][..], package.pip].concat())?;
    std::fs::write(&stamp, wanted).map_err(|e| e.to_string())?;
    Ok(python)
}

/// A Python of this version: on the path, or one of those that pyenv keeps.
fn interpreter(version: &str) -> Option<String> {
    let pyenv = std::env::var_os("PYENV_ROOT").map(PathBuf::from).or_else(|| Some(Path::new(&std::env::var_os("HOME")?).join(".pyenv")));
    let kept = pyenv.and_then(|pyenv| std::fs::read_dir(pyenv.join("versions")).ok());
    let kept = kept.into_iter().flatten().filter_map(Result::ok).map(|entry| entry.path());
    let of_version = |folder: &PathBuf| folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&format!("{version}.")));
    let mut candidates = vec![format!("python{version}")];
    candidates.extend(kept.filter(of_version).map(|folder| folder.join("bin/python3").display().to_string()));
    // The first may be a shim that only says which versions there are.
    candidates.into_iter().find(|python| run(python, &["-c", "import venv, ensurepip"]).is_ok())
}

/// Runs a program; the error is what it says last.
fn run(program: &str, arguments: &[&str]) -> Result<(), String> {
    let out = Command::new(program).args(arguments).stdin(Stdio::null()).output().map_err(|e| format!("{program}: {e}"))?;
    if out.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&out.stderr);
    let last = said.lines().rev().find(|line| line.starts_with("ERROR")).or_else(|| said.lines().rev().find(|line| !line.trim().is_empty()));
    Err(last.unwrap_or("it says nothing").trim_start_matches("ERROR: ").to_owned())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_installed_has_a_reason() {
        let folder = tempfile::tempdir().unwrap();
        let package = Package { name: "none", pip: &["none"], pythons: &["1.0"] };
        let why = Interpreters::Each(folder.path().into()).of(&package).unwrap_err();
        assert_eq!(why, "no Python 1.0 on this machine");
        assert_eq!(
            run("/bin/sh", &["-c", "echo one >&2; echo 'ERROR: no such package' >&2; echo notice >&2; exit 1"]).unwrap_err(),
            "no such package"
        );
        assert_eq!(Interpreters::One("python3".into()).of(&package).unwrap(), "python3");
    }

    #[test]
    fn an_environment_that_is_there_is_used_again() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(folder.path().join("octomap")).unwrap();
        std::fs::write(folder.path().join("octomap/installed"), "pyoctomap").unwrap();
        let python = Interpreters::Each(folder.path().into()).of(&OCTOMAP).unwrap();
        assert!(python.ends_with("octomap/bin/python"), "{python}");
    }
}
