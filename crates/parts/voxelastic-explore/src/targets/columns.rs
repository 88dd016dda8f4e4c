//! Where the map has changed, coarsely, by columns.

use hashbrown::HashSet;
use voxelastic_plan::Point;

/// A set of square columns of the map frame, as high as the world.
#[derive(Clone, Debug)]
pub(crate) struct Columns {
    /// Edge, metres.
    edge: f64,
    columns: HashSet<[i32; 2]>,
}

impl Columns {
    /// An empty set of columns with this edge, metres.
    pub fn new(edge: f64) -> Self {
        Self { edge, columns: HashSet::new() }
    }

    /// Adds everything less than `reach` metres from `centre` along x and y.
    pub fn add(&mut self, centre: Point, reach: f64) {
        let [low, high] = [-reach, reach].map(|reach| self.column(centre.map(|c| c + reach)));
        let all = (low[0]..=high[0]).flat_map(|x| (low[1]..=high[1]).map(move |y| [x, y]));
        self.columns.extend(all);
    }

    /// These and all that are next to them: everything within an edge.
    pub fn widened(&self) -> Self {
        let around = |[x, y]: &[i32; 2]| std::array::from_fn::<[i32; 2], 9, _>(|k| [x + k as i32 % 3 - 1, y + k as i32 / 3 - 1]);
        Self { edge: self.edge, columns: self.columns.iter().flat_map(around).collect() }
    }

    pub fn has(&self, place: Point) -> bool {
        self.columns.contains(&self.column(place))
    }

    fn column(&self, place: Point) -> [i32; 2] {
        [place[0], place[1]].map(|c| (c / self.edge).floor() as i32)
    }

    pub fn clear(&mut self) {
        self.columns.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_near_a_change_is_in_a_column(
            changes in prop::collection::vec((prop::array::uniform3(-50.0f64..50.0), 0.0f64..8.0), 1..6), place in prop::array::uniform3(-60.0f64..60.0)
        ) {
            let mut columns = Columns::new(2.0);
            changes.iter().for_each(|(centre, reach)| columns.add(*centre, *reach));
            let off = |(centre, reach): &(Point, f64)| (0..2).map(|k| (place[k] - centre[k]).abs() - reach).fold(f64::NEG_INFINITY, f64::max);
            let nearest = changes.iter().map(off).fold(f64::INFINITY, f64::min);
            prop_assert!(columns.has(place) || nearest > 0.0);
            prop_assert!(!columns.has(place) || nearest < 2.0);
            let widened = columns.widened();
            prop_assert!(widened.has(place) || nearest > 2.0);
            prop_assert!(!widened.has(place) || nearest < 4.0);
            columns.clear();
            prop_assert!(!columns.has(place));
        }
    }
}
