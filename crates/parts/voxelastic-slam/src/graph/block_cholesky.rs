//! A sparse symmetric system of 6 x 6 blocks, one row of blocks for each node, solved by the Cholesky factorisation of [`faer`].

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side, Spec};
use nalgebra::{Matrix6, Vector6};
use std::fmt;

/// Unknowns of a node.
const N: usize = 6;

/// Which blocks there are, in an order that keeps the factor sparse.
#[derive(Debug)]
pub(crate) struct Structure {
    /// Place of each node in the order of elimination.
    place_of: Vec<usize>,
    /// The upper triangle, by columns of blocks: blocks above the diagonal, as places of rows in ascending order.
    above: Vec<Vec<usize>>,
    /// Place of the first value of each column of blocks.
    first_value: Vec<usize>,
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
}

/// The numbers of a system of such a structure.
pub(crate) struct System {
    structure: Structure,
    values: Vec<f64>,
    factor: Vec<f64>,
    memory: MemBuffer,
}

impl fmt::Debug for System {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("System").field("structure", &self.structure).finish_non_exhaustive()
    }
}

/// Where a block between two nodes is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockPlace {
    column: usize,
    rank: usize,
    /// Whether the block is stored with rows and columns exchanged.
    is_transposed: bool,
}

impl Structure {
    /// The structure for `nodes` nodes with a block for each pair; pairs are of different nodes and may come more than once. `None` if memory or
    /// indices do not suffice.
    pub(crate) fn new(nodes: usize, pairs: impl Iterator<Item = (usize, usize)>) -> Option<Self> {
        let mut pairs: Vec<(usize, usize)> = pairs.map(|(a, b)| (a.max(b), a.min(b))).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let place_of = elimination_order(nodes, &pairs)?;
        let mut above = vec![Vec::new(); nodes];
        for (a, b) in pairs {
            let (a, b) = (place_of[a], place_of[b]);
            above[a.max(b)].push(a.min(b));
        }
        above.iter_mut().for_each(|rows| rows.sort_unstable());
        let (mut pointers, mut rows, mut first_value) = (vec![0], Vec::new(), Vec::with_capacity(nodes));
        for (column, above) in above.iter().enumerate() {
            first_value.push(rows.len());
            for c in 0..N {
                above.iter().for_each(|row| rows.extend(row * N..(row + 1) * N));
                rows.extend(column * N..=column * N + c);
                pointers.push(rows.len());
            }
        }
        let size = nodes * N;
        let pattern = SymbolicSparseColMat::new_checked(size, size, pointers, None, rows);
        let parameters = CholeskySymbolicParams { supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL, ..Default::default() };
        let symbolic = factorize_symbolic_cholesky(pattern.as_ref(), Side::Upper, SymmetricOrdering::Identity, parameters).ok()?;
        Some(Self { place_of, above, first_value, pattern, symbolic })
    }

    /// The place of the block with rows of `a` and columns of `b`; `None` if there is none.
    pub(crate) fn block(&self, a: usize, b: usize) -> Option<BlockPlace> {
        let (row, column) = (self.place_of[a], self.place_of[b]);
        let is_transposed = row > column;
        let (row, column) = (row.min(column), row.max(column));
        let rank = self.above[column].binary_search(&row).ok()?;
        Some(BlockPlace { column, rank, is_transposed })
    }
}

/// Place of each node in the order of elimination: approximate minimum degree. `pairs` are sorted, the later node first.
fn elimination_order(nodes: usize, pairs: &[(usize, usize)]) -> Option<Vec<usize>> {
    let mut pointers = vec![0; nodes + 1];
    pairs.iter().for_each(|(later, _)| pointers[later + 1] += 1);
    for k in 0..nodes {
        pointers[k + 1] += pointers[k];
    }
    let pattern = SymbolicSparseColMat::new_checked(nodes, nodes, pointers, None, pairs.iter().map(|p| p.1).collect());
    let (mut order, mut place_of) = (vec![0usize; nodes], vec![0usize; nodes]);
    let mut memory = MemBuffer::try_new(amd::order_scratch::<usize>(nodes, pairs.len())).ok()?;
    amd::order(&mut order, &mut place_of, pattern.as_ref(), amd::Control::default(), MemStack::new(&mut memory)).ok()?;
    Some(place_of)
}

impl System {
    /// A system of zeros.
    pub(crate) fn new(structure: Structure) -> Option<Self> {
        let values = vec![0.0; structure.pattern.row_idx().len()];
        let factor = vec![0.0; structure.symbolic.len_val()];
        let numeric = structure.symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default());
        let memory = MemBuffer::try_new(numeric.or(structure.symbolic.solve_in_place_scratch::<f64>(1, Par::Seq))).ok()?;
        Some(Self { structure, values, factor, memory })
    }

    /// The structure.
    pub(crate) fn structure(&self) -> &Structure {
        &self.structure
    }

    /// Sets all blocks to zero.
    pub(crate) fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Adds to the block on the diagonal of a node.
    pub(crate) fn add_diagonal(&mut self, node: usize, block: &Matrix6<f64>) {
        let place = self.structure.place_of[node];
        let rows_above = N * self.structure.above[place].len();
        let mut at = self.structure.first_value[place];
        for c in 0..N {
            at += rows_above;
            for r in 0..=c {
                self.values[at + r] += block[(r, c)];
            }
            at += c + 1;
        }
    }

    /// Adds to a block beside the diagonal.
    pub(crate) fn add(&mut self, place: BlockPlace, block: &Matrix6<f64>) {
        let rows_above = N * self.structure.above[place.column].len();
        let mut at = self.structure.first_value[place.column] + N * place.rank;
        for c in 0..N {
            for (r, value) in self.values[at..at + N].iter_mut().enumerate() {
                *value += if place.is_transposed { block[(c, r)] } else { block[(r, c)] };
            }
            at += rows_above + c + 1;
        }
    }

    /// Factors the matrix with its diagonal enlarged by the share `damping`. False if it is not positive definite.
    pub(crate) fn factorise(&mut self, damping: f64) -> bool {
        let mut damped;
        let mut values = &self.values;
        if damping > 0.0 {
            damped = self.values.clone();
            for end in self.structure.pattern.col_ptr().iter().skip(1) {
                // The diagonal is the last of each column.
                damped[end - 1] *= 1.0 + damping;
            }
            values = &damped;
        }
        let matrix = SparseColMatRef::new(self.structure.pattern.as_ref(), values);
        let stack = MemStack::new(&mut self.memory);
        let none = LltRegularization::default();
        let (symbolic, factor) = (&self.structure.symbolic, &mut self.factor);
        symbolic.factorize_numeric_llt(factor, matrix, Side::Upper, none, Par::Seq, stack, Spec::default()).is_ok()
    }

    /// Solves for the step of each node with the last factor.
    pub(crate) fn solve(&mut self, right: &[Vector6<f64>]) -> Vec<Vector6<f64>> {
        let mut x = vec![0.0; right.len() * N];
        for (place, value) in self.structure.place_of.iter().zip(right) {
            x[place * N..(place + 1) * N].copy_from_slice(value.as_slice());
        }
        let size = x.len();
        let factor = LltRef::new(&self.structure.symbolic, &self.factor);
        factor.solve_in_place_with_conj(Conj::No, MatMut::from_column_major_slice_mut(&mut x, size, 1), Par::Seq, MemStack::new(&mut self.memory));
        self.structure.place_of.iter().map(|place| Vector6::from_column_slice(&x[place * N..(place + 1) * N])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn solutions_are_those_of_the_dense_system() {
        let nodes = 23;
        let pairs: Vec<(usize, usize)> = (1..nodes).map(|i| (i - 1, i)).chain([(20, 3), (5, 17), (3, 20), (2, 22)]).collect();
        let mut system = System::new(Structure::new(nodes, pairs.iter().copied()).unwrap()).unwrap();
        let mut dense = DMatrix::<f64>::zeros(nodes * N, nodes * N);
        for (k, (a, b)) in pairs.iter().enumerate() {
            let j: [Matrix6<f64>; 2] = [0, 1].map(|s| Matrix6::from_fn(|r, c| ((k * 31 + s * 7 + r * 5 + c * 3) as f64 * 0.7).sin()));
            let place = system.structure().block(*a, *b).unwrap();
            system.add(place, &(j[0].transpose() * j[1]));
            for (s, node) in [(0, *a), (1, *b)] {
                let block = j[s].transpose() * j[s] + Matrix6::identity();
                system.add_diagonal(node, &block);
                let mut view = dense.fixed_view_mut::<N, N>(node * N, node * N);
                view += block;
            }
            let mut view = dense.fixed_view_mut::<N, N>(a * N, b * N);
            view += j[0].transpose() * j[1];
            let mut view = dense.fixed_view_mut::<N, N>(b * N, a * N);
            view += j[1].transpose() * j[0];
        }
        let right: Vec<Vector6<f64>> = (0..nodes).map(|i| Vector6::from_fn(|r, _| (i * 6 + r) as f64 * 0.1 - 3.0)).collect();
        let flat = DVector::from_iterator(nodes * N, right.iter().flat_map(|v| v.iter().copied()));
        for damping in [0.0, 0.5] {
            assert!(system.factorise(damping));
            let found = system.solve(&right);
            let damped = &dense + damping * DMatrix::from_diagonal(&dense.diagonal());
            let expected = damped.lu().solve(&flat).unwrap();
            let off = found.iter().enumerate().map(|(i, v)| (v - expected.fixed_rows::<N>(i * N)).norm()).fold(0.0, f64::max);
            assert!(off < 1e-9, "{off}");
        }
        assert!(system.structure().block(0, 9).is_none());
        system.clear();
        assert!(!system.factorise(0.0));
    }
}
