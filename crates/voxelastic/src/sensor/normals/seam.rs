//! Where the end of a sweep meets its beginning: neighbours in the image that the sensor saw from different places.

use super::super::image::{NO_POINT, RangeImage};

/// Pixels measured farther apart than this share of the sweep are no neighbours.
const LONGEST: f32 = 0.25;

/// The pixels of a sweep by when they were measured.
pub(super) struct Seam<'a> {
    times: &'a [f32],
    image: &'a RangeImage,
    /// Seconds between neighbours, at most.
    longest: f32,
}

impl<'a> Seam<'a> {
    /// For points of an image measured at `times`; `None` if those say nothing.
    pub fn new(times: &'a [f32], image: &'a RangeImage) -> Option<Self> {
        let (low, high) = times.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &t| (low.min(t), high.max(t)));
        let longest = LONGEST * (high - low);
        (longest > 0.0 && longest.is_finite()).then_some(Self { times, image, longest })
    }

    /// Cuts the links between the pixels of two rows, or of one, of which the second's are `onward` columns further.
    pub fn cut(&self, links: &mut [f32], rows: [usize; 2], onward: usize) {
        let columns = self.image.columns;
        let [from, to] = rows.map(|row| &self.image.points[row * columns..][..columns]);
        for (column, link) in links[..columns].iter_mut().enumerate() {
            let (a, b) = (from[column], to[if column + onward < columns { column + onward } else { column + onward - columns }]);
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
    fn the_end_of_a_sweep_is_no_neighbour_of_its_beginning() {
        // The sweep begins at column 3, and in the second row at column 2; one pixel is empty.
        let (rows, columns) = (2, 8);
        let start = |row: usize| 3 - row;
        let times: Vec<f32> = (0..rows * columns).map(|i| ((i % columns + columns - start(i / columns)) % columns) as f32 * 0.01).collect();
        let mut points: Vec<u32> = (0..(rows * columns) as u32).collect();
        points[6] = NO_POINT;
        let image = RangeImage { rows, columns, ranges: vec![1.0; rows * columns], points };
        let seam = Seam::new(&times, &image).unwrap();
        let cut = |rows, onward| {
            let mut links = vec![1.0; columns];
            seam.cut(&mut links, rows, onward);
            (0..columns).filter(|&c| links[c] == 0.0).collect::<Vec<usize>>()
        };
        assert_eq!([cut([0, 0], 1), cut([1, 1], 1), cut([0, 1], 0)], [[2], [1], [2]]);
        assert!(Seam::new(&[0.5; 16], &image).is_none() && Seam::new(&[], &image).is_none());
    }
}
