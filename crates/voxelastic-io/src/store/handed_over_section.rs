//! The section of what a submap handed over to others: the number of these (u32); for each the other submap's id (u32), the pose of this one in it (7 f64: x, y, z, qx, qy, qz, qw),
//! the number of blocks (u64), and their keys, ascending, each as the difference from the one before in base 128. Little endian. Absent where there is nothing.

use super::bytes::{Bytes, push_varint};
use super::frames::Section;
use crate::Result;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use std::io::{self, Write};
use voxelastic::Pose;
use voxelastic::atlas::{HandedOver, Submap};
use xxhash_rust::xxh3::xxh3_64;

/// How far a quaternion's norm may be from 1.
const TOLERANCE: f64 = 1e-3;
/// Keys are below this.
const KEY_END: u64 = 1 << 63;

fn bytes(submap: &Submap) -> Vec<u8> {
    let mut out = (submap.handed_over().len() as u32).to_le_bytes().to_vec();
    for record in submap.handed_over() {
        let (t, q) = (&record.t_to_submap.translation.vector, &record.t_to_submap.rotation.coords);
        out.extend(record.to.to_le_bytes());
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w].iter().for_each(|number| out.extend(number.to_le_bytes()));
        out.extend((record.keys.len() as u64).to_le_bytes());
        let mut before = 0;
        for key in record.keys.iter() {
            push_varint(&mut out, key - before);
            before = *key;
        }
    }
    out
}

/// A hash of everything that the section would hold.
pub(super) fn digest(submap: &Submap) -> u64 {
    xxh3_64(&bytes(submap))
}

/// Writes the section and returns its [`digest`].
pub(super) fn write(submap: &Submap, out: &mut impl Write) -> io::Result<u64> {
    let bytes = bytes(submap);
    out.write_all(&bytes)?;
    Ok(xxh3_64(&bytes))
}

/// Reads a section whose checksum is right.
pub(super) fn read(section: &Section<'_>) -> Result<Vec<HandedOver>> {
    parse(section.bytes).map_err(|what| section.damaged(0, what))
}

fn parse(bytes: &[u8]) -> std::result::Result<Vec<HandedOver>, String> {
    let mut bytes = Bytes::new(bytes);
    let count = bytes.u32()?;
    let mut records = Vec::new();
    for _ in 0..count {
        let to = bytes.u32()?;
        let mut number = || bytes.u64().map(f64::from_bits);
        let [x, y, z, qx, qy, qz, qw] = [number()?, number()?, number()?, number()?, number()?, number()?, number()?];
        let rotation = UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz));
        let is_pose = [x, y, z].iter().all(|n| n.is_finite()) && (rotation.norm() - 1.0).abs() <= TOLERANCE;
        if !is_pose {
            return Err(format!("the pose in submap {to} is none"));
        }
        let (blocks, mut keys, mut key) = (bytes.u64()?, Vec::new(), 0u64);
        for i in 0..blocks {
            let step = bytes.varint()?;
            key = key.checked_add(step).filter(|key| (i == 0 || step > 0) && *key < KEY_END).ok_or("keys of blocks do not ascend")?;
            keys.push(key);
        }
        records.push(HandedOver { to, t_to_submap: Pose::from_parts(Translation3::new(x, y, z), rotation), keys: keys.into() });
    }
    bytes.end()?;
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_handed_over_comes_back(
            all in prop::collection::vec((any::<u32>(), prop::array::uniform6(-9f64..9.0), prop::collection::btree_set(0..KEY_END, 1..40)), 0..4),
        ) {
            let record = |(to, [x, y, z, a, b, c], keys): (u32, [f64; 6], std::collections::BTreeSet<u64>)| HandedOver {
                to,
                t_to_submap: Pose::new(nalgebra::Vector3::new(x, y, z), nalgebra::Vector3::new(a, b, c)),
                keys: keys.into_iter().collect(),
            };
            let submap = Submap::new(0, 0.1, Pose::identity()).with_handed_over(all.into_iter().map(record).collect());
            prop_assert_eq!(parse(&bytes(&submap)), Ok(submap.handed_over().to_vec()));
            let mut longer = bytes(&submap);
            longer.push(0);
            prop_assert!(parse(&longer).is_err());
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
            if let Ok(records) = parse(&bytes) {
                prop_assert!(records.iter().all(|record| record.keys.is_sorted()));
            }
        }
    }

    #[test]
    fn keys_that_do_not_ascend_are_refused() {
        let record = HandedOver { to: 3, t_to_submap: Pose::identity(), keys: [5, 9].into() };
        let submap = Submap::new(0, 0.1, Pose::identity()).with_handed_over(vec![record]);
        let mut bytes = bytes(&submap);
        assert!(parse(&bytes).is_ok());
        *bytes.last_mut().unwrap() = 0;
        assert!(parse(&bytes).is_err_and(|what| what.contains("ascend")));
    }
}
