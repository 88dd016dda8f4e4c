//! Pieces of tiles that belong together, and whether they stay.

use crate::surface::evidence::{Evidence, SmallComponents};

/// The pieces of several tiles, numbered from 0. Those that are connected across the border of tiles are one piece.
#[derive(Clone, Debug, Default)]
pub(crate) struct PieceSets {
    evidence: Vec<Evidence>,
    /// By piece, one with a lower number that it is connected to, or itself.
    lower: Vec<u32>,
}

impl PieceSets {
    /// Adds the pieces of a tile. Returns the number of the first.
    pub fn add(&mut self, pieces: &[Evidence]) -> u32 {
        let first = self.lower.len() as u32;
        self.evidence.extend_from_slice(pieces);
        self.lower.extend(first..first + pieces.len() as u32);
        first
    }

    /// Two pieces are connected.
    pub fn connect(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.lower[a.max(b) as usize] = a.min(b);
    }

    /// Which pieces have enough evidence to stay, all with `keep_all`, and what does not.
    pub fn judge(mut self, keep_all: bool) -> (Vec<bool>, SmallComponents) {
        let count = self.lower.len() as u32;
        for piece in 0..count {
            let root = self.root(piece);
            if root != piece {
                let evidence = self.evidence[piece as usize];
                self.evidence[root as usize].add(&evidence);
            }
        }
        let (mut stays, mut small_components) = (Vec::with_capacity(count as usize), SmallComponents::default());
        for piece in 0..count {
            // A root has a lower number than the pieces that it stands for.
            let root = self.root(piece);
            let is_enough = if root == piece { keep_all || self.evidence[piece as usize].is_enough() } else { stays[root as usize] };
            if root == piece && !is_enough {
                small_components.add(&self.evidence[piece as usize]);
            }
            stays.push(is_enough);
        }
        (stays, small_components)
    }

    /// The lowest piece that `piece` is connected to; halves the way there.
    fn root(&mut self, mut piece: u32) -> u32 {
        while self.lower[piece as usize] != piece {
            let next = self.lower[self.lower[piece as usize] as usize];
            self.lower[piece as usize] = next;
            piece = next;
        }
        piece
    }
}
