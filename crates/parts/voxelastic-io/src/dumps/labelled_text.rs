//! Text files of labels, numbers and 4 x 4 matrices, as Eigen prints them.

use crate::text::{self, ROTATION_TOLERANCE};
use crate::{Error, Position, Result};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::{Path, PathBuf};
use voxelastic::Pose;

/// The words of a text file with their line numbers.
pub(super) struct LabelledText {
    path: PathBuf,
    words: Vec<(usize, String)>,
}

impl LabelledText {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = text::read(path)?;
        let words = (1..).zip(text.lines()).flat_map(|(line, l)| text::words(l).map(move |w| (line, w.to_owned()))).collect();
        Ok(Self { path: path.into(), words })
    }

    /// Indices of the words that are a label, with or without a colon.
    pub(super) fn labels<'a>(&'a self, label: &'a str) -> impl Iterator<Item = usize> + 'a {
        self.words.iter().enumerate().filter(move |(_, (_, w))| w.strip_suffix(':').unwrap_or(w) == label).map(|(k, _)| k)
    }

    /// The numbers after a label.
    pub(super) fn numbers<const N: usize>(&self, label: usize) -> Result<[f64; N]> {
        let mut numbers = [0.0; N];
        for (k, number) in numbers.iter_mut().enumerate() {
            let Some((line, word)) = self.words.get(label + 1 + k) else {
                return Err(self.error(self.words.last().map_or(1, |(line, _)| *line), "it ends early"));
            };
            *number = word.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| self.error(*line, format!("{word:?} is not a number")))?;
        }
        Ok(numbers)
    }

    /// The pose whose 4 x 4 matrix follows a label.
    pub(super) fn pose(&self, label: usize) -> Result<Pose> {
        let m: [f64; 16] = self.numbers(label)?;
        let line = self.words.get(label).map_or(1, |(line, _)| *line);
        rigid(&[m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11]])
            .ok_or_else(|| self.error(line, "the matrix here is not a pose"))
    }

    fn error(&self, line: usize, problem: impl Into<String>) -> Error {
        Error::content(&self.path, Position::line(line), problem, "the file is damaged or of another program: write it again")
    }
}

/// A pose from the upper 3 x 4 part of its matrix, row by row; `None` if it is not rigid.
pub(super) fn rigid(m: &[f64; 12]) -> Option<Pose> {
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    if !m.iter().all(|v| v.is_finite()) {
        return None;
    }
    let off = (rotation.transpose() * rotation - Matrix3::identity()).amax();
    if off > ROTATION_TOLERANCE || rotation.determinant() < 0.0 {
        return None;
    }
    let svd = rotation.svd(true, true);
    let nearest = svd.u.zip(svd.v_t).map_or(rotation, |(u, v_t)| u * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
    Some(Pose::from_parts([m[3], m[7], m[11]].into(), rotation))
}
