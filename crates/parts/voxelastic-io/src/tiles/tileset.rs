//! The tree of tiles, and its form as JSON (3D Tiles 1.1, section 7).

use crate::{Error, Origin, Position, Result, file};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::Path;

/// The file with the tree.
pub(super) const TILESET: &str = "tileset.json";
/// Folder of the tiles, beside `tileset.json`.
pub(super) const CONTENT: &str = "content";

/// A tile and those below it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Node {
    /// Least and largest coordinates of what it shows, map frame, metres.
    pub min: [f64; 3],
    pub max: [f64; 3],
    /// How far its surface may be from that of full detail, metres.
    pub error: f64,
    /// Name of its file in the folder of the tiles: a mesh, or another tree.
    pub file: String,
    pub children: Vec<Node>,
}

impl Node {
    /// The tile as JSON in a file that names those of the folder of tiles with `prefix`.
    fn json(&self, prefix: &str) -> Value {
        let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (self.min[k] + self.max[k]));
        // Flat surfaces, too, have a volume.
        let half: [f64; 3] = std::array::from_fn(|k| (0.5 * (self.max[k] - self.min[k])).max(1e-3));
        let [hx, hy, hz] = half;
        let bounds = [middle[0], middle[1], middle[2], hx, 0.0, 0.0, 0.0, hy, 0.0, 0.0, 0.0, hz];
        let mut tile = json!({
            "boundingVolume": { "box": bounds },
            "geometricError": self.error,
            "refine": "REPLACE",
            "content": { "uri": format!("{prefix}{}", self.file) },
        });
        if !self.children.is_empty() {
            tile["children"] = self.children.iter().map(|child| child.json(prefix)).collect();
        }
        tile
    }

    /// A whole tree in a file of its own, around `origin`.
    pub(super) fn tileset(&self, prefix: &str, extras: Value, origin: Origin) -> String {
        // Above it, nothing is shown: the error of that is the size of the map.
        let size = (0..3).map(|k| self.max[k] - self.min[k]).fold(self.error, f64::max);
        let mut asset = json!({ "version": "1.1", "generator": "Voxelastic" });
        if !extras.is_null() {
            asset["extras"] = extras;
        }
        let mut root = self.json(prefix);
        if !origin.is_zero() {
            let [x, y, z] = origin.coordinates();
            // By columns.
            root["transform"] = json!([1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, y, z, 1.0]);
        }
        json!({ "asset": asset, "geometricError": size, "root": root }).to_string()
    }
}

/// The box of all tiles of the folder, map frame, and the error of its root, as numbers of `tileset.json`.
pub(super) fn read_root(folder: &Path) -> Result<([f64; 12], f64)> {
    let path = folder.join(TILESET);
    let damaged = || Error::content(&path, Position::File, "not a tree of tiles", "export the map again");
    let tree: Value = serde_json::from_slice(&file::read(&path)?).map_err(|_| damaged())?;
    let numbers = |value: &Value| value.as_array().map(|all| all.iter().filter_map(Value::as_f64).collect::<Vec<f64>>());
    let mut bounds: [f64; 12] = numbers(&tree["root"]["boundingVolume"]["box"]).and_then(|n| n.try_into().ok()).ok_or_else(damaged)?;
    if let Some(transform) = numbers(&tree["root"]["transform"]).filter(|n| n.len() == 16) {
        (0..3).for_each(|k| bounds[k] += transform[12 + k]);
    }
    let error = tree["geometricError"].as_f64().ok_or_else(damaged)?;
    Ok((bounds, error))
}

/// The box around boxes.
pub(super) fn around(boxes: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> ([f64; 3], [f64; 3]) {
    boxes.fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), (min, max)| {
        (std::array::from_fn(|k| low[k].min(min[k])), std::array::from_fn(|k| high[k].max(max[k])))
    })
}
