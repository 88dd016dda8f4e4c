//! Some of many things, evenly taken while they come.

/// At most so many things, evenly taken from all so far, from the first on.
pub struct Evenly<T> {
    most: usize,
    every: usize,
    count: usize,
    kept: Vec<T>,
}

impl<T> Evenly<T> {
    pub fn new(most: usize) -> Self {
        Self { most, every: 1, count: 0, kept: Vec::new() }
    }

    /// Adds a thing, which is made only if it is taken.
    pub fn add(&mut self, make: impl FnOnce() -> T) {
        if self.count.is_multiple_of(self.every) {
            if self.kept.len() == self.most {
                let mut is_odd = true;
                self.kept.retain(|_| {
                    is_odd = !is_odd;
                    !is_odd
                });
                self.every *= 2;
            }
            // Of twice as far apart, this may be none.
            if self.count.is_multiple_of(self.every) {
                self.kept.push(make());
            }
        }
        self.count += 1;
    }

    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.kept.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_evenly_taken_and_never_too_much() {
        for most in [2, 4, 7] {
            let mut evenly = Evenly::new(most);
            for count in 0..200 {
                evenly.add(|| count);
                let kept: Vec<i32> = evenly.iter().copied().collect();
                let every = kept.get(1).map_or(1, |second| second - kept[0]);
                assert!(kept.len() <= most && kept.iter().enumerate().all(|(k, taken)| *taken == k as i32 * every), "{kept:?}");
                assert!(kept.len() as i32 * every > count, "up to {count}: {kept:?}");
                assert!(2 * kept.len() >= most.min(count as usize), "{kept:?}");
            }
        }
    }
}
