//! What is least consistent in a map, and what would mend it.
//!
//! | module | contents |
//! | --- | --- |
//! | [`Suggestion`] | what is wrong, in words, and an edit |
//! | `survey` | the surfaces of a map, and how they agree with other poses |
//! | `trials` | closures that bend, submaps that lie apart: the edit is tried |
//! | `tilt` | what leans, by its walls |
//! | `floating` | pieces of surface with nothing around them |
//! | [`MapCheck`] | the same for a map on disk |
//!
//! Nothing here is certain: somebody looks at each, tries it, and takes it or not.

mod floating;
mod map_check;
mod suggestion;
mod survey;
mod tilt;
mod trials;

pub use map_check::MapCheck;
pub use suggestion::Suggestion;

use super::closures::ListedClosure;
use super::state::State;
use crate::error::Result;
use survey::Survey;

/// Pieces that float, and pairs without an edit, that are listed.
const LISTED: usize = 20;

/// What is least consistent, first: closures, because a wrong one bends whatever else is closed; pairs, by how many places agree if they are mended; what leans; pieces that
/// float; pairs of which nobody knows better. To be called in a pool.
pub(super) fn suggestions(state: &mut State, closures: &[ListedClosure]) -> Result<Vec<Suggestion>> {
    // Once, and not for each that is tried.
    state.graph()?;
    let mut survey = Survey::of(state)?;
    let before = survey.pairs(state);
    let surfaces = survey.surfaces();
    let poses: Vec<_> = state.entries.iter().map(|entry| (entry.id, entry.t_map_submap)).collect();
    let leaning = tilt::tilted(&surfaces, &poses, state.origin);
    let floating = floating::floating(&surfaces, survey.voxel(), state.origin);
    drop(surfaces);
    let mut closures = trials::of_closures(state, &mut survey, &before, closures)?;
    let pairs = trials::of_pairs(state, &mut survey, &before)?;
    let (mut better, unknown): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(gain, _)| gain.is_some());
    // Stable: those of the same gain stay in their order.
    closures.sort_by_key(|(gain, _)| std::cmp::Reverse(*gain));
    better.sort_by_key(|(gain, _)| std::cmp::Reverse(*gain));
    let first = closures.into_iter().chain(better).map(|(_, one)| one);
    let last = floating.into_iter().map(|(_, piece)| piece).take(LISTED).chain(unknown.into_iter().map(|(_, pair)| pair).take(LISTED));
    Ok(first.chain(leaning.into_iter().map(|(_, one)| one)).chain(last).collect())
}

#[cfg(test)]
mod tests {
    use super::{floating, tilt};
    use voxelastic::Pose;
    use voxelastic::surface::Mesh;
    use voxelastic_io::Origin;

    /// Vertices every 5 cm of a rectangle.
    fn add(mesh: &mut Mesh, corner: [f32; 3], across: [[f32; 3]; 2], steps: [usize; 2], normal: [f32; 3]) {
        for (i, j) in (0..steps[0]).flat_map(|i| (0..steps[1]).map(move |j| (i as f32, j as f32))) {
            mesh.positions.push(std::array::from_fn(|k| corner[k] + 0.05 * (i * across[0][k] + j * across[1][k])));
            mesh.normals.push(normal);
        }
    }

    #[test]
    fn a_box_in_the_air_floats_and_what_touches_or_has_nothing_below_does_not() {
        let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let mut mesh = Mesh::default();
        add(&mut mesh, [-3.0, -3.0, 0.0], [x, y], [120, 120], z);
        // In the air; on the floor; beside it.
        add(&mut mesh, [0.0, 0.0, 1.5], [x, z], [16, 16], y);
        add(&mut mesh, [-2.0, 0.0, 0.0], [x, z], [16, 16], y);
        add(&mut mesh, [9.0, 0.0, 1.5], [x, z], [16, 16], y);
        let found = floating::floating(&[(7, mesh)], 0.1, Origin::default());
        assert_eq!(found.len(), 1, "{found:?}");
        let (size, one) = &found[0];
        assert_eq!((*size, one.code, &one.submaps[..]), (256, "floating", &[7][..]));
        assert!((one.at[0] - 0.375).abs() < 0.02 && (one.at[2] - 1.875).abs() < 0.02, "{one:?}");
        let edit = one.edit.as_ref().unwrap();
        assert!(edit.contains("min = [-0.1, -0.1, 1.4], max = [0.85, 0.1, 2.35]"), "{edit}");
    }

    #[test]
    fn walls_in_two_directions_say_what_leans() {
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), 0.05);
        let turned = |v: [f32; 3]| <[f64; 3]>::from(turn * nalgebra::Vector3::from(v.map(f64::from))).map(|c| c as f32);
        let [x, y, z] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(turned);
        let mut mesh = Mesh::default();
        add(&mut mesh, [0.0; 3], [x, z], [100, 50], y);
        let tilted = |mesh: &Mesh| tilt::tilted(&[(3, mesh.clone())], &[(3, Pose::identity())], Origin::default());
        // One direction does not tell.
        assert!(tilted(&mesh).is_empty());
        add(&mut mesh, [0.0; 3], [y, z], [100, 50], x);
        let found = tilted(&mesh);
        assert!(found.len() == 1 && (found[0].0 - 0.05).abs() < 1e-4, "{found:?}");
        assert!(found[0].1.edit.as_ref().unwrap().contains("submap = 3\nup = [0.04997"), "{found:?}");
    }
}
