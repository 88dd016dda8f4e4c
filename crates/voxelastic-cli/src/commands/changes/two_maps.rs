//! The two maps that are compared: two files, or sessions of one.

use crate::failure::Failure;
use crate::map_files::{self, LoadArgs, LoadedMap};
use nalgebra::Vector3;
use std::path::Path;
use voxelastic::atlas::{Atlas, Submap};
use voxelastic_io::Origin;

/// Two maps in one frame.
pub(super) struct TwoMaps {
    pub older: Atlas,
    pub newer: Atlas,
    /// What they are called, the older one first.
    pub names: [String; 2],
    /// Where the coordinates of both are counted from.
    pub origin: Origin,
    /// Submaps that were left out because they are damaged.
    pub damaged: usize,
}

impl TwoMaps {
    /// Loads two maps, or without a `newer` one a session of `map` (the last one, unless it is given) and those before it.
    pub fn load(map: &Path, newer: Option<&Path>, session: Option<u32>, load: LoadArgs) -> anyhow::Result<Self> {
        // Sessions are compared as they were mapped.
        let load = LoadArgs { keep_vanished: newer.is_none() || load.keep_vanished, ..load };
        let older = map_files::load(map, load)?;
        match newer {
            Some(path) => Ok(Self::of_maps(older, map_files::load(path, load)?, [map, path].map(|path| path.display().to_string()))),
            None => Self::of_sessions(map, older, session),
        }
    }

    fn of_maps(older: LoadedMap, newer: LoadedMap, names: [String; 2]) -> Self {
        let (origin, damaged) = (older.origin, older.damaged + newer.damaged);
        let shift = Vector3::from(newer.origin.coordinates()) - Vector3::from(origin.coordinates());
        let mut newer = newer.atlas;
        for submap in newer.submaps_mut() {
            let mut pose = submap.t_map_submap();
            pose.translation.vector += shift;
            submap.set_pose(pose);
        }
        Self { older: older.atlas, newer, names, origin, damaged }
    }

    fn of_sessions(path: &Path, map: LoadedMap, session: Option<u32>) -> anyhow::Result<Self> {
        let sessions = map_files::open(path)?.manifest().all_sessions();
        let last = sessions.iter().map(|session| session.number).max().unwrap_or_default();
        let number = session.unwrap_or(last);
        let file = path.display();
        let Some(chosen) = sessions.iter().find(|session| session.number == number) else {
            let known: Vec<String> = sessions.iter().map(|session| session.number.to_string()).collect();
            return Err(Failure::usage(format!("{file}: there is no session {number}"), format!("its sessions are {}", known.join(", "))).into());
        };
        let (mut older, mut newer): (Vec<Submap>, Vec<Submap>) = (Vec::new(), Vec::new());
        for submap in map.atlas.submaps() {
            if chosen.has(submap.id()) {
                newer.push(submap.clone());
            } else if sessions.iter().any(|session| session.number < number && session.has(submap.id())) {
                older.push(submap.clone());
            }
        }
        if older.is_empty() {
            let remedy = "give a second map, or add a session with `voxelastic map MORE --into MAP`";
            return Err(Failure::usage(format!("{file}: nothing was there before session {number}"), remedy).into());
        }
        let atlas = |submaps| Atlas::from_submaps(map.settings.voxel_size, submaps);
        let names = [format!("what was in {file} before"), format!("session {number}")];
        Ok(Self { older: atlas(older), newer: atlas(newer), names, origin: map.origin, damaged: map.damaged })
    }
}
