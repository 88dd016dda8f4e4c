#![no_main]

use voxelastic::event::Event;
use voxelastic_fuzz::{check, check_memory, dumps};
use voxelastic_io::{OpenOptions, dataset, poses};

/// A letter for what left the folder, and one of its files; the rest of the folder is sound.
fn read(data: &[u8]) {
    let Some((letter, data)) = data.split_first() else { return };
    let place = dumps::put(usize::from(letter.wrapping_sub(b'a')), data);
    if place.extension().is_some() {
        let _ = poses::read(&place);
        return;
    }
    if let Ok(dataset) = dataset::open(&place, &OpenOptions::default()) {
        let _ = dataset.description().to_string();
        for event in dataset.events() {
            match event {
                Ok(Event::Scan(scan)) => check(&scan.cloud),
                Ok(Event::PoseUpdate(poses)) => assert!(poses.iter().all(|(_, p)| (p.rotation.norm() - 1.0).abs() < 1e-9)),
                _ => {}
            }
        }
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
