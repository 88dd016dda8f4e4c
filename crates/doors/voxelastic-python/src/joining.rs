//! Adding a map to one on disk.

use crate::map::Map;
use crate::{arrays, errors, job};
use numpy::PyReadonlyArray1;
use pyo3::{PyResult, Python, pyfunction};
use std::path::{Path, PathBuf};
use voxelastic_io::store::MapWriter;
use voxelastic_run::joining::{self, Frame, Outcome, SessionSummary, Sessions};
use voxelastic_run::{Error, Warnings, map_files};

/// Numbers of the new sessions, what told where they lie, their frame in that of the map, loop edges, how far they were bent, and what was said: codes and texts.
type Joined = (Vec<u32>, &'static str, [[f64; 4]; 4], usize, f64, Vec<(String, String)>);

/// Adds a map to the one at `into`, which is replaced when all is written. Its frame may be that of the map, or lies there at `pose`.
#[pyfunction]
pub fn merge_into(py: Python<'_>, map: &Map, into: PathBuf, pose: Option<PyReadonlyArray1<'_, f64>>, same_frame: bool) -> PyResult<Joined> {
    let (content, pool) = (map.content()?, job::shared_pool()?);
    let pose = pose.as_ref().map(arrays::pose).transpose()?;
    let join = move || -> voxelastic_run::Result<_> {
        map_files::open(&into)?;
        let mut writer = MapWriter::open(&into)?;
        let settings = map_files::settings_of(writer.store())?;
        joining::check_settings(&into, &settings, &content.settings, "")?;
        let mut entries = content.sessions.clone();
        if entries.is_empty() {
            entries.push(joining::new_session(&content.atlas, Path::new("Python"), String::new()));
            entries[0].run = None;
        }
        let sessions = Sessions { atlas: &content.atlas, origin: content.origin, entries, has_frame: same_frame };
        let mut warnings = Warnings::default();
        let (addition, summary) = match joining::place(writer.store(), sessions, pose.map(Frame), &mut warnings)? {
            Outcome::Joined(addition, summary) => (addition, summary),
            Outcome::Apart(why) => {
                let remedy = "nothing was changed; `pose` says where it lies, if that is known";
                return Err(Error::new(format!("{}: the map is not added: {why}", into.display()), remedy));
            }
        };
        addition.save(&mut writer, &content.atlas)?;
        joining::log(&into, &summary, &mut warnings);
        Ok((summary, warnings))
    };
    // A save that has begun is completed.
    let joined = job::run_short(py, || pool.install(join))?;
    let (summary, mut warnings) = joined.map_err(|error| errors::run(py, &error))?;
    let SessionSummary { numbers, by, t_map_session, loop_edges, bent_m, .. } = summary;
    let said = warnings.take_new().into_iter().map(|w| (w.code, w.text.replace("--align", "`pose`"))).collect();
    let by = if by == "align" { "pose" } else { by };
    Ok((numbers, by, arrays::matrix_of_numbers(t_map_session), loop_edges, bent_m, said))
}
