//! The two maps that are compared: two files, or sessions or laps of one.

use crate::args::LoadArgs;
use crate::failure::Failure;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::atlas::{Atlas, Submap, SubmapId, laps};
use voxelastic::changes::{ChangeOptions, keep_newest};
use voxelastic::settings;
use voxelastic_io::Origin;
use voxelastic_run::map_files::{self, LoadedMap};

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
    /// The lap that is the newer one, if laps are compared.
    pub lap: Option<u32>,
}

/// What is compared with what was before.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part<'a> {
    /// A newer map.
    Newer(&'a Path),
    Session(u32),
    Lap(u32),
    /// The last session, or all laps of the only one.
    Last,
}

impl TwoMaps {
    /// Loads two maps, or a part of `map` and those before it, and compares them. Laps are compared one after the other unless one of them is asked for.
    pub fn compare_each(map: &Path, part: Part<'_>, load: LoadArgs, mut compare: impl FnMut(&Self) -> anyhow::Result<()>) -> anyhow::Result<()> {
        // Sessions and laps are compared as they were mapped.
        let load = LoadArgs { keep_vanished: load.keep_vanished || !matches!(part, Part::Newer(_)), ..load };
        let older = map_files::load(map, load.into())?;
        let is_one_run = || -> anyhow::Result<bool> { Ok(map_files::open(map)?.manifest().all_sessions().len() < 2) };
        match part {
            Part::Newer(path) => {
                compare(&Self::of_maps(older, map_files::load(path, load.into())?, [map, path].map(|path| path.display().to_string())))
            }
            Part::Session(session) => compare(&Self::of_sessions(map, older, Some(session))?),
            Part::Lap(lap) => compare(&Laps::of(map, older)?.maps(lap)?),
            Part::Last if older.settings.laps == settings::Laps::Apart && is_one_run()? => {
                let laps = Laps::of(map, older)?;
                (2..=laps.last.max(2)).try_for_each(|lap| compare(&laps.maps(lap)?))
            }
            Part::Last => compare(&Self::of_sessions(map, older, None)?),
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
        Self { older: older.atlas, newer, names, origin, damaged, lap: None }
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
            let remedy = "give a second map, add a session with `voxelastic map MORE --into MAP`, or map with --laps apart and --field both";
            return Err(Failure::usage(format!("{file}: nothing was there before session {number}"), remedy).into());
        }
        let atlas = |submaps| Atlas::from_submaps(map.settings.voxel_size, submaps);
        let names = [format!("what was in {file} before"), format!("session {number}")];
        Ok(Self { older: atlas(older), newer: atlas(newer), names, origin: map.origin, damaged: map.damaged, lap: None })
    }
}

/// A map of one run whose laps were kept apart.
struct Laps {
    map: LoadedMap,
    file: String,
    /// By submap.
    laps: BTreeMap<SubmapId, u32>,
    last: u32,
}

impl Laps {
    /// The laps of a map, which was loaded from `path`.
    fn of(path: &Path, map: LoadedMap) -> anyhow::Result<Self> {
        let file = path.display().to_string();
        if map.settings.laps == settings::Laps::Fused {
            let remedy = "map the data again with --laps apart and --field both";
            return Err(Failure::usage(format!("{file}: its laps were not kept apart"), remedy).into());
        }
        let sessions = map_files::open(path)?.manifest().all_sessions().len();
        if sessions > 1 {
            let remedy = "compare its sessions with --session, or map the data of one by itself";
            return Err(Failure::usage(format!("{file}: it has {sessions} sessions, each with laps of its own"), remedy).into());
        }
        let laps = laps(map.atlas.submaps());
        let last = laps.values().copied().max().unwrap_or_default();
        Ok(Self { map, file, laps, last })
    }

    /// A lap, and what was there before it.
    fn maps(&self, number: u32) -> anyhow::Result<TwoMaps> {
        let Self { map, file, laps, last } = self;
        if number < 2 || number > *last {
            let remedy = if *last < 2 { "the sensor never came back to a place where it was" } else { "the first one has nothing before it" };
            return Err(Failure::usage(format!("{file}: it has {last} lap(s), and nothing was there before lap {number}"), remedy).into());
        }
        let of = |wanted: &dyn Fn(u32) -> bool| {
            let submaps = map.atlas.submaps().iter().filter(|submap| laps.get(&submap.id()).is_some_and(|lap| wanted(*lap)));
            Atlas::from_submaps(map.settings.voxel_size, submaps.cloned().collect())
        };
        // What had gone before that lap does not vanish in it.
        let margin = ChangeOptions::for_voxels(map.settings.voxel_size).margin;
        let age = |id| laps.get(&id).copied().unwrap_or_default();
        let (older, _) = keep_newest(of(&|lap| lap < number), age, margin, &(&map.settings).into());
        let names = [format!("the laps of {file} before"), format!("lap {number} of {last}")];
        Ok(TwoMaps { older, newer: of(&|lap| lap == number), names, origin: map.origin, damaged: map.damaged, lap: Some(number) })
    }
}
