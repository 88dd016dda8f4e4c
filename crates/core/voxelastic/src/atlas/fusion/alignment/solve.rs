//! The smoothest displacements that bring pairs of places together.

use super::displacement::{Cell, Displacement};
use super::found::Term;
use hashbrown::HashMap;
use nalgebra::{Matrix3, Vector3};

/// Weight of the difference between neighbouring cells, beyond the expected one, beside that of one for pairs in every direction.
pub(super) const SMOOTHNESS: f64 = 0.25;
/// Weight of the difference from what is expected: what no pair asks for is moved as expected, and of two fields each moves half the way.
pub(super) const REST: f64 = 0.01;
/// Steps of conjugate gradients at most, and the residual at which they end.
const STEPS: usize = 300;
const RESIDUAL: f64 = 1e-14;

/// A displacement in a cell that is searched for.
struct Unknown {
    matrix: Matrix3<f64>,
    inverse: Matrix3<f64>,
    right: Vector3<f64>,
    /// Other unknowns that pairs or smoothness tie it to: the number of the term, if it is one.
    tied: Vec<(usize, Option<usize>)>,
}

/// The displacements of all fields, given the cells of each, with the displacements that are expected there, and what pairs of them ask for: those with the least sum of
/// squares.
pub(super) fn displacements(expected: &[HashMap<Cell, [f32; 3]>], terms: &[Term]) -> Vec<Displacement> {
    let mut places: Vec<(Cell, usize)> =
        expected.iter().enumerate().flat_map(|(field, cells)| cells.keys().map(move |cell| (*cell, field))).collect();
    places.sort_unstable();
    let numbers: HashMap<(Cell, usize), usize> = places.iter().enumerate().map(|(i, place)| (*place, i)).collect();
    let expected_at = |(cell, field): &(Cell, usize)| Vector3::from(expected[*field].get(cell).copied().unwrap_or_default().map(f64::from));
    let expected_there: Vec<Vector3<f64>> = places.iter().map(expected_at).collect();
    let found = solve(&unknowns(&places, &numbers, &expected_there, terms), terms);
    let of = |field: usize| {
        let own = places.iter().zip(&found).filter(move |((_, owner), _)| *owner == field);
        Displacement::new(own.map(|((cell, _), vector)| (*cell, <[f32; 3]>::from(vector.map(|v| v as f32)))))
    };
    (0..expected.len()).map(of).collect()
}

/// Conjugate gradients, preconditioned by the matrices of single unknowns.
fn solve(unknowns: &[Unknown], terms: &[Term]) -> Vec<Vector3<f64>> {
    let dot = |a: &[Vector3<f64>], b: &[Vector3<f64>]| a.iter().zip(b).map(|(a, b)| a.dot(b)).sum::<f64>();
    let mut found = vec![Vector3::zeros(); unknowns.len()];
    let mut residual: Vec<Vector3<f64>> = unknowns.iter().map(|unknown| unknown.right).collect();
    let precondition =
        |residual: &[Vector3<f64>]| -> Vec<Vector3<f64>> { unknowns.iter().zip(residual).map(|(unknown, r)| unknown.inverse * r).collect() };
    let mut towards = precondition(&residual);
    let (mut direction, mut slope) = (towards.clone(), dot(&residual, &towards));
    let end = RESIDUAL * slope;
    for _ in 0..STEPS {
        if slope <= end || slope <= 0.0 {
            break;
        }
        let change: Vec<Vector3<f64>> = unknowns
            .iter()
            .zip(&direction)
            .map(|(unknown, own)| {
                let tie = |&(other, term): &(usize, Option<usize>)| match term {
                    Some(term) => terms[term].normals * direction[other],
                    None => SMOOTHNESS * direction[other],
                };
                unknown.tied.iter().map(tie).fold(unknown.matrix * own, |sum, tie| sum - tie)
            })
            .collect();
        let step = slope / dot(&direction, &change);
        for i in 0..found.len() {
            found[i] += step * direction[i];
            residual[i] -= step * change[i];
        }
        towards = precondition(&residual);
        let next = dot(&residual, &towards);
        for (direction, towards) in direction.iter_mut().zip(&towards) {
            *direction = towards + next / slope * *direction;
        }
        slope = next;
    }
    found
}

fn unknowns(places: &[(Cell, usize)], numbers: &HashMap<(Cell, usize), usize>, expected: &[Vector3<f64>], terms: &[Term]) -> Vec<Unknown> {
    let alone = |expected: &Vector3<f64>| Unknown {
        matrix: REST * Matrix3::identity(),
        inverse: Matrix3::identity(),
        right: REST * expected,
        tied: Vec::new(),
    };
    let mut unknowns: Vec<Unknown> = expected.iter().map(alone).collect();
    for (t, term) in terms.iter().enumerate() {
        let [Some(&a), Some(&b)] = term.fields.map(|field| numbers.get(&(term.cell, field))) else { continue };
        for (here, there, sign) in [(a, b, 1.0), (b, a, -1.0)] {
            unknowns[here].matrix += term.normals;
            unknowns[here].right += sign * term.gap;
            unknowns[here].tied.push((there, Some(t)));
        }
    }
    for (i, &(cell, field)) in places.iter().enumerate() {
        for k in 0..3 {
            for step in [-1, 1] {
                let near: Cell = std::array::from_fn(|l| cell[l] + if l == k { step } else { 0 });
                if let Some(&other) = numbers.get(&(near, field)) {
                    unknowns[i].matrix += SMOOTHNESS * Matrix3::identity();
                    unknowns[i].right += SMOOTHNESS * (expected[i] - expected[other]);
                    unknowns[i].tied.push((other, None));
                }
            }
        }
    }
    for unknown in &mut unknowns {
        // Positive definite, because of `REST`.
        unknown.inverse = unknown.matrix.try_inverse().unwrap_or_else(Matrix3::identity);
    }
    unknowns
}
