//! Adding sessions to a saved map: where they lie in it, and what the map has then.
//!
//! A session keeps its submaps: none is fused into one of another session. So what others see of a place, a mesh for one, is fused from all, and a session can be
//! taken out again.

mod addition;
mod frame;

pub use addition::Addition;
pub use frame::{Frame, numbers, pose_of};

use crate::error::{Error, Result};
use crate::map_files::{self, Loading};
use crate::precision::too_far;
use crate::surfaces::{self, SurfaceOptions};
use crate::warning::{Code, Warnings};
use serde::Serialize;
use std::collections::HashMap;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic::event::NodeId;
use voxelastic::settings::Settings;
use voxelastic::surface::Mesh;
use voxelastic_io::Origin;
use voxelastic_io::store::{MapStore, SessionEntry};
use voxelastic_report::RunLog;
use voxelastic_slam::join::{Attempt, FoundBy, Joined, Start, join};
use voxelastic_slam::loops::{LoopSettings, MapSurface, PlaceBook, Verdict};

/// Lengths that people have taken for metres: one of them in metres, and what they are.
const UNITS: [(f64, &str); 5] = [(0.3048, "feet"), (0.0254, "inches"), (0.01, "centimetres"), (0.001, "millimetres"), (1000.0, "kilometres")];

/// A session that is bent by more than this to fit is one that drifted, metres.
const MOST_BENT_M: f64 = 1.0;

/// What is added.
pub struct Sessions<'a> {
    /// Its submaps.
    pub atlas: &'a Atlas,
    /// Where their coordinates are counted from.
    pub origin: Origin,
    /// Its sessions, as they are in its own map.
    pub entries: Vec<SessionEntry>,
    /// Whether its frame may be that of the map.
    pub has_frame: bool,
}

/// Where a session lies, as `--json` has it.
#[derive(Clone, Debug, Serialize)]
pub struct SessionSummary {
    /// Numbers of the sessions that were added.
    pub numbers: Vec<u32>,
    /// What told where it lies: `frame` (its poses), `align`, `places` (recognised).
    pub by: &'static str,
    /// Where its frame lies in the map: x y z qx qy qz qw.
    pub t_map_session: [f64; 7],
    /// Loop edges to the sessions before.
    pub loop_edges: usize,
    /// Closures that were tried.
    pub closures_tried: usize,
    /// Closures refused because surfaces would be in space that the other has observed to be free.
    pub free_space: usize,
    /// By how much its shape was bent to fit, at most, metres: the drift that it came with.
    pub bent_m: f64,
}

/// Where a session lies.
pub enum Outcome {
    /// In the map.
    Joined(Box<Addition>, SessionSummary),
    /// Nobody knows where. The words say why.
    Apart(String),
}

/// The surfaces of a map, and the nodes from which they were observed.
struct View {
    surface: Mesh,
    voxel: f32,
    path: Vec<(NodeId, Pose)>,
}

impl View {
    fn of(atlas: &Atlas, voxel: f32) -> Result<Self> {
        let mut path = Vec::new();
        for submap in atlas.submaps() {
            path.extend(submap.corrected_scans().map(|(node, t_submap_lidar)| (node, submap.t_map_submap() * t_submap_lidar)));
        }
        path.sort_by_key(|(node, _)| *node);
        Ok(Self { surface: surfaces::of_submaps(atlas, &SurfaceOptions::default())?, voxel, path })
    }

    fn surface(&self) -> MapSurface<'_> {
        MapSurface { positions: &self.surface.positions, normals: &self.surface.normals, voxel: self.voxel }
    }

    fn book(&self, voxel: f64, settings: &LoopSettings) -> PlaceBook {
        PlaceBook::of_map(&self.surface(), &self.path, voxel, settings)
    }

    fn scaled(&mut self, scale: f64) {
        self.voxel *= scale as f32;
        self.surface.positions.iter_mut().flatten().for_each(|c| *c *= scale as f32);
        self.path.iter_mut().for_each(|(_, pose)| pose.translation.vector *= scale);
    }
}

/// Refuses settings that what is added to a map must share with it.
pub fn check_settings(map: &Path, base: &Settings, added: &Settings, remedy: &str) -> Result<()> {
    let differ = |what: String| Err(Error::usage(format!("{}: {what}", map.display()), remedy));
    if base.voxel_size != added.voxel_size {
        return differ(format!("its voxels are {} m wide, and what is to be added has voxels of {} m", base.voxel_size, added.voxel_size));
    }
    if base.field != added.field {
        return differ(format!("it has {} (--field), and what is to be added {}", base.field.name(), added.field.name()));
    }
    Ok(())
}

/// The session in the map that was mapped by the run with this number.
pub fn session_of_run(store: &MapStore, run: &str) -> Option<u32> {
    store.manifest().sessions.iter().find(|session| session.run.as_deref() == Some(run)).map(|session| session.number)
}

/// Finds where `added` lies in the map. To be called in a pool.
///
/// # Errors
/// When the map cannot be read, or one of the two has no surface.
pub fn place(store: &MapStore, added: Sessions<'_>, align: Option<Frame>, warnings: &mut Warnings) -> Result<Outcome> {
    let map = store.dir().to_owned();
    let base = map_files::load(&map, Loading::AS_STORED)?;
    let voxel_size = base.settings.voxel_size;
    let base_origin = base.origin;
    let first = View::of(&base.atlas, voxel_size)?;
    drop(base);
    let mut second = View::of(added.atlas, voxel_size)?;
    let node_offset = store.manifest().next_node();
    second.path.iter_mut().for_each(|(node, _)| *node += node_offset);
    let settings = LoopSettings::default();
    let voxel = PlaceBook::voxel_for_map(&first.surface(), &first.path);
    let (first_book, second_book) = (first.book(voxel, &settings), second.book(voxel, &settings));
    tracing::info!("looking for places that both have: {} in {}, {} in what is added", first_book.len(), map.display(), second_book.len());
    let frames = Frames { map: base_origin, added: added.origin };
    let start = match align {
        Some(frame) => Start::Given(frames.local(&frame.0)),
        None if added.has_frame => Start::Likely(frames.local(&Pose::identity())),
        None => Start::Unknown,
    };
    let attempt = join(&first_book, &second_book, &second.path, start, &settings)?;
    let joined = match (&attempt.joined, start) {
        (Some(joined), _) => joined.clone(),
        (None, Start::Given(t)) => {
            let text = "no surfaces were found to be the same where --align says: it is added there as it is, and not joined";
            warnings.add(Code::NotJoined, text, "");
            let poses = second.path.iter().map(|(node, pose)| (*node, t * pose)).collect();
            Joined { by: FoundBy::Start, t_first_second: t, poses, edges: Vec::new() }
        }
        (None, _) => return Ok(Outcome::Apart(why_apart(&map, &attempt, second, &first_book, &settings)?)),
    };
    if let Some(why) = too_far(joined.poses.iter().map(|(_, pose)| pose), voxel_size) {
        return Ok(Outcome::Apart(why));
    }
    let t_map_session = frames.stored(&joined.t_first_second);
    let offsets = addition::Offsets { submap: store.manifest().submaps.last().map_or(0, |entry| entry.id + 1), node: node_offset };
    let before = listed_sessions(store);
    let new = addition::sessions(&added.entries, &before, offsets, &t_map_session, &joined.edges, added.atlas);
    let summary = SessionSummary {
        numbers: new.iter().map(|session| session.number).collect(),
        by: match (joined.by, align) {
            (FoundBy::Places, _) => "places",
            (FoundBy::Start, Some(_)) => "align",
            (FoundBy::Start, None) => "frame",
        },
        t_map_session: numbers(&t_map_session),
        loop_edges: joined.edges.len(),
        closures_tried: attempt.tried.len(),
        free_space: attempt.count(Verdict::FreeSpace),
        bent_m: bent(&joined, &second.path),
    };
    let sessions = before.into_iter().chain(new).collect();
    Ok(Outcome::Joined(Box::new(Addition::new(offsets, joined, sessions, voxel_size)), summary))
}

/// The sessions of a map; one that the map began with has its name from the log of its run.
pub fn listed_sessions(store: &MapStore) -> Vec<SessionEntry> {
    let mut all = store.manifest().all_sessions();
    if let Some(first) = all.first_mut().filter(|first| first.number == 1 && first.input.is_none()) {
        let log = store.run_log().ok().flatten().and_then(|text| RunLog::from_json(&text).ok());
        first.input = log.map(|log| log.input).filter(|input| !input.is_empty());
    }
    all
}

/// How far the corrected poses of a session are from where it would lie as a rigid whole, at most, metres. Its frame is put at its first pose, from where
/// drift counts.
fn bent(joined: &Joined, path: &[(NodeId, Pose)]) -> f64 {
    let corrected: HashMap<NodeId, Pose> = joined.poses.iter().copied().collect();
    let both = path.iter().filter_map(|(node, pose)| Some((pose, corrected.get(node)?)));
    let Some(t_map_session) = both.clone().next().map(|(pose, now)| now * pose.inverse()) else { return 0.0 };
    both.map(|(pose, now)| ((t_map_session * pose).translation.vector - now.translation.vector).norm()).fold(0.0, f64::max)
}

/// Says what was added.
pub fn log(map: &Path, summary: &SessionSummary, warnings: &mut Warnings) {
    let words = match summary.by {
        "places" => "recognised by its places",
        "align" => "aligned as --align says",
        _ => "in the frame of the map",
    };
    let numbers: Vec<String> = summary.numbers.iter().map(u32::to_string).collect();
    let (numbers, map) = (numbers.join(", "), map.display());
    tracing::info!("session {numbers} of {map}: {words}, {} loop edges to the sessions before", summary.loop_edges);
    if summary.bent_m > MOST_BENT_M {
        let text = format!(
            "session {numbers} was bent by up to {:.1} m to fit: it drifted, so {map} may show places twice where it met neither itself nor an earlier session",
            summary.bent_m
        );
        warnings.add(Code::Bent, text, "map it with loop closures (--loops) before it is added");
    }
}

fn why_apart(map: &Path, attempt: &Attempt, mut second: View, first: &PlaceBook, settings: &LoopSettings) -> Result<String> {
    if let Some((places, share)) = attempt.alike {
        return Ok(format!(
            "it looks like {} in {places} places, but {:.1} % of its surfaces there are in space that was seen to be free, or the other way round: that is \
             another storey or room that looks alike, or much has changed. If it belongs there, --align says where",
            map.display(),
            100.0 * share
        ));
    }
    let accepted = attempt.count(Verdict::Accepted);
    let tried = format!(
        "{} pairs of places were compared, {accepted} fit, {} are refused by free space",
        attempt.tried.len(),
        attempt.count(Verdict::FreeSpace)
    );
    let mut scale = 1.0;
    for (unit, name) in UNITS {
        second.scaled(unit / scale);
        scale = unit;
        if join(first, &second.book(first.voxel_size(), settings), &second.path, Start::Unknown, settings)?.joined.is_some() {
            return Ok(format!("its lengths times {unit} fit those of {}: it seems to be in {name}", map.display()));
        }
    }
    Ok(format!("it has no places that {} surely has, too ({tried})", map.display()))
}

/// Where coordinates of two maps are counted from.
struct Frames {
    map: Origin,
    added: Origin,
}

impl Frames {
    fn shift(origin: Origin) -> Pose {
        let [x, y, z] = origin.coordinates();
        Pose::translation(x, y, z)
    }

    /// The pose of the added frame in the map's, as submaps have it.
    fn local(&self, t_map_session: &Pose) -> Pose {
        Self::shift(self.map).inverse() * t_map_session * Self::shift(self.added)
    }

    /// The same as users have it.
    fn stored(&self, t_first_second: &Pose) -> Pose {
        Self::shift(self.map) * t_first_second * Self::shift(self.added).inverse()
    }
}

/// A session that was just mapped, of `atlas`, from this input.
pub fn new_session(atlas: &Atlas, input: &Path, run: String) -> SessionEntry {
    let end = |submap: Option<&Submap>| submap.map_or(0, Submap::id);
    SessionEntry {
        number: 1,
        input: Some(input.display().to_string()),
        added: None,
        scans: atlas.scan_count(),
        first_submap: end(atlas.submaps().first()),
        last_submap: end(atlas.submaps().last()),
        node_offset: 0,
        t_map_session: None,
        loop_edges: Vec::new(),
        run: Some(run),
    }
}
