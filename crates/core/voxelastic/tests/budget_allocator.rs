//! The allocator whose large arrays are part of the memory budget, as that of a program.
#![cfg(target_os = "linux")]

use voxelastic::memory::{BudgetAllocator, keep_arrays_in_file, limit};

#[global_allocator]
static ALLOCATOR: BudgetAllocator = BudgetAllocator;

/// Sizes on both sides of what counts as large.
const SIZES: [usize; 6] = [10, 1_000, 32_767, 32_768, 100_000, 700_000];

/// Resident memory of this process, megabytes.
fn resident_mb() -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse::<f64>().unwrap() * 1024.0 / 1e6
}

/// The numbers of an array, and the one that it begins with.
struct Numbers {
    first: u64,
    all: Vec<u64>,
}

impl Numbers {
    fn push_until(&mut self, length: usize) {
        self.all.extend(self.first + self.all.len() as u64..self.first + length as u64);
    }

    fn is_whole(&self) -> bool {
        self.all.iter().zip(self.first..).all(|(number, expected)| *number == expected)
    }
}

// One test: the budget and the switch are those of the process.
#[test]
fn arrays_keep_what_is_in_them_wherever_they_are_and_the_budget_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    limit(150_000_000, Some(folder.path())).unwrap();
    let mut random = 7u64;
    let mut next = |most: usize| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as usize % most
    };
    let mut arrays: Vec<Numbers> = Vec::new();
    for step in 0..3_000u64 {
        // Arrays outlive the switch: they grow, shrink and are freed where they are, or move.
        keep_arrays_in_file(step / 100 % 3 != 2);
        let (what, size) = (next(6), SIZES[next(SIZES.len())]);
        if what == 0 || arrays.is_empty() {
            let mut new = Numbers { first: step << 32, all: Vec::new() };
            new.push_until(size);
            arrays.push(new);
            continue;
        }
        let which = next(arrays.len());
        match what {
            1 => arrays[which].push_until(size),
            2 => {
                arrays[which].all.truncate(size);
                arrays[which].all.shrink_to_fit();
            }
            3 if arrays.len() > 20 => drop(arrays.swap_remove(which)),
            4 => assert!(vec![0u64; size].iter().all(|number| *number == 0), "new memory is zero"),
            _ => assert!(arrays[which].is_whole(), "step {step}"),
        }
    }
    assert!(arrays.iter().all(Numbers::is_whole));
    drop(arrays);

    keep_arrays_in_file(true);
    let mut large = Numbers { first: 5, all: Vec::new() };
    large.push_until(100_000_000);
    std::thread::sleep(std::time::Duration::from_millis(500));
    let resident = resident_mb();
    assert!(resident < 400.0, "{resident} MB of an array of 800 MB with a budget of 150");
    assert!(large.is_whole());
}
