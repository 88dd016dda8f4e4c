//! One manifest for the submaps of several maps.

use crate::store::description::manifest::{Manifest, SubmapEntry};
use crate::store::description::manifest_text;
use crate::store::description::pose_as_numbers;
use crate::{Error, Origin, Result};
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::Pose;
use voxelastic::atlas::SubmapId;

/// The text of the manifest of a map that has the submaps of several others, from the texts of their manifests. Their files need only lie beside it: a
/// file does not depend on where its submap lies. Submaps that `poses` names get these root poses (map frame); with `only_posed`, the others are left
/// out. Settings are those of the first map, and so is the origin from which poses count, unless another one is given.
///
/// # Errors
/// [`Error::Damaged`] and the like for a text that is no manifest, [`Error::Unwritable`] for two submaps with one number, other voxel sizes, and poses that are
/// not finite.
pub fn join_manifests(texts: &[String], poses: &BTreeMap<SubmapId, Pose>, only_posed: bool, origin: Option<Origin>) -> Result<String> {
    let path = Path::new("manifest.json");
    let mut joined: Option<Manifest> = None;
    for text in texts {
        let part = manifest_text::read(path, text.as_bytes())?;
        match &mut joined {
            None => joined = Some(part),
            Some(all) => {
                let sizes = (all.voxel_size(), part.voxel_size());
                if sizes.0 != sizes.1 {
                    return Err(Error::unwritable(path, "the maps have voxels of different sizes".to_owned()));
                }
                let damaged = |words: &str| Error::damaged(path, "settings", 0, format!("{words:?} is no origin"));
                let (to, from) = (all.details.origin().map_err(damaged)?, part.details.origin().map_err(damaged)?);
                let moved = |mut entry: SubmapEntry| {
                    if from != to {
                        entry.t_map_submap = to.to_local(from.to_map(entry.t_map_submap));
                    }
                    entry
                };
                all.submaps.extend(part.submaps.into_iter().map(moved));
            }
        }
    }
    let mut joined = joined.unwrap_or_default();
    joined.sessions.clear();
    if let Some(origin) = origin {
        joined.details = joined.details.with_origin(origin);
    }
    joined.submaps.retain(|entry| !only_posed || poses.contains_key(&entry.id));
    joined.submaps.sort_by_key(|entry| entry.id);
    if let Some(twice) = joined.submaps.windows(2).find(|pair| pair[0].id == pair[1].id) {
        return Err(Error::unwritable(path, format!("two maps have a submap {}", twice[0].id)));
    }
    for entry in &mut joined.submaps {
        if let Some(pose) = poses.get(&entry.id) {
            pose_as_numbers::check(pose).map_err(|what| Error::unwritable(path, format!("the pose of submap {} {what}", entry.id)))?;
            entry.t_map_submap = *pose;
        }
    }
    manifest_text::write(&joined).map_err(|e| Error::unwritable(path, e.to_string()))
}
