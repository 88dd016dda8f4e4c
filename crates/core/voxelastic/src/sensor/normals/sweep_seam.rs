//! The seam of a sweep, where its end meets its beginning: neighbouring pixels that were measured from different positions.

use crate::sensor::range_image::{NO_POINT, RangeImage};

/// Pixels measured more than this part of the sweep apart are not linked.
const LONGEST: f32 = 0.25;

/// The measurement times of the pixels of a sweep.
pub(super) struct Seam<'a> {
    times: &'a [f32],
    image: &'a RangeImage,
    /// Largest time between linked pixels, seconds.
    longest: f32,
}

impl<'a> Seam<'a> {
    /// For points of an image measured at `times`, seconds; `None` if all times are equal or not finite.
    pub fn new(times: &'a [f32], image: &'a RangeImage) -> Option<Self> {
        let (low, high) = times.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &t| (low.min(t), high.max(t)));
        let longest = LONGEST * (high - low);
        (longest > 0.0 && longest.is_finite()).then_some(Self { times, image, longest })
    }

    /// Removes links between pixels of two rows, or of one row, that are `column_offset` columns apart.
    pub fn cut(&self, links: &mut [f32], rows: [usize; 2], column_offset: usize) {
        let columns = self.image.columns;
        let [from, to] = rows.map(|row| &self.image.points[row * columns..][..columns]);
        for (column, link) in links[..columns].iter_mut().enumerate() {
            let (a, b) = (from[column], to[if column + column_offset < columns { column + column_offset } else { column + column_offset - columns }]);
            if a != NO_POINT && b != NO_POINT && (self.times[a as usize] - self.times[b as usize]).abs() > self.longest {
                *link = 0.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_sweep_is_not_linked_to_its_beginning() {
        // The sweep begins at column 3, and in the second row at column 2; one pixel is empty.
        let (rows, columns) = (2, 8);
        let start = |row: usize| 3 - row;
        let times: Vec<f32> = (0..rows * columns).map(|i| ((i % columns + columns - start(i / columns)) % columns) as f32 * 0.01).collect();
        let mut points: Vec<u32> = (0..(rows * columns) as u32).collect();
        points[6] = NO_POINT;
        let image = RangeImage { rows, columns, ranges: vec![1.0; rows * columns], points };
        let seam = Seam::new(&times, &image).unwrap();
        let cut = |rows, column_offset| {
            let mut links = vec![1.0; columns];
            seam.cut(&mut links, rows, column_offset);
            (0..columns).filter(|&c| links[c] == 0.0).collect::<Vec<usize>>()
        };
        assert_eq!([cut([0, 0], 1), cut([1, 1], 1), cut([0, 1], 0)], [[2], [1], [2]]);
        assert!(Seam::new(&[0.5; 16], &image).is_none() && Seam::new(&[], &image).is_none());
    }
}
