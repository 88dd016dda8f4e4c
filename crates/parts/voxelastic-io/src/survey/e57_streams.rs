//! Whether the values of an E57's points come together. Each value of a point has a stream of its own; the decoder keeps what has come of one until the others follow, which a few
//! megabytes can make gigabytes.

use e57::{PointCloud, RecordDataType};
use std::io::{self, Read, Seek, SeekFrom};

/// So many values may wait for those of the other streams: 64 MB in the decoder. Packets hold up to 65,536 bytes of all streams, and writers fill them evenly.
const MOST_WAITING: u64 = 4_000_000;
/// Bytes of a page that are its checksum.
const CHECKSUM: u64 = 4;

/// Whether more values of some streams would have to wait than there is room for. Follows packets as the decoder does; what is damaged is left to it.
pub(super) fn are_apart<R: Read + Seek>(file: R, described: &PointCloud) -> bool {
    most_waiting(file, described, MOST_WAITING).is_ok_and(|waiting| waiting > MOST_WAITING)
}

/// The largest number of values that wait, or the first that is above `enough`.
fn most_waiting<R: Read + Seek>(file: R, described: &PointCloud, enough: u64) -> io::Result<u64> {
    let mut pages = Pages::new(file)?;
    pages.go_to(described.file_offset);
    let header: [u8; 32] = pages.bytes()?;
    pages.go_to(u64_at(&header, 16));
    let bits: Vec<u64> = described.prototype.iter().map(|record| bits(&record.data_type)).collect();
    let mut stored = vec![0u64; bits.len()];
    let mut most = 0;
    loop {
        let values = || stored.iter().zip(&bits).filter(|(_, bits)| **bits > 0).map(|(stored, bits)| 8 * stored / bits);
        let complete = values().min().unwrap_or(0);
        most = most.max(values().map(|values| values - complete).sum());
        if complete >= described.records || most > enough {
            return Ok(most);
        }
        match pages.bytes::<1>()? {
            [1] => {
                let head: [u8; 5] = pages.bytes()?;
                if usize::from(u16_at(&head, 3)) != stored.len() {
                    return Ok(most);
                }
                let mut length = 0;
                for stored in &mut stored {
                    let size = u64::from(u16::from_le_bytes(pages.bytes()?));
                    (*stored, length) = (*stored + size, length + size);
                }
                pages.at += length;
            }
            [0] => pages.at += 1 + u64::from(u16_at(&pages.bytes::<15>()?, 1)),
            [2] => pages.at += 1 + u64::from(u16_at(&pages.bytes::<3>()?, 1)),
            _ => return Ok(most),
        }
        pages.at = pages.at.next_multiple_of(4);
    }
}

/// Bits of a value.
fn bits(of: &RecordDataType) -> u64 {
    match of {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::ScaledInteger { min, max, .. } | RecordDataType::Integer { min, max } => {
            let range = i128::from(*max) - i128::from(*min);
            if range > 0 { u64::from(range.ilog2()) + 1 } else { 0 }
        }
    }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|k| bytes[at + k]))
}

/// What pages hold without their checksums.
struct Pages<R> {
    file: R,
    page: u64,
    /// Where it is read, counted without checksums.
    at: u64,
}

impl<R: Read + Seek> Pages<R> {
    fn new(mut file: R) -> io::Result<Self> {
        let mut header = [0; 48];
        file.rewind()?;
        file.read_exact(&mut header)?;
        let page = u64_at(&header, 40);
        if page <= CHECKSUM { Err(io::ErrorKind::InvalidData.into()) } else { Ok(Self { file, page, at: 0 }) }
    }

    /// Goes to an offset of the file.
    fn go_to(&mut self, offset: u64) {
        self.at = offset / self.page * (self.page - CHECKSUM) + offset % self.page;
    }

    fn bytes<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        let mut done = 0;
        while done < N {
            let (held, within) = (self.page - CHECKSUM, self.at % (self.page - CHECKSUM));
            let count = (N - done).min((held - within) as usize);
            self.file.seek(SeekFrom::Start((self.at / held).saturating_mul(self.page).saturating_add(within)))?;
            self.file.read_exact(&mut bytes[done..done + count])?;
            (done, self.at) = (done + count, self.at + count as u64);
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use e57::{E57Reader, E57Writer, Record, RecordName, RecordValue};
    use std::io::Cursor;

    /// A file of points with a bit for x and 64 for y, and what it holds.
    fn file(points: u64) -> (Vec<u8>, PointCloud) {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = E57Writer::new(&mut bytes, "test").unwrap();
        let bit = RecordDataType::ScaledInteger { min: 0, max: 1, scale: 1.0, offset: 0.0 };
        let double = RecordDataType::Double { min: None, max: None };
        let records = [(RecordName::CartesianX, bit), (RecordName::CartesianY, double.clone()), (RecordName::CartesianZ, double)];
        let mut scan = writer.add_pointcloud("cloud", records.map(|(name, data_type)| Record { name, data_type }).to_vec()).unwrap();
        for k in 0..points {
            scan.add_point(vec![RecordValue::ScaledInteger((k % 2) as i64), RecordValue::Double(k as f64), RecordValue::Double(1.0)]).unwrap();
        }
        scan.finalize().unwrap();
        writer.finalize().unwrap();
        drop(writer);
        let bytes = bytes.into_inner();
        let described = E57Reader::new(Cursor::new(&bytes)).unwrap().pointclouds().remove(0);
        (bytes, described)
    }

    #[test]
    fn what_waits_is_counted_over_pages_and_packets() {
        let (bytes, mut described) = file(50_000);
        let waiting = most_waiting(Cursor::new(&bytes), &described, u64::MAX).unwrap();
        assert!(bytes.len() > 800_000 && waiting < 60_000, "writers fill packets evenly: {waiting}");
        assert!(!are_apart(Cursor::new(&bytes), &described));
        // Read as if y took a bit, too: its stream is sixty times ahead of that of z.
        described.prototype[1].data_type = RecordDataType::ScaledInteger { min: 0, max: 1, scale: 1.0, offset: 0.0 };
        let waiting = most_waiting(Cursor::new(&bytes), &described, u64::MAX).unwrap();
        assert!((3_000_000..3_300_000).contains(&waiting), "{waiting}");
        let (bytes, mut longer) = file(100_000);
        longer.prototype[1].data_type = described.prototype[1].data_type.clone();
        assert!(are_apart(Cursor::new(&bytes), &longer));
    }
}
