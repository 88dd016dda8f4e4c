//! A message of any type in a recording that is otherwise sound: MCAP without chunks, whose checksums would keep mutations out.

use std::path::PathBuf;

/// The topic of the message that is tried.
pub const TOPIC: &str = "/tried";
/// The topic of a cloud of one point.
pub const CLOUDS: &str = "/points";

/// A recording of one message of the given type and encoding, and one sound cloud.
pub fn bag(kind: &str, encoding: &str, message: &[u8]) -> Vec<u8> {
    let mut bag = b"\x89MCAP0\r\n".to_vec();
    let mut record = |op: u8, parts: &[&[u8]]| {
        bag.push(op);
        bag.extend((parts.iter().map(|p| p.len() as u64).sum::<u64>()).to_le_bytes());
        parts.iter().for_each(|p| bag.extend(*p));
    };
    let (one, two, none, time) = (1u16.to_le_bytes(), 2u16.to_le_bytes(), 0u32.to_le_bytes(), 100_000_000_000u64.to_le_bytes());
    record(0x01, &[&text("ros2"), &text("")]);
    for (number, kind, topic, encoding) in [(one, "sensor_msgs/msg/PointCloud2", CLOUDS, "cdr"), (two, kind, TOPIC, encoding)] {
        record(0x03, &[&number, &text(kind), &text(""), &none]);
        record(0x04, &[&number, &number, &text(topic), &text(encoding), &none]);
    }
    record(0x05, &[&one, &none, &time, &time, &cloud()]);
    record(0x05, &[&two, &none, &time, &time, message]);
    record(0x0f, &[&none]);
    record(0x02, &[&[0; 20]]);
    bag.extend(b"\x89MCAP0\r\n");
    bag
}

/// A trajectory of one pose.
pub fn trajectory() -> PathBuf {
    crate::file(b"100 0 0 0 0 0 0 1\n", "tum")
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

/// `sensor_msgs/PointCloud2` of one point as CDR; every field begins where it is aligned anyway.
fn cloud() -> Vec<u8> {
    let mut cdr = vec![0, 1, 0, 0];
    let mut numbers = |numbers: &[u32]| numbers.iter().for_each(|n| cdr.extend(n.to_le_bytes()));
    // Stamp, the frame "lid", height, width, three fields.
    numbers(&[100, 0, 4, u32::from_le_bytes(*b"lid\0"), 1, 1, 3]);
    for (name, offset) in [(b"x\0\0\0", 0), (b"y\0\0\0", 4), (b"z\0\0\0", 8)] {
        // The kind is a byte, followed by padding.
        numbers(&[2, u32::from_le_bytes(*name), offset, 7, 1]);
    }
    // Endianness with its padding, bytes of a point, of a row, of all.
    numbers(&[0, 12, 12, 12]);
    numbers(&[1.0f32.to_bits(), 2.0f32.to_bits(), 3.0f32.to_bits()]);
    cdr.push(1);
    cdr
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic_io::dataset::Keyframing;
    use voxelastic_io::{OpenOptions, bag::Recording};

    #[test]
    fn the_sound_part_is_sound() {
        let path = crate::file(&bag("nav_msgs/msg/Odometry", "cdr", &[]), "mcap");
        let options = OpenOptions { keyframing: Some(Keyframing::All), poses: Some(trajectory()), cloud_topic: Some(CLOUDS.into()), ..OpenOptions::default() };
        let events: Vec<_> = Recording::open(&path, &options).unwrap().events().collect();
        assert!(events.len() == 1 && events[0].is_ok(), "{events:?}");
    }
}
