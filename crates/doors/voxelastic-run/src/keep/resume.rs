//! Whether a run goes on with one that did not end.

use super::identity::Identity;
use super::target::Target;
use super::unfinished::Unfinished;
use crate::warning::{Code, Warnings};
use crate::{Error, Result};
use voxelastic_io::store::Checkpoint;

/// Whether a run goes on with one that did not end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resume {
    /// If that had the same input and settings.
    #[default]
    IfSame,
    /// It must; it is an error if there is none.
    Required,
    /// Never: what that has mapped is given up.
    Restart,
}

impl Resume {
    /// The run in the directory of the target that did not end, if it is to be gone on with. One that has mapped more than the map that is there
    /// is not given up without [`restart`](Self).
    pub fn find(self, target: &mut Target, identity: &Identity, warnings: &mut Warnings) -> Result<Option<Unfinished>> {
        if self == Self::Restart {
            target.remove_checkpoints()?;
            return Ok(None);
        }
        let map = target.path().display().to_string();
        let unusable = |problem: String| unusable(&map, problem);
        let Some((found, differences)) = self.look(target, identity)? else { return Ok(None) };
        if differences.is_empty() {
            return going_on(found).map(Some).map_err(unusable);
        }
        let scans = scans_in(&found);
        let differ = differ(&map, scans, &differences);
        if self == Self::Required || scans > target.scans() {
            let remedy = "use the same input and settings to go on with it, name another map with -o, or give it up with --restart";
            return Err(Error::new(differ, remedy));
        }
        warnings.add(Code::SetAside, format!("{differ}; the map that is there has no fewer scans, so it is given up"), "");
        target.remove_checkpoints()?;
        Ok(None)
    }

    /// As [`find`](Self::find), for what must begin in any case: a run that is not gone on with is set aside, as a map of its own.
    pub fn find_or_set_aside(self, target: &mut Target, identity: &Identity, warnings: &mut Warnings) -> Result<Option<Unfinished>> {
        if self == Self::Restart {
            target.remove_checkpoints()?;
            return Ok(None);
        }
        let map = target.path().display().to_string();
        let found = self.look(target, identity).and_then(|found| match found {
            Some((found, differences)) if differences.is_empty() => going_on(found).map(Some).map_err(|problem| unusable(&map, problem)),
            Some((found, differences)) => {
                let remedy = "use the same input and settings to go on with it";
                Err(Error::new(differ(&map, scans_in(&found), &differences), remedy))
            }
            None => Ok(None),
        });
        match found {
            Err(problem) if self != Self::Required => {
                warnings.add(Code::SetAside, problem.one_line(), problem.remedy().unwrap_or_default());
                target.set_unfinished_aside(warnings)?;
                Ok(None)
            }
            other => other,
        }
    }

    /// What is in the directory of a run that did not end, and how that run differs from this one.
    fn look(self, target: &mut Target, identity: &Identity) -> Result<Option<(Checkpoint, Vec<String>)>> {
        let map = target.path().display().to_string();
        let found = target.take_checkpoint().map_err(|error| unusable(&map, error.to_string()))?;
        let Some(found) = found else {
            let remedy = "do without --resume to map from the beginning";
            return if self == Self::Required { Err(Error::new(format!("{map}: there is no run that did not end"), remedy)) } else { Ok(None) };
        };
        let (before, _) = Identity::split(&found.state).map_err(|problem| unusable(&map, problem))?;
        let differences = identity.differences(&before);
        Ok(Some((found, differences)))
    }
}

fn scans_in(found: &Checkpoint) -> usize {
    found.atlas.scan_count()
}

fn unusable(map: &str, problem: String) -> Error {
    let remedy = format!("--restart maps from the beginning; `voxelastic repair {map}/unfinished` makes a map of what is whole");
    Error::new(format!("cannot go on with the run that did not end: {problem}"), remedy)
}

fn differ(map: &str, scans: usize, differences: &[String]) -> String {
    format!("{map} has {scans} scans of a run that did not end, and that is another run: {}", differences.join("; "))
}

fn going_on(found: Checkpoint) -> std::result::Result<Unfinished, String> {
    let scans = scans_in(&found);
    let unfinished = Unfinished::read(found)?;
    tracing::info!("going on with the run that did not end: {scans} scans are mapped (--restart maps from the beginning)");
    Ok(unfinished)
}
