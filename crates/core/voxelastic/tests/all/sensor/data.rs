//! Real scans, where they are; the plain binary layouts of the development data.

use voxelastic::Cloud;

/// A file of the recorded data; none, after noting the skip, where it is absent.
fn bytes(relative: &str) -> Option<Vec<u8>> {
    voxelastic_testing::data(relative).map(|path| std::fs::read(path).unwrap())
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

/// The numbers of a file of 32-bit floats.
pub fn numbers(relative: &str) -> Option<Vec<f32>> {
    bytes(relative).map(|bytes| floats(&bytes))
}

/// Points of `columns` floats each, of which the first three are coordinates.
pub fn raw(relative: &str, columns: usize) -> Option<Cloud> {
    let values = floats(&bytes(relative)?);
    Some(Cloud::from_points(values.chunks_exact(columns).map(|v| [v[0], v[1], v[2]]).collect()))
}

/// Points of a binary PCD file with the fields x y z, and perhaps more of four bytes.
pub fn pcd(relative: &str) -> Option<Cloud> {
    const MARK: &[u8] = b"DATA binary\n";
    let bytes = bytes(relative)?;
    let end = bytes.windows(MARK.len()).position(|w| w == MARK)?;
    let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
    let fields = header.lines().find_map(|l| l.strip_prefix("FIELDS "))?.split_whitespace().count();
    let values = floats(&bytes[end + MARK.len()..]);
    Some(Cloud::from_points(values.chunks_exact(fields).map(|v| [v[0], v[1], v[2]]).collect()))
}
