//! What pages of the editor are sent, as messages of the viewer's scene.
//!
//! Surfaces are those of the submaps, in their frames: whatever moves, only poses are sent. A surface is sent again when an edit has changed its field.

use crate::scene::{Scene, Thing};
use crate::wire::{self, Place};
use rayon::prelude::*;
use serde_json::json;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::surface::{Mesh, MeshOptions};
use voxelastic_run::Result;
use voxelastic_run::editing::{Draft, Edit, Suggestion};
use voxelastic_run::surfaces::SurfaceOptions;

/// Edge of the pieces that a surface is sent in, finest voxels: what is out of the picture is not drawn.
const PIECE: f32 = 192.0;
/// Surfaces that are made before they are sent.
const TOGETHER: usize = 8;
/// Positions of the path in a message.
const PART: usize = 256;

/// What pages know of a map.
pub struct SceneUpdates {
    scene: Arc<Scene>,
    options: SurfaceOptions,
    surfaces: HashMap<SubmapId, Surface>,
    path: Vec<Place>,
    suggestions: Option<Suggestions>,
}

/// What was found, and the edits that the map had then.
struct Suggestions {
    found: Vec<Suggestion>,
    edits: Vec<Edit>,
}

/// A surface that pages have.
struct Surface {
    /// What an edit has made of the submap.
    changed: Option<Arc<Submap>>,
    pieces: usize,
}

impl Surface {
    fn is_of(&self, changed: Option<&Arc<Submap>>) -> bool {
        match (&self.changed, changed) {
            (None, None) => true,
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }
}

impl SceneUpdates {
    /// Nothing yet.
    pub fn new(scene: Arc<Scene>, lod: usize) -> Self {
        let options = SurfaceOptions { mesh: MeshOptions { lod, ..MeshOptions::default() }, ..SurfaceOptions::default() };
        Self { scene, options, surfaces: HashMap::new(), path: Vec::new(), suggestions: None }
    }

    /// Keeps what was found not to be consistent in a map.
    pub fn keep_suggestions(&mut self, found: Vec<Suggestion>, draft: &Draft) {
        self.suggestions = Some(Suggestions { found, edits: draft.edits().cloned().collect() });
    }

    /// Sends pages what is another one than they have. Poses and figures come first.
    ///
    /// # Errors
    /// When a submap cannot be read.
    pub fn send(&mut self, draft: &Draft) -> Result<()> {
        let poses: Vec<_> = draft.submaps().collect();
        let mut messages = vec![(Thing::Submaps, wire::submaps(&poses)), (Thing::Statistics, wire::statistics(&self.figures(draft)))];
        self.add_path(draft, &mut messages);
        let gone: Vec<SubmapId> = self.surfaces.keys().copied().filter(|id| poses.iter().all(|(there, _)| there != id)).collect();
        for id in gone {
            let pieces = self.surfaces.remove(&id).map_or(0, |surface| surface.pieces);
            messages.extend((0..pieces).map(|k| piece(id, k, Mesh::default())));
        }
        self.scene.put(messages);
        let is_new = |id: &SubmapId| !self.surfaces.get(id).is_some_and(|surface| surface.is_of(draft.changed(*id)));
        let new: Vec<SubmapId> = poses.iter().map(|(id, _)| *id).filter(is_new).collect();
        for ids in new.chunks(TOGETHER) {
            let make = |id: &SubmapId| {
                let submap = draft.submap(*id)?;
                Ok((*id, pieces(&self.options.extract(&submap), PIECE * submap.voxel_size())))
            };
            let made = ids.par_iter().map(make).collect::<Result<Vec<_>>>()?;
            for (id, pieces) in made {
                let before = self.surfaces.get(&id).map_or(0, |surface| surface.pieces);
                let count = pieces.len();
                let all = pieces.into_iter().chain((count..before).map(|_| Mesh::default()));
                self.scene.put(all.enumerate().map(|(k, mesh)| piece(id, k, mesh)));
                self.surfaces.insert(id, Surface { changed: draft.changed(id).cloned(), pieces: count.max(before) });
            }
        }
        Ok(())
    }

    fn add_path(&mut self, draft: &Draft, messages: &mut Vec<(Thing, Vec<u8>)>) {
        let place =
            |(_, submap, t): (_, SubmapId, voxelastic::Pose)| Place { submap, position: <[f64; 3]>::from(t.translation.vector).map(|c| c as f32) };
        let path: Vec<Place> = draft.path().into_iter().map(place).collect();
        for part in 0..path.len().max(self.path.len()).div_ceil(PART) {
            let now = path.chunks(PART).nth(part).unwrap_or_default();
            if self.path.chunks(PART).nth(part).unwrap_or_default() != now {
                messages.push((Thing::Path(part as u32), wire::path(part as u32, now)));
            }
        }
        self.path = path;
    }

    /// What is not drawn, and closures.
    fn figures(&self, draft: &Draft) -> String {
        let (saved, is_saved) = draft.saved();
        let edits: Vec<_> = draft.edits().map(|edit| json!({ "kind": edit.kind(), "text": edit.to_text().trim() })).collect();
        let mut rows = vec![
            ["Submaps".to_owned(), draft.submaps().count().to_string()],
            ["Scans".to_owned(), draft.path().len().to_string()],
            ["Edits".to_owned(), edits.len().to_string()],
        ];
        if !is_saved {
            rows.push(["Not saved".to_owned(), "yes".to_owned()]);
        }
        json!({
            "rows": rows, "read_only": draft.why_read_only(), "origin": draft.origin().coordinates(), "edits": edits, "saved": saved, "is_saved": is_saved,
            "redo": draft.undone(), "trial": draft.trial(), "closures": draft.closures(), "changes": draft.changes(), "shows_saved": draft.shows_saved(),
            "suggestions": self.suggestions.as_ref().map(|all| &all.found),
            "suggestions_are_old": self.suggestions.as_ref().is_some_and(|all| !all.edits.iter().eq(draft.edits())),
        })
        .to_string()
    }
}

fn piece(id: SubmapId, number: usize, mesh: Mesh) -> (Thing, Vec<u8>) {
    let place = [id.cast_signed(), number as i32, 0];
    (Thing::Tile(place), wire::tile(id, place, 0, mesh))
}

/// A mesh in pieces of about `edge` metres, each with its own vertices.
fn pieces(mesh: &Mesh, edge: f32) -> Vec<Mesh> {
    let mut cells: BTreeMap<[i32; 3], Vec<[u32; 3]>> = BTreeMap::new();
    for triangle in &mesh.triangles {
        let cell = mesh.positions[triangle[0] as usize].map(|c| (c / edge).floor() as i32);
        cells.entry(cell).or_default().push(*triangle);
    }
    cells.into_values().map(|triangles| part(mesh, &triangles)).collect()
}

fn part(mesh: &Mesh, triangles: &[[u32; 3]]) -> Mesh {
    let (mut part, mut numbers) = (Mesh::default(), HashMap::new());
    for triangle in triangles {
        let corners = triangle.map(|v| {
            *numbers.entry(v).or_insert_with(|| {
                let v = v as usize;
                part.positions.push(mesh.positions[v]);
                part.normals.push(mesh.normals[v]);
                part.intensities.extend(mesh.intensities.get(v));
                part.colours.extend(mesh.colours.get(v));
                part.scales.extend(mesh.scales.get(v));
                part.positions.len() as u32 - 1
            })
        });
        part.triangles.push(corners);
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_together_are_the_mesh() {
        let positions: Vec<[f32; 3]> = (0..60).map(|k| [0.5 * k as f32 - 7.0, (k % 2) as f32, 0.0]).collect();
        let triangles: Vec<[u32; 3]> = (0..58).map(|k| [k, k + 1, k + 2]).collect();
        let mesh = Mesh { normals: vec![[0.0, 0.0, 1.0]; 60], scales: (0..60).collect(), positions, triangles, ..Mesh::default() };
        let pieces = pieces(&mesh, 4.0);
        assert!(pieces.len() > 5 && pieces.iter().all(|piece| piece.positions.len() < 20 && piece.colours.is_empty()));
        let corners = |mesh: &Mesh| mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].map(f32::to_bits))).collect::<Vec<_>>();
        let mut all: Vec<_> = pieces.iter().flat_map(corners).collect();
        let mut expected = corners(&mesh);
        all.sort_unstable();
        expected.sort_unstable();
        assert_eq!(all, expected);
        let scales = |mesh: &Mesh| mesh.positions.iter().zip(&mesh.scales).all(|(p, scale)| 2.0 * (p[0] + 7.0) == f32::from(*scale));
        assert!(pieces.iter().all(scales));
    }
}
