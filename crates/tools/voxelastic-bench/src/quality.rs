//! Accuracy of a map: against the simulated world, or against held-out scans.

use crate::data::{Dataset, Truth};
use crate::error::Result;
use crate::workspace::{Workspace, words};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use voxelastic::settings::FieldKind;

/// Most points of a map that are measured: the mean of a million is as precise as that of all.
const MAX_POINTS: &str = "1000000";
/// Spacing of the points of the world's surface, metres, as in the paper (Sec. V-A). A larger one would give more weight to parts that few beams hit.
const TRUTH_VOXEL: &str = "0.05";
/// Largest range of held-out points, metres.
const HELD_OUT_RANGE: &str = "20";

/// Accuracy of a map, in metres and shares.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Quality {
    /// What is measured: `vertices` of the mesh, occupied `voxels`, or `points` (held out, or of a cloud).
    pub of: String,
    /// The reference: `world` or `mesh`.
    pub to: &'static str,
    /// Mean distance.
    pub mean_m: Option<f64>,
    /// Half of the distances are at most this.
    pub median_m: Option<f64>,
    /// 90 % of the distances are at most this.
    pub p90_m: Option<f64>,
    /// Share of the surface visible below 30 m that is within 5 cm of the map; only for a world.
    pub complete: Option<f64>,
}

/// Measures a map (or the cloud of a peer) of `data`; `None` without reference.
pub(crate) fn measure(workspace: &Workspace, map: &Path, data: &Dataset, field: Option<FieldKind>) -> Result<Option<Quality>> {
    let map = map.display().to_string();
    let folder = data.folder.display().to_string();
    match data.truth {
        Truth::World => {
            let mut arguments = words(&["eval", &map, "--truth", &folder, "--max-points", MAX_POINTS, "--truth-voxel", TRUTH_VOXEL, "--json"]);
            // An occupancy map is measured as a cloud of voxels, without free space.
            arguments.extend(field.iter().flat_map(|f| words(&["--field", f.name()])));
            Ok(Some(against_world(&workspace.run_json(&arguments)?)))
        }
        Truth::HeldOut(n) if field.is_some() => {
            let arguments = words(&["heldout", &map, &folder, "--hold-out", &n.to_string(), "--max-range", HELD_OUT_RANGE, "--json"]);
            let answer = workspace.run_json(&arguments)?;
            Ok(Some(Quality { of: "points".to_owned(), to: "mesh", ..of_distances(&answer["distances"]) }))
        }
        Truth::HeldOut(_) | Truth::None => Ok(None),
    }
}

fn against_world(answer: &Value) -> Quality {
    let surface = &answer["surface"];
    let exact = &surface["accuracy_exact"];
    let accuracy = of_distances(if exact.is_null() { &surface["accuracy"] } else { exact });
    let of = answer["measured"].as_str().unwrap_or_default().to_owned();
    Quality { of, to: "world", complete: surface["completeness"]["fraction_under_5cm"].as_f64(), ..accuracy }
}

fn of_distances(distances: &Value) -> Quality {
    let length = |key: &str| distances[key].as_f64();
    Quality { mean_m: length("mean"), median_m: length("median"), p90_m: length("p90"), ..Quality::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn exact_distances_have_priority() {
        let exact = json!({"mean": 0.01, "median": 0.005, "p90": 0.02});
        let answer = json!({"measured": "vertices", "surface": {"accuracy": {"mean": 0.04}, "accuracy_exact": exact, "completeness": {"fraction_under_5cm": 0.9}}});
        let quality = against_world(&answer);
        assert_eq!((quality.mean_m, quality.complete, quality.of.as_str()), (Some(0.01), Some(0.9), "vertices"));
        let rough = json!({"measured": "points", "surface": {"accuracy": {"mean": 0.04}, "accuracy_exact": null}});
        assert_eq!(against_world(&rough).mean_m, Some(0.04));
    }
}
