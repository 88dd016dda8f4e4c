//! What can be done to a map, and how it is written down.

use super::region::Region;
use crate::joining::numbers;
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;
use voxelastic::changes::OccupancyThen;
use voxelastic::event::{Edge, NodeId};

/// An edit of a map.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Edit {
    /// What a region has is erased.
    Erase {
        /// The region.
        region: Region,
        /// Whether surfaces are.
        surfaces: bool,
        /// What its occupancy is then; none if it stays.
        occupancy: Option<OccupancyThen>,
        /// In these submaps only; in all if none are named.
        submaps: Vec<SubmapId>,
    },
    /// What lies outside of a region is erased.
    Crop {
        /// The region.
        region: Region,
    },
    /// A scan or a submap is held, and the map bends so that it is.
    Pin {
        /// What is held.
        target: Target,
        /// How.
        pin: Pin,
    },
    /// Two places are the same, and the map bends so that they are.
    Closure {
        /// The two.
        between: Between,
        /// About where the second lies in the frame of the first; none if nobody knows.
        start: Option<Pose>,
        /// What is known for certain: as it was given or registered. Empty until it is registered.
        edges: Vec<Edge>,
    },
    /// A loop edge, of the run, of a session or of an edit before, was wrong.
    RemoveClosure {
        /// Its scans, in any order.
        scans: [NodeId; 2],
    },
    /// A submap becomes part of another one.
    Merge {
        /// The one that stays.
        into: SubmapId,
        /// The one that goes.
        from: SubmapId,
    },
    /// Two submaps are not the same place: no closure joins them, they are not merged, and nobody is told that they do not fit.
    KeepApart {
        /// The two.
        submaps: [SubmapId; 2],
    },
    /// The map has another zero and another x axis.
    Origin {
        /// What is zero then, metres.
        at: [f64; 3],
        /// The direction of the x axis then, degrees, from x to y.
        yaw: f64,
    },
    /// A session as a whole is moved.
    AlignSession {
        /// Its number.
        session: SessionName,
        /// Where its own frame lies in the map.
        t_map_session: Pose,
    },
    /// Something to remember.
    Note {
        /// In words.
        text: String,
        /// Where, metres; none for the whole map.
        at: Option<[f64; 3]>,
    },
}

/// A scan or a submap.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The scan of a node.
    Scan(NodeId),
    /// A submap.
    Submap(SubmapId),
}

/// Two scans or two submaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// Scans of two nodes.
    Scans([NodeId; 2]),
    /// Submaps.
    Submaps([SubmapId; 2]),
}

/// A session as it is named.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SessionName {
    /// By its number.
    Number(u32),
    /// By its data.
    Input(String),
}

/// How something is held.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pin {
    /// The point of it that is meant by position and height, where it lies before, metres; none for the scanner, or the origin of the submap's frame.
    pub at: Option<[f64; 3]>,
    /// Its whole pose, of the scanner or of the submap's frame in the map.
    pub pose: Option<Pose>,
    /// Its position, metres.
    pub position: Option<[f64; 3]>,
    /// Its height, metres.
    pub height: Option<f64>,
    /// What is up.
    pub up: Option<Up>,
}

/// What is to point up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Up {
    /// The z axis of what is held.
    Own,
    /// This direction of the map as it lies before.
    Direction([f64; 3]),
}

impl Edit {
    /// Whether the pose graph of the map has to be known for it.
    pub(super) fn needs_graph(&self) -> bool {
        match self {
            Self::Pin { .. }
            | Self::Closure { .. }
            | Self::RemoveClosure { .. }
            | Self::KeepApart { .. }
            | Self::AlignSession { .. }
            | Self::Origin { .. } => true,
            Self::Erase { .. } | Self::Crop { .. } | Self::Merge { .. } | Self::Note { .. } => false,
        }
    }

    /// What it is called.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Erase { .. } => "erase",
            Self::Crop { .. } => "crop",
            Self::Pin { .. } => "pin",
            Self::Closure { .. } => "closure",
            Self::RemoveClosure { .. } => "remove-closure",
            Self::Merge { .. } => "merge",
            Self::KeepApart { .. } => "keep-apart",
            Self::Origin { .. } => "origin",
            Self::AlignSession { .. } => "align-session",
            Self::Note { .. } => "note",
        }
    }

    /// The edit as a table of a list of edits: the same edit is always the same text, and reading it gives the same numbers, every bit.
    pub fn to_text(&self) -> String {
        let mut text = format!("\n[[edit]]\nkind = \"{}\"\n", self.kind());
        let mut key = |name: &str, value: String| text += &format!("{name} = {value}\n");
        match self {
            Self::Erase { region, surfaces, occupancy, submaps } => {
                let (name, value) = region_text(region);
                key(name, value);
                let of = match (surfaces, occupancy) {
                    (true, Some(_)) => "both",
                    (true, None) => "surfaces",
                    _ => "occupancy",
                };
                key("of", quoted(of));
                if let Some(then) = occupancy {
                    key("then", quoted(if *then == OccupancyThen::Free { "free" } else { "unknown" }));
                }
                if !submaps.is_empty() {
                    key("submaps", format!("{submaps:?}"));
                }
            }
            Self::Crop { region } => {
                let (name, value) = region_text(region);
                key(name, value);
            }
            Self::Pin { target, pin } => {
                match target {
                    Target::Scan(node) => key("scan", node.to_string()),
                    Target::Submap(id) => key("submap", id.to_string()),
                }
                if let Some(at) = &pin.at {
                    key("at", format!("{at:?}"));
                }
                if let Some(pose) = &pin.pose {
                    key("pose", format!("{:?}", numbers(pose)));
                }
                if let Some(position) = &pin.position {
                    key("position", format!("{position:?}"));
                }
                if let Some(height) = &pin.height {
                    key("height", format!("{height:?}"));
                }
                match &pin.up {
                    Some(Up::Own) => key("upright", "true".to_owned()),
                    Some(Up::Direction(up)) => key("up", format!("{up:?}")),
                    None => {}
                }
            }
            Self::Closure { between, start, edges } => {
                match between {
                    Between::Scans(scans) => key("scans", format!("{scans:?}")),
                    Between::Submaps(submaps) => key("submaps", format!("{submaps:?}")),
                }
                if let Some(start) = start {
                    key("start", format!("{:?}", numbers(start)));
                }
                if !edges.is_empty() {
                    let edges: Vec<String> = edges.iter().map(edge_text).collect();
                    key("edges", format!("[\n  {},\n]", edges.join(",\n  ")));
                }
            }
            Self::RemoveClosure { scans } => key("scans", format!("{scans:?}")),
            Self::Merge { into, from } => key("submaps", format!("[{into}, {from}]")),
            Self::KeepApart { submaps } => key("submaps", format!("{submaps:?}")),
            Self::Origin { at, yaw } => {
                key("at", format!("{at:?}"));
                key("yaw", format!("{yaw:?}"));
            }
            Self::AlignSession { session, t_map_session } => {
                key(
                    "session",
                    match session {
                        SessionName::Number(number) => number.to_string(),
                        SessionName::Input(input) => quoted(input),
                    },
                );
                key("pose", format!("{:?}", numbers(t_map_session)));
            }
            Self::Note { text, at } => {
                key("text", quoted(text));
                if let Some(at) = at {
                    key("at", format!("{at:?}"));
                }
            }
        }
        text
    }
}

fn region_text(region: &Region) -> (&'static str, String) {
    match region {
        Region::Box { min, max, yaw } => ("box", format!("{{ min = {min:?}, max = {max:?}, yaw = {yaw:?} }}")),
        Region::Sphere { centre, radius } => ("sphere", format!("{{ centre = {centre:?}, radius = {radius:?} }}")),
        Region::Prism { polygon, z } => ("prism", format!("{{ polygon = {polygon:?}, z = {z:?} }}")),
    }
}

fn edge_text(edge: &Edge) -> String {
    let information = edge.information.map_or_else(String::new, |information| format!(", information = {information:?}"));
    format!("{{ scans = [{}, {}], measured = {:?}{information} }}", edge.from, edge.to, numbers(&edge.t_from_to))
}

/// A string of TOML.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
