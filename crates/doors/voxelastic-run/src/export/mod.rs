//! Maps in the formats of other programs: clouds of the surface, OctoMaps of free space, 2-D maps of the floor, the surface in tiles, and planned paths.

pub mod cloud;
pub mod grid;
pub mod octomap;
pub mod path;
pub mod tiles;

use std::path::Path;

/// What helps where no format is known.
pub const FORMATS: &str =
    "use the extension .ply, .pcd, .las, .laz, .copc.laz, .e57, .bt, .ot or .yaml, or end a folder for tiles with a slash: tiles/";

/// File formats that maps are exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// States (`.bt`), or log-odds (`.ot`).
    Octomap {
        /// Whether it has states only.
        states_only: bool,
    },
    /// 2-D maps of the floor.
    Grid,
    /// Points.
    Cloud(cloud::Format),
    /// A folder of 3D Tiles.
    Tiles,
}

impl Format {
    /// By a name: its extension, or the slash at the end of a folder.
    pub fn of(path: &Path) -> Option<Self> {
        // The end of the name is lost in a path.
        let is_folder = path.is_dir() || path.as_os_str().as_encoded_bytes().ends_with(b"/");
        if is_folder {
            return Some(Self::Tiles);
        }
        let name = path.file_name()?.to_str()?.to_lowercase();
        if name.ends_with(".copc.laz") {
            return Some(Self::Cloud(cloud::Format::Copc));
        }
        let ending = path.extension()?.to_str()?.to_lowercase();
        Some(match ending.as_str() {
            "bt" => Self::Octomap { states_only: true },
            "yaml" => Self::Grid,
            "ot" => Self::Octomap { states_only: false },
            other => Self::Cloud(cloud::Format::of(other)?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_formats() {
        let of = |name: &str| Format::of(Path::new(name));
        assert_eq!(of("a/hall.BT"), Some(Format::Octomap { states_only: true }));
        assert_eq!(of("hall.ot"), Some(Format::Octomap { states_only: false }));
        assert_eq!(of("hall.copc.laz"), Some(Format::Cloud(cloud::Format::Copc)));
        assert_eq!([of("hall.laz"), of("hall.las")], [Some(Format::Cloud(cloud::Format::Las)); 2]);
        assert_eq!(of("map.yaml"), Some(Format::Grid));
        assert_eq!(of("there/is/none/"), Some(Format::Tiles));
        assert_eq!([of("hall"), of("hall.obj"), of("")], [None; 3]);
    }
}
