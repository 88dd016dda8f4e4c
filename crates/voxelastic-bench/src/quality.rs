//! What a map is worth: its error against the simulated world, or against scans that were held out of it.

use crate::data::{Dataset, Truth};
use crate::error::Result;
use crate::workshop::{Workshop, words};
use serde::Serialize;
use serde_json::Value;
use std::path::Path;
use voxelastic::settings::FieldKind;

/// Points of a map that are measured at most: the mean of a million is as good as that of all.
const MOST_POINTS: &str = "1000000";
/// The world's surface is looked for at points this far apart, metres, as the paper does (Sec. V-A): a coarser choice would count places
/// that few beams met as much as all others.
const TRUTH_VOXEL: &str = "0.05";
/// Held-out points farther from the sensor are left out, metres.
const HELD_OUT_RANGE: &str = "20";

/// Errors of a map, in metres and shares.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Quality {
    /// From what: `vertices` of the mesh, `voxels` that are occupied, `points` that were held out or of a cloud.
    pub of: String,
    /// To what: `world` or `mesh`.
    pub to: &'static str,
    /// Mean distance.
    pub mean_m: Option<f64>,
    /// Half of the distances are at most this.
    pub median_m: Option<f64>,
    /// 90 % of the distances are at most this.
    pub p90_m: Option<f64>,
    /// Share of the surface that was visible nearer than 30 m that lies within 5 cm of the map; only for a world.
    pub complete: Option<f64>,
}

/// Measures the map (or the cloud of a peer) that was made of `data`; `None` where nothing is true.
pub(crate) fn measure(shop: &Workshop, map: &Path, data: &Dataset, field: Option<FieldKind>) -> Result<Option<Quality>> {
    let map = map.display().to_string();
    let folder = data.folder.display().to_string();
    match data.truth {
        Truth::World => {
            let mut arguments = words(&["eval", &map, "--truth", &folder, "--max-points", MOST_POINTS, "--truth-voxel", TRUTH_VOXEL, "--json"]);
            // An occupancy map as a cloud of voxels: nothing else is asked of it here, so free space is not judged.
            arguments.extend(field.iter().flat_map(|f| words(&["--field", f.name()])));
            Ok(Some(against_world(&shop.ask(&arguments)?)))
        }
        Truth::HeldOut(every) if field.is_some() => {
            let arguments = words(&["heldout", &map, &folder, "--hold-out", &every.to_string(), "--max-range", HELD_OUT_RANGE, "--json"]);
            let answer = shop.ask(&arguments)?;
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
    fn exact_distances_are_preferred() {
        let exact = json!({"mean": 0.01, "median": 0.005, "p90": 0.02});
        let answer = json!({"measured": "vertices", "surface": {"accuracy": {"mean": 0.04}, "accuracy_exact": exact, "completeness": {"fraction_under_5cm": 0.9}}});
        let quality = against_world(&answer);
        assert_eq!((quality.mean_m, quality.complete, quality.of.as_str()), (Some(0.01), Some(0.9), "vertices"));
        let rough = json!({"measured": "points", "surface": {"accuracy": {"mean": 0.04}, "accuracy_exact": null}});
        assert_eq!(against_world(&rough).mean_m, Some(0.04));
    }
}
