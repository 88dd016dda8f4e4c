//! What is least consistent in a map, and what would mend it.
//!
//! | module | contents |
//! | --- | --- |
//! | [`Suggestion`] | what is wrong, in words, and an edit |
//! | `survey` | the surfaces of a map, and how they agree with other poses |
//! | `trials` | closures that bend, submaps that lie apart: the edit is tried |
//! | `tilt` | what leans, by its walls |
//! | [`MapCheck`] | the same for a map on disk |
//!
//! Nothing here is certain: somebody looks at each, tries it, and takes it or not.

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

/// What is least consistent, first: closures, because a wrong one bends whatever else is closed; pairs; each by how many more places agree with the edit; what leans. `tried` is
/// called after each edit that was tried. To be called in a pool.
pub(super) fn suggestions(state: &mut State, closures: &[ListedClosure], tried: &mut (dyn FnMut() + Send)) -> Result<Vec<Suggestion>> {
    // Once, and not for each that is tried.
    state.graph()?;
    let mut survey = Survey::of(state)?;
    let before = survey.pairs(state);
    let poses: Vec<_> = state.entries.iter().map(|entry| (entry.id, entry.t_map_submap)).collect();
    let leaning = tilt::tilted(&survey.surfaces(), &poses, state.origin);
    let mut closures = trials::of_closures(state, &mut survey, &before, closures, tried)?;
    let mut pairs = trials::of_pairs(state, &mut survey, &before, tried)?;
    // Stable: those of the same gain stay in their order.
    closures.sort_by_key(|(gain, _)| std::cmp::Reverse(*gain));
    pairs.sort_by_key(|(gain, _)| std::cmp::Reverse(*gain));
    let tilts = leaning.into_iter().map(|(_, one)| one);
    Ok(closures.into_iter().chain(pairs).map(|(_, one)| one).chain(tilts).collect())
}

#[cfg(test)]
mod tests {
    use super::tilt;
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
        assert!(found[0].1.edit.contains("submap = 3\nup = [0.04997"), "{found:?}");
    }
}
