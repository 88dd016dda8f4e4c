//! Conditions that select scans of a recording by their index.

use std::fmt;
use std::sync::Arc;

/// A condition on a scan.
#[derive(Clone)]
enum Condition {
    Keep(Arc<dyn Fn(usize) -> bool + Send + Sync>),
    /// Only the first so many.
    First(usize),
}

/// Conditions on scans. Each sees a scan's index among those of its sensor that met all earlier conditions; the number of scans is limited over all sensors.
#[derive(Clone, Default)]
pub(crate) struct Selection {
    conditions: Vec<Condition>,
}

impl fmt::Debug for Selection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Selection({})", self.conditions.len())
    }
}

impl Selection {
    pub(crate) fn add(&mut self, keep: impl Fn(usize) -> bool + Send + Sync + 'static) {
        self.conditions.push(Condition::Keep(Arc::new(keep)));
    }

    /// Takes no more than the first `most`.
    pub(crate) fn limit(&mut self, most: usize) {
        self.conditions.push(Condition::First(most));
    }

    /// Whether no further scan will be taken.
    pub(crate) fn is_done(&self, counts: &[usize]) -> bool {
        let full = |(condition, count): (&Condition, &usize)| matches!(condition, Condition::First(most) if count >= most);
        self.conditions.iter().zip(counts).any(full)
    }

    /// Whether the next scan is taken. `counts` holds the number of scans that came to each condition, and `own` those of the scan's sensor, for the caller
    /// to keep.
    pub(crate) fn takes(&self, counts: &mut Vec<usize>, own: &mut Vec<usize>) -> bool {
        counts.resize(self.conditions.len(), 0);
        own.resize(self.conditions.len(), 0);
        self.conditions.iter().zip(counts).zip(own).all(|((condition, count), own)| {
            let (index, own_index) = (*count, *own);
            *count += 1;
            *own += 1;
            match condition {
                Condition::Keep(keep) => keep(own_index),
                Condition::First(most) => index < *most,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_conditions_count_what_earlier_ones_keep() {
        let mut selection = Selection::default();
        selection.limit(6);
        selection.add(|k| k % 3 != 2);
        let (mut counts, mut own) = (Vec::new(), Vec::new());
        let taken: Vec<usize> = (0..10).filter(|_| selection.takes(&mut counts, &mut own)).collect();
        assert_eq!(taken, [0, 1, 3, 4]);
        assert!(selection.is_done(&counts) && !selection.is_done(&[5, 5]));
    }

    #[test]
    fn each_sensor_has_its_own_indices() {
        let mut selection = Selection::default();
        selection.limit(9);
        selection.add(|k| k % 3 != 2);
        let (mut counts, mut own) = (Vec::new(), [Vec::new(), Vec::new()]);
        // Scans of two sensors by turns.
        let taken: Vec<usize> = (0..12).filter(|k| selection.takes(&mut counts, &mut own[k % 2])).collect();
        assert_eq!(taken, [0, 1, 2, 3, 6, 7, 8]);
    }
}
