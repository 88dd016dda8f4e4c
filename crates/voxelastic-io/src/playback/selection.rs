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

/// Conditions on scans. Each sees a scan's index among those that met all earlier conditions.
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

    /// Whether the next scan is taken. `counts` holds the number of scans that came to each condition, for the caller to keep.
    pub(crate) fn takes(&self, counts: &mut Vec<usize>) -> bool {
        counts.resize(self.conditions.len(), 0);
        self.conditions.iter().zip(counts).all(|(condition, count)| {
            let index = *count;
            *count += 1;
            match condition {
                Condition::Keep(keep) => keep(index),
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
        let mut counts = Vec::new();
        let taken: Vec<usize> = (0..10).filter(|_| selection.takes(&mut counts)).collect();
        assert_eq!(taken, [0, 1, 3, 4]);
        assert!(selection.is_done(&counts) && !selection.is_done(&[5, 5]));
    }
}
