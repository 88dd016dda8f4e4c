//! The connected pieces of a mesh.

/// For each vertex of a mesh the piece that it is part of.
pub(super) struct Pieces {
    /// By vertex, the lowest vertex of its piece.
    lowest: Vec<u32>,
}

impl Pieces {
    /// The pieces of `count` vertices, numbered from `first` on, that `triangles` connect.
    pub fn new(triangles: &[[u32; 3]], first: u32, count: usize) -> Self {
        let mut lowest: Vec<u32> = (0..count as u32).collect();
        for [a, b, c] in triangles.iter().map(|t| t.map(|v| v - first)) {
            join(&mut lowest, a, b);
            join(&mut lowest, a, c);
        }
        // A vertex only ever points to a lower one, which points to its root already.
        for v in 0..count {
            lowest[v] = lowest[lowest[v] as usize];
        }
        Self { lowest }
    }

    /// The lowest vertex of the piece of vertex `v`, both counted from the first one.
    pub fn lowest(&self, v: usize) -> usize {
        self.lowest[v] as usize
    }
}

fn join(lowest: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(lowest, a), root(lowest, b));
    lowest[a.max(b) as usize] = a.min(b);
}

/// The root of `v`; halves the way there.
fn root(lowest: &mut [u32], mut v: u32) -> u32 {
    while lowest[v as usize] != v {
        let next = lowest[lowest[v as usize] as usize];
        lowest[v as usize] = next;
        v = next;
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pieces_are_what_spreading_over_triangles_reaches(triangles in prop::collection::vec(prop::array::uniform3(5u32..45), 0..30)) {
            let pieces = Pieces::new(&triangles, 5, 40);
            let mut expected: Vec<usize> = (0..40).collect();
            for _ in 0..40 {
                for t in triangles.iter().map(|t| t.map(|v| v as usize - 5)) {
                    let least = t.iter().map(|&v| expected[v]).min().unwrap_or(0);
                    t.iter().for_each(|&v| expected[v] = least);
                }
            }
            for (v, lowest) in expected.into_iter().enumerate() {
                prop_assert_eq!(pieces.lowest(v), lowest);
            }
        }
    }
}
